"""Shapes of the faults, and that they are a function of stamp and value alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_core.sensor_errors import DEG_PER_H, KNOT, MICRO_G
from riins_core.settings import SettingError, build
from riins_sim.faults import Fault, FaultSchedule, FaultSettings, FaultType, Sample, kind_of

S = 1_000_000_000
STAMPS = np.arange(1, 101, dtype=np.int64) * S // 10  # 0.1 .. 10 s
CLEAN = np.random.default_rng(4).standard_normal((100, 6))


def before(clean, stamps=STAMPS, k_first=1):
    """`before` of a recording held in arrays."""

    def at(stamp_ns):
        i = max(int(np.searchsorted(stamps, stamp_ns)) - 1, 0)
        return Sample(int(stamps[i]), k_first + i, clean[i])

    return at


def put(*faults, seed=1, clean=CLEAN, rows=slice(None)):
    values = clean[rows].copy()
    stamps = STAMPS[rows]
    valid = FaultSchedule(faults, seed).apply_axes("gyro", stamps, 1 + int(np.searchsorted(STAMPS, stamps[0])), values, before(clean))
    return values, valid


def test_step_from_start_to_end():
    values, valid = put(Fault("gyro_2", FaultType.STEP, 3.0, start_ns=2 * S, end_ns=5 * S))
    change = values - CLEAN
    inside = (STAMPS >= 2 * S) & (STAMPS < 5 * S)
    assert change[inside, 2] == pytest.approx(3.0)
    change[inside, 2] = 0.0
    assert np.all(change == 0.0)
    assert np.all(valid == 63)


def test_ramp_starts_from_its_size_and_never_ends():
    values, _ = put(Fault("gyro_0", FaultType.RAMP, 0.5, slope=2.0, start_ns=4 * S))
    inside = STAMPS >= 4 * S
    assert (values - CLEAN)[inside, 0] == pytest.approx(0.5 + 2.0 * (STAMPS[inside] * 1e-9 - 4.0))
    assert np.all(values[~inside] == CLEAN[~inside])


def test_scale_multiplies():
    values, _ = put(Fault("gyro_5", FaultType.SCALE, -0.25, start_ns=0))
    assert values[:, 5] == pytest.approx(0.75 * CLEAN[:, 5])


def test_noise_has_its_sigma_and_is_the_same_again():
    m = 100_000
    stamps = np.arange(m, dtype=np.int64) * 1000
    values = np.zeros((m, 1))
    schedule = FaultSchedule([Fault("gyro_0", FaultType.NOISE, 2.0)], 3)
    schedule.apply_axes("gyro", stamps, 5, values, before(values))
    assert values.std() == pytest.approx(2.0, rel=4.0 / np.sqrt(2 * m))
    assert values.mean() == pytest.approx(0.0, abs=4.0 * 2.0 / np.sqrt(m))
    part = np.zeros((10, 1))
    schedule.apply_axes("gyro", stamps[500:510], 505, part, before(values))
    assert np.array_equal(part, values[500:510])


def test_stuck_holds_the_last_value_before_the_onset_with_what_other_faults_made_of_it():
    step = Fault("gyro_1", FaultType.STEP, 10.0, start_ns=1 * S)
    stuck = Fault("gyro_1", FaultType.STUCK, start_ns=3 * S, end_ns=6 * S)
    values, _ = put(step, stuck)
    inside = (STAMPS >= 3 * S) & (STAMPS < 6 * S)
    last = np.flatnonzero(STAMPS < 3 * S)[-1]
    assert np.all(values[inside, 1] == CLEAN[last, 1] + 10.0)
    assert values[np.flatnonzero(inside)[-1] + 1, 1] == CLEAN[np.flatnonzero(inside)[-1] + 1, 1] + 10.0
    # asked from the middle, it is the same value
    middle, _ = put(step, stuck, rows=slice(45, 50))
    assert np.array_equal(middle, values[45:50])
    # listed before the stuck value, or after it: the order is that in which they act
    values, _ = put(stuck, step)
    assert np.all(values[inside, 1] == CLEAN[last, 1] + 20.0)


def test_stuck_from_the_beginning_holds_the_first_value():
    values, _ = put(Fault("gyro_3", FaultType.STUCK), Fault("gyro_3", FaultType.STUCK, start_ns=5 * S))
    assert np.all(values[:, 3] == CLEAN[0, 3])


def test_dropout_clears_the_bit_of_one_sensor():
    values, valid = put(Fault("gyro_4", FaultType.DROPOUT, start_ns=1 * S, end_ns=2 * S), Fault("accel_0", FaultType.DROPOUT))
    inside = (STAMPS >= 1 * S) & (STAMPS < 2 * S)
    assert np.all(valid[inside] == 63 - 16) and np.all(valid[~inside] == 63)
    assert np.array_equal(values, CLEAN)


def test_a_sensor_that_does_not_exist_is_left_out():
    values, valid = put(Fault("gyro_7", FaultType.STEP, 1.0))
    assert np.array_equal(values, CLEAN) and np.all(valid == 63)


SOME = st.sampled_from(list(FaultType)).flatmap(
    lambda kind: st.builds(
        Fault,
        st.sampled_from([f"gyro_{i}" for i in range(6)]),
        st.just(kind),
        st.floats(0.0, 5.0),
        st.floats(-1.0, 1.0),
        st.just("all"),
        st.integers(0, 8 * S),
        st.one_of(st.none(), st.integers(8 * S + 1, 12 * S)),
    )
)


@given(st.lists(SOME, max_size=4), st.integers(1, 30))
@settings(max_examples=40, deadline=None)
def test_any_block_split_gives_the_same(faults, size):
    whole, valid = put(*faults)
    for first in range(0, 100, size):
        part, flags = put(*faults, rows=slice(first, first + size))
        assert np.array_equal(part, whole[first : first + size])
        assert np.array_equal(flags, valid[first : first + size])


def test_aids_axes_and_units():
    """10 arcmin are 10 arcmin of latitude and of longitude; metres go through the radii."""
    m = 100
    place = np.tile([0.7, 2.1, 10.0], (m, 1))
    per_metre = np.tile([1e-7, 2e-7, -1.0], (m, 1))

    def shift(*faults):
        values = place.copy()
        FaultSchedule(faults).apply_aid("gps", STAMPS, 1, values, before(place), per_metre)
        return (values - place)[-1]

    arcmin = np.deg2rad(1.0 / 60.0)
    assert shift(Fault("gps", FaultType.STEP, 10.0 * arcmin, angular=True)) == pytest.approx([10.0 * arcmin, 10.0 * arcmin, 0.0], abs=1e-15)
    assert shift(Fault("gps", FaultType.STEP, 60.0)) == pytest.approx([60e-7, 120e-7, 0.0], abs=1e-15)
    assert shift(Fault("gps", FaultType.STEP, 60.0, axis="north")) == pytest.approx([60e-7, 0.0, 0.0], abs=1e-15)
    assert shift(Fault("gps", FaultType.RAMP, slope=2.0, axis="down")) == pytest.approx([0.0, 0.0, -20.0], abs=1e-12)
    assert shift(Fault("bds", FaultType.STEP, 60.0)) == pytest.approx(0.0)


def test_aid_sticks_and_drops_out_as_a_whole():
    place = np.cumsum(np.ones((100, 3)), axis=0)
    values = place.copy()
    faults = [Fault("doppler", FaultType.STUCK, start_ns=3 * S, end_ns=4 * S), Fault("doppler", FaultType.DROPOUT, start_ns=7 * S, end_ns=8 * S)]
    present = FaultSchedule(faults).apply_aid("doppler", STAMPS, 1, values, before(place))
    stuck = (STAMPS >= 3 * S) & (STAMPS < 4 * S)
    assert np.all(values[stuck] == place[28]) and np.array_equal(values[~stuck], place[~stuck])
    assert np.array_equal(present, ~((STAMPS >= 7 * S) & (STAMPS < 8 * S)))


def test_changes_at_run_time():
    schedule = FaultSchedule([Fault("gps", FaultType.STEP, 1.0, end_ns=5 * S), Fault("gyro_1", FaultType.STEP, 1.0, start_ns=2 * S)])
    assert [f.target for f in schedule.in_force(1 * S)] == ["gps"]
    assert [f.target for f in schedule.in_force(5 * S)] == ["gyro_1"]
    assert [f.target for f in schedule.only(["gyro", "accel"]).faults] == ["gyro_1"]
    schedule.add(Fault("gps", FaultType.DROPOUT))
    assert schedule.clear("gps") == 2 and len(schedule.faults) == 1
    assert schedule.clear() == 1 and not schedule.faults


@pytest.mark.parametrize(
    ("values", "size", "slope"),
    [
        ({"target": "gyro_0", "type": "step", "size_deg_h": 3.0}, 3.0 * DEG_PER_H, 0.0),
        ({"target": "gyro_0", "type": "ramp", "slope_deg_h_s": 1.6}, 0.0, 1.6 * DEG_PER_H),
        ({"target": "gyro_0", "type": "ramp", "slope_deg_h_s": 1.0, "size_deg_s": 1.0}, np.deg2rad(1.0), DEG_PER_H),
        ({"target": "accel_5", "type": "noise", "size_mg": 2.0}, 2000.0 * MICRO_G, 0.0),
        ({"target": "accel_5", "type": "scale", "size_percent": 2.0}, 0.02, 0.0),
        ({"target": "gyro_5", "type": "scale", "size_ppm": 50.0}, 5e-5, 0.0),
        ({"target": "doppler", "type": "step", "size_kn": 10.0}, 10.0 * KNOT, 0.0),
        ({"target": "doppler", "type": "ramp", "slope_kn_s": 10.0}, 0.0, 10.0 * KNOT),
        ({"target": "bds", "type": "step", "size_m": 7.0}, 7.0, 0.0),
        ({"target": "gyro_5", "type": "stuck"}, 0.0, 0.0),
    ],
)
def test_settings_become_si(values, size, slope):
    fault = build(FaultSettings, {**values, "start_s": 1.25, "end_s": 2.5}).fault()
    assert fault.size == pytest.approx(size, rel=1e-14) and fault.slope == pytest.approx(slope, rel=1e-14)
    assert (fault.start_ns, fault.end_ns) == (1_250_000_000, 2_500_000_000)


@pytest.mark.parametrize(
    "values",
    [
        {"target": "gyro_0", "type": "stuck", "size_deg_h": 1.0},
        {"target": "gyro_0", "type": "step", "slope_deg_h_s": 1.0},
        {"target": "gyro_0", "type": "scale", "size_deg_h": 1.0},
        {"target": "gps", "type": "ramp", "slope_mps": 1.0, "size_arcmin": 1.0},
        {"target": "gps", "type": "step", "size_arcmin": 1.0, "axis": "down"},
        {"target": "gyro_0", "type": "noise", "size_deg_h": -1.0},
        {"target": "gyro_0", "type": "step", "size_deg_h": 1.0, "axis": "north"},
    ],
)
def test_settings_that_make_no_sense(values):
    with pytest.raises(SettingError):
        build(FaultSettings, {**values, "start_s": 1.0})


def test_kinds():
    assert [kind_of(t) for t in ("gyro_11", "accel_0", "gps", "bds", "doppler")] == ["gyro", "accel", "position", "position", "velocity"]
    for bad in ("gyro", "gyro_", "gyro_-1", "gyro_64", "gps_1", "", "gyro_\u0661"):  # an Arabic digit
        with pytest.raises(SettingError, match="target"):
            kind_of(bad)
