"""Trajectories and problems as objects of other libraries.

A trajectory becomes a DataFrame of pandas, or a TimeResponseData of python-control, and is made from the latter. A
problem becomes a problem of CVXPY, to be solved with its solvers or extended by the user.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError, missing_extra
from lin_freq_ocp.files.reading import at_location
from lin_freq_ocp.files.solution_files import require_clock, trajectory_from_signals
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block
from lin_freq_ocp.program.program_rows import ProgramRows

if TYPE_CHECKING:
    import cvxpy
    from control import TimeResponseData
    from pandas import DataFrame

Signals = tuple[str, Array | None, Sequence[str] | None]  # their kind, values and labels


def to_frame(problem: OptimalControlProblem, trajectory: Trajectory) -> DataFrame:
    """Return a row per time 0 .. T, with states and controls under their names; see ``Result.to_frame``."""
    try:
        import pandas
    except ImportError:
        raise missing_extra("to_frame", "pandas", "pandas") from None
    problem.require(trajectory)
    label = "t" if problem.sampling_time is None else "time [s]"
    return pandas.DataFrame(
        np.hstack([trajectory.x, _controls_until_end(trajectory)]),
        index=pandas.Index(problem.times, name=label),
        columns=[*problem.state_names, *problem.control_names],
    )


def _controls_until_end(trajectory: Trajectory) -> Array:
    """Return the controls with not-a-number at time T, (T+1, m)."""
    return np.vstack([trajectory.u, np.full((1, trajectory.u.shape[1]), np.nan)])


def to_time_response(problem: OptimalControlProblem, trajectory: Trajectory) -> TimeResponseData:
    """Return a trajectory as a ``control.TimeResponseData``, whose last axis is time, with the problem's names.

    Its time (T+1,) is in seconds (in steps, without sampling time); states and outputs both are x', (n, T+1); inputs
    are u', (m, T+1), NaN at time T, where there is no control.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory
        Of its horizon and dimensions.

    Returns
    -------
    control.TimeResponseData

    Raises
    ------
    ProblemError
        If the trajectory is not of the problem's shape.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> lfo.io.to_time_response(result.problem, result.trajectory).states.shape
    (2, 201)
    """
    import control  # here, because it takes seconds to import and only its users need it

    problem.require(trajectory)
    return control.TimeResponseData(
        problem.times,
        outputs=trajectory.x.T,
        states=trajectory.x.T,
        inputs=_controls_until_end(trajectory).T,
        output_labels=list(problem.state_names),
        state_labels=list(problem.state_names),
        input_labels=list(problem.control_names),
        title=problem.name or None,
        sysname=problem.name or None,
    )


def from_time_response(response: TimeResponseData, problem: OptimalControlProblem) -> Trajectory:
    """Return a response of python-control, such as of ``forced_response``, as a trajectory of the problem.

    Signals are found by the problem's names if the labels have them all, else by their order if there are as many. The
    states of the problem are looked for among the states of the response, then among its outputs. Inputs at time T act
    on nothing, and are left out. python-control draws straight lines between the inputs of a continuous system; the
    problem holds them.

    Parameters
    ----------
    response : control.TimeResponseData
        One response (one trace) at T+1 times, with inputs.
    problem : OptimalControlProblem
        Its names, dimensions, horizon and sampling time.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If the response has other times or signals, or more than one trace.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> lfo.from_time_response(result.to_time_response(), result.problem).u.shape == result.trajectory.u.shape
    True
    """
    import control  # here, because it takes seconds to import and only its users need it

    if not isinstance(response, control.TimeResponseData):
        raise ProblemError("response", type(response).__name__, "a control.TimeResponseData")
    if response.ntraces > 1:
        advice = "Take the response to one input: of step_response, with input=0."
        raise ProblemError("response", f"{response.ntraces} traces", "one", advice)
    T = problem.horizon
    times = real_array("response.time", response.t)
    if times.shape != (T + 1,):
        raise ProblemError("response.time", f"{len(times)} times", f"{T + 1}, one per state")
    if problem.sampling_time is not None:
        require_clock("response.time", times, problem.sampling_time)
    sources = [("states", response.x, response.state_labels), ("outputs", response.y, response.output_labels)]
    states = [
        x for _, signals, labels in sources if (x := _rows_by_name(signals, labels, problem.state_names)) is not None
    ]
    controls = _rows_by_name(response.u, response.input_labels, problem.control_names)
    if not states:
        raise _unfit_error("states, outputs", sources, problem.state_names)
    if controls is None:
        raise _unfit_error("inputs", [("inputs", response.u, response.input_labels)], problem.control_names)
    with at_location("response"):
        return trajectory_from_signals(problem, states[0].T, controls.T[:T])


def _rows_by_name(signals: ArrayLike | None, labels: Sequence[str] | None, names: Sequence[str]) -> Array | None:
    """Return the signals of these names, or all of them, in their order, if there are as many; else None."""
    if signals is None:
        return None
    rows = np.asarray(signals)
    rows = rows.reshape(len(rows), -1)  # the axis of a single trace may be between signal and time
    if labels is not None and set(names) <= set(labels):
        return rows[[list(labels).index(name) for name in names]]
    return rows if len(rows) == len(names) else None


def _unfit_error(field: str, sources: Sequence[Signals], names: Sequence[str]) -> ProblemError:
    got = "; ".join(
        f"{'no' if signals is None else len(signals)} {kind}" + (f" ({', '.join(labels)})" if labels else "")
        for kind, signals, labels in sources
    )
    return ProblemError(f"response.{field}", got, f"{len(names)}: {', '.join(names)}")


def to_cvxpy(problem: OptimalControlProblem) -> cvxpy.Problem:
    """Return the problem in CVXPY; its optimal value is the cost J, constant terms included.

    Variables (``var_dict``): "x" of shape (T+1, n), "u" of shape (T, m). Constraints carry labels: "dynamics", whose
    dual value is the adjoint eta (T, n); "initial state", "terminal state", "state set", "control set" where a
    component is fixed, and the same with " lower" and " upper" for bounds (only the finite ones, in the order of
    time, then component); "control spectrum", "state spectrum": orthonormal real rows per component.

    All other constraints carry the name of their multipliers in ``result.multipliers.stage``: joint
    rows ("stage rows" by default), "control set" and the like beyond boxes (components that such a set also fixes are
    then "control set fixed"), "mask on ...", "energy bound on ...". Rows and equations have the multipliers as their
    dual value, only finite limits, in the order of time or bin, then row. Euclidean norms and cones are ``cvxpy.SOC``,
    one cone per time or bin, whose dual values are a number sigma >= |z| and a vector z of each: the multiplier is -z
    of a norm, and (-sigma, -z) of a cone. Soft constraints and nonsmooth costs are in the objective, with a variable of
    their own: "slacks of " and their name, bounded by constraints of that name with " slack".

    Parameters
    ----------
    problem : OptimalControlProblem
        With a convex cost.

    Returns
    -------
    cvxpy.Problem

    Raises
    ------
    UnsupportedError
        If the cost is not convex, or the dynamics have modes (take ``problem.with_modes(sequence)``).

    Examples
    --------
    >>> model = lfo.to_cvxpy(lfo.library.double_integrator(horizon=60))
    >>> model.var_dict["x"].shape
    (61, 2)
    """
    import cvxpy as cp  # here, because it takes more than a second to import and only its users need it

    require_problem(problem)
    _ = problem.equations  # which raises if there are modes
    nonconvex = problem.quadratic.nonconvexity()
    if nonconvex is not None:
        t, eigenvalue = nonconvex
        which = "P" if t < 0 else f"[[Q, S], [S', R]] at t = {t}"
        message = f"cost: {which} has the eigenvalue {eigenvalue:g} < 0, and CVXPY takes convex costs only."
        raise UnsupportedError(message)
    (T, n, m), slacks = (problem.horizon, problem.state_dim, problem.control_dim), [np.zeros(1)] * len(problem.terms)
    linear = LinearProgram(problem, given_slacks=slacks)
    x, u = cp.Variable((T + 1, n), name="x"), cp.Variable((T, m), name="u")
    # Bounds on the state where an end fixes it would be redundant
    lower, upper = problem.state_boxes.lower.copy(), problem.state_boxes.upper.copy()
    for t, end in ((0, problem.initial_box), (-1, problem.terminal_box)):
        lower[t, end.fixed], upper[t, end.fixed] = -np.inf, np.inf
    # the variables of the program, deviations from the references
    z = cp.hstack([cp.vec(x - linear.origin.x, order="C"), cp.vec(u - linear.origin.u, order="C")])
    # its Hessian is known to be positive semidefinite up to rounding
    P, q = cp.psd_wrap(linear.hessian[: linear.signals, : linear.signals]), linear.gradient[: linear.signals]
    quadratic = 0.5 * cp.quad_form(z, P) + q @ z + problem.quadratic.value(linear.origin.x, linear.origin.u)
    defects = cp.reshape(linear.dynamics[:, : linear.signals] @ z, (T, n), order="C") - linear.drift
    costs, terms = _conic_constraints(linear, z)
    taken = {constraint.label for constraint in terms}
    return cp.Problem(
        cp.Minimize(sum(costs, quadratic)),
        [
            (defects == 0).set_label("dynamics"),
            *_box_constraints(problem.initial_box, x[0], "initial state", taken),
            *_box_constraints(problem.terminal_box, x[T], "terminal state", taken),
            *_box_constraints(Box(lower, upper), x, "state set", taken),
            *_box_constraints(problem.control_tube, u, "control set", taken),
            *terms,
            *_stop_band_constraints(linear, z),
        ],
    )


def _conic_constraints(
    linear: LinearProgram, z: cvxpy.Expression
) -> tuple[list[cvxpy.Expression], list[cvxpy.Constraint]]:
    """Return the costs and the constraints of all terms, from the same rows as other solvers get.

    The constraints of a hard term carry its name. Only finite limits appear, group after group; how the duals
    become the term's multipliers lambda:

        v <= limit                lambda = dual
        v = 0                     lambda = dual; the imaginary parts of bins 0 and N/2 are left out
        |v| <= radius, SOC        lambda = -dual_value[1], (groups, dim), and |lambda| = dual_value[0]
        v_0 >= |(v_1, ...)|, SOC  lambda_0 = -dual_value[0], (groups,); (lambda_1, ...) = -dual_value[1]

    Groups of radius 0 are equations of their own, labelled with the term's name and " zero". A soft term
    or nonsmooth cost has a variable, its slacks: the objective has their prices, and their lower bounds are
    labelled with the term's name and " slack".
    """
    import cvxpy as cp

    costs: list[cvxpy.Expression] = []
    constraints: list[cvxpy.Constraint] = []
    for rows in linear.of_terms:
        values, name = rows.signals @ z, rows.name
        if len(rows.prices):
            slacks, name = cp.Variable(len(rows.prices), name=f"slacks of {name}"), f"{name} slack"
            values, costs = values + rows.slacks @ slacks, [*costs, rows.prices @ slacks]
        for k, (kind, constraint) in enumerate(_constraints_of_term(rows, values)):
            constraints.append(constraint.set_label(name if k == 0 else f"{name} {kind}"))
    return costs, constraints


def _constraints_of_term(rows: ProgramRows, values: cvxpy.Expression) -> list[tuple[str, cvxpy.Constraint]]:
    """Return the cones, intervals, equations and inequalities of a term, each with the name of its kind."""
    import cvxpy as cp

    lower, upper = rows.lower, rows.upper
    constraints: list[tuple[str, cvxpy.Constraint]] = []
    free = np.ones(len(lower), dtype=bool)
    if len(rows.cones):
        inside = rows.cones[:, :1] + np.arange(rows.cones[0, 1] - rows.cones[0, 0])  # all of one size
        free[inside] = False
        cone = cp.reshape(values[inside.ravel()], inside.shape, order="C") - lower[inside]
        constraints.append(("cone", cp.SOC(cone[:, 0], cone[:, 1:], axis=1)))
    both = free & np.isfinite(lower) & np.isfinite(upper)
    between, equal = np.flatnonzero(both & (lower < upper)), both & (lower == upper)
    if len(between):
        half, middle = (upper - lower)[between] / 2, (upper + lower)[between] / 2
        constraints.append(
            ("interval", cp.SOC(half, cp.reshape(values[between] - middle, (len(half), 1), "C"), axis=1))
        )
    if equal.any():
        constraints.append(("zero", values[equal] == upper[equal]))
    for kind, here, sign, limit in (("upper", np.isfinite(upper), 1, upper), ("lower", np.isfinite(lower), -1, lower)):
        here = free & here & ~both
        if here.any():
            constraints.append((kind, sign * values[here] <= sign * limit[here]))
    return constraints


def _box_constraints(box: Box, signal: cvxpy.Expression, label: str, taken: set[str | None]) -> list[cvxpy.Constraint]:
    """Return signal = value where the box leaves no freedom, and its finite bounds elsewhere."""
    lower, upper, free = box.lower, box.upper, ~box.fixed
    parts = (
        (box.fixed, lambda here: signal[here] == lower[here], f"{label} fixed" if label in taken else label),
        (free & np.isfinite(lower), lambda here: signal[here] >= lower[here], f"{label} lower"),
        (free & np.isfinite(upper), lambda here: signal[here] <= upper[here], f"{label} upper"),
    )
    return [constraint(here).set_label(name) for here, constraint, name in parts if here.any()]


def _stop_band_constraints(linear: LinearProgram, z: cvxpy.Expression) -> list[cvxpy.Constraint]:
    """Return R_i v_i = 0 for every component i with stopped bins, one component after the other."""
    constraints: list[cvxpy.Constraint] = []
    for block in (Block.CONTROL_SPECTRUM, Block.STATE_SPECTRUM):
        rows = [rows for rows in linear.rows if rows.block is block]
        if rows:
            matrix, right = linear.matrix(rows)[:, : linear.signals], np.concatenate([part.lower for part in rows])
            constraints.append((matrix @ z == right).set_label(block.value))
    return constraints
