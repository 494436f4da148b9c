"""The KKT system of a step: the rows as the embedding sees them, and their reduction to stages with coupling rows.

The rows b - A y in a cone are a list of arrays: dynamics x_{t+1} - A_t x_t - B_t w_t (T+1, n), the last zero; x_0 (n,);
stages G y (T+1, p); equations, those of x_T first, flat; inequalities (rows, 1); -(head, values) (balls, 1 + d) for
each family of balls. One step solves, refined,

    [P A'; A -W^2] (y, z) = (r_y, r_z).

Stage cones are eliminated, Phi = H + G'W^-2 G, and so are the constant heads of hard balls. A KKT solver then solves

    Phi y + gradient + (dynamics)'eta + (x_0 rows)'lam0 + F'nu = 0
    x_{t+1} - A x_t - B w_t = c_t,   x_0 = x0 where it is fixed,   F y - C nu = f

F are all coupling rows in the order of ``Coupling``: x_T, equations, inequalities, balls (each with its head in front
if it is soft). C > 0 is block diagonal: tiny for equations, squares of scalings for the others.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, times_vectors
from lin_freq_ocp.base.cones import Cone
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.stages import Stages

DYNAMICS, INITIAL, STAGES, EQUATIONS, INEQUALITIES, BALLS = range(6)
Values = list[Array]
REFINEMENTS = 3  # at most; each halves the number of wrong digits, or is rejected
REGULARISATION = 1e-9  # of the Hessian, in units of order 1; refinement corrects for it wherever there is curvature
DUAL_REGULARISATION = 1e-12  # compliance of equations, which may depend on each other or on no variable
REFINED = 1e-8  # residual, relative to the right-hand side, from which a solution is refined


class System:
    """The operators of one problem, and the cones of its rows by their index in the list."""

    def __init__(self, stages: Stages, loops: Loops):
        self.loops, coupling, fixed, present = loops, stages.coupling, stages.fixed, stages.present
        self.coupling, self._fixed = coupling, fixed
        limits = [part.limits for part in coupling.inequalities]
        self.b: Values = [
            stages.d,
            np.where(fixed, stages.initial, 0.0),
            stages.g,
            np.concatenate([coupling.terminal_state, *(part.right for part in coupling.equations)]),
            np.concatenate([np.zeros(0), *limits])[:, None],
            *(part.right for part in coupling.balls),
        ]
        self.cones = {STAGES: Cone(present, stages.cones)}
        if coupling.inequalities:
            self.cones[INEQUALITIES] = Cone(np.ones(self.b[INEQUALITIES].shape, dtype=bool), ())
        for i, part in enumerate(coupling.balls):
            shape = len(part.radius), 1 + part.dim
            self.cones[BALLS + i] = Cone(np.ones(shape, dtype=bool), (1 + part.dim,))
        self._set_stages(stages)

    def _set_stages(self, stages: Stages) -> None:
        present = self.cones[STAGES].present
        self.stages, self._AB = stages, np.concatenate([stages.A, stages.B], axis=2)
        self._G = stages.G * present[:, :, None]
        self.b = [stages.d, self.b[INITIAL], np.where(present, stages.g, 0.0), *self.b[EQUATIONS:]]

    def exchanged(self, stages: Stages) -> System:
        """Return the operators of stages with other numbers; the cones, with their scalings, are the same objects."""
        other = copy(self)
        other._set_stages(stages)
        return other

    def rows(self, y: Array) -> Values:
        """Return A y."""
        n = self.stages.states
        dynamics = -times_vectors(self._AB, y)
        dynamics[:-1] += y[1:, :n]
        of_stages = times_vectors(self._G, y)
        return [dynamics, np.where(self._fixed, y[0, :n], 0.0), of_stages, *self.coupled(y)]

    def coupled(self, y: Array) -> Values:
        """Return the rows of A y that couple times."""
        values, coupling = self.stages.coupled.values(y), self.coupling
        first = coupling.equation_count
        last = first + sum(part.rows.count for part in coupling.inequalities)
        coupled: Values = [values[:first], values[first:last, None]]
        for part in coupling.balls:
            balls, heads = len(part.radius), part.heads is not None
            rows, first = np.zeros((balls, 1 + part.dim)), last
            last += balls * (part.dim + heads)
            rows[:, 1 - heads :] = -values[first:last].reshape(balls, -1)
            coupled.append(rows)
        return coupled

    def adjoint(self, z: Values) -> Array:
        """Return A'z, (T+1, n + k)."""
        n, eta = self.stages.states, z[DYNAMICS]
        result = times_vectors(self._G.swapaxes(1, 2), z[STAGES])
        result -= times_vectors(self._AB.swapaxes(1, 2), eta)
        result[1:, :n] += eta[:-1]
        result[0, :n] += np.where(self._fixed, z[INITIAL], 0.0)
        if self.coupling.count:
            nu = [z[EQUATIONS], z[INEQUALITIES][:, 0]]
            for part, rows in zip(self.coupling.balls, z[BALLS:], strict=True):
                nu.append(-rows[:, 0 if part.heads is not None else 1 :].ravel())
            self.stages.coupled.add_adjoint(np.concatenate(nu), result)
        return result

    def curvature(self, y: Array) -> Array:
        """Return P y."""
        return times_vectors(self.stages.H, y)


