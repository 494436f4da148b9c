"""Further answers to a convex program, for where the best is not proven.

Small residuals of a program do not suffice if a component that should be zero holds rounding, which is judged by its
own size, or if a far bound disturbed the solver. So answers are polished and rounded, and the program is solved in
other units, with and without far bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex.attempts import Attempt, Solves, better_of, over
from lin_freq_ocp.methods.convex.polish import polished, without_rounding
from lin_freq_ocp.program.backends.base import Claim, Solution
from lin_freq_ocp.program.program import Scaling
from lin_freq_ocp.program.units import bounds_scaling, own_scaling, plain_scaling, stated_scaling

ROUNDING_LEVELS = (1e-12, 1e-9)  # parts of the units of variables and duals that may be rounding: the judge decides
LARGEST_ERROR = 1e-3  # relative residuals up to which versions of a point are judged


def further(solves: Solves, natural: Scaling, best: Attempt) -> Iterator[Candidate]:
    """Yield other candidates than the best attempt until the time limit or Ctrl-C; ``natural``: the expected units."""
    if best.ended:
        return
    yield from _versions(solves, natural, best)
    for units in _units(solves, natural):
        for solve in (solves.complete, solves.near):
            if over(solves):
                return
            scaling = units(best)
            attempt = None if scaling is None else solve(scaling)
            if attempt is None:
                continue
            if attempt.ended:
                if attempt.candidate.interrupted:
                    yield replace(best.candidate, interrupted=True)
                return
            if attempt.z is not None or attempt.candidate.status in ("infeasible", "unbounded"):
                yield attempt.candidate
            yield from _versions(solves, natural, attempt)
            best = better_of(best, attempt)


def _units(solves: Solves, natural: Scaling) -> list[Callable[[Attempt], Scaling | None]]:
    """Return other units, each from the best attempt so far; units that need its point come last."""
    transcription = solves.transcription

    def own(best: Attempt, per_time: bool) -> Scaling | None:
        return None if best.z is None else own_scaling(transcription, best.z, natural.columns, per_time)

    return [
        lambda _: plain_scaling(transcription),
        lambda _: stated_scaling(transcription),
        lambda _: natural,
        lambda _: bounds_scaling(transcription, natural),
        lambda best: own(best, per_time=False),
        lambda best: own(best, per_time=True),
    ]


def _versions(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Yield a point with exact zeros for rounding, polished, and both."""
    if attempt.z is None or attempt.y is None or attempt.error > LARGEST_ERROR:
        return
    yield from _rounded(solves, natural, attempt)
    program = solves.transcription.program.scaled(attempt.scaling)
    if program.cones or over(solves):
        return
    scaling = attempt.scaling
    found = polished(program, scaling.scaled_primal(attempt.z), scaling.scaled_dual(attempt.y))
    if found is not None:
        better = solves.measured(scaling, program, Solution(Claim.SOLVED, *found, "polished"))
        if better.z is not None and better.error <= LARGEST_ERROR:
            yield better.candidate
            yield from _rounded(solves, natural, better)


def _rounded(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Yield a point with exact zeros for what is rounding in the natural units, if that changes it."""
    assert attempt.z is not None
    assert attempt.y is not None
    program, before = solves.transcription.program.scaled(natural), (attempt.z, attempt.y)
    for level in ROUNDING_LEVELS:
        z = without_rounding(attempt.z, natural.columns, level)
        y = without_rounding(attempt.y, natural.rows / natural.cost, level)
        if np.array_equal(z, before[0]) and np.array_equal(y, before[1]):
            continue
        before = z, y
        scaled = natural.scaled_primal(z), natural.scaled_dual(y)
        yield solves.measured(natural, program, Solution(Claim.SOLVED, *scaled, attempt.candidate.message)).candidate
