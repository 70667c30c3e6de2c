"""Every type of aid against what its sensor reads, written out by hand, and its H against finite differences, at random poses with all its states."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from riins_core.frames import ned_offset
from riins_core.rotation import dcm_from_euler, exp_so3, quat_from_dcm
from riins_core.settings import SettingError, build
from riins_federated.aid_inputs import inputs
from riins_federated.aiding import AidModel, Pose, models_of, noise, white_inflation
from riins_federated.aids import AID_MODELS, DEFAULT_AIDS, make
from riins_federated.config import NavigatorConfig
from riins_federated.inertial_model import InertialModel
from riins_federated.integrated_filter import IntegratedFilter
from riins_federated.known_height import HeightAid, HeightModel
from riins_federated.state_blocks import StateModel
from riins_federated.types import Aid, Array, Reason

LEVER, SIGMAS = [3.0, -2.0, -9.0], {"lever_sigma_m": 0.5, "delay_sigma_s": 0.1}
MOUNTED = {"mounting_yaw_deg": 20.0, "mounting_pitch_deg": -4.0, "misalignment_deg": 1.0, "misalignment_pitch_deg": 1.0, "scale_ppm": 1e4}


class Truth(NamedTuple):
    """True motion, and the true value of each state of the aid's own."""

    pose: Pose
    own: dict[str, Array]

    def at(self, name: str, size: int = 1) -> Array:
        """A state of its own, zero where it is off."""
        return self.own.get(name, np.zeros(size))

    def velocity_b(self, lever: Any, water: Array | None = None) -> Array:
        """At a lever arm, body."""
        relative = self.pose.v_n - (np.zeros(3) if water is None else water)
        return self.pose.C_nb.T @ relative + np.cross(self.pose.rate_b, np.asarray(lever) + self.at("lever", 3))

    def sensor_velocity(self, settings: Any, lever: Any, water: Array | None = None) -> Array:
        """The same in the axes of a mounted sensor."""
        pitch = np.radians(settings.mounting_pitch_deg) + self.at("pitch")[0]
        yaw = np.radians(settings.mounting_yaw_deg) + self.at("yaw")[0]
        return np.asarray(dcm_from_euler(0.0, pitch, yaw).T @ self.velocity_b(lever, water))


def antenna(t: Truth, s: Any) -> Array:
    offset = t.pose.C_nb @ (np.array(s.lever_arm_m) + t.at("lever", 3)) + np.resize(np.append(t.at("markov", 3), 0.0), 3)
    return np.array([float(v) for v in ned_offset(t.pose.lat, t.pose.lon, t.pose.h, offset)])


def antenna_velocity(t: Truth, s: Any) -> Array:
    return t.pose.C_nb @ t.velocity_b(s.lever_arm_m) + t.at("markov", 3)


def log(t: Truth, s: Any) -> Array:
    current = np.append(t.at("current", 2), 0.0)
    return (1.0 + t.at("scale")) * t.sensor_velocity(s, s.lever_arm_m, current) + t.at("markov", 3)


def beams(t: Truth, s: Any) -> Array:
    v = t.sensor_velocity(s, s.lever_arm_m)
    angle = np.radians(s.beam_angle_deg)
    along = [[np.sin(angle) * np.cos(a), np.sin(angle) * np.sin(a), np.cos(angle)] for a in np.radians(s.beam_azimuth_deg)]
    read = s.beam_sign * (1.0 + t.at("scale")) * (np.array(along) @ v)
    read[1] = np.nan  # has lost the bottom
    return read


def wheels(t: Truth, s: Any) -> Array:
    return (1.0 + t.at("scale")) * t.sensor_velocity(s, s.lever_arm_m)[:1]


def barometer(t: Truth, s: Any) -> Array:
    return t.pose.h - (t.pose.C_nb @ (np.array(s.lever_arm_m) + t.at("lever", 3)))[2:] - s.zero_m + t.at("markov")


def compass(t: Truth, s: Any) -> Array:
    if s.two_antennas:  # the azimuth of the line from one to the other
        line = t.pose.C_nb @ dcm_from_euler(0.0, 0.0, np.radians(s.offset_deg))[:, 0]
        return np.arctan2(line[1], line[0]) + t.at("deviation")
    return np.arctan2(t.pose.C_nb[1, 0], t.pose.C_nb[0, 0]) + np.radians(s.offset_deg) + t.at("deviation")


