"""The conditions of a problem with piecewise-affine dynamics: those of the averaged linear one, and those of its modes.

With weights alpha, the derivative of f_t is sum_i alpha_i (A_i, B_i): Clarke's rule is then the adjoint equation and
stationarity in u of the linear problem with these dynamics, if the sum is a convex one of modes that meet.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.conditions import (
    CONDITION_TOLERANCE,
    Condition,
    all_conditions,
    worst_condition,
    worth_of_residuals,
)
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at
from lin_freq_ocp.certificate.modes.clarke import (
    SwitchingFacts,
    nearest_weights,
    stationarity_scale,
    switching_facts,
    switching_stages,
)
from lin_freq_ocp.certificate.scales import Floors, floors
from lin_freq_ocp.certificate.sizes import measured_modes, trajectory_sizes
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.dynamics.mode_arrays import BORDER_TOLERANCE, ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

OF_BORDERS = ("adjoint equation", "transversality at 0", "Hamiltonian stationary in u", "Hamiltonian maximal in u")
"""Conditions that depend on the weights: at times where only one mode holds they are looked at apart."""


def judge_modes(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> tuple[tuple[Condition, ...], SwitchingFacts, float]:
    """Return the conditions of a trajectory of affine modes, the facts about borders, and what residuals are worth."""
    problem.require(trajectory)
    arrays = measured_modes(problem, trajectory)
    sequence, meeting = arrays.sequence(trajectory.x, trajectory.u), arrays.meeting(trajectory.x, trajectory.u)
    weights = _weights(problem, trajectory, multipliers, arrays, sequence, meeting)
    extremal = extremal_at(_averaged(problem, weights), trajectory, multipliers)
    least = floors(extremal, trajectory_sizes(problem, trajectory))
    own = _state_equation(problem, trajectory, sequence, least)
    linear = [own if one.name == own.name else one for one in all_conditions(extremal, least)]
    added = _mode_holds(arrays, trajectory, sequence), _weights_of_modes(weights, meeting)
    stages = switching_stages(extremal, least, arrays, meeting)
    others = all(one.passed for one in (*linear, added[0]) if one.name not in OF_BORDERS)
    elsewhere = others and _stationary(extremal, least, ~np.isin(np.arange(problem.horizon), [s.time for s in stages]))
    conditions = (*linear, *added)
    joint = all(one.passed for one in conditions)
    facts = switching_facts(problem, trajectory, stages, weights, joint, elsewhere)
    return conditions, facts, worth_of_residuals(extremal)


def _averaged(problem: OptimalControlProblem, weights: Array) -> OptimalControlProblem:
    return replace(problem, dynamics=problem.piecewise.averaged(weights))


def _weights(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    arrays: ModeArrays,
    sequence: Indices,
    meeting: Mask,
) -> Array:
    """Return the weights that were given, or those that fit best, (T, modes)."""
    T, modes = meeting.shape
    if multipliers.weights is not None:
        if multipliers.weights.shape != (T, modes):
            raise ProblemError("multipliers.weights", f"shape {multipliers.weights.shape}", f"shape {(T, modes)}")
        return multipliers.weights
    weights = np.zeros((T, modes))
    weights[np.arange(T), sequence] = 1.0
    extremal = extremal_at(_averaged(problem, weights), trajectory, multipliers)
    for stage in switching_stages(extremal, floors(extremal, trajectory_sizes(problem, trajectory)), arrays, meeting):
        weights[stage.time] = 0.0
        weights[stage.time, stage.modes] = nearest_weights(stage)
    return weights


def _state_equation(
    problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, least: Floors
) -> Condition:
    """C-iii: x_{t+1} = f_t(x_t, u_t), with the mode that holds."""
    x, u = np.abs(trajectory.x), np.abs(trajectory.u)
    dynamics = problem.piecewise.along(sequence)
    terms = x[1:] + dynamics.magnitudes().successors(x, u)
    residual = np.abs(trajectory.x[1:] - dynamics.successors(trajectory.x, trajectory.u))
    return worst_condition("C-iii", "state equation", residual, np.maximum(terms.max(0), least.x))


def _mode_holds(arrays: ModeArrays, trajectory: Trajectory, sequence: Indices) -> Condition:
    """S-f: (x_t, u_t) lies in the region of the mode that leads to x_{t+1}; relative to the terms of its rows."""
    distance = arrays.distance(trajectory.x, trajectory.u)[np.arange(len(sequence)), sequence]
    t = int(np.argmax(distance))
    name = "a mode holds that leads to the next state"
    return Condition("S-f", name, float(distance[t]), 1.0, BORDER_TOLERANCE, t, int(sequence[t]))


def _weights_of_modes(weights: Array, meeting: Mask) -> Condition:
    """N-f: weights are >= 0, 0 for modes that do not meet there, and sum to 1."""
    wrong = np.maximum(-weights, np.where(meeting, 0.0, np.abs(weights)))
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
