"""How the equations of an optimum change with the data: the right-hand side of the solves of ``jvp``.

Matrices enter the program of a problem affinely, one at a time. So the change of its equations at the optimum is a
difference of two programs, exact but for rounding. The other data are slopes of the cost and limits of rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, stack_signals
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.derivatives.data import (
    BINS,
    ENDS,
    Values,
    Variables,
    bounds_of_ends,
    data_of,
    is_matrix,
    is_upper,
    with_data,
)
from lin_freq_ocp.derivatives.exact_point import ExactPoint
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.program.program_rows import ProgramRows, map_rows

SLOPES = ("q", "r", "p", "x_ref", "u_ref")
WEIGHTS = ("Q", "R", "S", "P")
OF_BLOCK = {  # the data that move the limits of its rows
    Block.STATE_SET: (*ENDS, "state_upper", "state_lower"),
    Block.CONTROL_SET: ("control_upper", "control_lower"),
    Block.CONTROL_SPECTRUM: BINS[:1],
    Block.STATE_SPECTRUM: BINS[1:],
}


@dataclass(frozen=True, eq=False)
class ChangedEquations:
    """The changes, along a change of the data, of the slope in z, of A z, and of the lower and upper limits of rows.

    In scaled units. ``affine``: z and y are affine in the change as long as the same rows are active.
    """

    of_z: Array
    values: Array
    lower: Array
    upper: Array
    affine: bool


def changed_equations(point: ExactPoint, change: Values) -> ChangedEquations:
    """Return the change of the equations at a point along a change of the data."""
    linear, scaling = point.deviations.linear, point.deviations.scaling
    program, known = linear.sparse, data_of(linear.problem)
    z, y = scaling.primal(point.kkt.z), scaling.dual(point.kkt.y)
    slacks = [one.origin for one in linear.of_terms]
    of_z, values, limits = np.zeros(linear.variables), np.zeros(len(y)), np.zeros((2, len(y)))
    for name, d in change.items():
        if name in SLOPES:
            of_z += _slope_change(linear, name, d)
        elif not is_matrix(name):
            limits += _limit_changes(point, name, d)
        elif name in WEIGHTS:  # the cost is linear in them, and no difference of costs is formed
            parts = {one: d if one == name else 0.0 * known[one] for one in (*WEIGHTS, "q", "r", "p")}
            alone = LinearProgram(with_data(linear.problem, parts), linear.origin, slacks)
            of_z[: linear.signals] += (alone.hessian @ z + alone.gradient)[: linear.signals]
        elif d.any():  # any step is exact; a large one leaves no rounding
            step = (float(np.abs(known[name]).max()) or 1.0) / float(np.abs(d).max())
            moved = with_data(linear.problem, {name: known[name] + step * d})
            other = LinearProgram(moved, linear.origin, slacks).sparse
            rows = (other.A - program.A) / step
            of_z += rows.T @ y
            values += rows @ z
            limits += _difference(other, program) / step
    lower, upper = scaling.rows * limits
    affine = not any(is_matrix(name) and d.any() for name, d in change.items())
    return ChangedEquations(scaling.cost * scaling.columns * of_z, scaling.rows * values, lower, upper, affine)


@dataclass(frozen=True, eq=False)
class ChangedSignals:
    """The same changes of a problem of bounds, ends and stop bands, for z_t = (x_t, u_t), in the units of the problem.

    Those of the slope in z and of the lower and upper bounds, (T+1, n+m), and of f_t(x_t, u_t), (T, n). ``levels`` is a
    signal (T+1, n+m) with the changed levels of removed bins, and no other bins.
    """

    of_z: Array
    lower: Array
    upper: Array
    offset: Array
    levels: Array
    affine: bool


def changed_signals(problem: OptimalControlProblem, at: Variables, change: Values) -> ChangedSignals:
    """Return the change of the equations of an optimum along a change of the data."""
    cost, linear, T = problem.quadratic, problem.linear, problem.horizon
    of_cost = {name: change.get(name, 0.0) for name in (*WEIGHTS, "q", "r", "p")}
    weights = replace(cost, **of_cost).at_dimensions(problem.state_dim, problem.control_dim, T)
    moved = (np.broadcast_to(change.get(name, 0.0), part.shape) for name, part in (("x_ref", at.x), ("u_ref", at.u)))
    of_z = stack_signals(*weights.gradient(at.x, at.u)) - cost.bend(stack_signals(*moved))
    matrices = {name: change.get(name, np.zeros_like(getattr(linear, name))) for name in ("A", "B")}
    dynamics = replace(linear, **matrices, offset=change.get("offset", 0.0 * linear.offset))
    of_z[:-1] -= dynamics.pull_back(at.multipliers.eta)
    sides = [np.zeros((2, *signal.shape)) for signal in (at.x, at.u)]
    for name, d in change.items():
        for block, side in zip((Block.STATE_SET, Block.CONTROL_SET), sides, strict=True):
            if name in OF_BLOCK[block]:
                side += _bound_changes(problem, at.multipliers, block is Block.STATE_SET, name, d)
    lower, upper = map(stack_signals, *sides)
    return ChangedSignals(
        of_z,
        lower,
        upper,
        dynamics.successors(at.x, at.u),
        level_signal(problem, *(cast("ComplexArray | None", change.get(name)) for name in BINS)),
        not any(is_matrix(name) and d.any() for name, d in change.items()),
    )


def level_signal(problem: OptimalControlProblem, of_u: ComplexArray | None, of_x: ComplexArray | None) -> Array:
    """Return the signal z (T+1, n+m) whose removed bins have these levels, without other bins."""
    signals, T = list[Array](), problem.horizon
    for levels, stop, samples in ((of_x, problem.state_stop, T + 1), (of_u, problem.control_stop, T)):
        kept = np.zeros(stop.shape) if levels is None else np.where(stop, levels, 0.0)
        signals.append(np.fft.irfft(kept, samples, axis=0))
    return stack_signals(*signals)


def _slope_change(linear: LinearProgram, name: str, d: Array) -> Array:
    """Return the change of the slope of the cost in all variables along a change of q, r, p or a reference."""
    z = np.zeros(linear.variables)
    in_x, in_u = linear.split_signals(z)
    places = {"r": in_u, "u_ref": in_u, "x_ref": in_x, "q": in_x[:-1], "p": in_x[-1]}
    places[name][:] = d
    return -(linear.hessian @ z) if name.endswith("_ref") else z


def _limit_changes(point: ExactPoint, name: str, d: Array) -> Array:
    """Return the changes of lower and upper limits of all rows, (2, rows), along a change of limits."""
    linear = point.deviations.linear
    of_dynamics = np.zeros((2, linear.drift.size))
    changes = [of_dynamics]
    if name == "offset":
        of_dynamics[:] = d.ravel()
    for part in linear.rows:
        found = np.zeros((2, len(part.lower)))
        if name not in OF_BLOCK.get(part.block, (part.name,)):
            pass
        elif part.map is None:
            of_states = part.block is Block.STATE_SET
            bounds = _bound_changes(linear.problem, point.multipliers, of_states, name, d).reshape(2, -1)
            found[:] = bounds[:, part.entries - (0 if of_states else linear.states)]
        elif part.block is Block.TERMS:
            found[:] = _term_changes(linear, part, d)
        else:
            assert part.map.spectrum is not None
            assert part.spectrum is not None
            bins, weights = d[part.spectrum.bins, part.map.spectrum.component], part.weights
            found[:] = (1.0 if weights is None else weights) * bins.view(np.float64)[part.spectrum.kept]
        changes.append(found)
    return np.concatenate(changes, axis=1)


def _bound_changes(problem: OptimalControlProblem, at: Multipliers, of_states: bool, name: str, d: Array) -> Array:
    """Return the changes of bounds, (2, T+1, n) of states or (2, T, m); those of ends move by these data alone."""
    tube, normals = (problem.state_tube, at.mu) if of_states else (problem.control_tube, at.nu)
    full = np.zeros((2, *normals.shape))
    of_ends = np.stack(bounds_of_ends(problem)) if of_states else full != 0
    if name in ENDS:
        t = -ENDS.index(name)
        full[:, t] = np.where(of_ends[:, t], d, 0.0)
    else:
        side = int(name.endswith("upper"))
        full[side] = np.where(of_ends[side], 0.0, d)
    return np.where(tube.fixed, np.where(is_upper(normals, tube), full[1], full[0]), full)


def _term_changes(linear: LinearProgram, part: ProgramRows, d: Array) -> Array:
    """Return the changes of the limits of the rows of a term along a change of its levels."""
    index = linear.of_terms.index(part)
    term, target = linear.problem.terms[index], linear.layout.terms[index]
    amount = np.asarray(term.per_limit)[..., None] * d
    relaxed = term.penalty.relaxed(np.zeros(term.shape), amount)[1]
    moved = map_rows(term.name, term.map, relaxed, linear.origin, target, part.origin)
    if len(moved.lower) != len(part.lower):
        got = f"a change of a limit of zero, of '{part.name}'"
        raise UnsupportedError(f"derivatives: got {got}; expected one above zero, with two sides.")
    return _difference(moved, part)


def _difference(new: Program | ProgramRows, old: Program | ProgramRows) -> Array:
    """Return the change of the lower and upper limits, (2, rows), of rows; 0 where there is none."""
    finite = np.isfinite([old.lower, old.upper])
    after, before = (np.where(finite, [one.lower, one.upper], 0.0) for one in (new, old))
    return (after - before).astype(np.float64)