def stars(t: Truth, s: Any) -> Array:
    return quat_from_dcm(t.pose.C_nb @ exp_so3(t.at("mounting", 3)) @ dcm_from_euler(*np.radians(s.mounting_rpy_deg)))


CASES: list[tuple[str, Callable[[Truth, Any], Array], dict[str, Any]]] = [
    ("gnss_position", antenna, {"lever_arm_m": LEVER, **SIGMAS, "use_height": True, "markov_sigma_m": 3.0, "markov_state": True}),
    ("gnss_position", antenna, {"lever_arm_m": LEVER}),
    ("gnss_velocity", antenna_velocity, {"lever_arm_m": LEVER, **SIGMAS, "markov_sigma_mps": 0.1, "markov_state": True}),
    ("body_velocity", log, {"lever_arm_m": LEVER, **SIGMAS, **MOUNTED, "use_down": True, "markov_sigma_mps": 0.1, "markov_state": True}),
    ("body_velocity", log, {"lever_arm_m": LEVER, **MOUNTED, "use_down": True, "scale_each_axis": True}),
    ("body_velocity", log, {"lever_arm_m": LEVER, "misalignment_deg": 0.0}),
    ("water_velocity", log, {"lever_arm_m": LEVER, **SIGMAS, **MOUNTED, "use_down": True}),
    ("beam_velocity", beams, {"lever_arm_m": LEVER, **SIGMAS, **MOUNTED, "beam_sign": -1}),
    ("odometer", wheels, {"lever_arm_m": LEVER, **SIGMAS, **MOUNTED, "sideways_mps": 0.0, "down_mps": 0.0}),
    ("height", barometer, {"lever_arm_m": LEVER, **SIGMAS, "zero_m": 30.0, "markov_sigma_m": 5.0, "markov_state": True}),
    ("heading", compass, {"delay_sigma_s": 0.1, "offset_deg": 90.0, "deviation_deg": 2.0}),
    ("heading", compass, {"delay_sigma_s": 0.1, "offset_deg": 90.0, "two_antennas": True, "deviation_deg": 2.0}),
    ("attitude", stars, {"delay_sigma_s": 0.1, "mounting_rpy_deg": [10.0, -80.0, 30.0], "misalignment_deg": 1.0}),
]
SIZES = {"lever": 0.3, "delay": 0.0, "markov": 0.05, "yaw": 0.01, "pitch": 0.01, "scale": 0.005, "current": 0.4, "deviation": 0.02, "mounting": 0.01}
STEPS = {"m]": 1e-2, "m/s]": 1e-4, "rad]": 1e-6, "1]": 1e-6, "s]": 1e-4}


def declared(kind: str, values: dict[str, Any]) -> tuple[AidModel[Any], StateModel]:
    model = make("aid", build(AID_MODELS[kind].Settings, {"type": kind, **values}))
    states = StateModel(InertialModel(), (), model.blocks())
    model.place(states)
    return model, states


def scene(model: AidModel[Any], states: StateModel, seed: int) -> tuple[Truth, np.ndarray, np.ndarray]:
    """Random true motion and own states, the navigation state and the parameters that say the same."""
    rng = np.random.default_rng(seed)
    nav, parameters = np.zeros(16), np.zeros(states.n - 9)
    nav[0:3] = rng.uniform(-1.2, 1.2), rng.uniform(-3.0, 3.0), rng.uniform(-50.0, 5000.0)
    nav[3:6] = rng.normal(size=3) * [10.0, 10.0, 1.0]
    nav[6:15] = dcm_from_euler(rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3.0, 3.0)).ravel()
    own = {name: SIZES[name] * rng.normal(size=place.stop - place.start) for name, place in model.at.items()}
    for name, place in model.at.items():
        parameters[place.start - 9 : place.stop - 9] = own[name]
    return Truth(pose(nav, rng.normal(size=3) * 0.2, rng.normal(size=3)), own), nav, parameters


def pose(nav: np.ndarray, rate_b: np.ndarray, a_n: np.ndarray) -> Pose:
    return Pose(nav[0], nav[1], nav[2], nav[3:6], nav[6:15].reshape(3, 3), rate_b, a_n)


