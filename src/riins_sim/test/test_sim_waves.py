"""Sea state: energy, distribution, encounter, and the hull's answer."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.integrate
from scipy.signal import welch

from riins_core.earth import STANDARD_GRAVITY
from riins_sim.vessel import VesselSettings, motion, response_table
from riins_sim.waves import SeaSettings, WaveField, encounter_frequency, jonswap


@pytest.mark.parametrize(("height", "period", "gamma"), [(1.5, 7.0, 3.3), (3.5, 9.0, 1.0), (6.0, 12.0, 6.0)])
def test_spectrum_holds_the_significant_wave_height(height, period, gamma):
    omega = np.linspace(0.05, 15.0, 60001)
    s = jonswap(omega, height, period, gamma)
    assert 4.0 * np.sqrt(scipy.integrate.trapezoid(s, omega)) == pytest.approx(height, rel=2e-3)
    assert omega[np.argmax(s)] == pytest.approx(2.0 * np.pi / period, rel=1e-2)
    # second moment of Pierson-Moskowitz: zero-crossing period 0.710 Tp (DNV-RP-C205 3.5.5.4)
    if gamma == 1.0:
        zero_crossing = 2.0 * np.pi * np.sqrt(scipy.integrate.trapezoid(s, omega) / np.trapezoid(omega**2 * s, omega))
        assert zero_crossing == pytest.approx(0.710 * period, rel=0.02)


def test_components_hold_the_significant_wave_height_and_so_does_a_record():
    sea = SeaSettings(significant_wave_height_m=3.0, peak_period_s=8.0, components=200)
    field = WaveField.draw(sea, 5)
    assert field.significant_wave_height == pytest.approx(3.0, rel=1e-12)
    t = np.arange(0.0, 20000.0, 0.5)
    eta = np.concatenate([field.elevation(part) for part in np.array_split(t, 20)])
    # 4 sigma of a record of T: relative error of the variance sqrt(2 pi int S^2 / T) / m0, about 2 % here
    assert 4.0 * eta.std() == pytest.approx(3.0, rel=0.05)
    frequency, power = welch(eta, fs=2.0, nperseg=4096)
    assert frequency[np.argmax(power)] == pytest.approx(1.0 / 8.0, rel=0.1)
    # the crest-trough definition of an oceanographer: mean of the highest third of zero up-crossing waves, 4 sigma within some per cent
    crossings = np.flatnonzero((eta[:-1] < 0.0) & (eta[1:] >= 0.0))
    heights = np.sort([np.ptp(eta[a:b]) for a, b in pairwise(crossings)])
    assert heights[-len(heights) // 3 :].mean() == pytest.approx(3.0, rel=0.12)


def test_the_sea_is_drawn_by_seed_and_flat_water_has_no_component():
    sea = SeaSettings(significant_wave_height_m=2.0)
    assert np.array_equal(WaveField.draw(sea, 1).phase, WaveField.draw(sea, 1).phase)
    assert not np.array_equal(WaveField.draw(sea, 1).phase, WaveField.draw(sea, 2).phase)
    fixed = SeaSettings(significant_wave_height_m=2.0, seed=9)
    assert np.array_equal(WaveField.draw(fixed, 1).phase, WaveField.draw(fixed, 2).phase)
    assert WaveField.draw(SeaSettings(), 1).amplitude.size == 0
    # waves that come from the south-west travel to the north-east
    long_crested = WaveField.draw(SeaSettings(significant_wave_height_m=1.0, direction_deg=225.0, spreading_deg=0.0), 1)
    assert np.cos(long_crested.direction) == pytest.approx(np.full(30, np.sqrt(0.5)))
    assert np.sin(long_crested.direction) == pytest.approx(np.full(30, np.sqrt(0.5)))


def test_encounter_frequency_of_head_and_following_sea():
    assert encounter_frequency(0.8, 7.0, np.pi) == pytest.approx(0.8 + 0.64 * 7.0 / STANDARD_GRAVITY)
    assert encounter_frequency(0.8, 7.0, 0.5 * np.pi) == pytest.approx(0.8)
    assert encounter_frequency(0.8, STANDARD_GRAVITY / 0.8, 0.0) == pytest.approx(0.0, abs=1e-12)  # the ship keeps pace with the crest


def _one_wave(omega: float, direction: float) -> np.ndarray:
    one = np.ones(1)
    field = WaveField(one, omega * one, omega**2 / STANDARD_GRAVITY * one, direction * one, 0.3 * one)
    return response_table(field, VesselSettings())


def _motion_at(t: float, table: np.ndarray, speed: float, heading: float, rate: float = 0.0) -> np.ndarray:
    """Motion on a straight course, or on a circle of constant rate through the same state at t = 0."""
    out = np.zeros((6, 3))
    psi = heading + rate * t
    v = speed * np.array([np.cos(psi), np.sin(psi)])
    if rate:
        x = speed / rate * np.array([np.sin(psi) - np.sin(heading), np.cos(heading) - np.cos(psi)])
    else:
        x = v * t
    a = speed * rate * np.array([-np.sin(psi), np.cos(psi)])
    motion(t, np.concatenate([x, v, a]), np.array([psi, rate, 0.0]), table, out)
    return out


@pytest.mark.parametrize("direction", [0.4, 2.0, 3.9])
def test_motion_is_met_at_the_encounter_frequency(direction):
    omega, speed, heading = 0.9, 7.7, 1.1
    table = _one_wave(omega, direction)
    period = 2.0 * np.pi / float(encounter_frequency(omega, speed, direction - heading))
    for t in (0.0, 3.1):
        here, later = _motion_at(t, table, speed, heading), _motion_at(t + period, table, speed, heading)
        assert later == pytest.approx(here, abs=1e-9)
        half = _motion_at(t + 0.5 * period, table, speed, heading)
        assert half == pytest.approx(-here, abs=1e-9)


@pytest.mark.parametrize("rate", [0.0, 0.02])
def test_derivatives_of_the_motion(rate):
    table = _one_wave(0.9, 2.0)
    t, h = 12.3, 1e-3
    before, here, after = (_motion_at(t + s * h, table, 7.0, 0.6, rate) for s in (-1, 0, 1))
    assert (after[:, 0] - before[:, 0]) / (2 * h) == pytest.approx(here[:, 1], abs=1e-6)
    assert (after[:, 1] - before[:, 1]) / (2 * h) == pytest.approx(here[:, 2], abs=1e-6)


def test_signs_of_roll_and_pitch_and_orbit():
    """Quarter of a period before the crest the water rises ahead in a following sea: the bow is up, the water carries the ship back."""
    omega = 0.4
    vessel = VesselSettings(roll_period_s=2.0, roll_damping=1.0)  # roll follows the slope nearly at once
    one = np.ones(1)

    def at(phase, direction):
        table = response_table(WaveField(one, omega * one, omega**2 / STANDARD_GRAVITY * one, direction * one, phase * one), vessel)
        return _motion_at(0.0, table, 0.0, 0.0)[:, 0]

    crest = at(0.0, 0.0)
    assert crest[3] > 0.7 and crest[1] == pytest.approx(0.0, abs=1e-12)
    rising_ahead = at(0.5 * np.pi, 0.0)  # eta = a cos(wt - kN + pi/2), slope along north k a sin > 0
    assert rising_ahead[1] > 0.0 and rising_ahead[4] > 0.0
    rising_to_starboard = at(0.5 * np.pi, 0.5 * np.pi)
    assert rising_to_starboard[0] < 0.0 and rising_to_starboard[5] > 0.0
    short = _one_wave(3.0, 0.0)
    assert abs(short[0, 6]) < 0.01  # a wave of 7 m does not heave a ship of 100 m
