"""The protocol of dynamics.

A new class of dynamics is a subclass of ``Dynamics`` in a file of its own: its constructor calls ``signal_labels``, and
``standard_form`` returns the equivalent linear, piecewise-affine or piecewise-smooth dynamics. All operations, methods
of solution and the judgement are those of the standard form, unless the class overrides them or has its own entry in
the tables ``FAMILIES`` (solving/families.py) and ``JUDGES`` (certificate/verdict.py).
``tests/problem/test_new_dynamics.py`` shows complete ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, Mask, brief, component_names, positive_number, printable
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.kinds import register_all
from lin_freq_ocp.base.phrases import first_few, plural
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.dynamics.plant import ContinuousPlant
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.stage_rows import StageRows, StageSets
from lin_freq_ocp.problem.terms.term import Link

Entry = TypeVar("Entry")
Form = TypeVar("Form", bound="Dynamics")
Step = Callable[[int, Array, Array], Array]  # from t, x_t (n,) and u_t (m,) to x_{t+1} (n,)
Selections = Mapping[Formula, Array]  # the derivatives of norms at zero, (T, components), as for ``formulas.jets``


class SwitchingBoundary(ABC):
    """Where the regions of two modes meet."""

    first: int
    second: int

    @property
    @abstractmethod
    def continuous(self) -> bool:
        """Whether the map does not jump there."""


class Dynamics(ABC):
    """x_{t+1} = f_t(x_t, u_t) with named signals.

    A class of dynamics is a dataclass whose fields are what its constructor takes, so that ``dataclasses.replace``
    makes the same with other values.
    """

    state_dim: int
    control_dim: int
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    plant: ContinuousPlant | None = None  # the continuous model whose zero-order hold they are, if it is known

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
    def given(self) -> tuple[Dynamics, ConvexSet | None]:
        """Return the dynamics as stated, and the control set that became a part of them."""
        return self, None

    @property
    def level_sizes(self) -> Array:
        """Return the largest absolute level of each control, (m,); 0 for a control without levels."""
        return np.zeros(self.control_dim)

    def controls_of(self, sequence: Indices) -> Array | None:
        """Return the controls (T, m) that a mode sequence fixes; None where it leaves them free."""
        return None

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the dynamics in words, as pairs of a term and what it is; labels name states and controls."""
        return self.standard_form.facts(labels)

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless everything given per time is given for ``horizon`` steps."""
        self.standard_form.require_horizon(horizon)

    def links(self, horizon: int) -> tuple[Link, ...]:
        """Return the equations on the ends that these dynamics imply."""
        return ()

    def response(self, horizon: int) -> Response | None:
        """Return the map from all controls to all states, of dynamics known by it; None for a recursion."""
        return None

    def require_sets(self, sets: StageSets) -> None:
        """Raise ProblemError unless f_t is unique on the sets."""
        self.standard_form.require_sets(sets)

    def gap(self, sets: StageSets) -> str | None:
        """Return a place in the sets where f_t is not defined, as text; None if there is none."""
        return self.standard_form.gap(sets)

    def borders(self, sets: StageSets) -> tuple[SwitchingBoundary, ...]:
        """Return where regions of affine modes meet within the sets."""
        return self.standard_form.borders(sets)

    def stepper(self, horizon: int) -> Step:
        """Return the function that steps; it raises NumericalError where f_t is not defined."""
        return self.standard_form.stepper(horizon)

    def gains(self) -> tuple[Array, Array, Array]:
        """Return how large the derivatives are, (n, n) and (n, m), and the constants (n,)."""
        return self.standard_form.gains()

    def gains_along(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return ``gains`` along a trajectory."""
        return self.standard_form.gains_along(x, u)

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of those that hold, the one that leads nearest to x_{t+1}."""
        return self.standard_form.sequence_of(x, u)

    def affine_at(self, x: Array, u: Array, selections: Selections | None = None) -> Dynamics:
        """Return dynamics of affine maps that are the same to first order at (x_t, u_t)."""
        return self.standard_form.affine_at(x, u, selections)

    def with_modes(self, sequence: ArrayLike, horizon: int) -> tuple[Dynamics, StageRows]:
        """Return the linear dynamics of a mode sequence (T,), checked, and the rows of its regions."""
        return self.standard_form.with_modes(sequence, horizon)

    def linear_at(self, x: Array, u: Array) -> Dynamics:
        """Return linear dynamics that are the same to first order at (x_t, u_t), those of the modes there."""
        return self.standard_form.linear_at(x, u)

    def active_kinks(self, x: Array, u: Array) -> dict[Formula, Mask]:
        """Return for every norm at which of the times t < T its arguments are zero, (T,)."""
        return self.standard_form.active_kinks(x, u)

    def translated(self, origin: Array) -> Dynamics | None:
        """Return the dynamics of x - origin, origin (n,); None where they are stated about zero."""
        return self.standard_form.translated(origin)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> Dynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t, A (k, k) and B (k, m)."""
        return self.standard_form.augmented(A, B, names, horizon)


