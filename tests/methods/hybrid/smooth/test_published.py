"""Published smooth problems from cold starts: nothing but dynamics, quartic costs, unstable maps, saddles."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.published import PUBLISHED, mass_around_disc
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import certificate

QUICK = [
    "DTOC1L, N = 10",
    "DTOC1L, N = 50",
    "DTOC2, N = 10",
    "DTOC2, N = 50",
    "DTOC2, N = 100",
    "DTOC4, N = 100",
    "DTOC5, N = 50",
    "DTOC6, N = 11",
    "DTOC6, N = 21",
    "DTOC6, N = 51",
    "DTOC6, N = 101",
    "Chen-Allgoewer, T = 100",
    "Chen-Allgoewer, T = 400",
    "pendulum of acados, T = 40",
    "mass around a disc, by h",
]


@pytest.mark.parametrize("name", seeds(QUICK))
def test_a_published_optimum_is_found_or_a_better_one(name):
    case = PUBLISHED[name]
    result = lfo.solve(case.build(case.horizon), global_bound=False)
    assert result.status == "locally_optimal"
    assert result.cost <= case.cost * (1 + 1e-7)
    assert result.certificate.worst.relative <= 1e-6
    assert result.certificate.worth_of_residuals <= 1e-10 * result.certificate.cost_scale


@pytest.fixture(scope="module")
def around():
    return lfo.solve(mass_around_disc(), global_bound=False)


@expensive
def test_an_optimum_at_the_rim_of_a_region_is_named(around):
    result = around
    assert result.cost == pytest.approx(PUBLISHED["mass around a disc"].cost, rel=1e-7)
    assert (result.status, result.certificate.pmp) == ("locally_optimal", "not_applicable")
    assert result.message.startswith(
        "the trajectory touches the rim of the region of 'outside the disc' at t = 6 to 7, "
    )
    assert "docs/borders.md" in result.message
    distance = (result.trajectory.x[:, :2] ** 2).sum(axis=1)
    assert list(result.certificate.borders.gaps) == [t for t in range(20) if distance[t] <= 1 + 1e-6]


@expensive
def test_an_optimum_at_a_rim_is_judged_once(around, monkeypatch):
    """No step cures the conditions of the theorem, which does not apply: with the region as a constraint, all hold."""
    substitute(monkeypatch, "methods.hybrid.newton_points", lambda *given: pytest.fail("refined"))
    judged = list[lfo.results.Trajectory]()
    honest = certificate.judge

    def count(problem, trajectory, *others):
        judged.append(trajectory)
        return honest(problem, trajectory, *others)

    substitute(monkeypatch, "certificate.judge", count)
    assert lfo.solve(around.problem, start=around, global_bound=False).cost == pytest.approx(around.cost, rel=1e-9)
    assert len(judged) <= 2  # the answer, and the start


@expensive
def test_a_rim_that_is_passed_by_for_no_reason_is_not_optimal(around):
    problem, known = around.problem, around.trajectory
    u = known.u + 0.01 * (-1.0) ** np.arange(20)[:, None] * (np.arange(20)[:, None] >= 15)
    certificate = lfo.certify(problem, lfo.simulate(problem, u))
    assert certificate.status_within(0.0) == "numerical_error"
