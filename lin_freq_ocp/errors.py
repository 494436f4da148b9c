"""Everything the package raises on purpose, and the one warning it gives about frequency bands."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

__all__ = [
    "BandWarning",
    "InfeasibleError",
    "LimitError",
    "LinFreqOCPError",
    "MissingExtraError",
    "NumericalError",
    "ProblemError",
    "SolveError",
    "UnboundedError",
    "UnsupportedError",
]


class LinFreqOCPError(Exception):
    """Base of all errors of this package."""


class ProblemError(LinFreqOCPError, ValueError):
    """A description that is not a problem: says which field, what was got, what was expected and what to do.

    Parameters
    ----------
    field : str
        Where the fault is, as the user wrote it (``"control_set.lower"``).
    got, expected : str
        What was found there, and what would be right.
    advice : str, optional
        What to do about it.
    """

    def __init__(self, field: str, got: str, expected: str, advice: str = ""):
        self.field, self.got, self.expected, self.advice = field, got, expected, advice
        super().__init__(f"{field}: got {got}; expected {expected}." + (f" {advice}" if advice else ""))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes an equal error in another process: pickle would call the class with the message alone."""
        return type(self), (self.field, self.got, self.expected, self.advice), self.__dict__


class UnsupportedError(LinFreqOCPError):
    """A valid problem that the chosen method cannot take; the message says why and what can."""


class MissingExtraError(LinFreqOCPError, ImportError):
    """An optional package is not installed; the message names it and how to get it."""


class SolveError(LinFreqOCPError):
    """A solve that ended without an optimum; ``result`` holds all that was found."""

    def __init__(self, message: str, result: Any = None):
        self.result = result
        super().__init__(message)


class InfeasibleError(SolveError):
    """No trajectory satisfies all constraints.

    Attributes
    ----------
    proven : bool
        Whether the judge has verified a proof; otherwise a solver only says so.
    """

    @property
    def proven(self) -> bool:
        """Whether the judge has verified a proof."""
        return getattr(self.result, "status", None) == "infeasible"


class UnboundedError(SolveError):
    """The cost has no lower bound on the feasible set."""


class NumericalError(SolveError):
    """The solver stopped at a point whose residuals, computed by us, are too large to call it a solution."""


class LimitError(SolveError):
    """A time or iteration limit was reached first; the result holds the best point, if there is one.

    Attributes
    ----------
    cost : float or None
        Of the best point, None if there is none.
    bound : float or None
        A lower bound on the optimal cost, None if none was found.
    gap : float or None
        What the two leave open, as ``result.gap`` says it.
    """

    @property
    def cost(self) -> float | None:
        """Return the cost of the best point."""
        return getattr(self.result, "cost", None)

    @property
    def bound(self) -> float | None:
        """Return the lower bound on the optimal cost."""
        return getattr(self.result, "lower_bound", None)

    @property
    def gap(self) -> float | None:
        """Return the gap between the two."""
        return getattr(self.result, "gap", None)


class BandWarning(UserWarning):
    """A frequency band that, on this horizon, removes nothing or everything."""


def first_line(error: Exception) -> str:
    """Return what kind of an error of others it is, and the beginning of what it says."""
    return f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"


def suggestion(given: Any, known: Iterable[str]) -> str:
    """Return the question whether the nearest known word was meant, or nothing if none is near."""
    nearest = get_close_matches(given, list(known), n=1) if isinstance(given, str) else []
    return f"Did you mean {nearest[0]!r}?" if nearest else ""
