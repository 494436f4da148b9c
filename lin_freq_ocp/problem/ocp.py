"""The optimal control problem (paper, eq. (DTOCPNSD)) with convex sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Mask, assign, brief, known_entries, positive_integer, printable
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import html_table, plural
from lin_freq_ocp.base.resources import require_horizon
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.costs.quadratic import PREVIEWED, Cost, CostSum
from lin_freq_ocp.problem.description import problem_facts, warn_of_bands
from lin_freq_ocp.problem.dynamics.base import Dynamics, Form, StateEquations, SwitchingBoundary, require_form
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.problem_data import ProblemData, bounded_bins, replace_fields, terms_of
from lin_freq_ocp.problem.sets.box import End, SetOrSets, at_names, end_set
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint, path_constraints
from lin_freq_ocp.problem.sets.stage_rows import StageRows, StageSets, row_families, stage_sets
from lin_freq_ocp.problem.spectrum.base import Constraints, OutputSpectrum
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.problem.trajectory import Trajectory, horizon_advice

OF_MODES = "problem.with_modes(sequence) is the linear problem of one mode sequence of affine modes."


class OptimalControlProblem(ProblemData):
    """Minimise a cost over x_{t+1} = f_t(x_t, u_t), x_t in X_t, u_t in U_t, with constraints on the DFT of x and u.

    Parameters
    ----------
    dynamics : LinearDynamics, FrequencyResponse, PiecewiseAffineDynamics or PiecewiseSmoothDynamics
        The map f_t, with names, units and sampling time. Points outside the regions of all modes are infeasible.
    horizon : int
        T: number of controls u_0 .. u_{T-1}; there are T+1 states.
    cost : QuadraticCost, L1Cost, LInfCost, SmoothCost, or a sum of them
        The 1/2 of a QuadraticCost is part of its definition.
    control_set, state_set : set, sequence of sets, or None
        One set (Box, Polyhedron, Ball, ...) for all times, or one per time (T for controls, T+1 for states). A
        control_set may be a FiniteSet.
    initial_state, terminal_state : (n,), mapping, set, or None
        A point (a number, for a single state; a mapping with the value of every state by its name), a set, or free.
        The state set of that time also holds: the problem is infeasible if they have no common point. A terminal_state
        may be Periodic(), x_T = x_0, or LinkedEnds.
    control_spectrum, state_spectrum : Band, MagnitudeBound, EnergyBound, LinearConstraint, sequence of them, or None
        Frequency constraints, on the DFT of length T for controls and T+1 for states (T with Periodic()).
    stage_rows : StageRows, PathConstraint, sequence of them, or None
        Joint rows C x_t + D u_t <= e_t for t < T, or formulas h(t, x_t, u_t) <= upper, under different names; once
        constructed, a tuple of them.
    output_spectrum : OutputSpectrum, sequence of them, or None
        Frequency constraints on linear outputs of states and controls.
    name : str
        For tables and pictures.

    Raises
    ------
    ProblemError
        Naming the field, its value and the expected value.
    UnsupportedError
        If the signals do not fit into memory.

    Examples
    --------
    >>> dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    >>> cost = lfo.QuadraticCost(R=1.0)
    >>> problem = lfo.OptimalControlProblem(dynamics, 4, cost, initial_state=[0], terminal_state=[2])
    >>> round(lfo.solve(problem).cost, 9)
    0.5

    Methods
    -------
    with_ends(initial_state, terminal_state)
        The same problem between other ends.
    with_references(references)
        The same problem with other references.
    with_modes(sequence)
        The linear problem of one mode sequence.
    value(x, u)
        The cost of states (T+1, n) and controls (T, m).
    dynamics_along(trajectory)
        The linear dynamics along a trajectory.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        horizon: int,
        cost: Cost,
        control_set: SetOrSets = None,
        state_set: SetOrSets = None,
        initial_state: End = None,
        terminal_state: End = None,
        control_spectrum: Constraints = None,
        state_spectrum: Constraints = None,
        stage_rows: StageRows | Sequence[StageRows] | None = None,
        output_spectrum: OutputSpectrum | Sequence[OutputSpectrum] | None = None,
        name: str = "",
    ):
        if not isinstance(dynamics, Dynamics):
            expected = "LinearDynamics, FrequencyResponse, PiecewiseAffineDynamics or PiecewiseSmoothDynamics"
            advice = "From python-control: LinearDynamics.from_statespace."
            raise ProblemError("dynamics", brief(dynamics), expected, advice)
        if not isinstance(cost, Cost):
            raise ProblemError("cost", brief(cost), "QuadraticCost, L1Cost, LInfCost, SmoothCost, or a sum of them")
        printable("name", name)
        n, m, T = dynamics.state_dim, dynamics.control_dim, positive_integer("horizon", horizon)
        dynamics.require_horizon(T)
        require_horizon(T, n, m)
        states, controls = dynamics.state_names, dynamics.control_names
        cost = cost.at_names(states, controls).at_dimensions(n, m, T)
        rows = row_families(stage_rows, n, m, T)
        assign(
            self,
            dynamics=dynamics,
            horizon=T,
            cost=cost,
            control_set=at_names("control_set", control_set, controls),
            state_set=at_names("state_set", state_set, states),
            initial_state=end_set("initial_state", initial_state, states),
            terminal_state=end_set("terminal_state", terminal_state, states),
            control_spectrum=control_spectrum,
            state_spectrum=state_spectrum,
            stage_rows=rows,
            output_spectrum=output_spectrum,
            name=name,
        )
        _ = self.form, self.ends, self.control_tube, self.control_stop, self.state_stop, self.terms  # checked, cached
        if self.mode_names:
            self.form.require_sets(self.stage_sets)
        if not self.warned:
            warn_of_bands(self)

    def with_ends(self, initial_state: End = None, terminal_state: End = None) -> OptimalControlProblem:
        """Return the same problem with other ends; only these are checked.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or set, optional
            None keeps the end of the problem; a free end is Everything().

        Raises
        ------
        ProblemError
            If an end does not fit the problem.
        """
        given = {"initial_state": initial_state, "terminal_state": terminal_state}
        ends = {field: end_set(field, end, self.state_names) for field, end in given.items() if end is not None}
        problem = replace_fields(self, **ends)
        ends_before = self.initial_state, self.terminal_state, problem.initial_state, problem.terminal_state
        boxes = not any(end.members for end in ends_before)
        unmet = any(outside.any() for _, outside in problem.met_ends)
        hard = any(term.kind == TermKind.STATE_SET and term.hard for term in self.terms) or self.hard_state_sets
        linked = any(term.kind == TermKind.LINKED_ENDS for term in self.terms)
        if not boxes or unmet or hard or linked:  # other terms do not depend on ends
            problem.__dict__.pop("terms", None)
            _ = problem.terms
        return problem

    def with_references(self, references: Mapping[str, ArrayLike]) -> OptimalControlProblem:
        """Return the same problem with other references and prices of its quadratic cost.

        Parameters
        ----------
        references : mapping
            "x_ref", "u_ref", and the linear costs "q" and "r", as in QuadraticCost; an absent one stays.

        Raises
        ------
        ProblemError
            If a key is unknown, a reference does not fit the problem, or no part of the cost is quadratic.
        """
        replaced = known_entries("references", references, PREVIEWED)
        if self.quadratic.zero and not {"q", "r"}.intersection(replaced):
            raise ProblemError("references", f"some for {brief(self.cost)}", "a problem with a quadratic cost")
        quadratic = replace(self.quadratic, **replaced)
        cost = CostSum([quadratic, *self.cost.norms]) if self.cost.norms else quadratic
        cost = cost.at_names(self.state_names, self.control_names)
        return replace_fields(self, cost=cost.at_dimensions(self.state_dim, self.control_dim, self.horizon))

    def in_form(self, kind: type[Form], advice: str = "") -> Form:
        """Return the dynamics in a standard form, or raise UnsupportedError unless they are of this class."""
        if (self.cost.has_formulas or self.path_constraints) and not isinstance(self.form.standard_form, kind):
            got = "cost: got a cost by formulas, or stage_rows: a path constraint"
            raise UnsupportedError(f"{got}; expected quadratic, L1 and L-infinity costs, and linear rows.")
        return require_form(self.form, kind, advice)

    @cached_property
    def linear(self) -> LinearDynamics:
        """The dynamics, which must be linear; else UnsupportedError."""
        return self.in_form(LinearDynamics, OF_MODES)

    @cached_property
    def equations(self) -> StateEquations:
        """The dynamics, which must be linear or known by a frequency response; else UnsupportedError."""
        return self.in_form(StateEquations, OF_MODES)

    def affine_at(
        self, trajectory: Trajectory, selections: Mapping[Formula, Array] | None = None
    ) -> OptimalControlProblem:
        """Return the problem with smooth modes and path constraints linearised along a trajectory; others stay.

        Both problems agree to first order at the trajectory: its states and its multipliers are the same in both. The
        linearised regions need not cover the sets.

        Parameters
        ----------
        selections : mapping from norms to (T, components), optional
            The derivatives of norms at zero, as for ``formulas.jets_of``.

        Raises
        ------
        UnsupportedError
            If the cost has formulas: affine dynamics would lack it, unless it is a state.
        """
        if self.form.affine:
            return self
        if self.cost.has_formulas:
            raise UnsupportedError("dynamics: got a cost by formulas; expected one that is a state (cost_as_state).")
        affine = self.form.affine_at(trajectory.x, trajectory.u, selections)
        problem = replace_fields(self, dynamics=affine, stage_rows=self.rows_along(trajectory))
        problem.__dict__.update(borders=(), gap=None)  # smooth pieces meet continuously, and cover the sets
        return problem

    @property
    def path_constraints(self) -> tuple[PathConstraint, ...]:
        """Return the path constraints by formulas."""
        return path_constraints(self.stage_rows)

    def rows_along(self, trajectory: Trajectory) -> tuple[StageRows, ...]:
        """Return the joint rows, with path constraints to first order along a trajectory."""
        return tuple(rows.linearised(trajectory.x, trajectory.u) for rows in self.stage_rows)

    def with_modes(self, sequence: ArrayLike) -> OptimalControlProblem:
        """Return the linear problem of one mode sequence: its maps, and the rows of its regions as stage rows.

        Parameters
        ----------
        sequence : (T,) integers
            The mode at every time, counted from 0.

        Raises
        ------
        ProblemError
            If the sequence is invalid.
        UnsupportedError
            If the dynamics have no modes.
        """
        dynamics, rows = self.form.with_modes(sequence, self.horizon)
        return self.derived(dynamics=dynamics, control_set=self.control_hull, stage_rows=(*self.stage_rows, rows))

    def with_dynamics(self, dynamics: Dynamics) -> OptimalControlProblem:
        """Return the problem with other dynamics, and controls in the convex hull of its levels."""
        return self.derived(dynamics=dynamics, control_set=self.control_hull)

    def dynamics_along(self, trajectory: Trajectory) -> LinearDynamics:
        """Return the linear dynamics along a trajectory: those of its modes, linearised if smooth."""
        return require_form(self.form.linear_at(trajectory.x, trajectory.u), LinearDynamics)

    @cached_property
    def borders(self) -> tuple[SwitchingBoundary, ...]:
        """The switching boundaries of affine modes within the sets, and whether the map jumps there; else empty."""
        return self.form.borders(self.stage_sets) if self.mode_names else ()

    @cached_property
    def gap(self) -> str | None:
        """A point of the sets, as text, outside the regions of all affine modes; None if they cover the sets."""
        return self.form.gap(self.stage_sets) if self.mode_names else None

    @property
    def stage_sets(self) -> StageSets:
        """The polyhedral part of the sets of (x_t, u_t)."""
        return stage_sets(self.state_boxes, self.control_tube, self.state_tube, self.terms)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """All constraints and costs but the quadratic cost, formulas, boxes and stop bands."""
        return terms_of(self)

    @property
    def costs_nothing(self) -> bool:
        """Whether any trajectory that satisfies the constraints is optimal."""
        return self.quadratic.zero and not self.cost.has_formulas and all(term.hard for term in self.terms)

    def value(self, x: Array, u: Array) -> float:
        """Return J: the costs, quadratic, nonsmooth and by formulas, and the penalties of soft constraints."""
        terms = sum(term.cost(x, u).sum() for term in self.terms)
        return float(self.quadratic.value(x, u) + self.cost.formula_values(x, u).sum() + terms)

    @cached_property
    def control_band(self) -> Mask:
        """The bins of each control that a stop band, a mask or an energy limits: shape (T//2 + 1, m)."""
        return self.control_stop | bounded_bins(self.terms, TermKind.CONTROL_SPECTRUM, self.control_stop.shape)

    @cached_property
    def state_band(self) -> Mask:
        """The bins of each state that a stop band, a mask or an energy limits: shape (state_samples//2 + 1, n)."""
        return self.state_stop | bounded_bins(self.terms, TermKind.STATE_SPECTRUM, self.state_stop.shape)

    @cached_property
    def stop_band_maps(self) -> tuple[SpectrumMap, ...]:
        """The maps from (x, u) to (Re, Im) of the bins that stop bands make zero, one of each state and control."""
        maps = list[SpectrumMap]()
        signals = (True, self.state_stop, self.state_samples), (False, self.control_stop, self.horizon)
        for of_states, stop, samples in signals:
            for i in np.flatnonzero(stop.any(axis=0)):
                row, bins = np.eye(stop.shape[1])[i], np.flatnonzero(stop[:, i])
                parts = (row, None) if of_states else (None, row)
                maps.append(SpectrumMap(*parts, np.ones(samples), samples, bins, joint=True))
        return tuple(maps)

    def require(self, trajectory: Trajectory) -> None:
        """Raise ProblemError unless the trajectory has this problem's shape."""
        expected = (self.horizon + 1, self.state_dim), (self.horizon, self.control_dim)
        if (trajectory.x.shape, trajectory.u.shape) != expected:
            got = f"x {trajectory.x.shape}, u {trajectory.u.shape}"
            T, other = len(trajectory.u), trajectory.x.shape[1:] == expected[0][1:]
            advice = horizon_advice(T) if other and T != self.horizon else "Time is axis 0."
            raise ProblemError("trajectory", got, f"x {expected[0]}, u {expected[1]}", advice)

    def __str__(self) -> str:
        stops = {"control": self.control_stop, "state": self.state_stop}
        joint, modes = sum(family.rows for family in self.stage_rows), len(self.mode_names)
        parts = [
            f"horizon {self.horizon}",
            plural(self.state_dim, "state"),
            plural(self.control_dim, "control"),
            *([plural(modes, "mode")] if modes > 1 else []),
            *(f"{stop.sum()} of {stop.size} {word} bins removed" for word, stop in stops.items() if stop.any()),
            *([f"{plural(joint, 'joint row')} per step"] if joint else []),
            *(term.name for term in self.terms if term.kind != TermKind.STAGE_ROWS),
        ]
        return f"{self.name or 'optimal control problem'}: {', '.join(parts)}"

    def __repr__(self) -> str:
        return f"OptimalControlProblem({self})"

    def _repr_html_(self) -> str:
        return html_table(self.name or "Optimal control problem", problem_facts(self, self.gap))


def require_problem(problem: object) -> None:
    """Raise ProblemError unless it is an optimal control problem."""
    if not isinstance(problem, OptimalControlProblem):
        raise ProblemError("problem", brief(problem), "an OptimalControlProblem", "Of a file: lfo.read_problem(path).")