def measured(model: AidModel[Any], z: Array) -> Aid:
    side = 3 if model.kind in ("attitude", "odometer") else len(z)
    return Aid("aid", 0, z, np.zeros((side, side)))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("kind", "sensor", "values"), CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_the_true_state_leaves_no_innovation_and_h_is_its_derivative(
    kind: str, sensor: Callable[[Truth, Any], Array], values: dict[str, Any], seed: int
) -> None:
    model, states = declared(kind, values)
    truth, nav, parameters = scene(model, states, seed)
    aid = measured(model, sensor(truth, model.settings))
    assert model.defect(aid) is Reason.NONE
    there = model.measurement(aid, truth.pose, parameters)
    assert np.abs(there.z).max() < 2e-4  # metres on a curved Earth
    assert np.linalg.eigvalsh(there.R).min() > 0.0

    def innovation(x: np.ndarray) -> np.ndarray:
        """Of a navigator whose errors are x, computed minus true."""
        wrong, estimates = nav.copy(), parameters.copy()
        states.correct(wrong, estimates, -x)
        return model.measurement(aid, pose(wrong, truth.pose.rate_b, truth.pose.a_n), estimates).z

    for i in [*range(9), *range(15, states.n)]:
        x = np.zeros(states.n)
        x[i] = STEPS[states.labels[i].split("[")[1]]
        slope = (innovation(x) - innovation(-x)) / (2.0 * x[i])
        assert slope == pytest.approx(there.H[:, i], rel=1e-4, abs=1e-4 * max(1.0, np.abs(there.H[:, i]).max())), states.labels[i]


@pytest.mark.parametrize(("kind", "sensor", "values"), [c for c in CASES if "delay_sigma_s" in c[2]], ids=lambda v: v if isinstance(v, str) else "")
def test_a_measurement_that_was_taken_earlier_fits_once_its_delay_is_known(
    kind: str, sensor: Callable[[Truth, Any], Array], values: dict[str, Any]
) -> None:
    model, states = declared(kind, values)
    truth, _, parameters = scene(model, states, 4)
    early = truth._replace(pose=truth.pose.moved(-0.05))
    aid = measured(model, sensor(early, model.settings))
    late = model.measurement(aid, truth.pose, parameters)
    parameters[model.at["delay"].start - 9] = 0.05
    known = model.measurement(aid, truth.pose, parameters)
    assert np.abs(known.z).max() < 2e-4
    assert late.z == pytest.approx(late.H[:, model.at["delay"].start] * -0.05, rel=0.05, abs=2e-3)  # computed minus true is -0.05


def test_an_odometer_says_that_the_axle_moves_neither_sideways_nor_down() -> None:
    model, states = declared("odometer", {"axle_m": [-1.5, 0.0, 0.5], "lever_arm_m": [1.0, 0.8, 0.5], "misalignment_deg": 1.0})
    truth, nav, parameters = scene(model, states, 5)
    at_axle = np.array([7.0, 0.0, 0.0])
    v_b = dcm_from_euler(0.0, 0.0, truth.at("yaw")[0]) @ at_axle - np.cross(truth.pose.rate_b, [-1.5, 0.0, 0.5])
    nav[3:6] = truth.pose.C_nb @ v_b
    truth = truth._replace(pose=pose(nav, truth.pose.rate_b, truth.pose.a_n))
    aid = Aid("aid", 0, wheels(truth, model.settings), np.diag([0.04, 0.01, 0.0]))
    found = model.measurement(aid, truth.pose, parameters)
    assert np.abs(found.z).max() < 1e-12 and np.diag(found.R) == pytest.approx([0.04, 0.01, 0.01])
    for i in (*range(3, 9), model.at["yaw"].start):
        x = np.zeros(states.n)
        x[i] = 1e-5
        wrong, estimates = nav.copy(), parameters.copy()
        states.correct(wrong, estimates, -x)
        slope = model.measurement(aid, pose(wrong, truth.pose.rate_b, truth.pose.a_n), estimates).z / 1e-5
        assert slope == pytest.approx(found.H[:, i], abs=1e-3)


