"""The section DUAL of a proof for one mode: multipliers, and a point z_t of every stage."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.proof.adjoint import Recursion, steered
from lin_freq_ocp.proof.multipliers import DualPoint, dual_point
from lin_freq_ocp.proof.slopes import exact_slopes
from lin_freq_ocp.proof.lines import Text, exact, line, rows
from lin_freq_ocp.proof.terms import multiplier_lines

DRIFT = 1e-6  # of the adjoint by the recursion, relative to its size, above which the file gives the adjoint itself


@dataclass(frozen=True, eq=False)
class Dual:
    """Multipliers with mu_T as it stands in the file, and whether the file gives the adjoint at every time."""

    problem: OptimalControlProblem
    point: DualPoint
    end: Text  # mu_T
    adjoint: bool

    def lines(self) -> Iterator[str]:
        """Yield the sections NODES, of one node, and DUAL."""
        problem, point, n = self.problem, self.point, self.problem.state_dim
        yield line(section="nodes", reach=False)
        yield line(node=0, parent=None, t=0, modes=[0])
        yield line(section="dual", node=0, cost=int(point.normal))
        yield from signal_lines(0, point.state_signal[: problem.state_samples])
        yield from signal_lines(n, point.control_signal)
        yield from multiplier_lines(problem.terms, point.weights)
        yield line(t=problem.horizon, z=point.x[-1], mu=self.end)
        stages = rows(np.hstack([point.x[:-1], point.u])[::-1])
        for t, z in zip(range(problem.horizon - 1, -1, -1), stages, strict=True):
            of_bounds = {"mu": point.mu[t]} if t and point.mu[t].any() else {}
            adjoint = {"eta": point.eta[t - 1]} if t and self.adjoint else {}
            yield line(t=t, z=z, **of_bounds, **adjoint)


def signal_lines(first: int, signals: Array) -> Iterator[str]:
    """Yield the multipliers of removed bins of components, the first of which is ``first`` of (x, u)."""
    for i in np.flatnonzero(signals.any(axis=0)).tolist():
        yield line(signal=first + i, values=signals[:, i])


def dual_of(problem: OptimalControlProblem, at: Trajectory, multipliers: Multipliers) -> Dual:
    """Return the dual of multipliers, in the precision of balls; terms stand at their frequencies."""
    point = dual_point(problem, at, multipliers)
    free = np.flatnonzero(problem.state_tube.fixed[-1])
    moved, eta = steered(Recursion(problem.linear.A, exact_slopes(problem, point)), point.eta, free)
    end = [point.mu[-1, i].hex() for i in range(problem.state_dim)]
    for i, change in zip(free.tolist(), moved, strict=True):
        mantissa, exponent = (change + float(point.mu[-1, i])).mid().man_exp()
        end[i] = exact(int(mantissa), int(exponent))
    drift = np.abs(eta - point.eta).max(axis=0) > DRIFT * np.abs(point.eta).max(axis=0)
    return Dual(problem, point, Text(json.dumps(end)), bool(drift.any()) and _charged(problem, point.normal))


def _charged(problem: OptimalControlProblem, normal: bool) -> bool:
    """Whether a slope in any state costs something finite: by its bounds or its curvature."""
    tube, cost, n = problem.state_tube, problem.quadratic, problem.state_dim
    bounded = np.isfinite(tube.lower) & np.isfinite(tube.upper)
    curved = np.broadcast_to(cost.stage_hessians().diagonal(axis1=1, axis2=2)[:, :n] > 0, bounded[:-1].shape)
    return bool((bounded | (normal & np.vstack([curved, np.diagonal(cost.P) > 0]))).all())
