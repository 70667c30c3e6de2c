"""Structures on a generic model: fusion-reset is the centralized filter whatever the shares, a leave-one-out master never sees its aid, isolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from riins_federated import structures
from riins_federated.adaptive_noise import AdaptiveNoise
from riins_federated.aiding import Measurement
from riins_federated.inertial_evidence import InertialEvidence
from riins_federated.information_sharing import checked_shares, innovation_shares, trace_shares
from riins_federated.separated_masters import SeparatedMasters
from riins_federated.structure_settings import SolutionSeparation
from riins_federated.structures import FederatedFilter, Gate, Layout, Structure

OPEN = Gate(pfa=None)
N, AIDS = 5, 3
PERIOD = 10.0
PHI = np.eye(N)
PHI[0, 2] = PHI[1, 3] = PERIOD
PHI[2, 4] = 0.5
QD = np.diag([1e-4, 1e-4, 1e-6, 1e-6, 1e-10])
P0 = np.diag([900.0, 900.0, 0.01, 0.01, 1e-6])
ROWS = ((0, 1), (0, 1), (2, 3))
SIGMAS = (30.0, 100.0, 0.13)


def voyage(seed: int, epochs: int, fault=lambda k, aid: 0.0) -> tuple[np.ndarray, list[list[Measurement]]]:
    """Truth (epochs, N) of a body with a wandering velocity, and measurements of two positions and one velocity."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(N) * np.sqrt(np.diag(P0))
    truth, aids = np.empty((epochs, N)), []
    for k in range(epochs):
        x = PHI @ x + rng.standard_normal(N) * np.sqrt(np.diag(QD))
        truth[k] = x
        now = []
        for aid, (rows, sigma) in enumerate(zip(ROWS, SIGMAS, strict=True)):
            H = np.eye(N)[list(rows)]
            now.append(Measurement(H @ x + sigma * rng.standard_normal(2) + fault(k, aid), H, sigma**2 * np.eye(2)))
        aids.append(now)
    return truth, aids


def run(structure: Structure, aids: list, without: int | None = None) -> np.ndarray:
    """Fused states (epochs, N)."""
    states = np.empty((len(aids), N))
    for k, now in enumerate(aids):
        structure.epoch(PHI, QD, [None if i == without else m for i, m in enumerate(now)])
        states[k] = structure.x
    return states


def centralized(gate: Gate = OPEN, **more) -> SeparatedMasters:
    """The information form alone."""
    return SeparatedMasters(np.zeros(N), P0, AIDS, SolutionSeparation(left_out=0), gate=gate, **more)


@settings(max_examples=12, deadline=None)
@given(st.lists(st.floats(0.02, 1.0), min_size=AIDS, max_size=AIDS), st.integers(0, 1000), st.sampled_from(["fixed", "trace", "innovation"]))
def test_fusion_reset_is_the_centralized_filter(weights: list[float], seed: int, sharing: str) -> None:
    """Target 29, for shares that are constant and shares that change."""
    beta = np.array(weights) / np.sum(weights)
    _, aids = voyage(seed, 30)
    aids[7][0] = aids[9][1] = None
    federated = FederatedFilter(np.zeros(N), P0, AIDS, beta=beta, sharing=sharing, gate=OPEN)
    one = centralized()
    np.testing.assert_allclose(run(federated, aids), run(one, aids), rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(federated.P, one.P, rtol=1e-9, atol=1e-15)


def test_fusion_reset_is_the_centralized_filter_with_shares_drawn_anew_at_every_fusion(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(29)
    drawn: list[np.ndarray] = []

    def shares(*_: object) -> np.ndarray:
        drawn.append(rng.dirichlet(np.ones(AIDS)) * 0.94 + 0.02)
        return drawn[-1]

    monkeypatch.setattr(structures, "innovation_shares", shares)
    _, aids = voyage(4, 60)
    federated, one = FederatedFilter(np.zeros(N), P0, AIDS, sharing="innovation", gate=OPEN), centralized()
    np.testing.assert_allclose(run(federated, aids), run(one, aids), rtol=0.0, atol=1e-8)
    assert len(drawn) == 60 and np.ptp(drawn, axis=0).min() > 0.3


@settings(max_examples=12, deadline=None)
@given(st.floats(0.0, 1.0), st.integers(0, 1000))
def test_partial_feedback_conserves_information(retention: float, seed: int) -> None:
    _, aids = voyage(seed, 10)
    federated = FederatedFilter(np.zeros(N), P0, AIDS, retention=retention, gate=OPEN)
    run(federated, aids)
    total = sum(np.linalg.inv(local.P) for local in federated.local)
    vector = sum(np.linalg.inv(local.P) @ local.x for local in federated.local)
    np.testing.assert_allclose(np.linalg.inv(total), federated.P, rtol=1e-7, atol=1e-14)
    np.testing.assert_allclose(federated.P @ vector, federated.x, rtol=0.0, atol=1e-6)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, AIDS - 1), st.floats(0.0, 50.0), st.floats(0.0, 3.0), st.integers(0, 1000))