def test_a_vehicle_that_stands() -> None:
    model, states = declared("zero_velocity", {"lever_arm_m": LEVER, "lever_sigma_m": 0.5})
    truth, nav, parameters = scene(model, states, 6)
    nav[3:6] = -truth.pose.C_nb @ np.cross(truth.pose.rate_b, np.array(LEVER) + truth.at("lever", 3))  # it turns about the point that stands
    truth = truth._replace(pose=pose(nav, truth.pose.rate_b, truth.pose.a_n))
    aid = Aid("aid", 0, np.zeros(3), np.zeros((3, 3)))
    found = model.measurement(aid, truth.pose, parameters)
    assert np.abs(found.z).max() < 1e-12 and np.diag(found.R) == pytest.approx(0.02**2)
    for i in (*range(3, 9), *range(15, states.n)):
        x = np.zeros(states.n)
        x[i] = 1e-6
        wrong, estimates = nav.copy(), parameters.copy()
        states.correct(wrong, estimates, -x)
        slope = model.measurement(aid, pose(wrong, truth.pose.rate_b, truth.pose.a_n), estimates).z / 1e-6
        assert slope == pytest.approx(found.H[:, i], abs=1e-4)


def test_the_known_height_with_a_tide() -> None:
    model = HeightModel(HeightAid(mean_m=20.0, undulation_m=-8.0, bias_m=1.0))
    states = StateModel(InertialModel(), (), model.blocks())
    model.place(states)
    at = states.places["height.bias"].start
    parameters = np.zeros(states.n - 9)
    parameters[at - 9] = 0.7
    here = Pose(0.5, 0.1, 12.7, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
    found = model.measurement(here, parameters)
    assert found.z == pytest.approx(0.0, abs=1e-12) and (found.H[0, 2], found.H[0, at]) == (-1.0, 1.0)
    assert HeightModel(HeightAid()).blocks()[0].sigma == 0.0


@pytest.mark.parametrize(
    ("kind", "z", "R", "reason"),
    [
        ("gnss_position", [2.0, 0.0, 0.0], np.eye(3), Reason.NOT_FINITE),
        ("gnss_position", [0.5, 0.0, np.nan], np.eye(3), Reason.NONE),  # its height is not used
        ("gnss_position", [0.5, 0.0], np.eye(3), Reason.NOT_FINITE),
        ("gnss_position", [0.5, 0.0, 0.0], -np.eye(3), Reason.COVARIANCE),
        ("gnss_velocity", [0.5, 0.0, np.nan], np.eye(3), Reason.NOT_FINITE),
        ("body_velocity", [0.5, 0.0, np.nan], np.eye(3), Reason.NONE),
        ("beam_velocity", [1.0, np.nan, np.nan, np.nan], np.zeros((4, 4)), Reason.NONE),
        ("beam_velocity", [np.nan] * 4, np.zeros((4, 4)), Reason.NOT_FINITE),
        ("beam_velocity", [1.0, np.inf, 1.0, 1.0], np.zeros((4, 4)), Reason.NOT_FINITE),
        ("beam_velocity", [1.0, 1.0, 1.0, 1.0], np.diag([1.0, 0.0, 1.0, 1.0]), Reason.COVARIANCE),
        ("beam_velocity", [1.0, np.nan, 1.0, 1.0], np.diag([1.0, np.nan, 1.0, 1.0]), Reason.NONE),
        ("odometer", [np.nan], np.zeros((3, 3)), Reason.NOT_FINITE),
        ("odometer", [1.0], np.diag([-1.0, 1.0, 1.0]), Reason.COVARIANCE),
        ("zero_velocity", [0.0, 0.0, 0.0], np.zeros((3, 3)), Reason.NONE),
        ("zero_velocity", [0.0, 0.1, 0.0], np.zeros((3, 3)), Reason.NOT_FINITE),  # it does not stand
        ("height", [1.0], np.zeros((1, 1)), Reason.NONE),
        ("height", [1.0], -np.ones((1, 1)), Reason.COVARIANCE),
        ("heading", [np.nan], np.zeros((1, 1)), Reason.NOT_FINITE),
        ("attitude", [np.nan] * 4, np.zeros((3, 3)), Reason.NOT_FINITE),
        ("attitude", [0.0, 0.0, 0.0, 3.0], np.zeros((3, 3)), Reason.NOT_FINITE),
        ("attitude", [0.0, 0.0, 0.0, 1.0], np.diag([1.0, -1.0, 1.0]), Reason.COVARIANCE),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_reason(kind: str, z: list[float], R: Array, reason: Reason) -> None:
    model, _ = declared(kind, {})
    assert model.defect(Aid("aid", 0, np.array(z), np.asarray(R))) is reason


def test_frame_and_fix() -> None:
    model, _ = declared("heading", {"frame": "compass_link"})
    good = Aid("aid", 0, np.zeros(1), np.zeros((1, 1)), frame="compass_link")
    assert model.defect(good) is Reason.NONE
    assert model.defect(Aid("aid", 0, np.zeros(1), np.zeros((1, 1)), frame="base_link")) is Reason.FRAME
    assert model.defect(Aid("aid", 0, np.zeros(1), np.zeros((1, 1)))) is Reason.NONE  # it did not come in a message
    assert model.defect(Aid("aid", 0, np.zeros(1), np.zeros((1, 1)), ok=False)) is Reason.NO_FIX


@pytest.mark.parametrize(
    ("kind", "sigma", "z"),
    [("gnss_position", "m", 3), ("gnss_velocity", "mps", 3), ("body_velocity", "mps", 3), ("beam_velocity", "mps", 4), ("odometer", "mps", 1),
     ("height", "m", 1), ("attitude", "deg", 4)],
)  # fmt: skip
def test_a_correlated_error_without_a_state_is_a_larger_white_noise(kind: str, sigma: str, z: int) -> None:
    aid = measured(declared(kind, {})[0], np.array([0.0, 0.0, 0.0, 1.0])[-z:])
    here = Pose(0.5, 0.1, 0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
    covariances = []
    for values in ({}, {f"markov_sigma_{sigma}": 0.5, "markov_time_s": 20.0, "period_s": 2.0}):
        model, states = declared(kind, {**values, "misalignment_deg": 0.0} if kind in ("odometer", "body_velocity", "beam_velocity") else values)
        covariances.append(model.measurement(aid, here, np.zeros(states.n - 9)).R[0, 0])
    unit = np.radians(1.0) if sigma == "deg" else 1.0
    assert covariances[1] - covariances[0] == pytest.approx(white_inflation(0.5 * unit, 20.0, 2.0))


def test_a_heading_is_compared_around_the_circle_whatever_roll_and_pitch() -> None:
    model, _ = declared("heading", {"sigma_deg": 1.0, "sigma_floor_deg": 2.0})
    here = Pose(0.5, 0.1, 0.0, np.zeros(3), dcm_from_euler(0.3, 0.2, np.radians(359.0)), np.zeros(3), np.zeros(3))
    found = model.measurement(Aid("aid", 0, np.radians([1.0]), np.zeros((1, 1))), here, np.zeros(6))
    assert np.degrees(found.z) == pytest.approx(2.0) and found.R == pytest.approx(noise(np.zeros((1, 1)), np.radians([2.0]), 0.0))


def test_antennas_across_the_deck_of_a_ship_that_lists_do_not_read_heading_plus_90() -> None:
    """10 deg of roll and 5 of pitch: .87 deg, the tangent of the azimuth being sin roll sin pitch / cos roll."""
    C = dcm_from_euler(np.radians(10.0), np.radians(5.0), 1.0)
    here, aid = Pose(0.5, 0.1, 0.0, np.zeros(3), C, np.zeros(3), np.zeros(3)), Aid("aid", 0, np.array([1.0 + np.pi / 2.0]), np.zeros((1, 1)))
    apart = {}
    for antennas in (False, True):
        model, _ = declared("heading", {"offset_deg": 90.0, "two_antennas": antennas})
        apart[antennas] = float(np.degrees(model.measurement(aid, here, np.zeros(6)).z[0]))
    assert apart[False] == pytest.approx(0.0, abs=1e-9)
    assert apart[True] == pytest.approx(np.degrees(np.arctan(np.sin(np.radians(10.0)) * np.sin(np.radians(5.0)) / np.cos(np.radians(10.0)))))


def test_every_file_is_a_type_and_the_defaults_exist() -> None:
    assert set(AID_MODELS) >= {
        "gnss_position",
        "gnss_velocity",
        "body_velocity",
        "beam_velocity",
        "water_velocity",
        "odometer",
        "height",
        "heading",
        "attitude",
    }
    assert set(DEFAULT_AIDS.values()) <= set(AID_MODELS)
    assert all(model.Settings().type == kind for kind, model in AID_MODELS.items())


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"aids": ["gps", "compass"]}, r'"aids" names "compass", but there is no "compass.type"'),
        ({"aids": ["gps", "compass"], "compass": {"type": "compas"}}, 'must be one of .*heading.* not \'compas\''),
        ({"compass": {"type": "heading"}}, r'unknown setting "compass".*section that "aids" should name'),
        ({"aids": ["gps", "stern"], "stern": {"type": "gnss_position", "topic": "/gps/fix"}}, r'"stern" has the topic "/gps/fix".* of "gps"'),
        ({"gps": {"type": "heading"}, "bds": {"sigma_deg": 1.0}}, r'unknown setting "bds.sigma_deg"'),
        ({"gps": {"sigma_mm": [1, 1, 1]}}, r'unknown setting "gps.sigma_mm" \(did you mean "sigma_m"\?\)'),
        ({"aids": ["gyro_compass"], "gyro_compass": {"type": "heading"}}, r'"gyro_compass": names that begin with gyro_'),
        ({"states": ["gyro_scales"]}, r'"states" names "gyro_scales" \(did you mean "gyro_scale"\?\)'),
    ],
)  # fmt: skip
def test_a_wrong_declaration_is_one_clear_line(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingError, match=said) as caught:
        build(NavigatorConfig, values)
    assert "\n" not in str(caught.value)


