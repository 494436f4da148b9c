"""The conditions of a problem with piecewise-smooth dynamics: those of its linearisation along the trajectory.

To first order at a trajectory the problem is one with affine modes (``OptimalControlProblem.affine_at``), and the
conditions of the maximum principle, all of first order, are the same. Where the arguments q of a norm are zero, its
derivative may be any xi' Dq with |xi| <= 1: one selection xi for states and controls alike, the nearest to what the
adjoint equation and stationarity in u require. With c the derivative of <eta_t, f_t> by the norm, -<eta_t, f_t> is
regular there iff c <= 0; with c > 0 the printed form has no solution, and a step away from the kink raises H.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.certificate.conditions import CONDITION_TOLERANCE, Condition
from lin_freq_ocp.certificate.hamiltonian import extremal_at
from lin_freq_ocp.certificate.modes.clarke import NormKink, SwitchingFacts, required_slopes, stationarity_scale
from lin_freq_ocp.certificate.modes.conditions import judge_modes
from lin_freq_ocp.certificate.scales import floors
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.text import text_of
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


def judge_smooth(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> tuple[tuple[Condition, ...], SwitchingFacts, float]:
    """Return the conditions of a trajectory of smooth pieces, the facts about kinks, and what residuals are worth."""
    problem.require(trajectory)
    selections, kinks = _selections(problem, trajectory, multipliers)
    conditions, facts, worth = judge_modes(problem.affine_at(trajectory, selections), trajectory, multipliers)
    rising = any(kink.rate > 0 for kink in kinks)
    facts = replace(
        facts,
        norms=kinks,
        flip_stationary=facts.flip_stationary and not rising,
        printed=facts.printed and not rising,
        regular=facts.regular and not rising,
    )
    return conditions, facts, worth


def _selections(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> tuple[dict[Formula, Array], tuple[NormKink, ...]]:
    """Return the selection of every norm at the times at which its arguments are zero, not a number elsewhere."""
    found: dict[Formula, Array] = {}
    kinks: list[NormKink] = []
    dynamics = problem.smooth_pieces
    labels = [name.split(" [")[0] for name in (*problem.state_names, *problem.control_names)]
    for one, at_zero in dynamics.at_zero(trajectory.x, trajectory.u).items():
        count = len(one.arguments)
        selection = np.full((problem.horizon, count), np.nan)
        found[one] = selection
        if not at_zero.any():
            continue
        selection[at_zero] = 0.0
        linear = problem.affine_at(trajectory, found)
        sequence = linear.piecewise.sequence_of(trajectory.x, trajectory.u)
        extremal = extremal_at(replace(linear, dynamics=linear.piecewise.along(sequence)), trajectory, multipliers)
        least = floors(extremal, trajectory_sizes(linear, trajectory))
        scale, required = stationarity_scale(extremal, least), required_slopes(extremal)
        slopes = np.stack([_slopes(problem, trajectory, multipliers, found, one, at_zero, j) for j in range(-1, count)])
        for t in np.flatnonzero(at_zero):
            columns, missing = ((slopes[1:, t] - slopes[0, t]) / scale).T, (required[t] - slopes[0, t]) / scale
            selection[t] = nearest_in_ball(columns, missing)
            here = np.append(trajectory.x[t], trajectory.u[t])
            pull = dynamics.pull_of_norm(one, here, int(sequence[t]), multipliers.eta[t])
            rate = pull if pull > CONDITION_TOLERANCE * float(scale.max()) else min(pull, 0.0)
            kinks.append(NormKink(int(t), text_of(one, labels), tuple(float(part) for part in selection[t]), rate))
    return found, tuple(kinks)


def _slopes(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    selections: Mapping[Formula, Array],
    one: Formula,
    at_zero: Mask,
    component: int,
) -> Array:
    """Return D <eta_t, f_t>, (T, n + m), with the selection of a norm a unit vector, or zero (component -1)."""
    changed = selections[one].copy()
    changed[at_zero] = 0.0
    if component >= 0:
        changed[at_zero, component] = 1.0
    affine = problem.smooth_pieces.affine_at(trajectory.x, trajectory.u, {**selections, one: changed})
    linear = affine.along(affine.sequence_of(trajectory.x, trajectory.u))
    return np.einsum("tij,ti->tj", np.concatenate([linear.A, linear.B], axis=-1), multipliers.eta)


def nearest_in_ball(columns: Array, wanted: Array) -> Array:
    """Return xi with |xi| <= 1 for which columns @ xi is nearest to what is wanted; the shortest of those."""
    from scipy.optimize import brentq  # slow to import

    xi = np.asarray(np.linalg.lstsq(columns, wanted, rcond=1e-12)[0], dtype=np.float64)
    if np.linalg.norm(xi) <= 1:
        return xi
    values, vectors = np.linalg.eigh(columns.T @ columns)
    along = vectors.T @ (columns.T @ wanted)

    def excess(shift: float) -> float:
        return float(np.linalg.norm(along / (values + shift))) - 1

    largest = float(np.linalg.norm(along))  # there the norm is at most 1
    least = 1e-14 * max(float(values[-1]), largest)
    shift = brentq(excess, least, largest) if excess(least) > 0 else least
    return np.asarray(vectors @ (along / (values + shift)), dtype=np.float64)