def test_a_leave_one_out_master_never_sees_its_aid(aid: int, step: float, slope: float, seed: int) -> None:
    """Bit for bit against a run without the aid, whatever it measures, until the first alarm on another aid."""
    size = SIGMAS[aid]
    _, aids = voyage(seed, 60, lambda k, i: size * (step + slope * k) * (i == aid and k > 10))
    masters = SeparatedMasters(np.zeros(N), P0, AIDS)
    other = SeparatedMasters(np.zeros(N), P0, AIDS)
    for now in aids:
        verdicts = [one.epoch(PHI, QD, measured) for one, measured in ((masters, now), (other, [None if i == aid else m for i, m in enumerate(now)]))]
        if any(not verdict[i].fused for verdict in verdicts for i in range(AIDS) if i != aid):
            break
        np.testing.assert_array_equal(masters.without(aid).x, other.without(aid).x)
        np.testing.assert_array_equal(masters.without(aid).P, other.without(aid).P)


def test_no_reset_is_an_upper_bound_and_loses_little() -> None:
    error = {"centralized": 0.0, "no-reset": 0.0}
    for seed in range(10):
        truth, aids = voyage(seed, 300)
        made = {"centralized": centralized(), "no-reset": FederatedFilter(np.zeros(N), P0, AIDS, retention=1.0, gate=OPEN)}
        for name, structure in made.items():
            error[name] += float(np.sum((run(structure, aids)[50:, :2] - truth[50:, :2]) ** 2))
        assert made["no-reset"].P[0, 0] >= made["centralized"].P[0, 0] * (1.0 - 1e-9)
    assert 0.95 <= np.sqrt(error["no-reset"] / error["centralized"]) <= 1.3


@pytest.mark.parametrize("left_out", [1, 2])
def test_a_slow_fault_is_isolated_taken_out_and_its_aid_taken_in_again(left_out: int) -> None:
    _, good = voyage(3, 500)
    _, bad = voyage(3, 500, lambda k, aid: (aid == 0 and 100 <= k < 200) * 3.0 * (k - 99))
    found = SeparatedMasters(np.zeros(N), P0, AIDS, SolutionSeparation(left_out=left_out), layout=Layout(navigation=tuple(range(N))))
    twin = SeparatedMasters(np.zeros(N), P0, AIDS, SolutionSeparation(left_out=left_out), layout=Layout(navigation=tuple(range(N))))
    gated = centralized(Gate())
    isolated, apart, without = [], [], []
    for good_now, bad_now in zip(good, bad, strict=True):
        for structure, now in ((found, bad_now), (twin, good_now), (gated, bad_now)):
            structure.epoch(PHI, QD, now)
        isolated.append(found.isolated.copy())
        apart.append(np.linalg.norm(found.x[:2] - twin.x[:2]))
        without.append(np.linalg.norm(gated.x[:2] - twin.x[:2]))
    isolated = np.array(isolated)
    assert not isolated[:, 1:].any() and not isolated[:100].any()
    onset = int(isolated[:, 0].argmax())
    assert 100 < onset < 150  # the ramp is 0.3 m/s
    assert not isolated[-150:].any()
    assert max(apart) < 60.0 and max(apart[230:]) < 0.5 * max(without[230:]) and apart[-1] < 3.0


def test_the_protection_level_holds() -> None:
    truth, aids = voyage(8, 400)
    masters = SeparatedMasters(np.zeros(N), P0, AIDS)
    assert masters.protection(1e-5)[0] == pytest.approx(30.0 * np.sqrt(-2.0 * np.log(1e-5)))  # as it begins: of noise alone
    for k, now in enumerate(aids):
        masters.epoch(PHI, QD, now)
        assert np.linalg.norm(masters.x[:2] - truth[k, :2]) < masters.protection(1e-5)[0]
    assert masters.protection(1e-5)[0] < 300.0


def test_noise_that_grows_is_weighted_and_a_fault_is_not_taken_for_noise() -> None:
    def noisy(seed: int):
        rng = np.random.default_rng(seed + 100)
        return lambda k, aid: np.sqrt(8.0) * 30.0 * rng.standard_normal(2) * (aid == 0)

    error = np.zeros(2)
    for seed in range(6):
        truth, aids = voyage(seed, 400, noisy(seed))
        known = [[Measurement(m.z, m.H, m.R * (9.0 if i == 0 else 1.0)) for i, m in enumerate(now)] for now in aids]
        error += [
            np.sum((run(s, a)[100:, :2] - truth[100:, :2]) ** 2) for s, a in ((centralized(Gate(), adaptive=True), aids), (centralized(), known))
        ]
    assert np.sqrt(error[0] / error[1]) <= 1.15  # target 33
    noise, rng = AdaptiveNoise(), np.random.default_rng(1)
    for k in range(200):
        noise.learn(rng.standard_normal(2) + 0.3 * k + 20.0 * (k > 150), np.eye(2))
    assert noise.scale == 1.0


