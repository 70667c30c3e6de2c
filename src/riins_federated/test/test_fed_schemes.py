"""Navigation schemes of thesis chapter 6: consistency, what they share with the fusion methods, exact fixes, blocks and roll-back."""

from __future__ import annotations

import numpy as np
import pytest

from riins_core import earth, ins_error
from riins_core.imu_array import CONFIGURATIONS, ImuArray
from riins_core.rotation import dcm_from_euler
from riins_federated.schemes import SCHEMES, NavigationScheme
from riins_imu_fusion.method import TriadModel
from riins_imu_fusion.optimal import OptimalFusion

ARRAY = ImuArray(CONFIGURATIONS["dodecahedron"])
DT = 0.05
GYRO = TriadModel(ARRAY, 3e-6, drift=[1e-5, 1e-7, 1e-5, 1e-7, 1e-7, 1e-7], walk=[2e-7, 2e-8, 2e-7, 2e-8, 2e-8, 2e-8], dt=DT)
ACCEL = TriadModel(ARRAY, 5e-4, drift=[3e-3, 1e-3, 1e-3, 1e-3, 3e-3, 1e-3], walk=[3e-5, 1e-5, 1e-5, 1e-5, 3e-5, 1e-5], dt=DT)
EXACT = np.array([1e-3] * 3 + [1e-4] * 3 + [1e-8] * 3)


def rest() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Navigation state at rest, and the rate and force that keep it so."""
    c = dcm_from_euler(0.1, -0.2, 1.0)
    nav = np.zeros(16)
    nav[:3] = 0.8, 0.3, 100.0
    nav[6:15] = c.ravel()
    return nav, c.T @ earth.earth_rate_n(0.8), c.T @ [0.0, 0.0, -float(earth.gravity(0.8, 100.0))]


def simulate(m: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Start, readings (m, 6) of both kinds, drifts (2, 6) at the end."""
    nav, rate, force = rest()
    rng = np.random.default_rng(seed)
    z, last = [], []
    for model, true in ((GYRO, rate), (ACCEL, force)):
        drift = np.sqrt(model.P) * rng.standard_normal(6) + np.cumsum(np.sqrt(model.Q) * rng.standard_normal((m, 6)), axis=0)
        z.append(true @ ARRAY.H.T + drift + np.sqrt(model.R) * rng.standard_normal((m, 6)))
        last.append(drift[-1])
    return nav, z[0], z[1], np.array(last)


def errors(scheme: NavigationScheme, true: np.ndarray, nav: np.ndarray, drift: np.ndarray) -> np.ndarray:
    return np.r_[ins_error.difference(nav, true), (drift - scheme.drift).ravel()]


@pytest.mark.parametrize("name", ["wls_na", "po_na", "wls_na_without_parity"])
def test_errors_are_as_large_as_the_covariance_says(name: str) -> None:
    """All 21 states, before a fix and 10 s after one."""
    nees: list[list[float]] = [[], []]
    for seed in range(60):
        nav, gyro, accel, drift = simulate(600, seed)
        scheme = NavigationScheme(name, nav, GYRO, ACCEL)
        out = scheme.process(gyro[:400], accel[:400])
        e = ins_error.difference(out.nav[-1], nav)
        nees[0].append(e @ np.linalg.solve(scheme.covariance[:9, :9], e))
        scheme.fix(nav, EXACT)
        out = scheme.process(gyro[400:], accel[400:])
        e = errors(scheme, nav, out.nav[-1], drift)
        nees[1].append(e @ np.linalg.solve(scheme.covariance, e))
    for values, dof in zip(nees, (9, 21), strict=True):
        assert abs(np.mean(values) - dof) < 4.0 * np.sqrt(2.0 * dof / len(values))


