"""The parity tests of one epoch behind one interface: statistic, threshold from a false-alarm probability, isolation, ambiguity set.

Lives here: `ParityMethod` and its four kinds by name, `make`: direct comparison, optimal parity vector, singular value decomposition, GLT.
Does not live here: their mathematics where kernels share it (parity), the search over one and two sensors (search), tests over time (sequential).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from riins_core.imu_array import ImuArray
from riins_fdi.parity import ParityTest, family_threshold, fault_identifier, optimal_parity_vectors, parity_relations, parity_test
from riins_fdi.search import Diagnosis, Explanation, components, explain, single_scores

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class ParityMethod(Protocol):
    """A test of one epoch for the sensors in use.

    Attributes
    ----------
    name : word `make` takes
    test : the GLT of the same sensors, in whose form likelihoods are given
    threshold : the statistic exceeds it without a fault with the probability asked for, whatever number of tests the method makes inside
    """

    name: str
    test: ParityTest
    threshold: float

    def statistic(self, z: ArrayLike) -> Array:
        """Test statistic (...) of measurements z (..., n)."""
        ...

    def isolate(self, z: ArrayLike) -> Index:
        """Sensor (...) the method names, whether or not there is an alarm; -1: it names none."""
        ...

    def diagnose(self, z: ArrayLike) -> Diagnosis:
        """Answer for one epoch z (n,), with every explanation the method allows."""
        ...


class _Method:
    """What the methods share: the parity test of the sensors in use."""

    name = ""

    def __init__(self, array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> None:
        self.test = parity_test(array, mask, sigma, pfa)
        if self.test.dof < 1:
            raise ValueError(f"the sensors in use have no redundancy: {self.test.capability.name.lower()}")
        self.sigma: Array = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (array.n,)).copy()
        self.threshold = self.test.threshold
        self._used = np.any(self.test.V != 0.0, axis=0)
        self._checked = np.flatnonzero(self.test.gain > 0.0)

    def _parity(self, z: ArrayLike) -> Array:
        """Whitened parity vectors (..., dof); what has no part in the test may be anything."""
        return np.asarray(np.where(self._used, np.asarray(z, dtype=np.float64), 0.0) @ self.test.whitened.T)

    def statistic(self, z: ArrayLike) -> Array:
        """Test statistic (...) of measurements z (..., n)."""
        return np.asarray(np.sum(self._parity(z) ** 2, axis=-1))

    def isolate(self, z: ArrayLike) -> Index:
        """Sensor (...) the method names; -1: none."""
        return np.asarray(np.argmax(single_scores(self.test, z), axis=-1))

    def diagnose(self, z: ArrayLike) -> Diagnosis:
        """The method raises the alarm; which sensors explain it is the two-stage search's answer."""
        value = float(self.statistic(z))
        if not value > self.threshold:
            return Diagnosis(value, False, (), ())
        answer = explain(self.test._replace(threshold=-1.0), z)
        return answer._replace(statistic=value)


class Glt(_Method):
    """Generalized likelihood test, thesis 4.2.4: p'(V R V')^-1 p against chi-square; (4-37) lacks the division by sigma^2."""

    name = "glt"


