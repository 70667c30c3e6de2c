"""Scale factor and mounting errors of a reading: variance by formula and by the simulated sensors.

Lives here: `error_variance` against draws of riins_core's sensor model.
Does not live here: the tests that use it (riins_imu_fusion's test_fusion_motion.py).
"""

from __future__ import annotations

import numpy as np
import pytest

from riins_core.imu_array import CONFIGURATIONS
from riins_core.sensor_errors import InertialErrors, SensorErrors
from riins_fdi.motion import error_variance

H = CONFIGURATIONS["dodecahedron"]


def test_variance_is_that_of_the_simulated_sensors() -> None:
    """2000 units of six: within 10 %, over three sigma of such an estimate."""
    x = np.array([3.0, -5.0, 9.8])
    for scale, tilt in ((1e-3, 0.0), (0.0, 2e-3), (5e-4, 1e-3)):
        units = [SensorErrors(InertialErrors(scale=scale, misalignment=tilt), H, 0.01, seed, "accel") for seed in range(2000)]
        drawn = np.array([(1.0 + unit.scale) * (unit.axes @ x) - H @ x for unit in units])
        np.testing.assert_allclose(np.mean(drawn**2, axis=0), error_variance(H, x, scale, tilt), rtol=0.1, atol=1e-12)


def test_along_an_axis_only_its_scale_factor_counts_and_across_it_only_its_mounting() -> None:
    u = H[0] / np.linalg.norm(H[0])
    across = np.cross(u, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    found = error_variance(H, np.stack([2.0 * u, 3.0 * across]), 1e-3, 1e-2)
    assert found.shape == (2, 6)
    assert found[0, 0] == pytest.approx(4e-6) and found[1, 0] == pytest.approx(9e-4)
