"""All errors and warnings of the package."""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import AbstractContextManager, contextmanager
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter
from typing import Any, TypeVar, cast

NOT_OF_THE_USER = {__name__.partition(".")[0], *sys.stdlib_module_names}  # such as dataclasses, which copy problems
ADVICE = {"solver": "backend= chooses the solver, method= the algorithm."}  # on keywords that are often guessed
Entry = TypeVar("Entry")
MOST_CHARACTERS = 1000  # of a message: it may repeat names, files and values of any length


class LinFreqOCPError(Exception):
    """Base of all errors of this package. A message of more than 1,000 characters loses its middle.

    Examples
    --------
    >>> issubclass(lfo.errors.SolveError, lfo.errors.LinFreqOCPError)
    True
    """

    def __init__(self, message: str):
        end = MOST_CHARACTERS // 2 - 3
        super().__init__(message if len(message) <= MOST_CHARACTERS else f"{message[:end]} ... {message[-end:]}")


class ProblemError(LinFreqOCPError, ValueError):
    """An invalid problem: the message names the field, its value, the expected value and a remedy.

    Parameters
    ----------
    field : str
        The place of the fault, as the user wrote it (``"control_set.lower"``).
    got, expected : str
        The value there, and a description of valid values.
    advice : str, optional
        The remedy.

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


class UnknownNameError(ProblemError, KeyError):
    """A name that a mapping does not have; a mapping raises it so that ``in`` and ``get`` work."""

    __str__ = Exception.__str__  # KeyError shows the repr


class UnsupportedError(LinFreqOCPError):
    """A valid problem that the chosen method cannot solve; the message gives the reason and an alternative.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator(), "enumerate")
    Traceback (most recent call last):
    lin_freq_ocp.base.errors.UnsupportedError: method: got 'enumerate', which is for piecewise-affine dynamics; ...
    """


class MissingExtraError(LinFreqOCPError, ImportError):
    """An optional package is not installed; the message has the command that installs it.

    Examples
    --------
    >>> issubclass(lfo.errors.MissingExtraError, ImportError)
    True
    """


def missing_extra(purpose: str, package: str, extra: str) -> MissingExtraError:
    """Return the error of a part that needs the package of an extra, with the commands that install it."""
    commands = f"pip install 'lin-freq-ocp[{extra}]', or in a clone: pip install -e '.[{extra}]'"
    return MissingExtraError(f"{purpose}: {package} is not installed. Install it with: {commands}.")


class SolveError(LinFreqOCPError):
    """A solve that ended without an optimum; ``result`` holds its best trajectory and bounds.

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
        Whether the judge has verified a proof; if not, it is the claim of a solver.

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
    """The residuals at the last point of the solver, measured by the judge, are too large for a solution.

    Examples
    --------
    >>> lfo.errors.NumericalError("large residuals").result is None
    True
    """


class LimitError(SolveError):
    """A time or iteration limit was reached; the result holds the best point, if there is one.

    Attributes
    ----------
    cost : float or None
        Of the best point, None without one.
    bound : float or None
        A lower bound on the optimal cost, None if none was found.
    gap : float or None
        Their relative difference, as in ``result.gap``.

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


class NoDerivativeError(LinFreqOCPError):
    """An optimum without a derivative, asked for by a layer.

    Attributes
    ----------
    rows : tuple of str
        The rows in the way.

    Examples
    --------
    >>> lfo.errors.NoDerivativeError("layer: no derivative", ("control set, t = 3",)).rows
    ('control set, t = 3',)
    """

    def __init__(self, message: str, rows: tuple[str, ...] = ()):
        self.rows = rows
        super().__init__(f"{message} {'; '.join(rows)}".strip())


class BandWarning(UserWarning):
    """A frequency band that, on this horizon, removes nothing or everything.

    Examples
    --------
    >>> issubclass(lfo.errors.BandWarning, UserWarning)
    True
    """


class ClosedLoopWarning(UserWarning):
    """A frequency constraint of a control loop that limits each plan, but not the applied signal.

    Examples
    --------
    >>> issubclass(lfo.errors.ClosedLoopWarning, UserWarning)
    True
    """


def warn_user(text: str, category: type[Warning] = RuntimeWarning) -> None:
    """Warn at the line of the user, the first one outside this package and the standard library."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in NOT_OF_THE_USER:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