class OptimalParityVector(_Method):
    """Optimal parity vectors, thesis 4.2.2: the largest |c_i'p|, with a threshold for the family of tests.

    For D = F, which is every array whose sensors fail in proportion to their noise, c_i is the whitened column of V (`optimal_parity_vectors`),
    so the method isolates as GLT does and differs in what it detects.
    """

    name = "optimal_parity_vector"

    def __init__(self, array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> None:
        super().__init__(array, mask, sigma, pfa)
        self.vectors = optimal_parity_vectors((self.test.whitened * self.sigma)[:, self._checked])
        self.threshold = family_threshold(self.vectors, pfa)

    def statistic(self, z: ArrayLike) -> Array:
        """Test statistic (...) of measurements z (..., n)."""
        return np.asarray(np.max(np.abs(self._parity(z) @ self.vectors.T), axis=-1))

    def isolate(self, z: ArrayLike) -> Index:
        """Sensor (...) the method names; -1: none."""
        return np.asarray(self._checked[np.argmax(np.abs(self._parity(z) @ self.vectors.T), axis=-1)])


class SingularValues(_Method):
    """Singular value decomposition, thesis 4.2.3: the residual U_2 U_2'm of (4-30), in units of each sensor's sigma.

    The thesis gives no rule for deciding. Its length is GLT's statistic exactly; the sensor is that of the largest component, which is GLT's where
    all columns of V are of one length (dodecahedron, cones) and leans to the better-checked sensor elsewhere. In (4-15) ff. U is n x n.
    """

    name = "svd"

    def __init__(self, array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> None:
        super().__init__(array, mask, sigma, pfa)
        index = array.used(mask)
        left, _, _ = np.linalg.svd(array.H[index] / self.sigma[index, None], full_matrices=True)
        null = np.zeros((array.n, index.size - 3))
        null[index] = left[:, 3:]
        self.projector: Array = null @ null.T

    def residual(self, z: ArrayLike) -> Array:
        """U_2 U_2'm / sigma, (..., n)."""
        return np.asarray((np.where(self._used, np.asarray(z, dtype=np.float64), 0.0) / self.sigma) @ self.projector)

    def statistic(self, z: ArrayLike) -> Array:
        """Test statistic (...) of measurements z (..., n)."""
        return np.asarray(np.sum(self.residual(z) ** 2, axis=-1))

    def isolate(self, z: ArrayLike) -> Index:
        """Sensor (...) the method names; -1: none."""
        return np.asarray(np.argmax(np.abs(self.residual(z)), axis=-1))


class DirectComparison(_Method):
    """Direct comparison, thesis 4.2.1: every parity equation of few sensors against one threshold; the equations come from the geometry.

    The statistic is the largest normalized residual. A set of failed sensors explains the data when every broken equation has one of them in it
    (the smallest such sets are reported), which is table 4.2 where a fault breaks all its equations, and still an answer where a small fault breaks
    only some: the thesis' "soft fault gives 0x0000" does not happen, the words are merely not in its table.
    """

    name = "direct_comparison"

    def __init__(self, array: ImuArray, mask: int, sigma: ArrayLike, pfa: float) -> None:
        super().__init__(array, mask, sigma, pfa)
        index = array.used(mask)
        relations, members = parity_relations(ImuArray(array.H[index]))
        self.members = [tuple(int(index[i]) for i in chosen) for chosen in members]
        self.relations = np.zeros((len(members), array.n))
        self.relations[:, index] = relations
        self.relations /= np.linalg.norm(self.relations * self.sigma, axis=1, keepdims=True)  # residuals of unit variance
        # r = c V_w with |c| = 1 by the same scaling, and V_w R V_w' = I
        self.threshold = family_threshold((self.relations * self.sigma**2) @ self.test.whitened.T, pfa)
        self._member = np.zeros((len(members), array.n), dtype=bool)
        for row, chosen in enumerate(self.members):
            self._member[row, list(chosen)] = True

    def residuals(self, z: ArrayLike) -> Array:
        """Of every equation in units of its sigma, (..., q)."""
        return np.asarray(np.where(self._used, np.asarray(z, dtype=np.float64), 0.0) @ self.relations.T)

    def word(self, z: ArrayLike) -> int:
        """Fault identifier of one epoch, thesis table 4.2."""
        return fault_identifier(self.residuals(z), self.threshold)

    def statistic(self, z: ArrayLike) -> Array:
        """Test statistic (...) of measurements z (..., n)."""
        return np.asarray(np.max(np.abs(self.residuals(z)), axis=-1))

    def isolate(self, z: ArrayLike) -> Index:
        """Sensor (...) the method names; -1: none."""
        broken = np.abs(self.residuals(z)) > self.threshold
        missed = broken.astype(np.float64) @ (~self._member).astype(np.float64)  # broken equations without sensor i
        explains = (missed == 0.0) & (self.test.gain > 0.0)
        return np.asarray(np.where((explains.sum(axis=-1) == 1) & broken.any(axis=-1), np.argmax(explains, axis=-1), -1))

    def diagnose(self, z: ArrayLike) -> Diagnosis:
        """Answer for one epoch z (n,): the smallest sets with a sensor in every broken equation."""
        m = np.asarray(z, dtype=np.float64)
        residuals = np.abs(self.residuals(m))
        broken = residuals > self.threshold
        value = float(residuals.max())
        if not broken.any():
            return Diagnosis(value, False, (), ())
        found: tuple[Explanation, ...] = ()
        for size in (1, 2):
            sets = [s for s in itertools.combinations(self._checked.tolist(), size) if self._member[broken][:, list(s)].any(axis=1).all()]
            if sets:
                found = self._explanations(m, sets)
                break
        return Diagnosis(value, True, found[0].sensors if len(found) == 1 else (), found)

    def _explanations(self, z: Array, sets: list[tuple[int, ...]]) -> tuple[Explanation, ...]:
        p, rows = self._parity(z), components(self.test, z)
        fitted = []
        for chosen in sets:
            sizes = np.linalg.lstsq(self.test.whitened[:, list(chosen)], p, rcond=None)[0]
            fitted.append((chosen, sizes, 0.5 * float(sizes @ rows[list(chosen)])))
        best = max(f[2] for f in fitted)
        total = sum(float(np.exp(f[2] - best)) for f in fitted)
        made = [Explanation(c, tuple(s.tolist()), value, float(np.exp(value - best)) / total) for c, s, value in fitted]
        return tuple(sorted(made, key=lambda e: -e.log_likelihood))


METHODS: dict[str, Callable[[ImuArray, int, ArrayLike, float], ParityMethod]] = {
    kind.name: kind for kind in (Glt, OptimalParityVector, SingularValues, DirectComparison)
}
"""The methods by name."""


def make(name: str, array: ImuArray, sigma: ArrayLike, pfa: float, mask: int | None = None) -> ParityMethod:
    """A method by its name.

    Parameters
    ----------
    name : glt, optimal_parity_vector, svd or direct_comparison
    array : geometry of n sensors, 4 <= n
    sigma : (n,) or scalar, standard deviation of each sensor, in the unit of the measurements
    pfa : false-alarm probability per epoch, of all the tests the method makes together
    mask : bit i: sensor i takes part; None: all

    Returns
    -------
    ParityMethod

    Raises
    ------
    ValueError
        Unknown name, or the sensors in use have no redundancy.
    """
    if name not in METHODS:
        raise ValueError(f"no method {name!r}; there are {', '.join(METHODS)}")
    return METHODS[name](array, (1 << array.n) - 1 if mask is None else mask, sigma, pfa)
