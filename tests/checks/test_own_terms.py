"""The check of terms that users write finds each fault of a term."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.problem import AffineMap, FrequencyConstraint, NormBall, Penalty, StageMap, SumMap, Term
from lin_freq_ocp.testing import check_terms


class Drift(FrequencyConstraint):
    """A bound or a price on weighted sums of the first ``n`` components of a signal."""

    def __init__(self, penalty: Penalty, values: type[AffineMap] = SumMap, n: int = 2):
        self.penalty, self.values, self.n = penalty, values, n

    def describe(self, names):
        return "drift"

    def terms(self, signal, field, source) -> Iterator[Term]:
        weights = np.cos(np.arange(signal.length))[:, None, None] * np.ones((2, len(signal.names)))
        weights[:, 1, 0], weights[:, :, self.n :] = 0.5, 0.0
        stages = StageMap(np.arange(signal.length), weights, None, np.zeros(2))
        yield Term("drift", signal.kind, self.values((stages,), np.array([0.1, -0.3])), self.penalty, source)

    def augmented(self, n, k):
        return [Drift(self.penalty, self.values, n)]


class ForgottenDrift(Drift):
    def augmented(self, n, k):
        return []


class OtherDrift(Drift):
    def augmented(self, n, k):
        return [Drift(self.penalty, self.values, n + k)]


class OddRows(SumMap):
    def rows(self, horizon, n, m):
        L, c = super().rows(horizon, n, m)
        return L, 1.01 * c


class OddAdjoint(SumMap):
    def pull_back(self, weights, shapes):
        of_x, of_u = super().pull_back(weights, shapes)
        return -of_x, of_u


class OddSlope(NormBall):
    def slope(self, v, change, near):
        return 1.01 * super().slope(v, change, near)


class OddExcessSlope(NormBall):
    def excess_slope(self, v, change, near):
        return super().excess_slope(v, change, near) + 0.1 * np.abs(change).max()


class SmallGap(NormBall):
    def gap(self, v, multipliers, eta_C):
        return super().gap(v, multipliers, eta_C) - 0.1 * np.abs(multipliers).sum(1, keepdims=True)


class DearConic(NormBall):
    def conic(self, groups, dim):
        form = super().conic(groups, dim)
        return replace(form, prices=1.1 * form.prices)


class LooseConic(NormBall):
    def conic(self, groups, dim):
        return NormBall(self.order, 9 * self.radius, self.weight).conic(groups, dim)


def drifting(constraint: FrequencyConstraint) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics([[1.0, 0.2], [0.0, 0.8]], [[0.1], [0.5]])
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=[0.5, 0.2])
    return lfo.OptimalControlProblem(dynamics, 6, cost, initial_state=[1.0, 0.0], state_spectrum=constraint)


def ball(kind: type[NormBall] = NormBall, radius: float = 0.5, weight: float = 0.2) -> NormBall:
    return kind(2, np.asarray(radius), np.asarray(weight))


@pytest.mark.parametrize("penalty", [ball(), ball(weight=np.inf), ball(radius=9.0), ball(radius=0.0)])
def test_a_term_that_keeps_its_protocol_has_no_fault(penalty):
    assert check_terms(drifting(Drift(penalty))) == []


FAULTS = {
    "state spectrum: it is another one in rate_limited": [ForgottenDrift(ball()), OtherDrift(ball(weight=np.inf))],
    "drift: rows of the map differ from its values": [Drift(ball(), OddRows)],
    "drift: pull_back is not the adjoint of values": [Drift(ball(), OddAdjoint)],
    "drift: slope is not that of differences": [Drift(ball(OddSlope))],
    "drift: excess_slope is not that of differences": [Drift(ball(OddExcessSlope))],
    "drift: the gap is less than what another point gains": [Drift(ball(SmallGap)), Drift(ball(SmallGap, 0.5, np.inf))],
    "drift: the conic form has another value than the cost": [Drift(ball(DearConic))],
    "the optimum is not proven": [Drift(ball(LooseConic, weight=np.inf))],
}


@pytest.mark.parametrize("words", seeds(FAULTS))
def test_each_fault_is_found(words):
    for constraint in FAULTS[words]:
        assert any(fault.startswith(words) for fault in check_terms(drifting(constraint)))


def test_a_frequency_constraint_must_say_what_it_is_on_longer_signals():
    """One without ``augmented`` would vanish in ``rate_limited``."""

    class Incomplete(FrequencyConstraint):
        def describe(self, names):
            return "nothing"

        def terms(self, signal, field, source):
            yield from ()

    with pytest.raises(TypeError, match="augmented"):
        Incomplete()
