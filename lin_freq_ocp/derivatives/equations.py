"""How the equations of an optimum change with the data: the right-hand side of the solves of ``jvp``.

Matrices enter the program of a problem affinely, one at a time. So the change of its equations at the optimum is a
difference of two programs, exact but for rounding. The other data are slopes of the cost and limits of rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.derivatives.data import BINS, ENDS, Values, bounds_of_ends, data_of, is_matrix, with_data
from lin_freq_ocp.derivatives.exact_point import ExactPoint
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block
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
    of_z, values, limits = np.zeros(linear.variables), np.zeros(len(y)), np.zeros((2, len(y)))
    for name, d in change.items():
        if name in SLOPES:
            of_z += _slope_change(linear, name, d)
        elif not is_matrix(name):
            limits += _limit_changes(linear, name, d)
        elif d.any():  # any step is exact; a large one leaves no rounding
            largest = max(float(np.abs(known[one]).max()) for one in (WEIGHTS if name in WEIGHTS else (name,)))
            step = (largest or 1.0) / float(np.abs(d).max())
            other = LinearProgram(with_data(linear.problem, {name: known[name] + step * d}), linear.origin).sparse
            rows = (other.A - program.A) / step
            of_z += ((other.P - program.P) @ z + other.q - program.q) / step + rows.T @ y
            values += rows @ z
            finite = np.isfinite([program.lower, program.upper])
            old, new = (np.where(finite, [part.lower, part.upper], 0.0) for part in (program, other))
            limits += (new - old) / step
    lower, upper = scaling.rows * limits
    affine = not any(is_matrix(name) and d.any() for name, d in change.items())
    return ChangedEquations(scaling.cost * scaling.columns * of_z, scaling.rows * values, lower, upper, affine)


def _slope_change(linear: LinearProgram, name: str, d: Array) -> Array:
    """Return the change of the slope of the cost in all variables along a change of q, r, p or a reference."""
    z = np.zeros(linear.variables)
    in_x, in_u = linear.split_signals(z)
    places = {"r": in_u, "u_ref": in_u, "x_ref": in_x, "q": in_x[:-1], "p": in_x[-1]}
    places[name][:] = d
    return -(linear.hessian @ z) if name.endswith("_ref") else z


def _limit_changes(linear: LinearProgram, name: str, d: Array) -> Array:
    """Return the changes of lower and upper limits of all rows, (2, rows), along a change of limits."""
    problem, of_dynamics = linear.problem, np.zeros((2, linear.drift.size))
    changes = [of_dynamics]
    if name == "offset":
        of_dynamics[:] = d.ravel()
    for part in linear.rows:
        found = np.zeros((2, len(part.lower)))
        if name not in OF_BLOCK.get(part.block, (part.name,)):
            pass
        elif part.map is None:
            of_states = part.block is Block.STATE_SET
            found[:] = _bound_changes(problem, of_states, name, d)[
                :, part.entries - (0 if of_states else linear.states)
            ]
        elif part.block is Block.TERMS:
            found[:] = _term_changes(linear, part, d)
        else:
            assert part.map.spectrum is not None
            assert part.spectrum is not None
            bins, weights = d[part.spectrum.bins, part.map.spectrum.component], part.weights
            found[:] = (1.0 if weights is None else weights) * bins.view(np.float64)[part.spectrum.kept]
        changes.append(found)
    return np.concatenate(changes, axis=1)


def _bound_changes(problem: OptimalControlProblem, of_states: bool, name: str, d: Array) -> Array:
    """Return the changes of the bounds of states or controls, (2, values); those of ends move by these data alone."""
    fixed = problem.control_tube.fixed
    own = np.stack(bounds_of_ends(problem) if of_states else (fixed, fixed))  # not moved by the data of sets
    full = np.zeros(own.shape)
    if name in ENDS:
        t = -ENDS.index(name)
        full[:, t] = np.where(own[:, t], d, 0.0)
    else:
        side = int(name.endswith("upper"))
        full[side] = np.where(own[side], 0.0, d)
    return full.reshape(2, -1)


def _term_changes(linear: LinearProgram, part: ProgramRows, d: Array) -> Array:
    """Return the changes of the limits of the rows of a term along a change of its levels."""
    index = linear.of_terms.index(part)
    term, target = linear.problem.terms[index], linear.layout.terms[index]
    amount = np.asarray(term.per_limit)[..., None] * d
    moved = map_rows(term.name, term.map, term.penalty.relaxed(np.zeros(term.shape), amount)[1], linear.origin, target)
    if len(moved.lower) != len(part.lower):
        text = (
            f"derivatives: got a change of a limit of zero, of '{part.name}'; expected one above zero, with two sides."
        )
        raise UnsupportedError(text)
    return np.array([_difference(moved.lower, part.lower), _difference(moved.upper, part.upper)])


def _difference(new: Array, old: Array) -> Array:
    return np.where(np.isfinite(old), new - np.where(np.isfinite(old), old, 0.0), 0.0).astype(np.float64)
