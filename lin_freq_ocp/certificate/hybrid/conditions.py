"""The conditions of a problem with piecewise-affine dynamics: those of the averaged linear problem, and of its modes.

With weights alpha, the derivative of f_t is sum_i alpha_i (A_i, B_i): Clarke's rule is then the adjoint equation and
stationarity in u of the linear problem with these dynamics, if the sum is a convex combination of active modes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.certificate.conditions import Condition, all_conditions, cost_of_residuals, state_equation
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at
from lin_freq_ocp.certificate.hybrid.clarke import (
    modes_along,
    nearest_weights,
    stationarity_scale,
    switching_facts,
    switching_stages,
    times_at_gaps,
)
from lin_freq_ocp.certificate.sizes import Floors, floors, trajectory_sizes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, SCALE_FLOOR
from lin_freq_ocp.certificate.verdict import Judgement
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.hybrid.mode_arrays import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import held
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

# Conditions that depend on the weights: at times where only one mode is active they are checked apart
OF_WEIGHTS = ("adjoint equation", "transversality at 0", "Hamiltonian stationary in u", "Hamiltonian maximal in u")


def judge_modes(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Judgement:
    """Judge a trajectory of affine modes."""
    problem.require(trajectory)
    arrays, sizes = modes_along(problem, trajectory), trajectory_sizes(problem, trajectory)
    sequence, distance = arrays.sequence(trajectory.x, trajectory.u), region_distance(problem, trajectory, sizes)
    active = arrays.active_modes(trajectory.x, trajectory.u) & (distance <= CONDITION_TOLERANCE)
    active[np.arange(len(sequence)), sequence] = True
    gaps = times_at_gaps(problem, trajectory, arrays, active)
    weights = _weights(problem, trajectory, multipliers, arrays, sequence, active)
    extremal = extremal_at(_averaged(problem, weights, sequence), trajectory, multipliers)
    least = floors(extremal, sizes, origin=problem.origin)
    least = replace(least, u=np.maximum(least.u, problem.dynamics.level_sizes))  # be the trajectory zero or not
    own = state_equation(replace(problem, dynamics=piecewise_affine(problem).along(sequence)), trajectory, least)
    linear = [own if given.name == own.name else given for given in all_conditions(extremal, least)]
    active_mode, of_weights = _mode_is_active(distance, sequence), _weights_of_modes(weights, active)
    stages = switching_stages(extremal, least, arrays, active, gaps)
    others = all(given.passed for given in (*linear, active_mode) if given.name not in OF_WEIGHTS)
    elsewhere = others and _stationary(extremal, least, ~np.isin(np.arange(problem.horizon), [s.time for s in stages]))
    conditions = (*linear, active_mode, of_weights)
    joint = all(given.passed for given in conditions)
    facts = switching_facts(problem, trajectory, stages, weights, gaps, joint, elsewhere)
    return Judgement(conditions, facts, cost_of_residuals(extremal))


def region_distance(problem: OptimalControlProblem, trajectory: Trajectory, sizes: tuple[Array, Array]) -> Array:
    """Return by how much (x_t, u_t) lies outside each region, relative to the terms of its rows, (T, modes)."""
    arrays, (of_x, of_u) = piecewise_affine(problem).arrays(problem.horizon), sizes
    least = np.append(SCALE_FLOOR * of_x, np.maximum(SCALE_FLOOR * of_u, problem.dynamics.level_sizes))
    x, y = trajectory.x, np.hstack([trajectory.x[:-1], trajectory.u])
    n = x.shape[1]
    rows, maps = np.concatenate([arrays.G, arrays.H], axis=-1), np.concatenate([arrays.A, arrays.B], axis=-1)
    images = np.einsum("tkij,tj->tki", np.abs(maps), np.abs(y)) + np.abs(arrays.offset)
    largest = np.maximum(np.abs(y).max(axis=0), least)
    largest[:n] = np.maximum.reduce([largest[:n], np.abs(x[-1]), images.min(axis=1).max(axis=0)])
    limits = np.where(np.isfinite(arrays.h), np.abs(arrays.h), 0.0)
    scale = (np.abs(rows) @ largest + limits).max(axis=0)
    violation = (np.einsum("tkrj,tj->tkr", rows, y) - arrays.h) / np.where(scale > 0, scale, 1.0)
    return np.maximum(violation.max(axis=2), 0.0)


def _averaged(problem: OptimalControlProblem, weights: Array, sequence: Indices) -> OptimalControlProblem:
    """Return the linear problem with the weights of modes; controls that modes fix are fixed."""
    dynamics, fixed = piecewise_affine(problem).averaged(weights), problem.dynamics.controls_of(sequence)
    return replace(problem, dynamics=dynamics, control_set=held(problem.control_set, fixed))


def _weights(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    arrays: ModeArrays,
    sequence: Indices,
    active: Mask,
) -> Array:
    """Return the weights that were given, or those that fit best, (T, modes)."""
    T, modes = active.shape
    if multipliers.weights is not None:
        if multipliers.weights.shape != (T, modes):
            raise ProblemError("multipliers.weights", f"shape {multipliers.weights.shape}", f"shape {(T, modes)}")
        return multipliers.weights
    weights = np.eye(modes)[sequence]
    extremal = extremal_at(_averaged(problem, weights, sequence), trajectory, multipliers)
    least, none = floors(extremal, trajectory_sizes(problem, trajectory)), np.zeros(0, dtype=np.intp)
    for stage in switching_stages(extremal, least, arrays, active, none):
        weights[stage.time] = 0.0
        weights[stage.time, stage.modes] = nearest_weights(stage)
    return weights


def _mode_is_active(distance: Array, sequence: Indices) -> Condition:
    """S-f: (x_t, u_t) lies in the region of the mode that leads to x_{t+1}; relative to the terms of its rows."""
    own = distance[np.arange(len(sequence)), sequence]
    t = int(np.argmax(own))
    name = "a mode holds that leads to the next state"
    return Condition("S-f", name, float(own[t]), 1.0, CONDITION_TOLERANCE, t, int(sequence[t]))


def _weights_of_modes(weights: Array, active: Mask) -> Condition:
    """N-f: weights are >= 0, 0 for modes that are not active, and sum to 1."""
    wrong = np.maximum(-weights, np.where(active, 0.0, np.abs(weights)))
    wrong = np.maximum(wrong, np.abs(weights.sum(axis=1, keepdims=True) - 1))
    t, mode = (int(i) for i in np.unravel_index(np.argmax(wrong), wrong.shape))
    name = "weights >= 0, sum 1, of modes that hold"
    return Condition("N-f", name, float(wrong[t, mode]), 1.0, CONDITION_TOLERANCE, t, mode)


def _stationary(extremal: Extremal, least: Floors, times: Mask) -> bool:
    """Whether the adjoint equation and stationarity in u hold at these of the times 0 .. T-1, and transversality."""
    n, scale = extremal.problem.state_dim, stationarity_scale(extremal, least)
    in_x = np.abs(extremal.eta_before - extremal.in_x + extremal.multipliers.mu)[:-1] / scale[:n]
    in_u = np.abs(extremal.in_u - extremal.multipliers.nu) / scale[n:]
    return max(float(part[times].max(initial=0.0)) for part in (in_x, in_u)) <= CONDITION_TOLERANCE
