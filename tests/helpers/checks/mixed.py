"""A random problem of mixed features: its optimum is proven, costs what CVXPY's does, and spoiled input is refused.

Input of the judge is spoiled by a tighter constraint that matters, or a multiplier with the other sign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.mixed import problem_of, random_model

AGREEMENT = 1e-6  # difference of the two costs, relative to max(1, |J|)
TIGHTER = 0.98  # factor on a limit that must make the judge refuse the optimum
NOTHING = 1e-6  # multipliers that are all smaller than this, relative to the cost, are none


@dataclass(frozen=True)
class Outcome:
    """What became of one problem."""

    seed: int
    features: tuple[str, ...]
    status: str
    difference: float
    gap: float
    worst: float
    wrong: tuple[str, ...]
    tried: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def check(seed: int) -> Outcome:
    """Solve one problem twice, compare, and see that the judge refuses what it should."""
    model = random_model(seed)
    problem = problem_of(model)
    result = lfo.solve(problem, throw=False)
    oracle = model.optimal_cost()
    features = tuple(model.features)
    certificate = result.certificate
    if certificate is None or result.multipliers is None:
        return Outcome(seed, features, result.status, np.nan, np.nan, np.nan, ("no solution",), ())
    difference = abs(certificate.cost - oracle) / max(1.0, abs(oracle))
    gap = np.inf if certificate.gap is None else certificate.gap
    wrong = [
        what
        for what, bad in (
            ("not optimal", result.status != "optimal"),
            ("costs differ", not difference <= AGREEMENT),
            ("not satisfied", certificate.pmp != "satisfied"),
            ("gap", not gap <= AGREEMENT),
        )
        if bad
    ]
    tried = []
    for what, accepted in _spoiled(problem, result):
        tried.append(what)
        if accepted:
            wrong.append(f"accepted: {what}")
    worst = certificate.worst.relative
    return Outcome(seed, features, result.status, difference, gap, worst, tuple(wrong), tuple(tried))


def _spoiled(problem: lfo.OptimalControlProblem, result: lfo.results.Result) -> list[tuple[str, bool]]:
    """Return what was spoiled in the judge's input, and whether the judge accepted it all the same."""
    multipliers, trajectory = result.multipliers, result.trajectory
    assert multipliers is not None
    assert trajectory is not None
    assert result.cost is not None
    tried: list[tuple[str, bool]] = []
    if np.abs(multipliers.eta).max() < NOTHING * max(1.0, abs(result.cost)):  # nothing pulls: nothing to spoil
        return tried
    parts = {"eta": multipliers.eta, "mu": multipliers.mu, "nu": multipliers.nu}
    for name, values in parts.items():
        if np.abs(values).max() > 1e-3 * np.abs(multipliers.eta).max() > 0:
            tried.append((f"-{name}", _accepted(problem, trajectory, _changed(multipliers, **{name: -values}))))
    for name, values in multipliers.stage.items():
        if np.abs(values).max() > 1e-2 * max(1.0, np.abs(multipliers.eta).max()):
            stage = {**multipliers.stage, name: -values}
            tried.append((f"-{name}", _accepted(problem, trajectory, _changed(multipliers, stage=stage))))
    for field_name in ("control_set", "state_set", "terminal_state"):
        tighter = _tighter(getattr(problem, field_name))
        of_set = [one for one in multipliers.stage if one.startswith(field_name.replace("_", " "))]
        if tighter is not None and any(np.abs(multipliers.stage[one]).max() > 1e-2 for one in of_set):
            try:
                changed = replace(problem, **{field_name: tighter})
            except lfo.errors.ProblemError:  # the fixed initial state is outside: noticed earlier
                continue
            tried.append((f"tighter {field_name}", _accepted(changed, trajectory, multipliers)))
    return tried


def _accepted(
    problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory, multipliers: lfo.results.Multipliers
) -> bool:
    return lfo.certify(problem, trajectory, multipliers).pmp == "satisfied"


def _changed(multipliers: lfo.results.Multipliers, **changed: Any) -> lfo.results.Multipliers:
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")
    return lfo.results.Multipliers(**{**{name: getattr(multipliers, name) for name in names}, **changed})


def _tighter(one: Any) -> Any:
    """Return a set with smaller limits, where that is plain."""
    if isinstance(one, lfo.sets.Ball):
        return lfo.sets.Ball(TIGHTER * one.radius, one.centre)
    if isinstance(one, lfo.sets.Ellipsoid):
        return lfo.sets.Ellipsoid(one.W, TIGHTER * one.radius, one.centre)
    if isinstance(one, lfo.sets.Polyhedron):
        return lfo.sets.Polyhedron(one.F, one.g - (1 - TIGHTER) * np.abs(one.g))
    return None
