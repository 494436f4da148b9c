"""The linear system of one step, [P A'; A -W^2] (y, z) = (r_y, r_z), reduced to the system of a side, and refined.

Of a hard ball, the head is constant: its row is eliminated, and leaves on the values the compliance
eta^2 (I - 2 v v'/(1 + 2 |v|^2)), w = (w_0, v), which would lose its definiteness if it were computed by subtraction.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Side
from lin_freq_ocp.methods.structured.kkt.system import (
    BALLS,
    DYNAMICS,
    EQUATIONS,
    INEQUALITIES,
    INITIAL,
    STAGES,
    System,
    Values,
)
from lin_freq_ocp.methods.structured.model.cones import Cone

REFINEMENTS = 3  # at most; each halves the digits that are missing, or is not taken
REGULARISATION = 1e-9  # of the Hessian, in units of order 1; refinement takes it back where anything else curves
DUAL_REGULARISATION = 1e-12  # compliance of equations, for those that nothing can change or that repeat others
REFINED = 1e-8  # residual, relative to the right-hand side, that is not refined


class StepSystem:
    """The system of a step at the scalings of the cones; ``factor`` it before ``solve``."""

    def __init__(self, system: System, side: Side):
        self.system, self._side, self._loops = system, side, system.loops

    def factor(self) -> bool:
        """Factor at the present scalings; return what the side says of convexity."""
        system, stages = self.system, self.system.stages
        Phi = self._loops.gram(stages.H, stages.G, *system.cones[STAGES].inverse_squares, stages.cones)
        diagonal = np.arange(Phi.shape[1])
        Phi[:, diagonal, diagonal] += REGULARISATION
        balls = list(zip(system.coupling.balls, self._ball_cones(), strict=True))
        squares = [_of_values(cone) if part.heads is None else cone.block_squares(0) for part, cone in balls]
        roots = [_root_of_values(cone) for part, cone in balls if part.heads is None]
        unequal = system.cones[INEQUALITIES].w[:, 0] ** 2 if INEQUALITIES in system.cones else np.zeros(0)
        equations = np.full(system.coupling.equation_count, DUAL_REGULARISATION)
        return self._side.factor(Phi, Compliance(np.concatenate([equations, unequal]), tuple(squares), tuple(roots)))

    def solve(self, of_y: Array, of_z: Values, refined: bool = True) -> tuple[Array, Values]:
        """Return (y, z), by default refined as long as the residual falls."""
        y, z = self._once(of_y, of_z)
        if not refined:
            return y, z
        target = REFINED * largest([of_y, *of_z])
        left = self._residual(of_y, of_z, y, z)
        error = largest([left[0], *left[1]])
        for _ in range(REFINEMENTS):
            if error <= target:
                break
            dy, dz = self._once(*left)
            better = y + dy, [a + b for a, b in zip(z, dz, strict=True)]
            left = self._residual(of_y, of_z, *better)
            after = largest([left[0], *left[1]])
            if not after < error:
                break
            (y, z), error = better, after
        return y, z

    def _once(self, of_y: Array, of_z: Values) -> tuple[Array, Values]:
        system, stages = self.system, self.system.stages
        cone = system.cones[STAGES]
        gradient = -of_y - self._loops.transposed_times(stages.G, cone.scaled(of_z[STAGES], -2))
        f = [of_z[EQUATIONS], of_z[INEQUALITIES][:, 0]]
        for part, own, rows in zip(system.coupling.balls, self._ball_cones(), of_z[BALLS:], strict=True):
            right = -rows
            if part.heads is None:
                right = right[:, 1:] + _head_ratio(own) * rows[:, :1]
            f.append(right.ravel())
        step = self._side.solve(gradient, of_z[DYNAMICS], of_z[INITIAL], np.concatenate(f))
        of_stages = cone.scaled(self._loops.times(stages.G, step.y) - of_z[STAGES], -2)
        return step.y, [step.eta, step.initial, of_stages, *self._multipliers(step.coupling, of_z)]

    def _multipliers(self, nu: Array, of_z: Values) -> Values:
        """Return the duals of all rows that couple times from those of the reduced system."""
        counts = [len(of_z[EQUATIONS]), len(of_z[INEQUALITIES])]
        equations, unequal, rest = np.split(nu, np.cumsum(counts))
        found: Values = [equations, unequal[:, None]]
        for part, own, rows in zip(self.system.coupling.balls, self._ball_cones(), of_z[BALLS:], strict=True):
            dim = part.dim + (part.heads is not None)
            values, rest = np.split(rest, [len(part.radius) * dim])
            z = -values.reshape(-1, dim)
            if part.heads is None:
                w, eta = own.w, own.eta[:, 0]
                head = -rows[:, 0] / (eta**2 * (2 * w[:, 0] ** 2 - 1)) - (_head_ratio(own) * z).sum(1)
                z = np.column_stack([head, z])
            found.append(z)
        return found

    def _residual(self, of_y: Array, of_z: Values, y: Array, z: Values) -> tuple[Array, Values]:
        system = self.system
        left = [right - rows for right, rows in zip(of_z, system.rows(y), strict=True)]
        for i, cone in system.cones.items():
            left[i] += cone.scaled(z[i], 2)
        return of_y - system.curvature(y) - system.adjoint(z), left

    def _ball_cones(self) -> list[Cone]:
        return [self.system.cones[BALLS + i] for i in range(len(self.system.coupling.balls))]


def largest(parts: Values) -> float:
    """Return the largest absolute entry; inf if one is not finite."""
    found = max((float(np.abs(part).max(initial=0.0)) for part in parts), default=0.0)
    return found if np.isfinite(found) else np.inf


def _of_values(cone: Cone) -> Array:
    """Return the compliance of the values of hard balls, (balls, d, d)."""
    v, square = cone.w[:, 1:], cone.eta[:, 0, None, None] ** 2
    return square * (np.eye(v.shape[1]) - (2 / (1 + 2 * (v * v).sum(1)))[:, None, None] * v[:, :, None] * v[:, None, :])


def _root_of_values(cone: Cone) -> Array:
    """Return the symmetric root of its inverse, (I + 2 v v')^(1/2)/eta."""
    v = cone.w[:, 1:]
    along = 2 / (1 + np.sqrt(1 + 2 * (v * v).sum(1)))
    return (np.eye(v.shape[1]) + along[:, None, None] * v[:, :, None] * v[:, None, :]) / cone.eta[:, 0, None, None]


def _head_ratio(cone: Cone) -> Array:
    """Return the entries of W^2 beside its first one, divided by that, (balls, d)."""
    head, v = cone.w[:, :1], cone.w[:, 1:]
    return 2 * head * v / (2 * head**2 - 1)
