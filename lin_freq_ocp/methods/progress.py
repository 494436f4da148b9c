"""The progress of a search, which long solves report."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """What every search reports.

    Attributes
    ----------
    cost, lower_bound : float
        Of the best trajectory found, and of all; infinite as long as there is none.
    """

    cost: float
    lower_bound: float
