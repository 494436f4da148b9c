"""A random linear problem by every method that takes it: verdicts and costs are compared.

Where two costs differ by more than 1e-8, and by far more than the gap of the better answer, the other is less accurate.
A verdict that is proven by a bound, a ray or a direction is compared with those of the others; a local optimum beside
it is no error, but counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random import convex, infeasible, linear, lti, mixed
from helpers.replacing import substitute
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.methods.structured import loops
from lin_freq_ocp.transform import stated_sizes

KINDS: dict[str, Callable[[int], lfo.OptimalControlProblem]] = {  # linear problems by seed, taken in turn
    "convex": lambda seed: convex.random_problem(seed)[1],
    "linear": lambda seed: linear.random_linear(seed).problem,
    "lti": lti.random_lti,
    "infeasible": lambda seed: infeasible.random_infeasible(seed)[1],
    "mixed": lambda seed: mixed.problem_of(mixed.random_model(seed)),
}
KNOWN = 1e-6  # gap of the best answer above which the optimal cost is not known
FAR = 10  # multiple of the best answer's error beyond which a difference is another's
AGREEMENT = 1e-8  # difference of two costs, relative to the sum of absolute terms, up to which they agree
SECONDS = 60.0  # for every method


class Verdict(StrEnum):
    """How the answer of a method compares with the best of all."""

    AGREES = "agrees"
    LOCAL = "not proven, as by others"
    LESS_ACCURATE = "another cost, larger gap"
    NONE = "no answer"
    CONTRADICTS = "contradicts a proof"
    UNVERIFIED = "proof not verified"
    REFUSED = "refused"


ERRORS = Verdict.LESS_ACCURATE, Verdict.NONE, Verdict.CONTRADICTS, Verdict.UNVERIFIED


@dataclass(frozen=True)
class Answer:
    """How one method ended; ``error`` is its gap, or what its residuals are worth, in units of the cost."""

    status: str
    message: str
    cost: float | None = None
    scale: float = 0.0
    error: float = np.inf
    verified: bool = True

    @property
    def solved(self) -> bool:
        """Whether there is an optimum, local or global."""
        return self.status in ("optimal", "locally_optimal")

    @property
    def known(self) -> bool:
        """Whether there is an optimum, and its cost is known."""
        return self.solved and self.error <= KNOWN * self.scale

    @property
    def proven(self) -> bool:
        """Whether the verdict is a proof."""
        return self.status in ("optimal", "infeasible", "unbounded")


@dataclass(frozen=True)
class Outcome:
    """What became of one random problem: the answer and the verdict of every method."""

    seed: int
    answers: dict[str, Answer]
    verdicts: dict[str, Verdict]

    @property
    def passed(self) -> bool:
        """Whether the structured method is right, with both kinds of loops."""
        return not any(self.verdicts[name] in ERRORS for name in ("structured", "plain") if name in self.verdicts)

    @property
    def notable(self) -> bool:
        """Whether any method is wrong."""
        return any(verdict in ERRORS for verdict in self.verdicts.values())

    def __str__(self) -> str:
        lines = [f"{'' if self.passed else 'FAILED '}{kind_of(self.seed)} {self.seed // len(KINDS)}:"]
        for name, one in self.answers.items():
            cost = "" if one.cost is None else f", cost {one.cost:.12g}, error {one.error:.1e}"
            lines.append(f"  {name}: {self.verdicts[name]} ({one.status}{cost}) {one.message}")
        return "\n".join(lines)


def kind_of(seed: int) -> str:
    """Return the family of a seed."""
    return list(KINDS)[seed % len(KINDS)]


def problem_of(seed: int) -> lfo.OptimalControlProblem:
    """Return the problem of a seed; with modes where its family has them."""
    return KINDS[kind_of(seed)](seed // len(KINDS))


def check(seed: int) -> Outcome:
    """Solve one problem by every method, and compare."""
    problem = problem_of(seed)
    if problem.mode_names:
        return Outcome(seed, {}, dict.fromkeys(METHODS, Verdict.REFUSED))
    return compared(seed, {name: solve(problem) for name, solve in METHODS.items()})


def compared(seed: int, answers: dict[str, Answer]) -> Outcome:
    """Return the verdicts on the answers of all methods."""
    solved = [one for one in answers.values() if one.solved]
    proven = [one for one in answers.values() if one.proven and one.verified]
    best = min([one for one in proven if one.solved] or solved, key=lambda one: one.error, default=None)
    best = best if best is not None and best.known else None
    return Outcome(seed, answers, {name: _verdict(one, best, proven) for name, one in answers.items()})


def _verdict(one: Answer, best: Answer | None, proven: list[Answer]) -> Verdict:
    if one.status == "refused":
        return Verdict.REFUSED
    if not one.verified:
        return Verdict.UNVERIFIED
    kinds = {other.status for other in proven}
    if not (one.solved or one.proven):
        return Verdict.NONE if kinds or best is not None else Verdict.AGREES
    if kinds and one.status not in kinds and not (one.solved and "optimal" in kinds):
        return Verdict.CONTRADICTS
    if one.proven and len(kinds) > 1:
        return Verdict.CONTRADICTS
    if one.solved and best is not None and _differs(one, best):
        return Verdict.LESS_ACCURATE
    return Verdict.LOCAL if not one.proven and kinds else Verdict.AGREES


def _differs(one: Answer, best: Answer) -> bool:
    assert one.cost is not None
    assert best.cost is not None
    return abs(one.cost - best.cost) > max(AGREEMENT * max(one.scale, best.scale), FAR * best.error)


def _solved(method: str) -> Callable[[lfo.OptimalControlProblem], Answer]:
    def solve(problem: lfo.OptimalControlProblem) -> Answer:
        try:
            result = lfo.solve(problem, method=method, throw=False, time_limit=SECONDS)
        except lfo.errors.UnsupportedError as error:
            return Answer("refused", str(error))
        except Exception as error:  # whatever it is, it must not end a run over many problems
            return Answer(type(error).__name__, str(error))
        return _answer(problem, result)

    return solve


def _answer(problem: lfo.OptimalControlProblem, result: lfo.results.Result) -> Answer:
    certificate, status = result.certificate, str(result.status)
    if status == "infeasible":
        verified = result.ray is not None and prove_infeasible(problem, result.ray) is not None
        return Answer(status, result.message, verified=verified)
    if status == "unbounded" or certificate is None:
        return Answer(status, result.message)
    apart = np.inf if certificate.lower_bound is None else abs(certificate.cost - certificate.lower_bound)
    error = max(apart, certificate.worth_of_residuals)
    return Answer(status, result.message, certificate.cost, max(certificate.cost_scale, _rounding(problem)), error)


def _rounding(problem: lfo.OptimalControlProblem) -> float:
    """Return the rounding of the quadratic cost at the sizes in the data."""
    x, u = stated_sizes(problem)
    in_x, in_u = np.broadcast_to(x, (problem.horizon + 1, len(x))), np.broadcast_to(u, (problem.horizon, len(u)))
    return float(np.finfo(float).eps * problem.quadratic.magnitudes.value(in_x, in_u))


def _structured(compiled: bool | None) -> Callable[[lfo.OptimalControlProblem], Answer]:
    solve = _solved("structured")

    def solve_with(problem: lfo.OptimalControlProblem) -> Answer:
        chosen = loops(compiled)
        with pytest.MonkeyPatch.context() as patch:
            substitute(patch, "methods.structured.loops", lambda *given, **options: chosen)
            return solve(problem)

    return solve_with


METHODS = {
    "structured": _structured(None),
    "plain": _structured(False),
    "spectral": _solved("spectral"),
    "convex": _solved("convex"),
}
