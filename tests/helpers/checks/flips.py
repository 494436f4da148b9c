"""Changes of one mode at a switching facet: where the judge says "flip" the cost falls, and where not, it does not.

A random mode sequence is optimised; at every facet that its optimum lies on, every other mode that holds there is
tried by solving the sequence with that mode instead. Then the steepest flips are followed to where there is none, and
``certify`` is given the trajectory alone: it must find multipliers that satisfy the maximum principle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.kinks import random_problem
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.certificate.hybrid import SwitchingFacts, modes_along
from lin_freq_ocp.methods import uniqueness
from lin_freq_ocp.methods.hybrid import multipliers_with_weights
from lin_freq_ocp.transform.hybrid import piecewise_affine

VISIBLE = 1e-9  # relative change of a cost that solvers which stop at 1e-10 show
MOST_STEPS = 20  # flips that are followed, one after the other


@dataclass(frozen=True)
class Outcome:
    """What became of one problem: flips and stays that were tried, and what is wrong, if anything."""

    seed: int
    kind: str
    borders: int
    counts: Counter[str] = field(default_factory=Counter)
    wrong: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def sequence_optimum(problem: lfo.OptimalControlProblem, sequence: np.ndarray) -> lfo.results.Result | None:
    """Return the optimum of a mode sequence; None if it has none."""
    result = lfo.solve(problem.with_modes(sequence), throw=False)
    proven = result.certificate is not None and result.certificate.pmp == "satisfied"
    return result if "optimal" in result.status and proven else None


def signals_of(result: lfo.results.Result) -> lfo.Trajectory:
    """Return the trajectory of a problem that was solved."""
    assert result.trajectory is not None
    return result.trajectory


def change_of_cost(result: lfo.results.Result, other: lfo.results.Result) -> float:
    """Return the relative change of the cost from one optimum to another; inf if the other one was not found."""
    if "optimal" not in other.status or other.cost is None or result.cost is None:
        return np.inf
    return (other.cost - result.cost) / max(1.0, abs(result.cost))


def check(seed: int) -> Outcome:
    """Optimise one random mode sequence, and try every flip."""
    kind, problem, u = random_problem(seed)
    start = lfo.simulate(problem, u)
    sequence = piecewise_affine(problem).sequence_of(start.x, start.u)
    result = sequence_optimum(problem, sequence)
    if result is None:
        return Outcome(seed, kind, 0, Counter(unsolved=1))
    trajectory = signals_of(result)
    assert result.multipliers is not None
    certificate = judge(
        problem, trajectory, multipliers_with_weights(problem, trajectory, sequence, result.multipliers)
    )
    facts = certificate.borders
    assert facts is not None
    wrong = [] if certificate.feasible else ["the optimum of a mode sequence breaks a constraint"]
    counts = Counter({"joint": int(facts.joint and bool(facts.times))})
    if facts.flip_stationary and not facts.joint:
        wrong.append("flip-stationary without the joint inclusion")
    if facts.regular and facts.joint and not facts.flip_stationary:
        wrong.append("joint and regular, but not flip-stationary")
    if facts.joint != (certificate.pmp == "satisfied"):
        wrong.append("the facts and the verdict differ")
    for what, message in tried(problem, sequence, result, facts):
        counts[what] += 1
        wrong += [message] if message else []
    for what, message in followed(problem, sequence, result):
        counts[what] += 1
        wrong += [message] if message else []
    return Outcome(seed, kind, len(facts.times), counts, tuple(wrong))


def followed(
    problem: lfo.OptimalControlProblem, sequence: np.ndarray, result: lfo.results.Result
) -> Iterator[tuple[str, str]]:
    """Follow flips to the end; yield what certify says there of the trajectory alone, and words if that is wrong."""
    for _ in range(MOST_STEPS):
        trajectory = signals_of(result)
        certificate = lfo.certify(problem, trajectory)
        facts, better = certificate.borders, None
        assert facts is not None
        for flip in facts.flips:
            flipped = piecewise_affine(problem).sequence_of(trajectory.x, trajectory.u)
            flipped[flip.time] = flip.mode
            other = lfo.solve(problem.with_modes(flipped), throw=False)
            change = change_of_cost(result, other)
            if flip.improves is False and change < -VISIBLE:
                yield "wrong refusal", f"t = {flip.time} to {flip.mode} is said not to improve, and gains {-change:.1e}"
            if flip.improves and not change < 0:
                yield "wrong flip", f"t = {flip.time} to {flip.mode} is said to improve, and gains {-change:.1e}"
            if change < -VISIBLE and (better is None or change_of_cost(better, other) < 0):
                better = other
        if better is None:
            break
        result = better
    else:
        yield "long way", ""
        return
    feasible = certificate.feasible
    if not facts.times:
        alone = problem.with_modes(piecewise_affine(problem).sequence_of(trajectory.x, trajectory.u))
        same = lfo.certify(alone, trajectory).pmp == certificate.pmp  # "violated" where a solver was inaccurate
        yield "inside", "" if same else f"an optimum inside modes: {certificate.worst}"
    elif facts.flip_stationary:
        yield "flip-stationary", "" if certificate.pmp == "satisfied" and feasible else "but not satisfied"
    elif certificate.pmp == "satisfied":
        yield "joint only", ""
    else:
        yield "no multipliers found", "no flip improves, and no multipliers are found" if feasible else ""


def tried(
    problem: lfo.OptimalControlProblem, sequence: np.ndarray, result: lfo.results.Result, facts: SwitchingFacts
) -> Iterator[tuple[str, str]]:
    """Yield what each flip turned out to be, and words if that is not what was said."""
    trajectory = signals_of(result)
    meeting = modes_along(problem, trajectory).active_modes(trajectory.x, trajectory.u)
    said = {(flip.time, flip.mode): flip.rate for flip in facts.flips}
    unique = None
    for t, j in np.argwhere(meeting):
        if j == sequence[t]:
            if (t, j) in said:
                yield "own mode", f"a flip at t = {t} to the mode {j} that the sequence has"
            continue
        flipped = sequence.copy()
        flipped[t] = j
        other = lfo.solve(problem.with_modes(flipped), throw=False)
        change = change_of_cost(result, other)
        if change == np.inf:
            yield "undecided", ""
        elif (t, j) not in said:
            yield "stay", f"a stay at t = {t}, mode {j}, that would gain {-change:.1e}" if change < -VISIBLE else ""
        elif change < -VISIBLE:
            yield "flip", ""
        else:
            unique = unique or uniqueness(problem.with_modes(sequence), trajectory)
            both = unique.unique and uniqueness(problem.with_modes(flipped), trajectory).unique
            rate = said[t, j]
            message = f"a flip at t = {t} to mode {j}, rate {rate:.1e}, that gains {-change:.1e}" if both else ""
            yield "wrong flip" if both else "degenerate", message