@dataclass(frozen=True, eq=False)
class Compliance:
    """C: (count,) for all equations and inequalities, and (balls, d, d) for every family of balls.

    ``roots``, (balls, d, d) for every family of hard balls, are R with R'R = C^-1, which inverting C would lose near
    the boundary.
    """

    rows: Array
    balls: tuple[Array, ...]
    roots: tuple[Array, ...] = ()

    def add_to(self, S: Array, chosen: Indices | None = None) -> None:
        """Add C to the last rows of S: those of ``rows`` that are chosen, or all, and those of the balls."""
        rows = self.rows if chosen is None else self.rows[chosen]
        first = len(S) - len(rows) - sum(len(part) * part.shape[1] for part in self.balls)
        for blocks in (rows[:, None, None], *self.balls):
            count, d = blocks.shape[:2]
            at = first + np.arange(count * d).reshape(count, d)
            S[at[:, :, None], at[:, None, :]] += blocks
            first += count * d


class SystemSolution(NamedTuple):
    """The solution of the system."""

    y: Array  # (T+1, n + k)
    eta: Array  # (T+1, n), the last zero
    initial: Array  # lam0, (n,)
    coupling: Array  # nu, (rows,)


class KKTSolver(Protocol):
    """A way to solve the system, up to rounding and the tolerance of an iteration, which ``StepSystem`` refines."""

    indefinite: ClassVar[bool]
    """Whether Phi may be indefinite on the dynamics: ``factor`` then says whether the rows make the problem convex."""

    def exchanged(self, stages: Stages) -> KKTSolver:
        """Return the solver for stages with other dynamics and Hessians."""
        ...

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Factor for Phi (T+1, n+k, n+k) and C; return False if the problem is seen not to be convex."""
        ...

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> SystemSolution:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        ...


class StepSystem:
    """The system of a step at the scalings of the cones; call ``factor`` before ``solve``.

    ``compliance`` is what a unit of the multiplier of each equation leaves of its residual: steps stay short where
    equations depend on each other and contradict each other to first order.
    """

    def __init__(self, system: System, solver: KKTSolver, compliance: Array | float = 0.0):
        self.system, self._solver, self._loops, self._compliance = system, solver, system.loops, compliance

    def factor(self) -> bool:
        """Factor at the present scalings; return the answer of the KKT solver on convexity."""
        system, stages = self.system, self.system.stages
        Phi = self._loops.gram(stages.H, stages.G, *system.cones[STAGES].inverse_squares, stages.cones)
        np.einsum("tii->ti", Phi)[:] += REGULARISATION
        balls = list(zip(system.coupling.balls, self._ball_cones(), strict=True))
        squares = [cone.tail_square if part.heads is None else cone.block_squares(0) for part, cone in balls]
        roots = [cone.tail_inverse_root for part, cone in balls if part.heads is None]
        unequal = system.cones[INEQUALITIES].w[:, 0] ** 2 if INEQUALITIES in system.cones else np.zeros(0)
        equations = np.full(system.coupling.equation_count, DUAL_REGULARISATION + self._compliance)
        return self._solver.factor(Phi, Compliance(np.concatenate([equations, unequal]), tuple(squares), tuple(roots)))

    def solve(self, of_y: Array, of_z: Values, refined: bool = True) -> tuple[Array, Values]:
        """Return (y, z), by default refined as long as the residual falls."""
        y, z = self._solve_once(of_y, of_z)
        if not refined:
            return y, z
        target = REFINED * largest([of_y, *of_z])
        residual = self._residual(of_y, of_z, y, z)
        error = largest([residual[0], *residual[1]])
        for _ in range(REFINEMENTS):
            if error <= target:
                break
            dy, dz = self._solve_once(*residual)
            better = y + dy, [a + b for a, b in zip(z, dz, strict=True)]
            residual = self._residual(of_y, of_z, *better)
            after = largest([residual[0], *residual[1]])
            if not after < error:
                break
            (y, z), error = better, after
        return y, z

    def _solve_once(self, of_y: Array, of_z: Values) -> tuple[Array, Values]:
        system, stages = self.system, self.system.stages
        cone = system.cones[STAGES]
        gradient = -of_y - times_vectors(stages.G.swapaxes(1, 2), cone.scaled(of_z[STAGES], -2))
        f = [of_z[EQUATIONS], of_z[INEQUALITIES][:, 0]]
        for part, ball_cone, rows in zip(system.coupling.balls, self._ball_cones(), of_z[BALLS:], strict=True):
            right = -rows
            if part.heads is None:
                right = right[:, 1:] + ball_cone.head_ratio * rows[:, :1]
            f.append(right.ravel())
        step = self._solver.solve(gradient, of_z[DYNAMICS], of_z[INITIAL], np.concatenate(f))
        of_stages = cone.scaled(times_vectors(stages.G, step.y) - of_z[STAGES], -2)
        # the duals of all rows that couple times, with those of the eliminated heads of hard balls
        counts = [len(of_z[EQUATIONS]), len(of_z[INEQUALITIES])]
        equations, unequal, rest = np.split(step.coupling, np.cumsum(counts))
        duals: Values = [step.eta, step.initial, of_stages, equations, unequal[:, None]]
        for part, ball_cone, rows in zip(system.coupling.balls, self._ball_cones(), of_z[BALLS:], strict=True):
            dim = part.dim + (part.heads is not None)
            values, rest = np.split(rest, [len(part.radius) * dim])
            z = -values.reshape(-1, dim)
            if part.heads is None:
                w, eta = ball_cone.w, ball_cone.eta[:, 0]
                head = -rows[:, 0] / (eta**2 * (2 * w[:, 0] ** 2 - 1)) - (ball_cone.head_ratio * z).sum(1)
                z = np.column_stack([head, z])
            duals.append(z)
        return step.y, duals

    def _residual(self, of_y: Array, of_z: Values, y: Array, z: Values) -> tuple[Array, Values]:
        system = self.system
        residual = [right - rows for right, rows in zip(of_z, system.rows(y), strict=True)]
        residual[EQUATIONS] += self._compliance * z[EQUATIONS]
        for i, cone in system.cones.items():
            residual[i] += cone.scaled(z[i], 2)
        return of_y - system.curvature(y) - system.adjoint(z), residual

    def _ball_cones(self) -> list[Cone]:
        return [self.system.cones[BALLS + i] for i in range(len(self.system.coupling.balls))]


def largest(parts: Values) -> float:
    """Return the largest absolute entry; inf if an entry is not finite."""
    sizes = [float(np.abs(part).max(initial=0.0)) for part in parts]
    return max(sizes, default=0.0) if math.isfinite(sum(sizes)) else np.inf
