"""Dynamics x_{t+1} = f_i(x_t, u_t) with smooth pieces f_i, each where its switching functions are zero or below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, assign, brief, positive_integer
from lin_freq_ocp.base.errors import NumericalError, ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import first_few, split_unit
from lin_freq_ocp.formulas.jets import Jets, jets, values_of
from lin_freq_ocp.formulas.nodes import Formula, evaluate, kinks, text_of, translate_formulas
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, NORM, VARIABLE
from lin_freq_ocp.formulas.text import Formulas, listed_formulas
from lin_freq_ocp.problem.dynamics.base import StandardDynamics, Step, mode_facts, mode_labels, signal_labels
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.linearisation import ControlSystem, sampled_map
from lin_freq_ocp.problem.hybrid.affine_mode import REPLAY_ROUNDING, AffineMode
from lin_freq_ocp.problem.hybrid.formula_modes import formula_pieces
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics

# The arguments of a norm are zero if they are smaller, relative to the largest norm of the trajectory or to 1.
ZERO_NORM = 1e-9
OUTSIDE = 1e3  # A mode that is not defined at a point has a region there that the point is this far from


@dataclass(frozen=True, eq=False)
class SmoothMode:
    """One smooth piece of the dynamics, and where it holds.

    Parameters
    ----------
    f : sequence of Formula, or function
        x_{t+1}, one formula for each state, or a function of (x, u) that returns them when it is called with signals;
        functions that need numbers are wrapped in a ``DifferentiableFunction``, or come ``from_casadi``.
    region : sequence of Formula, or function
        Switching functions: the piece holds where all of them are <= 0. Nothing: everywhere.
    domain : sequence of Formula, or function
        What must be > 0 for f to be defined, as a denominator; denominators of f that no entry names may have any sign
        but not be zero.
    name : str
        As reports show it; default "mode i".

    Examples
    --------
    >>> left = lfo.dynamics.SmoothMode(["x_0**2 + u_0"], region=["x_0"], name="left")
    >>> right = lfo.dynamics.SmoothMode(["u_0"], region=["-x_0"], name="right")
    >>> lfo.PiecewiseSmoothDynamics([left, right], 1, 1).mode_names
    ('left', 'right')
    """

    f: Any  # Formulas as given; tuples of Formula in the modes of PiecewiseSmoothDynamics
    region: Any = ()
    domain: Any = ()
    name: str = ""

    def with_signals(self, field: str, dimensions: tuple[int, int]) -> SmoothMode:
        """Return the mode with tuples of formulas, one of f for each state, without maxima and minima."""
        f = listed_formulas(f"{field}.f", self.f, dimensions)
        region = listed_formulas(f"{field}.region", self.region, dimensions)
        domain = listed_formulas(f"{field}.domain", self.domain, dimensions)
        if len(f) != dimensions[0]:
            raise ProblemError(f"{field}.f", f"{len(f)} formulas", f"{dimensions[0]}, one for each state")
        if next(kinks([*f, *region, *domain], MAXIMUM, MINIMUM), None) is not None:
            advice = "PiecewiseSmoothDynamics.from_formulas makes the pieces."
            raise ProblemError(field, "a maximum or minimum", "smooth pieces", advice)
        return SmoothMode(f, region, domain, self.name)


@dataclass(frozen=True, eq=False)
class ModeJets:
    """All modes at (x_t, u_t), t = 0 .. T-1, each a tuple of one Jets for each mode."""

    f: tuple[Jets, ...]
    regions: tuple[Jets, ...]  # the switching functions
    domains: tuple[Jets, ...]  # what must be above zero

    def defined(self) -> Mask:
        """Which modes are defined where, (T, modes)."""
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
    """x_{t+1} = f_i(x_t, u_t) for the mode i whose switching functions are zero or below; norms may have kinks within.

    The map must be continuous: on a border the modes that meet lead to the same state. Derivatives are exact, or
    those that functions give.

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
        Saying which field, what was got and what was expected.

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
        made = tuple(mode.with_signals(f"dynamics.modes[{i}]", (n, m)) for i, mode in enumerate(modes))
        assign(self, modes=made, **signal_labels(n, m, sampling_time, state_names, control_names))
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
        """Take x_{t+1} = f(x_t, u_t) with maxima, minima and absolute values: one mode for each choice of arguments.

        Choices that never hold, as u_0 > 1 and u_0 < -1, are left out.

        Parameters
        ----------
        f : sequence of Formula, or function
            One formula for each state, or a function of (x, u) that returns them.
        state_dim, control_dim, sampling_time, state_names, control_names
            As for the class.
        domain : sequence of Formula, or function
            What must be > 0, in every mode.

        Raises
        ------
        ProblemError
            If there are more than ``MOST_MODES`` (64) combinations that can hold, or f is none.
        """
        dimensions = positive_integer("state_dim", state_dim), positive_integer("control_dim", control_dim)
        listed = listed_formulas("f", f, dimensions)
        common = listed_formulas("domain", domain, dimensions)
        modes = [SmoothMode(one.formulas, one.region, common, one.name) for one in formula_pieces(listed)]
        return cls(modes, *dimensions, sampling_time, state_names, control_names)

    @classmethod
    def from_system(
        cls,
        system: ControlSystem,
        sampling_time: float | None = None,
        params: Mapping[str, object] | None = None,
        integrator: str = "DOP853",
    ) -> PiecewiseSmoothDynamics:
        """Take the map of a smooth nonlinear python-control model over one period, which does not depend on time.

        ``lfo.solve`` then linearises anew along every trajectory it comes to, as ``LinearDynamics.linearised`` does
        along one: successive linearisation. The second derivatives of the model take no part; formulas have them, and
        are much faster than integrals.

        Parameters
        ----------
        system, sampling_time, params, integrator
            As for ``LinearDynamics.linearised``.

        Raises
        ------
        ProblemError
            If it is no such model, or sampling times do not fit.
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
        """The norms in the maps and switching functions, those within others first."""
        formulas = [one for mode in self.modes for one in (*mode.f, *mode.region)]
        return tuple(kinks(formulas, NORM))

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the modes, and the norms, which are not differentiable at zero."""
        facts = mode_facts(self.mode_names, "a smooth map in each, where its switching functions are at most zero")
        norms = list(dict.fromkeys(text_of(one, [split_unit(label)[0] for label in labels]) for one in self.norms))
        return [*facts, *([("kinks", f"{first_few(norms, 4)}, not differentiable at zero")] if norms else [])]

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless everything given per time is given for ``horizon`` steps: nothing is."""

    def gains(self) -> tuple[Array, Array, Array]:
        """Return a rough size of the derivatives, (n, n) and (n, m), and of the constant, (n,)."""
        n, m = self.state_dim, self.control_dim
        found = self.jets_at(np.stack([np.zeros(n + m), np.ones(n + m)]))
        slopes = np.nan_to_num(np.abs([one.slopes for one in found.f]), nan=1.0, posinf=1.0).max(axis=(0, 1))
        constant = np.nan_to_num(np.abs([one.values[0] for one in found.f]), nan=0.0, posinf=0.0).max(axis=0)
        return slopes[:, :n], slopes[:, n:], constant

    def translated(self, origin: Array) -> PiecewiseSmoothDynamics:
        """Return the dynamics of x - origin, with the same modes."""
        given = [(*mode.f, *mode.region, *mode.domain) for mode in self.modes]
        found = iter(translate_formulas([one for formulas in given for one in formulas], origin))
        modes = list[SmoothMode]()
        for mode in self.modes:
            images = [next(found) - float(value) for value in origin]
            region, domain = ([next(found) for _ in part] for part in (mode.region, mode.domain))
            modes.append(SmoothMode(images, region, domain, mode.name))
        return replace(self, modes=modes)

    def gains_along(self, x: Array, u: Array) -> tuple[Array, Array, Array]:
        """Return the largest derivatives along a trajectory, (n, n) and (n, m), and the largest constants, (n,)."""
        A, B, d = (np.nan_to_num(part, posinf=0.0) for part in self.affine_at(x, u).gains())
        return A, B, d

    def jets_at(self, y: Array, selections: Mapping[Formula, Array] | None = None) -> ModeJets:
        """Return all modes with derivatives at points y = (x, u), (points, n + m)."""
        parts = [
            tuple(jets(getattr(mode, part), y, selections) for mode in self.modes) for part in ("f", "region", "domain")
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
            Derivatives of norms, as for ``jets``.
        """
        n, T = self.state_dim, len(u)
        y = np.hstack([x[:T], u])
        found = self.jets_at(y, selections)
        defined = found.defined()
        modes: list[AffineMode] = []
        for i, name in enumerate(self.mode_names):
            ok = defined[:, i]
            F = np.where(ok[:, None, None], found.f[i].slopes, 0.0)
            offset = np.where(ok[:, None], found.f[i].values, 0.0) - np.einsum("tij,tj->ti", F, y)
            rows, values = found.regions[i].slopes, found.regions[i].values
            if not rows.shape[1]:
                rows, values = np.zeros((T, 1, y.shape[1])), np.full((T, 1), -np.inf)
            far = np.zeros(rows.shape)
            far[..., 0] = 1.0  # where a function is above zero and flat, no row of its own says how to get below
            G = np.where(ok[:, None, None] & (rows.any(axis=2) | (values <= 0))[..., None], rows, far)
            h = np.einsum("trj,tj->tr", G, y) - np.where(ok[:, None], values, OUTSIDE)
            modes.append(AffineMode(F[..., :n], F[..., n:], offset, G[..., :n], G[..., n:], h, name))
        return PiecewiseAffineDynamics(modes, self.sampling_time, self.state_names, self.control_names)

    def active_kinks(self, x: Array, u: Array) -> dict[Formula, Mask]:
        """Return for every norm at which of the times t < T its arguments are zero, (T,)."""
        y = np.hstack([x[: len(u)], u])
        found: dict[Formula, Mask] = {}
        for one in self.norms:
            size = np.linalg.norm(jets(one.arguments, y).values, axis=1)
            found[one] = size <= ZERO_NORM * max(1.0, float(np.nanmax(size, initial=0.0)))
        return found

    def pull_of_norm(self, one: Formula, y: Array, mode: int, eta: Array) -> float:
        """Return the derivative of <eta, f_mode> by a norm at y = (x, u), the norm taken for a variable of its own."""
        k, (n, m) = len(y), one.dimensions

        def with_variable(node: Formula, arguments: list[Formula]) -> Formula:  # of (x, u, w), w the norm
            if node is one:
                return Formula((n, m + 1), VARIABLE, (), (float(k),))
            return replace(node, dimensions=(n, m + 1), arguments=tuple(arguments))

        f = evaluate(self.modes[mode].f, with_variable)
        found = jets(f, np.append(y, values_of([one], y[None])[0])[None])
        return float(eta @ found.slopes[0, :, k])

    def linear_at(self, x: Array, u: Array) -> LinearDynamics:
        """Return the linearisation along a trajectory, of the modes that it is in."""
        return self.affine_at(x, u).linear_at(x, u)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> PiecewiseSmoothDynamics:
        """Raise UnsupportedError."""
        raise UnsupportedError(
            "dynamics: got PiecewiseSmoothDynamics; further states take linear or piecewise-affine dynamics: write the "
            "former control as a further state in the formulas."
        )

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time: of those that hold, the one that leads nearest to x_{t+1}; (T,)."""
        return self.affine_at(x, u).sequence_of(x, u)

    def stepper(self, horizon: int) -> Step:
        """Return the function that makes x_{t+1} of t, x_t (n,) and u_t (m,), by the first mode that holds there.

        It raises NumericalError where no mode is defined and holds.
        """

        def step(t: int, x: Array, u: Array) -> Array:
            if not np.isfinite(x).all():
                return np.full_like(x, np.nan)
            y = np.append(x, u)[None]
            if len(self.modes) == 1 and not self.modes[0].region:
                after, domain = values_of(self.modes[0].f, y)[0], values_of(self.modes[0].domain, y)
                if np.isfinite(after).all() and (domain > 0).all():
                    return after
            found = self.jets_at(y)
            defined = found.defined()[0]
            sizes = np.abs(np.append(x, u))
            for i in np.flatnonzero(defined):
                region = found.regions[i]
                rounding = REPLAY_ROUNDING * (np.abs(region.slopes[0]) @ sizes + np.abs(region.values[0]))
                if (region.values[0] <= rounding).all():
                    return found.f[i].values[0]
            at = f"t = {t}, x = {brief(x.tolist())}, u = {brief(u.tolist())}"
            raise NumericalError(f"No mode of the dynamics is defined and holds at {at}.")

        return step