def as_sequence(field: str, sequence: ArrayLike, horizon: int, modes: int) -> Indices:
    """Return a mode sequence as integers (T,), or raise ProblemError."""
    expected = f"{horizon} mode numbers from 0 to {modes - 1}"
    try:
        given = np.asarray(sequence)
    except ValueError:
        raise ProblemError(field, brief(sequence), expected) from None
    if given.shape != (horizon,) or given.dtype.kind not in "iu":
        raise ProblemError(field, f"shape {given.shape} of {given.dtype}", expected)
    if (given < 0).any() or (given >= modes).any():
        raise ProblemError(field, brief(given.tolist()), expected)
    return given.astype(np.intp)


class StandardDynamics(Dynamics):
    """Dynamics in a standard form; what is defined here holds for affine dynamics without modes."""

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
        """Return ``gains``, which are the same along all trajectories."""
        return self.gains()

    def translated(self, origin: Array) -> Dynamics | None:
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

    def active_kinks(self, x: Array, u: Array) -> dict[Formula, Mask]:
        """Return none: there are no norms."""
        return {}


class StateEquations(StandardDynamics):
    """x_{t+1} = f_t, affine in all states and controls of the trajectory: what the judge needs of linear dynamics."""

    def linear_at(self, x: Array, u: Array) -> Dynamics:
        """Return these dynamics."""
        return self

    @abstractmethod
    def successors(self, x: Array, u: Array) -> Array:
        """Return f_t for all t < T, (T, n); x is (T+1, n) or (T, n), u is (T, m)."""

    @abstractmethod
    def successor_sizes(self, x: Array, u: Array) -> Array:
        """Return what rounding errors of ``successors`` are relative to, (T, n)."""

    def motion_sizes(self, x: Array, u: Array) -> Array:
        """Return how much each state moves, (n,): what residuals count relative to, x (T+1, n) from where it moves."""
        return np.maximum(np.abs(x).max(0), self.successor_sizes(x, u).max(0))

    @abstractmethod
    def pull_back(self, eta: Array) -> tuple[Array, Array]:
        """Return the derivatives of <eta, f> in x_t, t < T, (T, n), and in u_t, (T, m), for eta (T, n)."""

    @abstractmethod
    def pulled_sizes(self, eta: Array) -> tuple[Array, Array]:
        """Return what residuals of ``pull_back`` are relative to."""


def in_form(dynamics: Dynamics, kind: type[Form], advice: str = "") -> Form:
    """Return the standard form of dynamics, which must be of this kind."""
    form = dynamics.standard_form
    if isinstance(form, kind):
        return form
    raise UnsupportedError(f"dynamics: got {type(dynamics).__name__}; expected {kind.__name__}. {advice}".rstrip())


def entry_for(table: Mapping[type, Entry], dynamics: Dynamics) -> Entry:
    """Return the entry for the class of dynamics, for a base class, or for its standard form."""
    kinds = *type(dynamics).__mro__, *type(dynamics.standard_form).__mro__
    if not any(kind in table for kind in kinds):
        register_all()
    for kind in kinds:
        if kind in table:
            return table[kind]
    known = ", ".join(kind.__name__ for kind in table)
    raise UnsupportedError(f"dynamics: got {type(dynamics).__name__}; expected one of {known}.")


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


def counted(states: int, controls: int) -> str:
    """Return "1 state and 2 controls"."""
    return f"{plural(states, 'state')} and {plural(controls, 'control')}"


def mode_labels(given: Iterable[str]) -> tuple[str, ...]:
    """Return the names of modes, "mode i" where none is given."""
    found: dict[str, None] = {}
    for i, name in enumerate(given):
        printable(f"dynamics.modes[{i}].name", name)
        label = name or f"mode {i}"
        if label in found:
            raise ProblemError(f"dynamics.modes[{i}].name", f"{label!r} a second time", "a different name for each")
        found[label] = None
    return tuple(found)


def mode_facts(names: Sequence[str], kind: str) -> list[tuple[str, str]]:
    """Return how many modes there are, their names, and of what kind they are; nothing of a single mode."""
    if len(names) == 1:
        return []
    quoted = [f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}" for name in names]
    shown = first_few(quoted, 3 if max(map(len, quoted)) > 30 else 6)
    return [("modes", f"{len(names)}: {shown}; {kind}")]


def unique_names(given: Sequence[str]) -> list[str]:
    """Return names for generated modes: repeated names get a number, an empty name stays unless "mode i" is taken."""
    labels = [name or f"mode {i}" for i, name in enumerate(given)]
    taken, unique = set(labels), list[str]()
    for name, label in zip(given, labels, strict=True):
        if labels.count(label) == 1:
            unique.append(name)
            continue
        numbered = (f"{label} ({count})" for count in range(1, 2 * len(labels) + 1))
        unique.append(next(one for one in numbered if one not in taken))
        taken.add(unique[-1])
    return unique
