"""The trajectory of given controls, and how far controls reach, by the dynamics alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Mask, brief, one_component, real_array, seal, stack_signals
from lin_freq_ocp.base.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory

INFINITE = 1e100  # replaces infinity, so that its product with zero is zero
POWER_BLOCK = 1024  # powers of A that are kept at a time


def simulate(problem: OptimalControlProblem, u: ArrayLike, initial_state: ArrayLike | None = None) -> Trajectory:
    """Return the trajectory of the controls u from the initial state, by the dynamics alone.

    Parameters
    ----------
    problem : OptimalControlProblem
        Its sets and bands play no part.
    u : (T, m)
        Controls.
    initial_state : (n,), optional
        Default: the problem's, which must then be a point.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If a shape is wrong or there is no single initial state.
    NumericalError
        If the state overflows, or leaves the regions of all modes.

    Examples
    --------
    >>> problem = lfo.library.double_integrator(horizon=3)
    >>> lfo.simulate(problem, [[1.0], [0.0], [0.0]], [0.0, 0.0]).x.shape
    (4, 2)
    """
    require_problem(problem)
    u = real_array("u", u)
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    if u.shape != (T, m):
        raise ProblemError("u", f"shape {u.shape}", f"shape {(T, m)}", "Time is axis 0.")
    response = problem.response
    if response is not None:
        if initial_state is not None:
            advice = "All outputs follow from the controls."
            raise ProblemError("initial_state", brief(initial_state), "None for a FrequencyResponse", advice)
        return Trajectory(response.states(u), u)
    if initial_state is None:
        if not problem.initial_box.fixed.all():
            got = "None, for a problem whose initial state is not one point"
            raise ProblemError("initial_state", got, "a state to start from")
        initial_state = problem.initial_box.lower
    start = one_component(real_array("initial_state", initial_state), n)
    if start.shape != (n,):
        raise ProblemError("initial_state", f"shape {start.shape}", f"shape {(n,)}")
    x, step = np.empty((T + 1, n)), problem.form.stepper(T)
    x[0] = start
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(T):
            x[t + 1] = step(t, x[t], u[t])
    if not np.isfinite(x).all():
        t = int(np.argmin(np.isfinite(x).all(axis=1)))
        text = f"The open-loop state overflows at t = {t}: these dynamics cannot be simulated over {T} steps."
        raise NumericalError(text)
    return Trajectory(x, u)


@lru_cache(maxsize=2)  # sizes, scales and origins of one problem ask for it
def reach_of_bounds(problem: OptimalControlProblem) -> Array:
    """Return how far apart bounds and dynamics let x_t and u_t of two trajectories lie, (T+1, n + m).

    INFINITE stands for any distance. Of smooth modes, the bounds alone count.
    """
    states, controls = problem.state_tube, problem.control_tube
    of_x, of_u = states.upper - states.lower, np.minimum(controls.upper - controls.lower, INFINITE)
    if _is_recursion_without_modes(problem):  # nan where powers of A overflow
        of_x = np.fmin(of_x, _reach_of_states(problem.linear, of_x[0].tobytes(), controls))
    elif problem.response is None and problem.form.affine:
        of_x = np.minimum(of_x, 2 * _largest_states(problem))
    return seal(np.minimum(stack_signals(of_x, of_u), INFINITE))


def within_reach(problem: OptimalControlProblem, x: Array) -> Array:
    """Return x, (n,) or (T+1, n), as (T+1, n); of a state that cannot be there at any time, the nearest it can be."""
    given, nearest = np.broadcast_to(x, (problem.horizon + 1, problem.state_dim)), nearest_in_reach(problem, x)
    return np.where((nearest == given).any(axis=0), given, nearest)


def nearest_in_reach(problem: OptimalControlProblem, x: Array) -> Array:
    """Return the states, (T+1, n), nearest to x, (n,) or (T+1, n), that bounds and affine dynamics leave."""
    low, high = problem.state_tube.bounds
    with np.errstate(over="ignore", invalid="ignore"):  # nan where powers of A overflow
        if _is_recursion_without_modes(problem):
            box = problem.initial_box
            start = np.where(box.fixed, box.lower, box.project(np.zeros_like(box.lower)))
            motion = problem.state_tube.project(motions_at_rest(problem, start)[-1])
            centre = np.where(np.abs(motion) < INFINITE, motion, np.nan)
            far = reach_of_bounds(problem)[:, : problem.state_dim]
            low, high = np.fmax(low, centre - far), np.fmin(high, centre + far)
        elif problem.response is None and problem.form.affine:
            largest = _largest_states(problem)
            low, high = np.fmax(low, -largest), np.fmin(high, largest)
        return np.clip(x, low, high)


def _is_recursion_without_modes(problem: OptimalControlProblem) -> bool:
    return problem.response is None and problem.form.affine and not problem.mode_names


@lru_cache(maxsize=4)  # for the steps of a loop
def _reach_of_states(dynamics: LinearDynamics, at_start: bytes, controls: Box) -> Array:
    of_u, first = np.minimum(controls.upper - controls.lower, INFINITE), np.minimum(np.frombuffer(at_start), INFINITE)
    if dynamics.time_varying:
        return growth([dynamics.magnitudes.at(t)[:2] for t in range(len(of_u))], first, of_u, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        return constant_radii(dynamics, first, np.append(of_u.max(axis=0), np.zeros(len(first))), len(of_u))


@lru_cache(maxsize=4)
def _largest_states(problem: OptimalControlProblem) -> Array:
    boxes = problem.initial_box, problem.control_tube
    start, controls = (np.minimum(np.abs(box.bounds).max(axis=0), INFINITE) for box in boxes)
    A, B, offset = problem.form.gains()
    return growth([(A, B)] * problem.horizon, start, controls, offset)


def growth(
    gains: Sequence[tuple[Array | Mask, Array | Mask]], first: Array | Mask, of_u: Array | Mask, offset: Array | float
) -> Array:
    """Return the sizes of states, (T+1, n), from that of the first, (n,), those of controls, (T, m), and |A|, |B|."""
    sizes = [first]
    for t, (A, B) in enumerate(gains):
        sizes.append(np.minimum(A @ sizes[t] + B @ of_u[t] + offset, INFINITE))
    return np.array(sizes, dtype=np.float64)


def motions_at_rest(problem: OptimalControlProblem, start: Array) -> list[Array]:
    """Return the states that stay at the start, (..., n), and those of controls at their references, (..., T+1, n)."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    held = np.broadcast_to(start[..., None, :], (*start.shape[:-1], T + 1, n))
    if not _is_recursion_without_modes(problem):
        return [held]
    form = problem.linear
    u = problem.control_tube.project(np.broadcast_to(problem.quadratic.u_ref, (T, m)))
    inputs = form.successors(np.zeros((T, n)), u)
    with np.errstate(over="ignore", invalid="ignore"):
        if not form.time_varying:
            return [held, _constant_motion(form.A, inputs, start)]
        moved = [start]
        for t, pushed in enumerate(inputs):
            moved.append(moved[t] @ form.at(t)[0].T + pushed)
    return [held, np.stack(moved, axis=-2)]