def test_before_a_fix_the_drifts_of_po_are_those_of_optimal_fusion() -> None:
    nav, gyro, accel, _ = simulate(300, 1)
    scheme = NavigationScheme("po_na", nav, GYRO, ACCEL)
    out = scheme.process(gyro, accel)
    for model, z, fused, drift in ((GYRO, gyro, out.rate, scheme.drift[0]), (ACCEL, accel, out.force, scheme.drift[1])):
        opt = OptimalFusion(model).process(z)
        np.testing.assert_allclose(fused, opt.x, rtol=0.0, atol=1e-9 * np.sqrt(model.R[0]) + 1e-13)
        np.testing.assert_allclose(drift, opt.drift[-1], atol=1e-9 * np.sqrt(model.R[0]))


def test_the_joint_filter_is_best_and_parity_helps() -> None:
    """Variances of position (sums of three) after the fix: joint <= two filters <= no parity, the last far behind."""
    sigma = {}
    nav, gyro, accel, _ = simulate(900, 2)
    for name in ("wls_na", "po_na", "wls_na_without_parity"):
        scheme = NavigationScheme(name, nav, GYRO, ACCEL)
        scheme.process(gyro[:500], accel[:500])
        before = np.trace(scheme.covariance[:3, :3])
        scheme.fix(nav, EXACT)
        scheme.process(gyro[500:], accel[500:])
        sigma[name] = before, np.trace(scheme.covariance[:3, :3])
    joint, pseudo, none = sigma.values()
    assert joint[0] <= pseudo[0] * (1.0 + 1e-9) and joint[1] <= pseudo[1] * (1.0 + 1e-9)
    assert joint != pseudo  # they are not one and the same
    assert pseudo[0] < 0.8 * none[0] and pseudo[1] < 1.05 * joint[1] < 0.9 * none[1]


def test_noise_estimation_finds_still_drifts_still() -> None:
    nav, rate, force = rest()
    rng = np.random.default_rng(3)
    z = [true @ ARRAY.H.T + np.sqrt(model.R) * rng.standard_normal((1500, 6)) for model, true in ((GYRO, rate), (ACCEL, force))]
    loud = [TriadModel(ARRAY, np.sqrt(model.R), np.sqrt(model.P), 2.0 * np.sqrt(model.R), dt=DT) for model in (GYRO, ACCEL)]
    scheme = NavigationScheme("ipo_na", nav, *loud, gain=0.2)
    scheme.process(z[0], z[1])
    Q, R = scheme.noise
    for k, model in enumerate((GYRO, ACCEL)):
        assert np.all(Q[k] < 0.02 * model.R)
        np.testing.assert_allclose(R[k], model.R, rtol=0.1)


@pytest.mark.parametrize("name", SCHEMES)
def test_blocks_and_copies_give_the_same_bits(name: str) -> None:
    nav, gyro, accel, _ = simulate(500, 4)
    whole, parts = (NavigationScheme(name, nav, GYRO, ACCEL, estimate_every=150) for _ in range(2))
    all_at_once = np.concatenate([whole.process(gyro[:300], accel[:300]).nav, (whole.fix(nav, EXACT), whole.process(gyro[300:], accel[300:]).nav)[1]])
    made = [parts.process(gyro[a:b], accel[a:b]).nav for a, b in ((0, 1), (1, 149), (149, 151), (151, 300))]
    kept = parts.copy()
    for scheme in (parts, kept):
        scheme.fix(nav, EXACT)
        rest_of_it = [scheme.process(gyro[a:b], accel[a:b]).nav for a, b in ((300, 420), (420, 500))]
        assert np.array_equal(np.concatenate(made + rest_of_it), all_at_once)


def test_refusals() -> None:
    nav, gyro, accel, _ = simulate(5, 5)
    with pytest.raises(ValueError, match='no scheme "best"; there are wls_na, po_na'):
        NavigationScheme("best", nav, GYRO, ACCEL)
    scheme = NavigationScheme("wls_na", nav, GYRO, ACCEL)
    with pytest.raises(ValueError, match="finite"):
        scheme.process(gyro * np.nan, accel)
    with pytest.raises(ValueError, match="nine positive"):
        scheme.fix(nav, np.zeros(9))