def first_line(error: Exception) -> str:
    """Return the type of an error of other software and the first line of its message."""
    return f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"


def suggestion(given: object, known: Iterable[str]) -> str:
    """Return "Did you mean ...?" with the nearest known word; empty if none is near."""
    nearest = get_close_matches(given, list(known), n=1) if isinstance(given, str) else []
    return f"Did you mean {nearest[0]!r}?" if nearest else ""


def entry_named(field: str, name: object, entries: Mapping[str, Entry]) -> Entry:
    """Return the entry of a name; UnknownNameError, a KeyError, with the names that there are."""
    if name not in entries:
        raise UnknownNameError(field, repr(name), f"one of {', '.join(entries)}", suggestion(name, entries))
    return entries[str(name)]


OPTIONS = 3  # parameters of a method that one may misspell without noticing
_ANSWERING = dict[object, object]()


def answering_misspelt(public: object) -> object:
    """Let a function, or a class with its methods, answer an unknown keyword by the nearest that it has.

    Of the methods of an object, those with at least OPTIONS parameters that may be left out. A class is changed in
    place; a function also where it is defined, so that it can be sent to other processes.
    """
    if public in _ANSWERING:
        return _ANSWERING[public]
    called = public
    if isinstance(public, type):
        members = {"__init__": inspect.getattr_static(public, "__init__"), **vars(public)}  # one of a base, too
        for name, member in members.items():
            if name == "__init__" and inspect.isfunction(member):
                setattr(public, name, _with_answer(member))
            elif isinstance(member, classmethod) and not name.startswith("_"):
                setattr(public, name, classmethod(_with_answer(member.__func__)))
            elif inspect.isfunction(member) and not name.startswith("_"):
                if len(member.__defaults__ or ()) + len(member.__kwdefaults__ or ()) >= OPTIONS:
                    setattr(public, name, _with_answer(member))
    elif inspect.isfunction(public):
        called = _with_answer(public)
        setattr(sys.modules[public.__module__], public.__name__, called)
    _ANSWERING[public] = _ANSWERING[called] = called
    return called


def answer_misspelt(namespace: dict[str, object]) -> None:
    """Let the public functions and classes of a namespace answer misspelt keywords."""
    namespace |= {name: answering_misspelt(namespace[name]) for name in cast(list[str], namespace["__all__"])}


def _with_answer(function: Callable[..., object]) -> Callable[..., object]:
    @wraps(function)
    def call(*args: object, **keywords: object) -> object:
        try:
            return function(*args, **keywords)
        except TypeError:
            parameters = inspect.signature(function).parameters
            by_name = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
            known = [name for name, one in parameters.items() if one.kind in by_name and name not in ("self", "cls")]
            unknown = next((name for name in keywords if name not in known), None)
            if unknown is None or any(one.kind is one.VAR_KEYWORD for one in parameters.values()):
                raise
            expected = f"one of the keywords {', '.join(known)}"
            advice = ADVICE.get(unknown, suggestion(unknown, known))
            raise ProblemError(unknown, repr(keywords[unknown]), expected, advice) from None

    return call


@contextmanager
def rename_field(rename: Callable[[str], str]) -> Generator[None]:
    """Let a ProblemError name the field that ``rename`` returns for its own."""
    try:
        yield
    except ProblemError as error:
        raise ProblemError(rename(error.field), error.got, error.expected, error.advice) from None


def located_at(location: str, own: str) -> AbstractContextManager[None]:
    """Let a ProblemError that names the field ``own``, or a field within it, name ``location`` instead."""
    return rename_field(lambda field: location + field[len(own) :] if field.startswith(own) else f"{location}: {field}")
