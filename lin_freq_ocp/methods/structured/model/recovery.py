"""The way back from stages: points y as trajectories, duals z as multipliers of the maximum principle.

z is a list: dynamics (T+1, n), x_0 (n,), stages (T+1, p), equations flat, inequalities (count, 1), and (balls, 1 + dim)
for each family of balls, with H y + h + A'z = 0 where A are the rows of dynamics, x_0, G, equations, inequalities, and
minus those of balls. The multiplier of a value is then the sum of its rows' duals, times 1 or -1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.methods.structured.model.origin import Origin, held_multipliers
from lin_freq_ocp.methods.structured.model.units import Units
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class MultiplierLayout:
    """Where each multiplier begins in one flat array of all of them; eta is not among them."""

    mu: int
    nu: int
    rho_x: int  # (Re, Im) of every bin of a state, state by state
    rho_u: int
    terms: tuple[int, ...]
    count: int


def multiplier_layout(problem: OptimalControlProblem) -> MultiplierLayout:
    """Return where the multipliers of a problem begin."""
    sizes = [
        problem.state_tube.lower.size,
        problem.control_tube.lower.size,
        2 * problem.state_stop.size,
        2 * problem.control_stop.size,
        *(groups * dim for groups, dim in (term.shape for term in problem.terms)),
    ]
    mu, nu, rho_x, rho_u, *terms = (int(first) for first in np.cumsum([0, *sizes]))
    return MultiplierLayout(mu, nu, rho_x, rho_u, tuple(terms[:-1]), terms[-1])


@dataclass(frozen=True, eq=False)
class Recovery:
    """The inverse of the assembly of a problem."""

    problem: OptimalControlProblem
    origin: Origin
    units: Units
    layout: MultiplierLayout
    targets: Indices  # of each dual behind those of the dynamics, flat: the multiplier that it belongs to; -1: none
    signs: Array

    def trajectory(self, y: Array) -> Trajectory:
        """Return (x, u) from y (T+1, n+k)."""
        change = self.direction(y)
        return Trajectory(self.origin.x + change.x, self.origin.u + change.u)

    def direction(self, y: Array) -> Trajectory:
        """Return the change (dx, du) of a change of y."""
        n, m = self.problem.state_dim, self.problem.control_dim
        change = y * self.units.columns
        return Trajectory(change[:, :n], change[:-1, n : n + m])

    def multipliers(self, z: Sequence[Array], eta_C: float, y: Array | None = None) -> Multipliers:
        """Return the multipliers of the maximum principle from all duals; eta_C = 0 for a Farkas ray, without y."""
        problem, layout = self.problem, self.layout
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        duals = np.concatenate([part.ravel() for part in z[1:]]) * self.units.rows / self.units.cost
        found = np.zeros(layout.count + 1)  # the last for duals without a multiplier
        np.add.at(found, self.targets, self.signs * duals)
        eta = z[0][:-1] / self.units.columns[1:, :n] / self.units.cost
        shapes = [term.shape for term in problem.terms]
        multipliers = Multipliers(
            eta_C=eta_C,
            eta=eta,
            mu=found[layout.mu : layout.nu].reshape(T + 1, n),
            nu=found[layout.nu : layout.rho_x].reshape(T, m),
            rho_x=_bins(found[layout.rho_x : layout.rho_u], n),
            rho_u=_bins(found[layout.rho_u :][: 2 * problem.control_stop.size], m),
            stage={
                term.name: found[first : first + shape[0] * shape[1]].reshape(shape)
                for term, first, shape in zip(problem.terms, layout.terms, shapes, strict=True)
            },
        )
        if not self.origin.held.any():
            return multipliers
        nu = held_multipliers(problem, self.origin, multipliers, None if y is None else self.trajectory(y))
        return replace(multipliers, nu=nu)


def _bins(pairs: Array, components: int) -> ComplexArray:
    """Return multipliers (bins, components) from (Re, Im) of every bin, component by component."""
    of_bins = pairs.reshape(components, -1, 2)
    return (of_bins[:, :, 0] + 1j * of_bins[:, :, 1]).T
