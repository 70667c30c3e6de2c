"""Optimal fusion with drift compensation (OPTDC): estimated drifts are fed back into the readings, gently, each by its drift factor.

Lives here: `DriftCompensatedFusion`, the drift factor of thesis 4.3.2.3.
Does not live here: drift compensation by particle filters (riins_fdi.drift), the filter's step (optimal.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from riins_core.jit import inner, jit
from riins_core.settings import setting

from .method import Fused, FusionMethod, Table, TriadModel
from .optimal import optimal_step
from .wls import weigh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CompensationSettings:
    """Settings of the drift compensation."""

    gain: float = setting(10.0, "feedback gain L", "1/s", 0.0, 1e4)


@jit
def drift_factor(total: Array, D: Array, d: Array, alpha: Array) -> None:
    """Drift factor of each sensor, written into `alpha` (n,), of sum 1.

    Parameters
    ----------
    total : (n,), sum of |steps of the compensation| so far: its share is the prior factor beta, (4-67)/(4-68)
    D, d : (n,), compensation and drift estimate: the share of |D d| is the present factor gamma, (4-69)/(4-70), which lack the absolute value

    Notes
    -----
    alpha ~ beta gamma, (4-71)/(4-72); equal where the products are zero, as at the start.
    """
    n = d.shape[0]
    s = 0.0
    for i in range(n):
        alpha[i] = total[i] * abs(D[i] * d[i])
        s += alpha[i]
    for i in range(n):
        alpha[i] = alpha[i] / s if s > 0.0 else 1.0 / n


@inner
def feed_back(d: Array, D: Array, total: Array, step: float, alpha: Array) -> None:
    """Move a part of the estimated drift `d` into the compensation `D`; `alpha` (n,) is written, the rest as in `compensated_block`."""
    drift_factor(total, D, d, alpha)
    for i in range(d.shape[0]):
        u = min(step * alpha[i], 1.0) * d[i]
        D[i] += u
        d[i] -= u  # the prediction contains the control: else the drift is counted twice
        total[i] += abs(u)


@jit
def compensated_block(
    d: Array, P: Array, D: Array, total: Array, step: float, Q: Array, R: Array, V: Array, RV: Array, W: Array, z: Array,
    x: Array, cov: Array, drift: Array, compensation: Array,
) -> None:  # fmt: skip
    """Samples one after the other.

    Parameters
    ----------
    d, P : (n,), (n, n), drift left after the compensation, its covariance, in place
    D, total : (n,), compensation and sum of its absolute steps, in place
    step : L dt
    Q .. drift : as in `optimal_block`
    compensation : (m, n), written: D as taken out of each reading
    """
    n, dof = z.shape[1], V.shape[0]
    p, dz, S, e = np.empty(dof), np.empty(dof), np.empty((dof, dof)), np.empty(dof)
    left, alpha = np.empty(n), np.empty(n)
    for k in range(z.shape[0]):
        for i in range(n):
            left[i] = z[k, i] - D[i]
            compensation[k, i] = D[i]
        optimal_step(d, P, Q, V, RV, left, p, dz, S, e)
        weigh(W, left, d, R, P, x[k], cov[k])
        for i in range(n):
            drift[k, i] = D[i] + d[i]
        feed_back(d, D, total, step, alpha)


class DriftCompensatedFusion(FusionMethod):
    """OPTDC, thesis 5.4: D += L alpha d dt is taken out of the readings, the filter goes on with what is left, x = W (z - D - d), (5-98).

    Notes
    -----
    (5-95)-(5-98) count the drift twice unless the prediction contains the control: here d loses what D gains. L alpha dt is at most 1, beyond it
    overshoots. With a linear filter and a known control the total D + d is then the OPT estimate itself: OPTDC fuses to the same numbers for any
    gain. The thesis' "OPTDC is more accurate than OPT" (52 m against 62 m) cannot come from the compensation: what it adds is compensated
    readings z - D for whoever wants them. Like OPT it is an oracle.
    """

    name = "optdc"
    title = "optimal fusion with drift compensation, told which sensors drift"
    oracle = True

    def __init__(self, model: TriadModel, settings: CompensationSettings | None = None) -> None:
        self.settings = settings or CompensationSettings()
        super().__init__(model)

    def _begin(self) -> tuple[Array, ...]:
        n = self.model.array.n
        return np.zeros(n), np.diag(self.model.P), np.zeros(n), np.zeros(n)

    def _run(self, table: Table, z: Array, out: Fused) -> None:
        # a sensor that is not used reads zero here: its drift and compensation have weight zero in V and W
        step = self.settings.gain * self.model.dt
        d, P, D, total = self._state
        compensated_block(d, P, D, total, step, self.model.Q, self.model.R, table.V, table.R, table.W, z, *out)
