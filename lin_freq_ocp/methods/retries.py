"""Further answers to a convex program, for where the judge proves nothing of the best one.

Small residuals of a program are not always enough: a component that should be zero holds rounding and is judged by its
own size, or a bound that nothing reaches has spoilt the solve. So there are versions of an answer (polished, and with
exact zeros for what is rounding), and solves in other units, each with and without far bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.methods.attempts import Attempt, Solves, over
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.polish import polished, without_rounding
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.transcription.program import Program, Scaling
from lin_freq_ocp.transcription.units import own_scaling, plain_scaling, stated_scaling

ROUNDING_LEVELS = (1e-12, 1e-9)
"""Parts of a variable's and a dual's unit below which they may be rounding: the judge decides."""

HOPELESS = 1e-3
"""Relative residuals from which versions of a point are not worth a judgement."""

POLISHED = "polished"
"""Words for a point that no solver has returned as it is."""


def further(solves: Solves, natural: Scaling, best: Attempt) -> Iterator[Candidate]:
    """Return other candidates than the best attempt, one after the other, until the time is over or Ctrl-C.

    Parameters
    ----------
    solves : Solves
    natural : Scaling
        The units in which the program is expected to be of order 1.
    best : Attempt
        What is known already.
    """
    if best.ended:
        return
    yield from _versions(solves, natural, best)
    for way in _ways(solves, natural, best):
        if over(solves):
            return
        attempt = way()
        if attempt.ended:
            if attempt.candidate.interrupted:
                yield replace(best.candidate, interrupted=True)
            return
        if attempt.z is not None or attempt.candidate.status in ("infeasible", "unbounded"):
            yield attempt.candidate
        yield from _versions(solves, natural, attempt)


def _ways(solves: Solves, natural: Scaling, best: Attempt) -> Iterator[Callable[[], Attempt]]:
    """Return further solves: for a point that costs nothing, and in other units, which are computed when needed."""
    transcription = solves.transcription
    yield lambda: _without_slope(solves, natural)
    units = [
        lambda: plain_scaling(transcription),
        lambda: stated_scaling(transcription),
        lambda: natural,
    ]
    if best.z is not None:
        z = best.z
        units += [lambda: own_scaling(transcription, z, natural.columns)]
        units += [lambda: own_scaling(transcription, z, natural.columns, per_time=True)]
    for unit in units:
        yield lambda unit=unit: solves.complete(unit())
        yield lambda unit=unit: solves.attempt(unit())


def _versions(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Return a point with exact zeros for rounding, polished, and both."""
    if attempt.z is None or attempt.y is None or attempt.error > HOPELESS:
        return
    yield from _rounded(solves, natural, attempt)
    program = attempt.scaling.apply(solves.transcription.program)
    if program.cones or over(solves):
        return
    scaling = attempt.scaling
    found = polished(program, attempt.z / scaling.columns, attempt.y * scaling.cost / scaling.rows)
    if found is not None:
        better = solves.measured(scaling, program, Solution(Claim.SOLVED, *found, POLISHED))
        if better.z is not None and better.error <= HOPELESS:
            yield better.candidate
            yield from _rounded(solves, natural, better)


def _rounded(solves: Solves, natural: Scaling, attempt: Attempt) -> Iterator[Candidate]:
    """Return a point with exact zeros for what is rounding in the natural units, if that changes it."""
    assert attempt.z is not None
    assert attempt.y is not None
    program, before = natural.apply(solves.transcription.program), (attempt.z, attempt.y)
    for level in ROUNDING_LEVELS:
        z = without_rounding(attempt.z, natural.columns, level)
        y = without_rounding(attempt.y, natural.rows / natural.cost, level)
        if np.array_equal(z, before[0]) and np.array_equal(y, before[1]):
            continue
        before = z, y
        scaled = z / natural.columns, y * natural.cost / natural.rows
        yield solves.measured(natural, program, Solution(Claim.SOLVED, *scaled, attempt.candidate.words)).candidate


def _without_slope(solves: Solves, scaling: Scaling) -> Attempt:
    """Return a point of slope zero, P z + q = 0: where there is one, its cost is the least, with duals of zero.

    Interior-point methods come near a face of such points only to the root of their tolerance.
    """
    program = scaling.apply(solves.transcription.program)
    curved = np.flatnonzero(abs(program.P).sum(1) + np.abs(program.q))
    flat = Program(
        P=sp.csc_array(program.P.shape),
        q=np.zeros_like(program.q),
        constant=0.0,
        A=sp.csc_array(sp.vstack([program.A, program.P[curved]])),
        lower=np.concatenate([program.lower, -program.q[curved]]),
        upper=np.concatenate([program.upper, -program.q[curved]]),
        rows=program.rows,
        cones=program.cones,
    )
    solution = solves.solver(flat, solves.asked, solves.left)
    if solution.claim is not Claim.SOLVED or solution.z is None or solution.y is None:
        ended = solution.claim in (Claim.LIMIT, Claim.INTERRUPTED)
        failed = solution if ended else replace(solution, claim=Claim.FAILED)
        return solves.measured(scaling, program, replace(failed, z=None, y=None))
    found = None if program.cones else polished(flat, solution.z, np.zeros_like(solution.y))
    z: Array = solution.z if found is None else found[0]
    return solves.measured(scaling, program, replace(solution, z=z, y=np.zeros(len(program.lower))))
