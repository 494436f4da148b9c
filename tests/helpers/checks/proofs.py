"""Proofs under mutation and of random problems: what the checker says must be true of the optimum to 50 digits.

A mutated proof is rejected, or what is printed still holds. A mutation within PROBLEM must change the hash that is
printed, and what is printed must hold of the problem that it makes.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

import lin_freq_ocp as lfo
from helpers import hand_proofs
from helpers.exact import Statement, optimal_cost
from helpers.hand_proofs import Verdict, check, text
from helpers.mutations import Mutation
from helpers.random import convex, kinks, mixed

LARGEST = 90  # controls and components of x_0: an exact optimum takes seconds
NO_CLAIM = '{"section": "claim", "lower": "-inf", "upper": "inf"}\n'
KINDS_OF_RANDOM = 4  # of which two are convex problems of the same kind


@dataclass(frozen=True)
class Truth:
    """The ends of an interval that has the optimal cost (None: infeasible), or only the cost of one mode sequence."""

    ends: tuple[Fraction, Fraction] | None
    above_only: bool = False

    def denies(self, verdict: Verdict) -> str:
        """Return what is wrong with a verdict, empty if nothing is."""
        if verdict.status != 0:
            return ""
        if self.ends is None:
            return (
                f"{verdict.last}, but nothing is feasible" if verdict.interval and verdict.interval[1] != "inf" else ""
            )
        if verdict.interval is None:
            return f"{verdict.last}, but the optimum is {float(self.ends[1]):.17g}"
        lower, upper = verdict.interval
        if lower != "-inf" and Fraction(lower) > self.ends[1]:
            return f"{verdict.last}, but the optimum is {float(self.ends[1]):.17g}"
        if not self.above_only and upper != "inf" and Fraction(upper) < self.ends[0]:
            return f"{verdict.last}, but the optimum is {float(self.ends[0]):.17g}"
        return ""


def exact_truth(proof: str, tree: bool = False) -> Truth | None:
    """Return the exact optimum of a proof's PROBLEM along the modes of its POINT; None if there is none to be had."""
    try:
        found = optimal_cost(Statement.read(proof))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, NotImplementedError, ZeroDivisionError):
        return None  # a problem that a mutation has spoiled
    if found is None:
        return None
    ends = [Fraction(*(int(part) for part in (end.fmpq().p, end.fmpq().q))) for end in (found.lower(), found.upper())]
    return Truth((ends[0], ends[1]), above_only=tree)


def hash_of(verdict: Verdict) -> str:
    """Return the line with the hash of PROBLEM; empty if it was not printed."""
    return next((line for line in verdict.printed.splitlines() if "sha256" in line.lower()), "")


def wrong_of(mutation: Mutation, truth: Truth, first_hash: str, folder: Path) -> str:
    """Check a mutated proof; return what is wrong with what the checker says of it, empty if nothing is.

    No bound is to be caught by the other one, nor by the claim: mutations are checked without them.
    """
    apart = {"nodes": without_point, "dual": without_point, "point": with_a_weak_dual}
    lines = apart[mutation.section](mutation.lines) if mutation.section in apart else mutation.lines
    verdict = check("".join(lines), folder)
    if mutation.section not in ("problem", "pulse train"):
        return truth.denies(verdict)
    if verdict.status == 0 and hash_of(verdict) == first_hash:
        return f"the same hash: {verdict.last}"
    if verdict.status == 0:
        changed = exact_truth("".join(mutation.lines), truth.above_only)
        return changed.denies(verdict) if changed else ""
    return ""


def without_point(lines: list[str]) -> list[str]:
    """Return a proof without its POINT, which claims nothing."""
    at = {json.loads(line).get("section"): index for index, line in enumerate(lines)}
    return [*lines[: at["claim"]], NO_CLAIM, *lines[at.get("nodes", at["claim"] + 1) :]]


def with_a_weak_dual(lines: list[str]) -> list[str]:
    """Return a proof that claims nothing, of one dual with its points z alone; trees as they are."""
    objects = [json.loads(line) for line in lines]
    if sum(one.get("section") == "dual" for one in objects) != 1:
        return lines
    kept = [{"t": one["t"], "z": one["z"]} if "z" in one else one for one in objects]
    kept = [one for one in kept if not {"signal", "multiplier"} & one.keys()]
    return [NO_CLAIM if one.get("section") == "claim" else json.dumps(one) + "\n" for one in kept]


