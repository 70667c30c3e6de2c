"""The platform form: its own frequencies, damping, and a start that is at rest."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.earth import OMEGA_IE, gravity_s, radii_s
from riins_core.platform_error import UNDAMPED, Damping, PlatformNoise, PlatformState, platform_dynamics, self_aligned

LAT = np.radians(40.0)
NOISE = PlatformNoise()
SCHULER = np.sqrt(gravity_s(LAT, 0.0) / radii_s(LAT)[1])


def poles(damping: Damping) -> np.ndarray:
    """Poles of a ship at rest, without those of the sensors."""
    F = platform_dynamics(LAT, 0.0, 0.0, 0.0, 0.0, damping, NOISE.markov_time)
    return np.linalg.eigvals(F[:9, :9])


def test_undamped_it_swings_with_schuler_and_the_earth() -> None:
    found = poles(UNDAMPED)
    assert np.min(np.abs(found - 1j * OMEGA_IE)) < 0.01 * OMEGA_IE
    fast = found[np.abs(found) > 0.5 * SCHULER]
    fast = fast[np.abs(fast.imag) > 0.5 * SCHULER]
    np.testing.assert_allclose(np.abs(fast), SCHULER, rtol=0.07)  # split by the Foucault frequency
    np.testing.assert_allclose(fast.real, 0.0, atol=1e-3 * SCHULER)


def test_the_network_damps_and_is_one_at_rest() -> None:
    network = Damping()
    assert network.k1 + network.k3 / network.k2 == pytest.approx(1.0, abs=1e-3)
    found = poles(network)
    assert (found.real < 5e-6).all()  # its phase at the Earth's rate lets the 24 h mode grow, e-fold in more than two days
    fast = found[np.abs(found.imag) > 0.5 * SCHULER]
    ratio = -fast.real / np.abs(fast)
    np.testing.assert_allclose(ratio, 0.5, atol=0.1)


def test_the_start_is_at_rest() -> None:
    """What the biases and drifts bring along moves neither the velocity nor the level."""
    A = self_aligned(LAT, NOISE)
    F = platform_dynamics(LAT, 0.0, 0.0, 0.0, 0.0, Damping(), NOISE.markov_time)
    for state in (PlatformState.B_E, PlatformState.B_N, PlatformState.EPS_CX, PlatformState.EPS_RX):
        rate = F @ A[:, state]
        assert (np.abs(rate[2:4]) < 1e-9).all() and abs(rate[PlatformState.ALPHA]) <= OMEGA_IE * NOISE.bias / 9.7
    heading = np.linalg.norm(A[PlatformState.GAMMA])
    assert np.degrees(heading) * 60.0 == pytest.approx(3.16, abs=0.15)
