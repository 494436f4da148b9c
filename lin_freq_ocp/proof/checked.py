"""What the checker makes of the lines of a proof, in this process: the file is never whole in memory."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from flint import arb, ctx
from lfo_check import check

from lin_freq_ocp.proof.enclosure import Enclosure


class Lines:
    """Lines as a file of bytes."""

    def __init__(self, lines: Iterable[str]):
        self.lines = iter(lines)

    def readline(self, limit: int) -> bytes:
        """Return the next line."""
        return next(self.lines, "").encode()


def checked(lines: Iterable[str]) -> Enclosure:
    """Return what a proof proves; raise the checker's error if it proves nothing."""
    with ctx.workprec(ctx.prec):  # the checker sets the precision
        lower, upper = check(Lines(lines), _silent)
    return Enclosure(_rounded(lower, -np.inf), _rounded(upper, np.inf))


def _rounded(exact: arb, towards: float) -> float:
    """Return an exact ball as a float, rounded one way."""
    found = float(exact)
    while arb(found) > exact if towards < 0 else arb(found) < exact:
        found = float(np.nextafter(found, towards))
    return found


def _silent(text: str) -> None:
    """Say nothing of the summary."""
