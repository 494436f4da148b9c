"""The answers of the sparse program and of the structured method to linear problems, against each other or a file.

Part of scripts/verify.py: every linear problem of the library with its defaults, and random ones of all kinds, each
solved once by either method. ``--save FILE`` (npz) writes status, cost, bound and multipliers; ``--against FILE``
compares with those of another state of the code. Verdicts must be the same, and costs and bounds within COST, relative
to the sum of the absolute terms of the cost. Multipliers are compared where they are unique, that is, where the
gradients of all equations and active rows are independent (``uniqueness``); the largest differences are printed with
the gap of the answer, which bounds what they can be worth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from helpers.checks.structured import kind_of, problem_of
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.library import LINEAR, MEASURED, WAVEFORMS
from lin_freq_ocp.methods.fitted_multipliers import uniqueness
from lin_freq_ocp.transform.sizes import search_scale, stated_sizes

METHODS = "convex", "structured"
SEEDS = 120  # random problems, with the kinds in turn
COST = 1e-9  # difference of costs and bounds, relative to the sum of the absolute terms of the cost
NOTABLE = 1e-6  # difference of unique multipliers, relative to the largest of all, from which it is printed
SECONDS = 60.0  # for every solve


@dataclass(frozen=True)
class Answer:
    """The answer of one method to one problem; multipliers by their names, only with a trajectory."""

    status: str
    cost: float
    bound: float
    gap: float  # relative to scale
    scale: float  # of the cost
    unique: bool
    multipliers: dict[str, Array]  # times the sizes of their values


def problems() -> Iterator[tuple[str, lfo.OptimalControlProblem]]:
    """Yield the linear problems of the library, then random ones."""
    for name, benchmark in (LINEAR | WAVEFORMS | MEASURED).items():
        yield name, benchmark()
    for seed in range(SEEDS):
        problem = problem_of(seed)
        if not problem.mode_names:
            yield f"{kind_of(seed)} {seed}", problem


def answer(problem: lfo.OptimalControlProblem, method: str) -> Answer | None:
    """Return the answer of a method; None if it does not take the problem."""
    try:
        result = lfo.solve(problem, method=method, time_limit=SECONDS, throw=False)
    except lfo.errors.UnsupportedError:
        return None
    if result.trajectory is None or result.multipliers is None or result.cost is None:
        return Answer(str(result.status), np.nan, np.nan, np.nan, 1.0, False, {})
    scale, bound = search_scale(problem, result.trajectory) or 1.0, result.lower_bound
    try:
        unique = uniqueness(problem, result.trajectory).unique
    except lfo.errors.UnsupportedError:  # too many gradients for their rank
        unique = False
    multipliers = _worths(problem, result.multipliers)
    bound = np.nan if bound is None else bound
    return Answer(str(result.status), result.cost, bound, (result.cost - bound) / scale, scale, unique, multipliers)


def _worths(problem: lfo.OptimalControlProblem, found: lfo.Multipliers) -> dict[str, Array]:
    """Return multipliers times the stated sizes of their values, so that all are in the unit of the cost."""
    x, u = stated_sizes(problem)
    signals = np.broadcast_to(x, found.mu.shape), np.broadcast_to(u, found.nu.shape)
    of_states, of_controls = ("eta", "mu", "rho_x"), ("nu", "rho_u")
    worths = {name: getattr(found, name) * x for name in of_states}
    worths |= {name: getattr(found, name) * u for name in of_controls}
    sizes = {term.name: term.map.sizes(*signals).max(initial=0.0) for term in problem.terms}
    return worths | {f"stage {name}": values * sizes[name] for name, values in found.stage.items() if name in sizes}


def all_answers() -> dict[str, Answer]:
    """Return the answers of all methods by problem and method."""
    found: dict[str, Answer] = {}
    with threadpool_limits(1):
        for name, problem in problems():
            for method in METHODS:
                one = answer(problem, method)
                if one is not None:
                    found[f"{name}, {method}"] = one
    return found


def save(answers: dict[str, Answer], path: Path) -> None:
    """Write answers into an npz file."""
    arrays: dict[str, Array] = {}
    for key, one in answers.items():
        arrays[f"{key}/status"] = np.array(one.status)
        arrays[f"{key}/numbers"] = np.array([one.cost, one.bound, one.gap, one.scale, one.unique])
        arrays |= {f"{key}/multipliers/{name}": values for name, values in one.multipliers.items()}
    np.savez_compressed(path, allow_pickle=False, **arrays)


def load(path: Path) -> dict[str, Answer]:
    """Return the answers in a file of ``save``."""
    with np.load(path) as file:
        arrays = dict(file)
    found: dict[str, Answer] = {}
    for key in dict.fromkeys(name.split("/")[0] for name in arrays if name.endswith("/status")):
        cost, bound, gap, scale, unique = (float(number) for number in arrays[f"{key}/numbers"])
        start = f"{key}/multipliers/"
        multipliers = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
        found[key] = Answer(str(arrays[f"{key}/status"]), cost, bound, gap, scale, bool(unique), multipliers)
    return found


def multiplier_difference(one: Answer, other: Answer) -> float:
    """Return the largest difference of two multipliers, relative to the largest of all.

    Those of a mask at every frequency are left out where they stand at other frequencies.
    """
    pairs = [(values, other.multipliers[name]) for name, values in one.multipliers.items()]
    pairs = [(values, others) for values, others in pairs if values.shape == others.shape]
    largest = max(float(np.abs(values).max(initial=0.0)) for values, _ in pairs)
    return max(float(np.abs(values - others).max(initial=0.0)) for values, others in pairs) / (largest or 1.0)


def compare(console: Console, pairs: dict[str, tuple[Answer, Answer]], title: str) -> bool:
    """Print where two answers differ; return whether verdicts and costs are the same."""
    table = Table("answer", "verdicts", "cost", "bound", "multipliers", "unique", "gap", title=title)
    failed, costs, unique = 0, [0.0], [0.0]
    for key, (one, other) in pairs.items():
        cost, bound = (abs(a - b) / one.scale for a, b in ((one.cost, other.cost), (one.bound, other.bound)))
        same = one.status == other.status and not cost > COST and np.isnan(one.bound) == np.isnan(other.bound)
        multipliers = multiplier_difference(one, other) if one.multipliers and other.multipliers else 0.0
        both_unique = one.unique and other.unique
        failed += not same
        costs.append(np.nan_to_num(cost))
        unique.append(multipliers if both_unique else 0.0)
        if not same or bound > COST or (both_unique and multipliers > NOTABLE):
            verdicts = one.status if one.status == other.status else f"{one.status} -> {other.status}"
            words = "yes" if both_unique else "no"
            gap = max(one.gap, other.gap)
            row = key, verdicts, f"{cost:.1e}", f"{bound:.1e}", f"{multipliers:.1e}", words, f"{gap:.1e}"
            table.add_row(*row, style=None if same else "red")
    console.print(table)
    console.print(
        f"{len(pairs)} pairs, {failed} with another verdict or cost; largest differences: cost {max(costs):.1e}"
    )
    console.print(f"unique multipliers of {sum(a.unique and b.unique for a, b in pairs.values())}: {max(unique):.1e}")
    return not failed


def verify(console: Console, saved: Path | None = None, against: Path | None = None) -> bool:
    """Solve all problems; compare the methods, or with the answers in a file, and write them into another."""
    answers = all_answers()
    if saved is not None:
        save(answers, saved)
    if against is not None:
        before = load(against)
        missing = sorted(set(before) ^ set(answers))
        if missing:
            console.print(f"answered by one of both only: {', '.join(missing)}")
        pairs = {key: (before[key], one) for key, one in answers.items() if key in before}
        return compare(console, pairs, f"answers that differ from {against}") and not missing
    firsts = {key.removesuffix(", convex"): one for key, one in answers.items() if key.endswith(", convex")}
    pairs = {
        name: (one, other) for name, one in firsts.items() if (other := answers.get(f"{name}, structured")) is not None
    }
    solved = {name: pair for name, pair in pairs.items() if all(one.multipliers for one in pair)}
    return compare(console, solved, "answers of the sparse program and of the structured method that differ")
