"""The rows of a problem over stages, as the embedding sees them: b - A y in a cone, with the Hessian P.

Rows are a list of arrays: dynamics x_{t+1} - A_t x_t - B_t w_t (T+1, n), the last zero; x_0 (n,); stages G y (T+1, p);
equations, those of x_T first, flat; inequalities (rows, 1); -(head, values) (balls, 1 + d) for each family of balls.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.model.cones import Cone
from lin_freq_ocp.methods.structured.model.stages import Stages

DYNAMICS, INITIAL, STAGES, EQUATIONS, INEQUALITIES, BALLS = range(6)
Values = list[Array]


class System:
    """The operators of one problem, and the cones of its rows by their index."""

    def __init__(self, stages: Stages, loops: Loops):
        self.stages, self.loops, coupling = stages, loops, stages.coupling
        self.coupling, self._first = coupling, len(coupling.terminal)
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
        signals, coupling = y[:, self.coupling.channels, None], self.coupling
        equations = [part.rows.forward(signals)[:, 0] for part in coupling.equations]
        unequal = [part.rows.forward(signals) for part in coupling.inequalities]
        balls: Values = []
        for part in coupling.balls:
            rows = np.zeros((len(part.radius), 1 + part.dim))
            rows[:, 1:] = -part.rows.forward(signals).reshape(-1, part.dim)
            if part.heads is not None:
                rows[:, 0] = -part.heads.forward(signals)[:, 0]
            balls.append(rows)
        return [
            np.concatenate([y[-1, coupling.terminal], *equations]),
            np.concatenate([np.zeros((0, 1)), *unequal]),
            *balls,
        ]

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
        coupling = self.coupling
        if not coupling.count:
            return
        equations, unequal, *balls = z
        gradient[-1, coupling.terminal] += equations[: self._first]
        signals = np.zeros((len(gradient), len(coupling.channels), 1))
        first = self._first
        for part in coupling.equations:
            part.rows.add_adjoint(equations[first : first + part.rows.count, None], signals)
            first += part.rows.count
        first = 0
        for part in coupling.inequalities:
            part.rows.add_adjoint(unequal[first : first + part.rows.count], signals)
            first += part.rows.count
        for part, rows in zip(coupling.balls, balls, strict=True):
            part.rows.add_adjoint(-rows[:, 1:].reshape(-1, 1), signals)
            if part.heads is not None:
                part.heads.add_adjoint(-rows[:, :1], signals)
        gradient[:, coupling.channels] += signals[:, :, 0]

    def curvature(self, y: Array) -> Array:
        """Return P y."""
        return self.loops.times(self.stages.H, y)

    @property
    def degree(self) -> int:
        """Return the degree of the cone."""
        return sum(cone.degree for cone in self.cones.values())
