"""The rows of a problem over stages, as the embedding sees them: b - A y in a cone, with the Hessian P.

Rows are a list of arrays: dynamics x_{t+1} - A_t x_t - B_t w_t (T+1, n), the last zero; x_0 (n,); stages G y (T+1, p);
equations, those of x_T first, flat; inequalities (rows, 1); -(head, values) (balls, 1 + d) for each family of balls.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.model.cones import Cone
from lin_freq_ocp.methods.structured.model.stages import Stages

DYNAMICS, INITIAL, STAGES, EQUATIONS, INEQUALITIES, BALLS = range(6)
Values = list[Array]


class System:
    """The operators of one problem, and the cones of its rows by their index."""

    def __init__(self, stages: Stages, loops: Loops):
        self.stages, self.loops, coupling = stages, loops, stages.coupling
        self.coupling = coupling
        present, fixed = stages.present, stages.fixed
        limits = [part.limits for part in coupling.inequalities]
        self.b: Values = [
            stages.d,
            np.where(fixed, stages.initial, 0.0),
            np.where(present, stages.g, 0.0),
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
        self._AB = np.concatenate([stages.A, stages.B], axis=2)
        self._G, self._fixed = stages.G * present[:, :, None], fixed

    def rows(self, y: Array) -> Values:
        """Return A y."""
        n = self.stages.states
        dynamics = -self.loops.times(self._AB, y)
        dynamics[:-1] += y[1:, :n]
        of_stages = self.loops.times(self._G, y)
        return [dynamics, np.where(self._fixed, y[0, :n], 0.0), of_stages, *self.coupled(y)]

    def coupled(self, y: Array) -> Values:
        """Return the rows of A y that couple times."""
        values, coupling = self.stages.coupled.values(y), self.coupling
        first = coupling.equation_count
        last = first + sum(part.rows.count for part in coupling.inequalities)
        found: Values = [values[:first], values[first:last, None]]
        for part in coupling.balls:
            balls, heads = len(part.radius), part.heads is not None
            rows, first = np.zeros((balls, 1 + part.dim)), last
            last += balls * (part.dim + heads)
            rows[:, 1 - heads :] = -values[first:last].reshape(balls, -1)
            found.append(rows)
        return found

    def adjoint(self, z: Values) -> Array:
        """Return A'z, (T+1, n + k)."""
        n, eta = self.stages.states, z[DYNAMICS]
        result = self.loops.transposed_times(self._G, z[STAGES])
        result -= self.loops.transposed_times(self._AB, eta)
        result[1:, :n] += eta[:-1]
        result[0, :n] += np.where(self._fixed, z[INITIAL], 0.0)
        self.add_coupled(z[EQUATIONS:], result)
        return result

    def add_coupled(self, z: Values, gradient: Array) -> None:
        """Add the adjoint of the rows that couple times to a gradient (T+1, n + k)."""
        if not self.coupling.count:
            return
        equations, unequal, *balls = z
        nu = [equations, unequal[:, 0]]
        for part, rows in zip(self.coupling.balls, balls, strict=True):
            nu.append(-rows[:, 0 if part.heads is not None else 1 :].ravel())
        self.stages.coupled.add_adjoint(np.concatenate(nu), gradient)

    def curvature(self, y: Array) -> Array:
        """Return P y."""
        return self.loops.times(self.stages.H, y)

    @property
    def degree(self) -> int:
        """Return the degree of the cone."""
        return sum(cone.degree for cone in self.cones.values())
