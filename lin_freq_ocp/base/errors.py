"""Everything the package raises on purpose, and the one warning it gives about frequency bands."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any


class LinFreqOCPError(Exception):
    """Base of all errors of this package.

    Examples
    --------
    >>> issubclass(lfo.errors.SolveError, lfo.errors.LinFreqOCPError)
    True
    """


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

    Examples
    --------
    >>> print(lfo.errors.ProblemError("horizon", "0", "a whole number above zero"))
    horizon: got 0; expected a whole number above zero.
    """

    def __init__(self, field: str, got: str, expected: str, advice: str = ""):
        self.field, self.got, self.expected, self.advice = field, got, expected, advice
        super().__init__(f"{field}: got {got}; expected {expected}." + (f" {advice}" if advice else ""))

    def __reduce__(self) -> tuple[object, ...]:
        """Return the arguments of an equal error: pickle would call the class with the message alone."""
        return type(self), (self.field, self.got, self.expected, self.advice), self.__dict__


class UnsupportedError(LinFreqOCPError):
    """A valid problem that the chosen method cannot take; the message says why and what can.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator(), "enumerate")
    Traceback (most recent call last):
    lin_freq_ocp.base.errors.UnsupportedError: method: got 'enumerate', which is for piecewise-affine dynamics; ...
    """


class MissingExtraError(LinFreqOCPError, ImportError):
    """An optional package is not installed; the message names it and how to get it.

    Examples
    --------
    >>> issubclass(lfo.errors.MissingExtraError, ImportError)
    True
    """


class SolveError(LinFreqOCPError):
    """A solve that ended without an optimum; ``result`` holds all that was found.

    Examples
    --------
    >>> issubclass(lfo.errors.LimitError, lfo.errors.SolveError)
    True
    """

    def __init__(self, message: str, result: Any = None):
        self.result = result
        super().__init__(message)


class InfeasibleError(SolveError):
    """No trajectory satisfies all constraints.

    Attributes
    ----------
    proven : bool
        Whether the judge has verified a proof; otherwise a solver only says so.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator(cutoff_hz=0.3), throw=False)
    >>> lfo.errors.InfeasibleError("no trajectory", result).proven
    True
    """

    @property
    def proven(self) -> bool:
        """Whether the judge has verified a proof."""
        return getattr(self.result, "status", None) == "infeasible"


class UnboundedError(SolveError):
    """The cost has no lower bound on the feasible set.

    Examples
    --------
    >>> lfo.errors.UnboundedError("no lower bound").result is None
    True
    """


class NumericalError(SolveError):
    """The solver stopped at a point whose residuals, computed by us, are too large to call it a solution.

    Examples
    --------
    >>> lfo.errors.NumericalError("large residuals").result is None
    True
    """


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

    Examples
    --------
    >>> problem = lfo.library.pendulum_with_wall()
    >>> result = lfo.solve(problem, node_limit=1, throw=False)
    >>> lfo.errors.LimitError("stopped", result).gap == result.gap
    True
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
    """A frequency band that, on this horizon, removes nothing or everything.

    Examples
    --------
    >>> issubclass(lfo.errors.BandWarning, UserWarning)
    True
    """


class ClosedLoopWarning(UserWarning):
    """A frequency constraint of a control loop that holds for each plan, and says nothing about what is applied.

    Examples
    --------
    >>> issubclass(lfo.errors.ClosedLoopWarning, UserWarning)
    True
    """


def first_line(error: Exception) -> str:
    """Return what kind of an error of others it is, and the beginning of what it says."""
    return f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"


def suggestion(given: object, known: Iterable[str]) -> str:
    """Return the question whether the nearest known word was meant, or nothing if none is near."""
    nearest = get_close_matches(given, list(known), n=1) if isinstance(given, str) else []
    return f"Did you mean {nearest[0]!r}?" if nearest else ""


@contextmanager
def located_at(location: str, own: str) -> Generator[None]:
    """Let a ProblemError that names the field ``own``, or one within, name it at ``location`` instead."""
    try:
        yield
    except ProblemError as error:
        rest = error.field.removeprefix(own)
        field = location + rest if rest != error.field else f"{location}: {error.field}"
        raise ProblemError(field, error.got, error.expected, error.advice) from None
