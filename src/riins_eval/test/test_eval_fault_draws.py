"""The study of drawn faults and of spoofing on a few of them; the page has a thousand."""

import numpy as np
import pytest
from scipy.stats import chi2

from riins_eval.studies import fault_draws, spoofing
from riins_sim.faults import Fault, FaultType


@pytest.fixture(scope="module")
def under_way():
    return fault_draws.Voyage(fault_draws.voyage(1))


def test_a_copy_without_a_fault_is_the_twin_itself(under_way):
    again = under_way.fly()
    np.testing.assert_array_equal(again.track.lat, under_way.twin.track.lat)
    np.testing.assert_array_equal(again.covariance, under_way.twin.covariance)


def test_errors_keep_to_their_protection_levels(under_way):
    """Position and heading, and the levels are no wall of infinities."""
    found = fault_draws.integrity(under_way.twin, under_way.truth(under_way.twin.track))
    assert found.shape == (4, len(under_way.twin.track.stamp_ns)) and np.isfinite(found).all()
    for error, level in (found[:2], found[2:]):
        assert (error < level).all() and np.median(level) < 30.0 * np.sqrt(np.mean(error**2))
    beyond = found.copy()
    beyond[2, :10] = 10.0
    assert [made.ok for made in fault_draws.integrity_rows("without a fault", [found, beyond])] == [True, False]


def test_draws_are_addressed_by_their_number_and_cover_what_they_should():
    sigma = {name: np.ones(2) for name in fault_draws.AIDS}
    faults = [fault_draws.draw(n, sigma) for n in range(400)]
    assert fault_draws.draw(7, sigma) == faults[7]
    assert {(f.target, f.type) for f in faults} == {(a, t) for a in fault_draws.AIDS for t in fault_draws.TYPES}
    steps = np.array([f.size for f in faults if f.type is FaultType.STEP])
    assert steps.min() >= fault_draws.SMALLEST and steps.max() <= fault_draws.LARGEST
    # log-uniform: half of them below the geometric mean, within four sigmas of the binomial
    assert abs(np.mean(steps < np.sqrt(3000.0)) - 0.5) < 2.0 / np.sqrt(len(steps))


def test_no_measurement_of_more_than_eight_sigma_is_fused(under_way):
    sigma = fault_draws.innovation_sigma(under_way.twin)
    found = [fault_draws.outcome(under_way, fault, under_way.fly(fault)) for fault in (fault_draws.draw(n, sigma) for n in range(12))]
    assert sum(o.large for o in found) > 100
    assert sum(o.fused for o in found) == 0


def test_the_outcome_counts_what_was_fused(under_way):
    """A step of which every measurement is refused, and the same fault too small for any test."""
    sigma = float(fault_draws.innovation_sigma(under_way.twin)["gps"][0])
    times = {"start_ns": 1_000_000_000_000, "end_ns": 1_200_000_000_000}
    small, gross = (Fault("gps", FaultType.STEP, size * sigma, axis="north", **times) for size in (0.01, 100.0))
    first, second = (fault_draws.outcome(under_way, fault, under_way.fly(fault)) for fault in (small, gross))
    assert not first.found and first.large == 0 and 0.0 < first.shift < 0.01 * sigma
    assert second.found and second.large == 20 and second.fused == 0 and second.delay_s == 0.0
    assert second.size == pytest.approx(100.0, rel=0.01)


def test_the_interval_holds_what_it_should():
    nees = chi2(7).ppf(np.linspace(0.0005, 0.9995, 1000))
    assert fault_draws.inside(nees).sum() == 990


def test_a_pull_of_both_receivers_ends_with_the_log_alone(under_way):
    pull = spoofing.pulled(under_way, ("gps", "bds"), 5.0)
    assert pull.delay_s <= 120.0 and pull.largest < 60.0 and not pull.wrong
