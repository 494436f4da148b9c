"""Multipliers of a proof: exactly in the domain of the conjugates, with the points z_t at which stages are bounded.

A checker wants lambda in the domain without any tolerance: what a price limits is made smaller by a few roundings, and
multipliers of a cone are moved into the dual one. mu_t is kept where z_t can be put on the bound that it belongs to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, StandardCone
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

SHRINK = 1 - 2.0**-48  # of multipliers that a price limits: their norm is rounded in the last few bits
NEAR = 1e-6  # distance from a bound, relative to the component's size, up to which a curved component is on it


@dataclass(frozen=True, eq=False)
class DualPoint:
    """z_t, mu_t and the multipliers of terms by their index, which need not be what the solver found."""

    x: Array  # z_t, (T+1, n)
    u: Array  # (T, m)
    mu: Array  # (T+1, n)
    eta: Array  # (T, n)
    normal: bool  # whether the cost counts
    state_signal: Array  # of removed bins, (T+1, n)
    control_signal: Array  # (T, m)
    weights: list[Array]  # of each term, (groups, dim)


def dual_point(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> DualPoint:
    """Return what a proof says of multipliers; the terms of the problem stand at their frequencies."""
    n = problem.state_dim
    curved = multipliers.eta_C * problem.quadratic.stage_hessians().diagonal(axis1=1, axis2=2) > 0  # (1 or T, n + m)
    at_end = multipliers.eta_C * np.diagonal(problem.quadratic.P) > 0
    in_x = np.vstack([np.broadcast_to(curved[:, :n], (problem.horizon, n)), at_end])
    x, mu = on_bounds(problem.state_tube, trajectory.x, multipliers.mu, in_x)
    u, _ = on_bounds(problem.control_tube, trajectory.u, multipliers.nu, curved[:, n:])
    weights = [
        inside(term, multipliers.stage.get(term.name, np.zeros(term.shape)), multipliers.eta_C)
        for term in problem.terms
    ]
    signals = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, problem.horizon)
    return DualPoint(x, u, mu, multipliers.eta, multipliers.eta_C > 0, *signals, weights)


def on_bounds(tube: Box, signal: Array, normals: Array, curved: Mask) -> tuple[Array, Array]:
    """Return a signal on its bounds where normals say so, and the normals that remain, both (times, size).

    A component without curvature may be moved to any bound at no loss.
    """
    size = np.abs(signal).max(axis=0, initial=0.0)
    found, kept = tube.project(signal), np.where(tube.fixed, normals, 0.0)
    for bound, pressed in ((tube.upper, normals > 0), (tube.lower, normals < 0)):
        finite = np.where(np.isfinite(bound), bound, signal)
        here = pressed & np.isfinite(bound) & (~curved | (np.abs(finite - signal) <= NEAR * size))
        found, kept = np.where(here, finite, found), np.where(here, normals, kept)
    return found, kept


def inside(term: Term, given: Array, eta_C: float) -> Array:
    """Return the nearest multipliers that are certainly in the domain of the conjugate of eta_C h, (groups, dim)."""
    return shrunk(term.penalty, term.penalty.subgradient(given, eta_C))


@singledispatch
def shrunk(penalty: Penalty, weights: Array) -> Array:
    """Return multipliers in the domain of the conjugate that are so for any rounding of their norms."""
    return np.where(np.isfinite(penalty.weights), SHRINK, 1.0) * weights


@shrunk.register
def _exactly(penalty: HalfSpaces, weights: Array) -> Array:
    return weights


@shrunk.register
def _within_cone(penalty: StandardCone, weights: Array) -> Array:
    return np.column_stack([weights[:, 0], SHRINK * weights[:, 1:]])
