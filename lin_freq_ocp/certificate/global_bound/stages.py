"""The stages that value_bound.py works on: their costs, and bounds of states and controls, some by the cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.global_bound.costs import StageCosts
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box

FLAT = 1e-12
"""A direction whose curvature is smaller than this part of the largest is flat, as is a slope relative to all of it."""

WIDER = 1e-6
"""Part by which bounds that follow from the cost are widened: far more than their rounding errors."""


@dataclass(frozen=True, eq=False)
class Stages:
    """A problem with priced costs and bounds: a trajectory that is not within them costs too much or is not feasible.

    Attributes
    ----------
    lower, upper : (T, m)
        Of the controls.
    lowest, highest : (T+1, n)
        Of the states.
    """

    problem: OptimalControlProblem
    costs: StageCosts
    lower: Array
    upper: Array
    lowest: Array
    highest: Array

    @classmethod
    def below(cls, problem: OptimalControlProblem, costs: StageCosts, level: float) -> Stages:
        """Return the stages of trajectories below a level of the cost without its constant."""
        n, states, controls = problem.state_dim, problem.state_tube, problem.control_tube
        forms = [QuadraticForm(*parts) for parts in zip(costs.hessians, costs.linear, strict=True)]
        forms.append(QuadraticForm(costs.terminal_hessian, costs.terminal_linear))
        left = level - sum(form.least for form in forms)
        shadows = [form.shadow(max(left, 0.0) if np.isfinite(left) else np.inf) for form in forms]
        x, u = np.array([shadow[:, :n] for shadow in shadows]), np.array([shadow[:, n:] for shadow in shadows[:-1]])
        return cls(problem, costs, *_meet(controls, u), *_meet(states, x))

    def cost(self, t: int, y: Array) -> Array:
        """Return c_t of pairs (points, n + m)."""
        return 0.5 * np.einsum("pi,ij,pj->p", y, self.costs.hessians[t], y) + y @ self.costs.linear[t]


class QuadraticForm:
    """The quadratic 1/2 y'H y + b'y with H >= 0.

    Attributes
    ----------
    least : float
        Its minimum, or -inf.
    """

    def __init__(self, hessian: Array, linear: Array):
        values, vectors = np.linalg.eigh(hessian)
        curved = values > FLAT * max(float(values[-1]), 0.0)
        along = vectors.T @ linear
        flat = np.abs(along[~curved]).max(initial=0.0) <= FLAT * float(np.abs(linear).max(initial=0.0))
        self._flat_in = np.abs(vectors[:, ~curved]).max(axis=1, initial=0.0) > FLAT
        inverse = vectors[:, curved] / values[curved]
        self._centre, self._inverse = -inverse @ along[curved], (inverse * vectors[:, curved]).sum(axis=1)
        self.least = -0.5 * float((along[curved] ** 2 / values[curved]).sum()) if flat else -np.inf

    def shadow(self, above: float) -> Array:
        """Return bounds of y where the form is ``above`` its least at most, (2, n + m)."""
        if above == np.inf:
            return np.stack([np.full(len(self._centre), -np.inf), np.full(len(self._centre), np.inf)])
        radius = np.sqrt(2 * above * self._inverse)
        radius = np.where(self._flat_in, np.inf, (1 + WIDER) * radius + WIDER * np.abs(self._centre))
        return np.stack([self._centre - radius, self._centre + radius])


def _meet(box: Box, shadow: Array) -> tuple[Array, Array]:
    """Return what is in a box and in shadows (times, 2, .); the nearest of the box where nothing is."""
    lower, upper = np.asarray(box.lower, dtype=float), np.asarray(box.upper, dtype=float)
    return np.clip(shadow[:, 0], lower, upper), np.clip(shadow[:, 1], lower, upper)
