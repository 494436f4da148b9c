"""Dynamics x_{t+1} = f_i(x_t, u_t) with smooth pieces f_i, each where none of its switching functions is above zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, assign, brief, positive_integer
from lin_freq_ocp.base.errors import NumericalError, ProblemError
from lin_freq_ocp.base.phrases import first_few, split_unit
from lin_freq_ocp.formulas.jets import Jets, jets_of, values_of
from lin_freq_ocp.formulas.nodes import (
    Formula,
    evaluate,
    kinks,
    require_times,
    signals,
    text_of,
    time_of,
    translate_formulas,
    with_states,
)
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, NORM, TABLE, TIME, VARIABLE
from lin_freq_ocp.formulas.text import Formulas, listed_formulas
from lin_freq_ocp.problem.dynamics.base import StandardDynamics, Step, mode_facts, mode_labels, signal_labels
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.linearisation import ControlSystem, sampled_map
from lin_freq_ocp.problem.hybrid.affine_mode import SIMULATION_ROUNDING, AffineMode
from lin_freq_ocp.problem.hybrid.formula_modes import formula_pieces
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics

# The arguments of a norm are zero if each is smaller, relative to what states and controls of their sizes change of it:
# solvers leave 1e-8.
ZERO_NORM = 1e-7
OUTSIDE = 1e3  # the distance of a point from the linearised region of a mode that is not defined there


@dataclass(frozen=True, eq=False)
class SmoothMode:
    """A smooth map of the dynamics, and the region where it holds.

    Parameters
    ----------
    f : sequence of Formula, or function
        x_{t+1}: a formula for each state, or a function of (x, u) or (t, x, u) that returns them when it is called with
        signals; t is the time 0 .. T-1, and ``t.look_up(values)`` a number for each.
        Wrap a function that needs numbers in a ``DifferentiableFunction``, or use ``from_casadi``.
    region : sequence of Formula, or function
        Switching functions: the piece holds where all of them are <= 0. Empty: everywhere.
    domain : sequence of Formula, or function
        Functions that must be > 0 for f to be defined, such as a denominator. Other denominators of f may have any sign
        but not be zero.
    name : str
        The name in reports; default "mode i".
    cost : tuple of Formula
        The stage cost by formulas in this mode, one formula or none; from the cost of a problem.

    Examples
    --------
    >>> left = lfo.dynamics.SmoothMode(["x_0**2 + u_0"], region=["x_0"], name="left")
    >>> right = lfo.dynamics.SmoothMode(["u_0"], region=["-x_0"], name="right")
    >>> lfo.PiecewiseSmoothDynamics([left, right], 1, 1).mode_names
    ('left', 'right')
    """

    f: Any  # Formulas; tuples of Formula in the modes of PiecewiseSmoothDynamics
    region: Any = ()
    domain: Any = ()
    name: str = ""
    cost: tuple[Formula, ...] = ()

    def pieces(self, field: str, dimensions: tuple[int, int]) -> list[SmoothMode]:
        """Return the mode with tuples of formulas, checked: a mode for each choice of maxima and minima of f."""
        f = listed_formulas(f"{field}.f", self.f, dimensions)
        region = listed_formulas(f"{field}.region", self.region, dimensions)
        domain = listed_formulas(f"{field}.domain", self.domain, dimensions)
        if len(f) != dimensions[0]:
            raise ProblemError(f"{field}.f", f"{len(f)} formulas", f"{dimensions[0]}, one for each state")
        if next(kinks([*region, *domain, *self.cost], MAXIMUM, MINIMUM), None) is not None:
            advice = "Those of f make modes of their own."
            raise ProblemError(field, "a maximum or minimum in a region or domain", "smooth functions", advice)
        if next(kinks(f, MAXIMUM, MINIMUM), None) is None:
            return [SmoothMode(f, region, domain, self.name, self.cost)]
        return [
            SmoothMode(
                piece.formulas, piece.region, domain, ", ".join(filter(None, (self.name, piece.name))), self.cost
            )
            for piece in formula_pieces(f, region=region)
        ]


def affine_formulas(rows: Array, offset: Array, dimensions: tuple[int, int]) -> list[Formula]:
    """Return rows (x, u) + offset as formulas, rows (k, n + m) and offset (k,), or (T, ...) each, one per time."""
    y, zero = np.concatenate(signals(*dimensions)), 0.0 * signals(*dimensions)[0][0]

    def coefficient(values: Array) -> Formula | float:
        varies = values.ndim and (values != values[0]).any()
        return time_of(dimensions).look_up(values) if varies else float(values.flat[0])

    formulas = list[Formula]()
    for i in range(rows.shape[-2]):
        total = zero + coefficient(offset[..., i])
        for j in np.flatnonzero(rows[..., i, :].reshape(-1, len(y)).any(axis=0)):
            total = total + coefficient(rows[..., i, j]) * y[j]
        formulas.append(total)
    return formulas


@dataclass(frozen=True, eq=False)
class ModeJets:
    """All modes at (x_t, u_t), t = 0 .. T-1: a Jets for each mode in every field."""

    f: tuple[Jets, ...]
    regions: tuple[Jets, ...]  # the switching functions
    domains: tuple[Jets, ...]  # the functions that must be above zero

    def maps_of(self, modes: Indices | int, times: Indices | int) -> tuple[Array, ...]:
        """Return values, slopes and curvatures of the maps of some modes at some times."""
        fields = ("values", "slopes", "curvatures")
        return tuple(np.stack([getattr(jet, field) for jet in self.f])[modes, times] for field in fields)

    def defined(self) -> Mask:
        """Return which modes are defined at which times, (T, modes)."""
        return np.stack(
            [
                np.isfinite(f.values).all(axis=1)
                & np.isfinite(f.slopes).all(axis=(1, 2))
                & np.isfinite(region.values).all(axis=1)
                & (domain.values > 0).all(axis=1)
                for f, region, domain in zip(self.f, self.regions, self.domains, strict=True)
            ],
            axis=1,
        )


@dataclass(frozen=True, eq=False, init=False)
class PiecewiseSmoothDynamics(StandardDynamics):
    """x_{t+1} = f_i(x_t, u_t) for the mode i with no switching function above zero; norms may have kinks.

    The map must be continuous: on a switching boundary, the modes that meet lead to the same state. Derivatives are
    exact, or those that functions return.

    Parameters
    ----------
    modes : sequence of SmoothMode
    state_dim, control_dim : int
        n and m.
    sampling_time : float, optional
        Seconds per step.
    state_names, control_names : sequences of str, optional
        Names with units.

    Raises
    ------
    ProblemError
        With the field, the value and the expected value.

    Methods
    -------
    from_formulas(...)
        Modes of formulas with maxima, minima and absolute values.
    from_system(...)
        The map of a python-control model.
    sequence_of(x, u)
        The mode of every time along a trajectory.

    Examples
    --------
    >>> dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["abs(x_0) + x_0*u_0"], 1, 1)
    >>> len(dynamics.modes)
    2
    """

    modes: tuple[SmoothMode, ...]
    state_dim: int
    control_dim: int
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]

    def __init__(
        self,
        modes: Sequence[SmoothMode],
        state_dim: int,
        control_dim: int,
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ):
        n, m = positive_integer("dynamics.state_dim", state_dim), positive_integer("dynamics.control_dim", control_dim)
        if not isinstance(modes, Sequence) or not modes or not all(isinstance(mode, SmoothMode) for mode in modes):
            raise ProblemError("dynamics.modes", brief(modes), "a list of at least one SmoothMode")
        checked = tuple(one for i, mode in enumerate(modes) for one in mode.pieces(f"dynamics.modes[{i}]", (n, m)))
        assign(self, modes=checked, **signal_labels(n, m, sampling_time, state_names, control_names))
        _ = self.mode_names  # all different

    @classmethod
    def from_formulas(
        cls,
        f: Formulas,
        state_dim: int,
        control_dim: int,
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
        domain: Formulas = (),
    ) -> PiecewiseSmoothDynamics:
        """Make the modes of x_{t+1} = f(x_t, u_t) with maxima, minima and absolute values, one per choice of arguments.

        Choices that never hold, such as u_0 > 1 and u_0 < -1, have no mode.

        Parameters
        ----------
        f : sequence of Formula, or function
            One formula for each state, or a function of (x, u) or (t, x, u) that returns them.
        state_dim, control_dim, sampling_time, state_names, control_names
            As for the class.
        domain : sequence of Formula, or function
            Functions that must be > 0 in every mode.

        Raises
        ------
        ProblemError
            If more than ``MOST_MODES`` (64) combinations can hold, or f has no formulas.
        """
        dimensions = positive_integer("state_dim", state_dim), positive_integer("control_dim", control_dim)
        listed = listed_formulas("f", f, dimensions)
        common = listed_formulas("domain", domain, dimensions)
        modes = [SmoothMode(piece.formulas, piece.region, common, piece.name) for piece in formula_pieces(listed)]
        return cls(modes, *dimensions, sampling_time, state_names, control_names)

    @classmethod
    def from_system(
        cls,
        system: ControlSystem,
        sampling_time: float | None = None,
        params: Mapping[str, object] | None = None,
        integrator: str = "DOP853",
    ) -> PiecewiseSmoothDynamics:
        """Take the map of a smooth time-invariant nonlinear python-control model over one period.

        ``lfo.solve`` linearises it along every iterate (successive linearisation), as ``LinearDynamics.linearised``
        does along one trajectory. It uses no second derivatives of the model; formulas have them, and are much faster
        than integrals.

        Parameters
        ----------
        system, sampling_time, params, integrator
            As for ``LinearDynamics.linearised``.

        Raises
        ------
        ProblemError
            If the model is of another kind, or sampling times do not fit.
        """
        import control  # here, because it takes seconds to import and only its users need it

        if not isinstance(system, control.NonlinearIOSystem):
            raise ProblemError("system", type(system).__name__, "a control.NonlinearIOSystem", "See control.nlsys.")
        f, step = sampled_map(system, sampling_time, params, (None, None), integrator)
        states, controls = list(system.state_labels), list(system.input_labels)
        return cls([SmoothMode(f)], len(states), len(controls), step, states, controls)

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Return the name of every mode."""
        return mode_labels(mode.name for mode in self.modes)

    @property
    def affine(self) -> bool:
        """Return False: the maps of the modes are smooth."""
        return False

    @cached_property
    def norms(self) -> tuple[Formula, ...]:
        """The norms in the maps, switching functions and costs that may be zero, inner ones first."""
        formulas = [formula for mode in self.modes for formula in (*mode.f, *mode.region, *mode.cost)]
        found = kinks(formulas, NORM)
        return tuple(one for one in found if not any(part.constant for part in one.arguments))

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the modes, and the norms, which are not differentiable at zero."""
        facts = mode_facts(self.mode_names, "a smooth map in each, where its switching functions are at most zero")
        names = [split_unit(label)[0] for label in labels]
        norms = list(dict.fromkeys(text_of(norm, names) for norm in self.norms))
        return [*facts, *([("kinks", f"{first_few(norms, 4)}, not differentiable at zero")] if norms else [])]

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """All formulas of all modes: maps, switching functions, domains and costs."""
        return tuple(one for mode in self.modes for one in (*mode.f, *mode.region, *mode.domain, *mode.cost))

    @cached_property
    def depends_on_time(self) -> bool:
        """Whether a formula has the time t."""
        return next(kinks(self.formulas, TIME, TABLE), None) is not None

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless tables over time have ``horizon`` numbers."""
        require_times("dynamics", self.formulas, horizon)

    def gains(self) -> tuple[Array, Array, Array]:
        """Return rough sizes of the derivatives, (n, n) and (n, m), and of the constant, (n,)."""
        n, m = self.state_dim, self.control_dim
        maps = self.jets_at(np.stack([np.zeros(n + m), np.ones(n + m)]), times=np.zeros(2, dtype=np.intp)).f
        slopes = np.nan_to_num(np.abs([jet.slopes for jet in maps]), nan=1.0, posinf=1.0).max(axis=(0, 1))
        constant = np.nan_to_num(np.abs([jet.values[0] for jet in maps]), nan=0.0, posinf=0.0).max(axis=0)
        return slopes[:, :n], slopes[:, n:], constant

    def translated(self, origin: Array, horizon: int) -> PiecewiseSmoothDynamics:
        """Return the dynamics of x - origin, with the same modes."""
        moved = iter(translate_formulas(self.formulas, origin))
        modes = list[SmoothMode]()
        for mode in self.modes:
            images = [next(moved) - float(value) for value in origin]
            region, domain, cost = ([next(moved) for _ in part] for part in (mode.region, mode.domain, mode.cost))
            modes.append(SmoothMode(images, region, domain, mode.name, tuple(cost)))
        return replace(self, modes=modes)

    def gains_along(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return the largest derivatives along a trajectory, (n, n) and (n, m), and the largest constants, (n,)."""
        A, B, d = (np.nan_to_num(part, posinf=0.0) for part in self.affine_at(x, u).gains())
        return A, B, d

    def jets_at(
        self, y: Array, selections: Mapping[Formula, Array] | None = None, times: Indices | None = None
    ) -> ModeJets:
        """Return all modes with derivatives at points y = (x, u), (points, n + m), and times as for ``jets_of``."""
        parts = [
            tuple(jets_of(getattr(mode, part), y, selections, times) for mode in self.modes)
            for part in ("f", "region", "domain")
        ]
        return ModeJets(parts[0], parts[1], parts[2])

    def affine_at(
        self, x: Array, u: Array, selections: Mapping[Formula, Array] | None = None
    ) -> PiecewiseAffineDynamics:
        """Return all modes linearised at (x_t, u_t): their maps, and their switching functions as regions.

        Parameters
        ----------
        x : (T+1, n) or (T, n), u : (T, m)
        selections : mapping from norms to (T, components), optional
            Derivatives of norms, as for ``jets_of``.
        """
        n, T = self.state_dim, len(u)
        y = np.hstack([x[:T], u])
        jets_along = self.jets_at(y, selections)
        defined = jets_along.defined()
        modes: list[AffineMode] = []
        for i, name in enumerate(self.mode_names):
            ok = defined[:, i]
            F = np.where(ok[:, None, None], jets_along.f[i].slopes, 0.0)
            offset = _constants(F, y, np.where(ok[:, None], jets_along.f[i].values, 0.0))
            rows, values = jets_along.regions[i].slopes, jets_along.regions[i].values
            if not rows.shape[1]:
                rows, values = np.zeros((T, 1, y.shape[1])), np.full((T, 1), -np.inf)
            far = np.zeros(rows.shape)
            far[..., 0] = 1.0  # a function that is above zero and flat has no row that leads below zero
            G = np.where(ok[:, None, None] & (rows.any(axis=2) | (values <= 0))[..., None], rows, far)
            h = -_constants(G, y, np.where(ok[:, None], values, OUTSIDE))
            modes.append(AffineMode(F[..., :n], F[..., n:], offset, G[..., :n], G[..., n:], h, name))
        return PiecewiseAffineDynamics(modes, self.sampling_time, self.state_names, self.control_names)

    def active_kinks(self, x: Array, u: Array, sizes: Array) -> dict[Formula, Mask]:
        """Return for every norm the times t < T at which its arguments are zero, (T,), by ``sizes`` (n + m,)."""
        y = np.hstack([x[: len(u)], u])
        active: dict[Formula, Mask] = {}
        for norm in self.norms:
            at = jets_of(norm.arguments, y)
            changes = np.abs(at.slopes) @ sizes + 0.5 * np.abs(at.curvatures) @ sizes @ sizes
            active[norm] = (np.abs(at.values) <= ZERO_NORM * np.nanmax(changes, axis=0, initial=0.0)).all(axis=1)
        return active

    def pull_of_norm(self, norm: Formula, y: Array, time: int, mode: int, eta: Array) -> float:
        """Return the derivative of <eta, f_mode> by a norm at y = (x, u), with the norm as an additional variable."""
        (k, (n, m)), times = (len(y), norm.dimensions), np.array([time])

        def with_variable(node: Formula, arguments: list[Formula]) -> Formula:  # of (x, u, w), w the norm
            if node is norm:
                return Formula((n, m + 1), VARIABLE, (), (float(k),))
            return replace(node, dimensions=(n, m + 1), arguments=tuple(arguments))

        f = evaluate(self.modes[mode].f, with_variable)
        slopes = jets_of(f, np.append(y, values_of([norm], y[None], times)[0])[None], times=times).slopes
        return float(eta @ slopes[0, :, k])

    def linear_at(self, x: Array, u: Array) -> LinearDynamics:
        """Return the linearisation along a trajectory, with its modes."""
        return self.affine_at(x, u).linear_at(x, u)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> PiecewiseSmoothDynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t."""
        n, m, k = self.state_dim, self.control_dim, len(A)
        added, modes = affine_formulas(np.hstack([np.zeros((k, n)), A, B]), np.zeros(k), (n + k, m)), list[SmoothMode]()
        for mode in self.modes:
            f, region, domain = (with_states(part, k) for part in (mode.f, mode.region, mode.domain))
            modes.append(SmoothMode([*f, *added], region, domain, mode.name))
        labels = self.sampling_time, [*self.state_names, *names], self.control_names
        return PiecewiseSmoothDynamics(modes, n + k, m, *labels)

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of the modes that hold, the one with the image nearest to x_{t+1}."""
        return self.affine_at(x, u).sequence_of(x, u)

    def stepper(self, horizon: int) -> Step:
        """Return the function from t, x_t (n,) and u_t (m,) to x_{t+1}, by the first mode that holds there.

        It raises NumericalError if no mode is defined and holds.
        """

        def step(t: int, x: Array, u: Array) -> Array:
            if not np.isfinite(x).all():
                return np.full_like(x, np.nan)
            y, at = np.append(x, u)[None], np.array([t])
            if len(self.modes) == 1 and not self.modes[0].region:
                after, domain = (values_of(part, y, at)[0] for part in (self.modes[0].f, self.modes[0].domain))
                if np.isfinite(after).all() and (domain > 0).all():
                    return after
            modes, sizes = self.jets_at(y, times=at), np.abs(np.append(x, u))
            for i in np.flatnonzero(modes.defined()[0]):
                region = modes.regions[i]
                rounding = SIMULATION_ROUNDING * (np.abs(region.slopes[0]) @ sizes + np.abs(region.values[0]))
                if (region.values[0] <= rounding).all():
                    return modes.f[i].values[0]
            where = f"t = {t}, x = {brief(x.tolist())}, u = {brief(u.tolist())}"
            raise NumericalError(f"No mode of the dynamics is defined and holds at {where}.")

        return step


def _constants(slopes: Array, y: Array, values: Array) -> Array:
    """Return values - slopes y, (T, rows), zero where that is rounding: it would be taken for a small limit."""
    images = np.einsum("tij,tj->ti", slopes, y)
    terms = np.einsum("tij,tj->ti", np.abs(slopes), np.abs(y)) + np.abs(values)
    constants = values - images
    return np.where(np.abs(constants) < SIMULATION_ROUNDING * terms, 0.0, constants)
