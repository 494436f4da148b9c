"""The protocol of dynamics.

A new class of dynamics is a subclass of ``Dynamics`` in a file of its own: its constructor calls ``signal_labels``, and
``standard_form`` returns the equivalent linear, piecewise-affine or piecewise-smooth dynamics. Its operations,
methods of solution and judge are those of the standard form, unless the class overrides them or has its own entry in
the tables ``FAMILIES`` (solving/families.py) and ``JUDGES`` (certificate/verdict.py).
``tests/helpers/own_kinds.py`` has complete examples.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, brief, positive_number, printable
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.kinds import register_all
from lin_freq_ocp.base.names import component_names
from lin_freq_ocp.base.phrases import first_few, html_table, plural, short_name
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.dynamics.plant import ContinuousPlant
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.stage_rows import StageRows, StageSets
from lin_freq_ocp.problem.terms.term import Link

Entry = TypeVar("Entry")
Form = TypeVar("Form", bound="Dynamics")
Step = Callable[[int, Array, Array], Array]  # from t, x_t (n,) and u_t (m,) to x_{t+1} (n,)
Selections = Mapping[Formula, Array]  # subgradients of norms at zero, (T, components), as for ``formulas.jets_of``


class SwitchingBoundary(ABC):
    """The switching boundary of two modes: where their regions meet."""

    first: int
    second: int

    @property
    @abstractmethod
    def continuous(self) -> bool:
        """Whether the map is continuous there."""


class Dynamics(ABC):
    """x_{t+1} = f_t(x_t, u_t) with named signals.

    A class of dynamics is a dataclass whose fields are the parameters of its constructor, so that
    ``dataclasses.replace`` works.
    """

    state_dim: int
    control_dim: int
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    plant: ContinuousPlant | None = None  # the continuous model whose zero-order hold they are, if it is known

    def __init_subclass__(cls, words: str = ""):
        """Keep the words by which errors name the class, by default its name."""
        cls.words = words or cls.__name__

    @property
    @abstractmethod
    def standard_form(self) -> Dynamics:
        """Return equivalent linear, piecewise-affine or piecewise-smooth dynamics of the same dimensions."""

    @property
    def affine(self) -> bool:
        """Whether the map of every mode is affine."""
        return self.standard_form.affine

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Return the name of every mode; empty for dynamics without modes."""
        return self.standard_form.mode_names

    @property
    def levels(self) -> ConvexSet | None:
        """Return the finite set of controls that has a mode for each point; None for other dynamics."""
        return None

    @property
    def choices(self) -> Array | None:
        """Return the control of each mode, (modes, m), where modes determine it."""
        return None if self.levels is None else self.levels.points(self.control_dim)

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the dynamics in words, as pairs (title, text); labels name states and controls."""
        return self.standard_form.facts(labels)

    def _repr_html_(self) -> str:
        return html_table(type(self).__name__, self.facts([*map(short_name, self.state_names), *self.control_names]))

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless data per time have ``horizon`` steps."""
        self.standard_form.require_horizon(horizon)

    def links(self, horizon: int) -> tuple[Link, ...]:
        """Return the equations on the ends that these dynamics imply."""
        return ()

    def response(self, horizon: int) -> Response | None:
        """Return the map from all controls to all states; None for dynamics that are a recursion."""
        return None

    def require_sets(self, sets: StageSets) -> None:
        """Raise ProblemError unless f_t is unique on the sets."""
        self.standard_form.require_sets(sets)

    def gap(self, sets: StageSets) -> str | None:
        """Return a point of the sets where f_t is not defined, in words; None without one."""
        return self.standard_form.gap(sets)

    def borders(self, sets: StageSets) -> tuple[SwitchingBoundary, ...]:
        """Return the switching boundaries of affine modes within the sets."""
        return self.standard_form.borders(sets)

    def stepper(self, horizon: int) -> Step:
        """Return the function from t, x_t and u_t to x_{t+1}; it raises NumericalError where f_t is not defined."""
        return self.standard_form.stepper(horizon)

    def gains(self) -> tuple[Array, Array, Array]:
        """Return the sizes of the derivatives, (n, n) and (n, m), and of the constants, (n,)."""
        return self.standard_form.gains()

    def gains_along(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return ``gains`` along a trajectory."""
        return self.standard_form.gains_along(x, u)

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of those that hold, the one with the image nearest to x_{t+1}."""
        return self.standard_form.sequence_of(x, u)

    def affine_at(self, x: Array, u: Array, selections: Selections | None = None) -> Dynamics:
        """Return dynamics of affine maps that agree to first order at (x_t, u_t)."""
        return self.standard_form.affine_at(x, u, selections)

    def with_modes(self, sequence: ArrayLike, horizon: int) -> tuple[Dynamics, StageRows]:
        """Return the linear dynamics of a mode sequence (T,), checked, and the rows of its regions."""
        return self.standard_form.with_modes(sequence, horizon)

    def linear_at(self, x: Array, u: Array) -> Dynamics:
        """Return linear dynamics that agree to first order at (x_t, u_t), with the modes of the trajectory."""
        return self.standard_form.linear_at(x, u)

    def translated(self, origin: Array, horizon: int) -> Dynamics | None:
        """Return the dynamics of x - origin, origin (n,); None if their zero has a meaning."""
        return self.standard_form.translated(origin, horizon)

    def disturbed(self, disturbance: Array) -> Dynamics:
        """Return the dynamics with a disturbance, (n,) or (T, n), added to the coming states, if they are linear."""
        raise UnsupportedError(f"disturbance: a preview needs linear dynamics; these are {self.words}.")

    def stacked(self, plants: Sequence[Dynamics], names: Sequence[str], horizon: int) -> Dynamics:
        """Return the dynamics of the states of several plants of this class under the same controls, if linear."""
        raise UnsupportedError(f"plants: got dynamics that are {self.words}; expected linear ones.")

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> Dynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t, A (k, k) and B (k, m)."""
        return self.standard_form.augmented(A, B, names, horizon)


def mode_sequence(field: str, sequence: ArrayLike, horizon: int, modes: int) -> Indices:
    """Return a mode sequence as integers (T,), or raise ProblemError."""
    expected = f"{horizon} mode numbers from 0 to {modes - 1}"
    try:
        numbers = np.asarray(sequence)
    except ValueError:
        raise ProblemError(field, brief(sequence), expected) from None
    if numbers.shape != (horizon,) or numbers.dtype.kind not in "iu":
        raise ProblemError(field, f"shape {numbers.shape} of {numbers.dtype}", expected)
    if (numbers < 0).any() or (numbers >= modes).any():
        raise ProblemError(field, brief(numbers.tolist()), expected)
    return numbers.astype(np.intp)


class StandardDynamics(Dynamics):
    """Dynamics in a standard form; the defaults are those of affine dynamics without modes."""

    @property
    def standard_form(self) -> StandardDynamics:
        """Return these dynamics."""
        return self

    @property
    def affine(self) -> bool:
        """Whether the map of every mode is affine."""
        return True

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Return none."""
        return ()

    def require_sets(self, sets: StageSets) -> None:
        """Accept all sets."""

    def gap(self, sets: StageSets) -> str | None:
        """Return None: f_t is defined everywhere."""
        return None

    def borders(self, sets: StageSets) -> tuple[SwitchingBoundary, ...]:
        """Return none."""
        return ()

    def gains_along(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return ``gains``, which do not depend on the trajectory."""
        return self.gains()

    def translated(self, origin: Array, horizon: int) -> Dynamics | None:
        """Return None."""
        return None

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return zeros (T,): there is one mode."""
        return np.zeros(len(u), dtype=np.intp)

    def with_modes(self, sequence: ArrayLike, horizon: int) -> tuple[Dynamics, StageRows]:
        """Raise UnsupportedError: only piecewise-affine dynamics have sequences of affine modes."""
        raise UnsupportedError(f"dynamics: got {type(self).__name__}; expected PiecewiseAffineDynamics.")

    def affine_at(self, x: Array, u: Array, selections: Selections | None = None) -> Dynamics:
        """Return these dynamics."""
        return self


class StateEquations(StandardDynamics, words="LinearDynamics or FrequencyResponse"):
    """x_{t+1} = f_t, affine in all states and controls of the trajectory: the linear dynamics that the judge sees."""

    def linear_at(self, x: Array, u: Array) -> Dynamics:
        """Return these dynamics."""
        return self

    @abstractmethod
    def successors(self, x: Array, u: Array) -> Array:
        """Return f_t for all t < T, (T, n); x is (T+1, n) or (T, n), u is (T, m)."""

    @abstractmethod
    def successor_sizes(self, x: Array, u: Array) -> Array:
        """Return the sizes that rounding errors of ``successors`` are relative to, (T, n)."""

    def motion_sizes(self, x: Array, u: Array) -> Array:
        """Return the size of each state, (n,), that residuals are relative to; x (T+1, n) from a nearby origin."""
        return np.maximum(np.abs(x).max(0), self.successor_sizes(x, u).max(0))

    @abstractmethod
    def pull_back(self, eta: Array) -> Array:
        """Return the derivatives of <eta, f> in (x_t, u_t), t < T, (T, n + m), for eta (T, n)."""

    @abstractmethod
    def pulled_sizes(self, eta: Array) -> Array:
        """Return the sizes that residuals of ``pull_back`` are relative to."""


def require_form(dynamics: Dynamics, kind: type[Form], advice: str = "") -> Form:
    """Return the standard form of dynamics, or raise UnsupportedError unless it is of this class."""
    form = dynamics.standard_form
    if isinstance(form, kind):
        return form
    raise UnsupportedError(f"dynamics: got {dynamics.words}; expected {kind.words}. {advice}".rstrip())


def entry_for(table: Mapping[type, Entry], dynamics: Dynamics) -> Entry:
    """Return the entry of the class of dynamics, of a base class, or of the standard form."""
    kinds = *type(dynamics).__mro__, *type(dynamics.standard_form).__mro__
    if not any(kind in table for kind in kinds):
        register_all()
    for kind in kinds:
        if kind in table:
            return table[kind]
    known = ", ".join(kind.__name__ for kind in table)
    raise UnsupportedError(f"dynamics: got {dynamics.words}; expected one of {known}.")


def signal_labels(
    n: int, m: int, sampling_time: float | None, state_names: Sequence[str] | None, control_names: Sequence[str] | None
) -> dict[str, object]:
    """Return the fields of ``Dynamics`` for n states and m controls, checked."""
    return {
        "state_dim": n,
        "control_dim": m,
        "sampling_time": None if sampling_time is None else positive_number("dynamics.sampling_time", sampling_time),
        "state_names": component_names("dynamics.state_names", state_names, n, "x"),
        "control_names": component_names("dynamics.control_names", control_names, m, "u"),
    }


def dimension_words(states: int, controls: int) -> str:
    """Return "1 state and 2 controls"."""
    return f"{plural(states, 'state')} and {plural(controls, 'control')}"


def mode_labels(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of modes, "mode i" for an empty name, or raise ProblemError if a name occurs twice."""
    labels: dict[str, None] = {}
    for i, name in enumerate(names):
        printable(f"dynamics.modes[{i}].name", name)
        label = name or f"mode {i}"
        if label in labels:
            raise ProblemError(f"dynamics.modes[{i}].name", f"{label!r} a second time", "a different name for each")
        labels[label] = None
    return tuple(labels)


def mode_facts(names: Sequence[str], kind: str) -> list[tuple[str, str]]:
    """Return the number of modes, their names and their kind in words; nothing for a single mode."""
    if len(names) == 1:
        return []
    quoted = [f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}" for name in names]
    shown = first_few(quoted, 3 if max(map(len, quoted)) > 30 else 6)
    return [("modes", f"{len(names)}: {shown}; {kind}")]


def unique_names(names: Sequence[str]) -> list[str]:
    """Return different names for generated modes: repeated ones get a number, empty ones if "mode i" is taken."""
    labels = [name or f"mode {i}" for i, name in enumerate(names)]
    taken, unique = set(labels), list[str]()
    for name, label in zip(names, labels, strict=True):
        if labels.count(label) == 1:
            unique.append(name)
            continue
        numbered = (f"{label} ({count})" for count in range(1, 2 * len(labels) + 1))
        unique.append(next(candidate for candidate in numbered if candidate not in taken))
        taken.add(unique[-1])
    return unique
