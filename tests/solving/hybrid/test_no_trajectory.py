"""What is said of smooth dynamics when no trajectory is found."""

from __future__ import annotations

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.certificate.hybrid import value_bounds


def hop(bound, **changes):
    """Return a problem that moves one state from 0 to 1 in two steps, with bounds of the control."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas("0.9*x_0 + 0.5*u_0 + 0.05*sin(x_0)", 1, 1)
    cost, ends = lfo.QuadraticCost(R=1.0), {"initial_state": [0.0], "terminal_state": [1.0]}
    return lfo.OptimalControlProblem(dynamics, 2, cost, control_set=lfo.Box(-bound, bound), **ends, **changes)


@expensive
def test_intervals_are_tried_only_where_bounds_alone_may_exclude_all_trajectories(monkeypatch):
    """They see bounds and no masks: where a trajectory keeps the bounds, they would search for seconds in vain."""
    tried = []

    def recorded(problem, *given, **options):
        tried.append(problem)
        return value_bounds(problem, *given, **options) if problem.control_spectrum is None else iter(())

    substitute(monkeypatch, "certificate.hybrid.value_bounds", recorded)
    masked = lfo.solve(hop(2.0, control_spectrum=lfo.MagnitudeBound(0.01, bins=range(2))), throw=False)
    assert (masked.status, tried) == ("numerical_error", [])
    excluded = lfo.solve(hop(0.5), throw=False)
    assert (excluded.status, len(tried)) == ("infeasible", 1)
    assert excluded.message.startswith("proven by dynamic programming with intervals")