def _constant_motion(A: Array, inputs: Array, start: Array) -> Array:
    """Return x_t of x_{t+1} = A x_t + w_t, (..., T+1, n), from x_0 (..., n): blocks of sqrt(T) steps side by side."""
    T, n = inputs.shape
    steps = math.isqrt(T) + 1
    blocks = T // steps + 1
    parts = np.vstack([inputs, np.zeros((blocks * steps - T, n))]).reshape(blocks, steps, n)
    powers, from_zero, starts = [np.eye(n)], [np.zeros((blocks, n))], [start]
    for k in range(steps):
        powers.append(A @ powers[k])
        from_zero.append(from_zero[k] @ A.T + parts[:, k])
    for block in range(blocks - 1):
        starts.append(starts[block] @ powers[steps].T + from_zero[steps][block])
    free = np.einsum("kij,...bj->...bki", np.array(powers[:steps]), np.stack(starts, axis=-2))
    moved = free + np.stack(from_zero[:steps], axis=1)
    return moved.reshape(*start.shape[:-1], blocks * steps, n)[..., : T + 1, :]


def constant_radii(dynamics: LinearDynamics, radius_0: Array, largest: Array, T: int) -> Array:
    """Return the radii of x_t, (T+1, n), from those of x_0, (n,), and of u and offsets at all times, (m + n,).

    For constant dynamics, by blocks of powers of A. For k starts and inputs, (n, k) and (m + n, k): (T+1, n, k).
    """
    A, B, _ = dynamics.at(0)
    n, count = len(A), min(POWER_BLOCK, T + 1)
    powers = np.eye(n)[None]
    while len(powers) < count:
        powers = np.concatenate([powers, powers[: count - len(powers)] @ (A @ powers[-1])])
    inputs, whole, first = np.hstack([B, np.eye(n)]), A @ powers[-1], np.eye(n)
    of_inputs, of_start = np.empty((T + 1, *radius_0.shape)), np.empty((T + 1, *radius_0.shape))
    for start in range(0, T + 1, count):
        block = powers[: T + 1 - start] @ first
        of_start[start : start + count] = np.abs(block) @ radius_0
        of_inputs[start : start + count] = np.abs(block @ inputs) @ largest
        first = whole @ first
    return np.concatenate([np.zeros((1, *radius_0.shape)), np.cumsum(of_inputs[:-1], axis=0)]) + of_start
