"""The options of ``solve``, and the table of methods: those for each kind of dynamics, with the options they take.

A new kind of dynamics is a subclass of ``Dynamics``. With an entry here it has methods of its own, otherwise those of
its standard form. Dynamics with modes or kinks register their methods in solving/hybrid.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

from lin_freq_ocp.base.errors import UnsupportedError, suggestion
from lin_freq_ocp.base.kinds import register_all
from lin_freq_ocp.problem.dynamics.base import entry_for
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.backends.base import backend as solver_named
from lin_freq_ocp.program.backends.base import names
from lin_freq_ocp.solving.linear import Convex, LinearAuto, Spectral, Structured
from lin_freq_ocp.solving.method import Method


@dataclass(frozen=True, eq=False)
class Options:
    """The keywords of ``lfo.solve`` that choose a method and limit it; ``lfo.solve`` documents them.

    UnsupportedError if one does not exist, MissingExtraError if the backend is not installed.
    """

    method: str | Method = "auto"
    backend: str = "auto"
    time_limit: float | None = None
    tolerance: float | None = None
    gap: float | None = None
    node_limit: int | None = None
    executor: Executor | None = None
    start: object = None
    global_bound: bool | None = None

    def __post_init__(self):
        if isinstance(self.method, str) and self.method != "auto":
            require_shorthand(self.method)
        if self.backend != "auto" and self.backend not in names(binaries=True):
            solver_named(self.backend)
        for name in ("time_limit", "tolerance", "gap", "node_limit"):
            value = getattr(self, name)
            if value is not None and not (hasattr(value, "__float__") and value > 0):
                raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")


DEFAULT_OPTIONS = Options()


@dataclass(frozen=True)
class Shorthand:
    """The method with a name of its own, with default options, and the field that each keyword of ``solve`` sets."""

    method: Method
    options: Mapping[str, str] = field(default_factory=dict[str, str])

    def describes(self, method: Method) -> bool:
        """Whether a method differs from the default only in options that can be given as keywords."""
        if type(method) is not type(self.method):
            return False
        without_keyword = set(method.__dataclass_fields__) - set(self.options.values())
        return all(getattr(method, name) == getattr(self.method, name) for name in without_keyword)


@dataclass(frozen=True)
class Family:
    """A kind of dynamics and its methods, by their shorthands; ``in_loop`` is what "auto" means in a control loop."""

    kind: str
    shorthands: Mapping[str, Shorthand]
    in_loop: str = "auto"

    @property
    def methods(self) -> tuple[type, ...]:
        """Return the classes of the methods."""
        return tuple({type(shorthand.method): None for shorthand in self.shorthands.values()})


RESIDUALS = {"tolerance": "tolerance"}
SOLVER = {"backend": "backend"}

LINEAR = {
    "auto": Shorthand(LinearAuto(), {**RESIDUALS, **SOLVER}),
    "spectral": Shorthand(Spectral(), RESIDUALS),
    "structured": Shorthand(Structured(), RESIDUALS),
    "convex": Shorthand(Convex(), {**RESIDUALS, **SOLVER}),
}
WITHOUT_STAGES = {name: shorthand for name, shorthand in LINEAR.items() if name != "structured"}

FAMILIES: dict[type, Family] = {
    LinearDynamics: Family("linear", LINEAR),
    FrequencyResponse: Family("frequency-response", WITHOUT_STAGES),
}

# methods of earlier versions, with the advice that replaces them
REMOVED = {"minlp": "SCIP's claims are an independent check in scripts/verify/nonsmooth.py now; use 'auto'"}

# why other methods do not take an option
ONLY = {
    "backend": "only 'convex' and 'miqp' call another solver",
    "tolerance": "the method 'nonsmooth' has no gap to prove; 'auto' does",
    "gap": "linear dynamics have a 'tolerance'; searches over modes, and 'auto', have a gap to prove",
    "node_limit": "only a search over affine modes has nodes",
    "executor": "only 'branch_and_bound' has parts for it",
    "start": "only 'branch_and_bound' and the search over smooth pieces begin with one",
    "global_bound": "only 'auto' over smooth pieces computes one after its search",
}


def family_of(problem: OptimalControlProblem) -> Family:
    """Return the methods for the dynamics of a problem."""
    return entry_for(FAMILIES, problem.form)


def require_shorthand(name: str) -> None:
    """Raise UnsupportedError unless a method for any kind of dynamics has this name."""
    if name in REMOVED:
        raise UnsupportedError(f"method: got {name!r}, which is no method any more: {REMOVED[name]}.")
    if any(name in family.shorthands for family in FAMILIES.values()):
        return
    register_all()
    names = list(dict.fromkeys(name for family in FAMILIES.values() for name in family.shorthands))
    if name not in names:
        known = ", ".join(map(repr, names[:-1]))
        hint = suggestion(name, names)
        raise UnsupportedError(f"method: got {name!r}; expected {known} or {names[-1]!r}. {hint}".rstrip())


def choose_method(problem: OptimalControlProblem, stated: Options) -> Method:
    """Return the method for a problem, with the options that are given.

    UnsupportedError if there is no such method, it is not for these dynamics, or it does not take an option.
    """
    family, method, auto = family_of(problem), stated.method, ("backend", "auto")
    options = {name: value for name in ONLY if (value := getattr(stated, name)) is not None and (name, value) != auto}
    start = options.pop("start", None)
    if isinstance(method, str):
        if method not in family.shorthands:
            require_shorthand(method)
            raise UnsupportedError(_other_kind_message(method, family))
        shorthand = family.shorthands[method]
        for option, value in options.items():
            if option not in shorthand.options:
                raise UnsupportedError(_unused_option_message(option, value, method, family))
        fields = [shorthand.options[option] for option in options]
        if len(set(fields)) < len(fields):
            raise UnsupportedError("gap: got a gap and a tolerance, which mean the same here; give one of them.")
        chosen = replace(shorthand.method, **dict(zip(fields, options.values(), strict=True)))
    else:
        if not isinstance(method, family.methods):
            if not hasattr(method, "shorthand"):
                raise UnsupportedError(f"method: got {method!r}; expected a text such as 'auto', or a method.")
            raise UnsupportedError(_other_kind_message(method.shorthand, family))
        if options:
            name, value = next(iter(options.items()))
            advice = f"Options of a method belong to it: lfo.solvers.{type(method).__name__}(...)."
            raise UnsupportedError(f"{name}: got {value!r} with {method!r}. {advice}")
        chosen = method
    if start is not None and not chosen.takes_start:
        name = method if isinstance(method, str) else chosen.shorthand
        raise UnsupportedError(_unused_option_message("start", start, name, family))
    return chosen


def saved_options(problem: OptimalControlProblem, stated: Options, method: Method) -> dict[str, object]:
    """Return the equivalent shorthand and keywords of ``solve``, as a file stores them, but for a start."""
    name = stated.method
    if not isinstance(name, str):
        shorthands = family_of(problem).shorthands
        name = next((text for text, known in shorthands.items() if known.describes(method)), method.shorthand)
    saved = {option: getattr(method, option, None) for option in ("backend", "tolerance", "node_limit")}
    gap = getattr(method, "gap", None)
    tolerance = gap if gap != getattr(type(method), "gap", None) else saved["tolerance"]
    further: dict[str, object] = {} if saved["node_limit"] is None else {"node_limit": saved["node_limit"]}
    if not getattr(method, "global_bound", True) and "global_bound" in family_of(problem).shorthands[name].options:
        further["global_bound"] = False
    chosen = {"method": name, "backend": saved["backend"] or "auto", "tolerance": tolerance}
    return {**chosen, **further, "time_limit": stated.time_limit}


def _other_kind_message(name: str, family: Family) -> str:
    register_all()
    kinds = " and ".join(takes.kind for takes in FAMILIES.values() if name in takes.shorthands)
    known = ", ".join(map(repr, family.shorthands))
    return f"method: got {name!r}, which is for {kinds} dynamics; expected one of {known} for {family.kind} dynamics."


def _unused_option_message(option: str, value: object, method: str, family: Family) -> str:
    got = f"{value!r}" if isinstance(value, (int, float, str)) else "one"
    return (
        f"{option}: got {got} for the method {method!r} and {family.kind} dynamics, which do not use it: "
        f"{ONLY[option]}. Leave it out."
    )