def written(problem: lfo.OptimalControlProblem, **options: object) -> str:
    """Return the proof of a problem's optimum, or of its infeasibility."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "some.proof"
        lfo.solve(problem, throw=False, **options).write_proof(path)
        return path.read_text()


def _double_integrator(**given: object) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]], sampling_time=0.5)
    arguments: dict[str, object] = {
        "cost": lfo.QuadraticCost(Q=[[0.5, 0.0], [0.0, 0.25]], R=1.0),
        "control_set": lfo.Box(-2.0, 2.0),
        "initial_state": [0.0, 0.0],
        "terminal_state": [2.0, 0.0],
    }
    return lfo.OptimalControlProblem(dynamics, 8, **(arguments | given))


def _masked(**bound: object) -> lfo.OptimalControlProblem:
    return _double_integrator(control_spectrum=lfo.spectrum.MagnitudeBound(band=lfo.low_pass(1.5), **bound))


KINDS: dict[str, Callable[[], str]] = {
    "by hand": lambda: text(hand_proofs.double_integrator()),
    "two modes, by hand": lambda: text(hand_proofs.two_modes()),
    "a ray, by hand": lambda: text(hand_proofs.infeasible()),
    "stop band": lambda: written(_double_integrator(control_spectrum=lfo.stop_band(bins=[3, 4]))),
    "stop band of a state": lambda: written(_double_integrator(state_spectrum=lfo.stop_band(bins=[2], component=1))),
    "masks": lambda: written(_masked(limit=0.75)),
    "energy": lambda: written(_double_integrator(control_spectrum=lfo.spectrum.EnergyBound(2.0, bins=[2, 3]))),
    "soft rows": lambda: written(
        _double_integrator(stage_rows=lfo.StageRows([[0.0, 1.0]], [[0.5]], [0.75], penalty=0.5))
    ),
    "a ball and a norm": lambda: written(
        _double_integrator(
            terminal_state=lfo.sets.Ball(0.25, centre=[2.0, 0.0]),
            cost=lfo.QuadraticCost(R=1.0) + lfo.costs.L1Cost(u=0.25),
        )
    ),
    "every frequency": lambda: written(_masked(limit=1.5, every_frequency=True)),
    "too weak": lambda: written(_double_integrator(control_set=lfo.Box(-0.25, 0.25))),
    "a tree": lambda: written(lfo.library.switched_rotation(horizon=4, initial_state=(-6, 7))),
    "a tree with a band": lambda: written(lfo.library.by_name("buck_affine")(horizon=4, control_spectrum=[2])),
    "a tree of rays": lambda: written(
        replace(lfo.library.switched_rotation(horizon=3, initial_state=(-6, 7)), terminal_state=[5.0, 5.0])
    ),
    "a pulse train": lambda: written(
        lfo.library.pulse_pattern("opp", modulation=1.05, switches=8, least_dwell=0.03, unipolar=True, exactly=True)
    ),
}
UNKNOWN = "every frequency", "a ray, by hand", "too weak", "a tree of rays", "a pulse train"  # to the exact solver
"""Kinds of proofs, small enough that every number can be changed."""


def truth_of(kind: str, proof: str, folder: Path) -> tuple[Truth, str]:
    """Return the truth about a kind's problem, and its hash."""
    verdict = check(proof, folder)
    assert verdict.status == 0, verdict.printed
    if kind in UNKNOWN:
        ends = verdict.interval
        return Truth(None if ends is None else (Fraction(ends[0]), Fraction(ends[1]))), hash_of(verdict)
    truth = exact_truth(proof)
    assert truth is not None, kind
    return truth, hash_of(verdict)


@dataclass(frozen=True)
class Outcome:
    """What became of one random problem: the checker's last line, the interval's relative width (NaN without one).

    ``exact``: whether the optimum is known to 50 digits; of a tree, that of its best sequence.
    """

    seed: int
    kind: str
    last: str
    width: float = np.nan
    exact: bool = False
    wrong: str = ""

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def random_result(seed: int) -> tuple[str, lfo.results.Result]:
    """Solve a random problem: convex, of mixed features, or over modes; small enough for an exact optimum."""
    for attempt in range(100):
        number = seed + 1000 * attempt
        if seed % KINDS_OF_RANDOM == 1:
            kind, problem = "mixed", mixed.problem_of(mixed.random_model(number))
        elif seed % KINDS_OF_RANDOM == 2:
            kind, problem = "kinks", kinks.random_problem(number)[1]
        else:
            kind, problem = convex.random_problem(number)
        if problem.state_dim + problem.horizon * problem.control_dim <= LARGEST:
            with suppress(lfo.errors.UnsupportedError), warnings.catch_warnings():  # several modes without bounds
                warnings.simplefilter("ignore", lfo.errors.BandWarning)
                return kind, lfo.solve(problem, throw=False)
    raise ValueError(seed)


def check_random(seed: int) -> Outcome:
    """Solve a random problem, write and check its proof, and compare it with the exact optimum."""
    kind, result = random_result(seed)
    tree = result.tree is not None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "some.proof"
        try:
            result.write_proof(path)
        except lfo.errors.SolveError as error:  # a ray that excludes trajectories of practical size only, say
            return Outcome(seed, kind, str(result.status), wrong=str(error) if result.status == "optimal" else "")
        verdict = hand_proofs.check_file(path)
        if verdict.status or verdict.interval is None:
            return Outcome(seed, kind, verdict.last, wrong=verdict.printed if verdict.status else "")
        truth = exact_truth(path.read_text(), tree)
    if "inf" in verdict.interval[1]:
        return Outcome(seed, kind, verdict.last, exact=truth is not None, wrong=truth.denies(verdict) if truth else "")
    lower, upper = map(Fraction, verdict.interval)
    width = float((upper - lower) / max(abs(lower), abs(upper), Fraction(1, 10**300)))
    return Outcome(seed, kind, verdict.last, width, truth is not None, truth.denies(verdict) if truth else "")