@pytest.mark.parametrize(
    "make", [lambda: FederatedFilter(np.zeros(N), P0, AIDS, retention=0.5), lambda: SeparatedMasters(np.zeros(N), P0, AIDS, adaptive=True)]
)
def test_copies_go_on_alone_and_bad_measurements_are_not_fused(make) -> None:
    _, aids = voyage(9, 100)
    aids[20][0] = Measurement(np.array([np.nan, 0.0]), aids[20][0].H, aids[20][0].R)
    aids[21][2] = Measurement(aids[21][2].z, aids[21][2].H, -aids[21][2].R)
    structure = make()
    for now in aids[:20]:
        structure.epoch(PHI, QD, now)
    assert not structure.epoch(PHI, QD, aids[20])[0].fused
    copy = structure.clone()
    assert not structure.epoch(PHI, QD, aids[21])[2].fused and np.isfinite(structure.x).all()
    run(structure, aids[22:])
    copy.epoch(PHI, QD, aids[21])
    run(copy, aids[22:])
    np.testing.assert_array_equal(structure.x, copy.x)
    before = structure.x.copy()
    structure.shift(np.ones(N))
    np.testing.assert_allclose(structure.x, before - 1.0)


def test_shares() -> None:
    for shares in (trace_shares([np.eye(2), 9.0 * np.eye(2), 1e9 * np.eye(2)]), innovation_shares([1.0, 1.0, 1.0], [1.0, 9.0, 0.0])):
        np.testing.assert_allclose(checked_shares(shares), shares)
        assert shares.min() >= 0.05 - 1e-12
    with pytest.raises(ValueError):
        checked_shares([0.5, np.nan, 0.5])
    for wrong in ({"retention": 1.5}, {"sharing": "guess"}, {"beta": [0.5, 0.5, 0.5]}):
        with pytest.raises(ValueError):
            FederatedFilter(np.zeros(N), P0, AIDS, **wrong)


def test_means_of_white_innovations_are_chi_square_and_a_bias_is_seen() -> None:
    evidence, rng = InertialEvidence(2, 2, 20.0), np.random.default_rng(5)
    ratios = []
    for k in range(40_000):
        evidence.learn(0, [0, 1], np.stack([noise := rng.standard_normal(2), noise + 1.0]))
        if k % 200 == 199:
            ratios.append(evidence.ratio(0, [0], 0.1))
    # ratio > 1 has the probability asked for: 200 independent looks, four sigmas of the binomial
    assert abs(np.mean(np.array(ratios) > 1.0) - 0.1) < 4.0 * np.sqrt(0.09 / 200.0)
    assert evidence.ratio(1, [0], 1e-6) > 1.0 and evidence.ratio(0, [1], 1e-6) == 0.0


def pulled(rate: float, begin: int = 200):
    """Both receivers pulled to the north, from an epoch on."""
    return lambda k, aid: np.array([rate * PERIOD * max(k - begin, 0), 0.0]) if aid < 2 else np.zeros(2)


@pytest.mark.parametrize("seed", range(4))
def test_receivers_pulled_together_do_not_outvote_the_log(seed: int) -> None:
    """One voice, not a majority; without that word the vote is against the log, and the position goes where the receivers say."""
    truth, aids = voyage(seed, 300, pulled(0.5))
    layout = Layout(navigation=(0, 1, 2, 3))
    for kinds, wrong in ((("satellite", "satellite", "log"), False), ((), True)):
        masters = SeparatedMasters(np.zeros(N), P0, AIDS, layout=layout, kinds=kinds)
        error = np.abs(run(masters, aids) - truth)[:, 0]
        assert masters.isolated[2] == wrong
        assert error[-1] > 400.0 if wrong else error.max() < 100.0 and masters.isolated[:2] == [True, True]


@pytest.mark.parametrize("seed", range(3))
def test_a_log_that_lies_is_isolated_whatever_the_receivers_are(seed: int) -> None:
    _, aids = voyage(seed, 260, lambda k, aid: np.array([0.0, 0.35 * (k >= 200)]) if aid == 2 else np.zeros(2))
    masters = SeparatedMasters(np.zeros(N), P0, AIDS, layout=Layout(navigation=(0, 1, 2, 3)), kinds=("satellite", "satellite", "log"))
    run(masters, aids)
    assert masters.isolated == [False, False, True]


def test_a_clone_keeps_evidence_of_its_own() -> None:
    _, aids = voyage(1, 30, pulled(3.0, 5))
    one = SeparatedMasters(np.zeros(N), P0, AIDS, kinds=("satellite", "satellite", "log"))
    other, third = one.clone(), one.clone()
    np.testing.assert_array_equal(run(one, aids), run(other, aids))
    np.testing.assert_array_equal(third._evidence.snapshot()[0], 0.0)