PAGE = Path(__file__).parents[3] / "docs" / "aids.md"


def blocks_of_page(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def test_the_ship_of_the_page_can_be_built() -> None:
    config = build(NavigatorConfig, yaml.safe_load(blocks_of_page("yaml")[0])["/**"]["ros__parameters"])
    assert [one.topic for one in inputs(config.aid)] == ["bow/fix", "/gnss2/fix", "bow/velocity", "dvl/velocity", "compass/heading"]
    assert inputs(config.aid)[1].delay_ns == 200_000_000
    assert IntegratedFilter(config).states.n == 15 + 6 + 2 + 3 + 2 + 1


def test_the_new_type_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "beacon_range.py").write_text(blocks_of_page("python")[0])
    monkeypatch.syspath_prepend(tmp_path)
    (kind,) = models_of({"beacon_range": importlib.import_module("beacon_range")}).values()
    model = kind("aid", kind.Settings(lever_arm_m=tuple(LEVER), lever_sigma_m=1.0, offset_m=2.0, latitude_deg=40.0, longitude_deg=120.0))
    states = StateModel(InertialModel(), (), model.blocks())
    model.place(states)
    nav, parameters = np.zeros(16), np.zeros(states.n - 9)
    nav[0:3], nav[6:15] = (np.radians(40.01), np.radians(120.02), 10.0), dcm_from_euler(0.1, 0.2, 1.0).ravel()
    aid = Aid("aid", 0, np.array([2000.0]), np.zeros((1, 1)))
    there = model.measurement(aid, pose(nav, np.zeros(3), np.zeros(3)), parameters)
    for i in [*range(9), *range(15, states.n)]:
        x = np.zeros(states.n)
        x[i] = STEPS[states.labels[i].split("[")[1]]
        wrong, estimates = nav.copy(), parameters.copy()
        states.correct(wrong, estimates, -x)
        slope = (model.measurement(aid, pose(wrong, np.zeros(3), np.zeros(3)), estimates).z - there.z) / x[i]
        assert slope == pytest.approx(there.H[:, i], abs=1e-2), states.labels[i]


def test_an_innovation_says_in_which_frame_its_components_are() -> None:
    frames = {kind: make("one", build(model.Settings, {"type": kind})).frame for kind, model in AID_MODELS.items()}
    own = {"body_velocity", "beam_velocity", "water_velocity", "odometer"}
    assert frames == {**dict.fromkeys(AID_MODELS, "map_ned"), **dict.fromkeys(own, "one_link"), "zero_velocity": "imu_link"}
    assert make("log", build(AID_MODELS["body_velocity"].Settings, {"type": "body_velocity", "frame": "dvl"})).frame == "dvl"


@pytest.mark.parametrize("topic", ["a b", "/", "bow//fix", "\u65e5\u672c/fix", "1st/fix", "gps/fix/"])
def test_a_topic_that_ros_does_not_take_is_one_line(topic: str) -> None:
    with pytest.raises(SettingError, match=r'"gps.topic" must be words of letters') as caught:
        build(NavigatorConfig, {"gps": {"topic": topic}})
    assert "\n" not in str(caught.value)
