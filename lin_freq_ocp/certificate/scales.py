"""What the judge measures residuals, gaps and slopes by: sizes of the trajectory, and what the cost's terms add up to.

All of it follows the units of states, controls and cost, and nothing of it comes from bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.hamiltonian import Extremal
from lin_freq_ocp.certificate.sizes import cost_scale, trajectory_sizes

SCALE_FLOOR = 1e-4
"""No component is measured more finely than this fraction of its size: what should be zero holds rounding only."""


@dataclass(frozen=True, eq=False)
class Floors:
    """The least scale of every kind of quantity: SCALE_FLOOR of its natural size.

    Attributes
    ----------
    x : (n,), u : (m,)
        Of states and controls.
    level : float
        What multipliers times signals are compared with: S of ``cost_scale``, but at least SCALE_FLOOR of what a stage
        costs with states and controls of their natural sizes; for eta_C = 0, which has no unit of cost, SCALE_FLOOR of
        the largest terms of the Hamiltonian.
    in_x : (n,), in_u : (m,)
        Of multipliers in the adjoint equation and in D_u H: what changes the cost of a stage by its own size.
    terms : tuple of (dim,)
        Of values of terms, one entry per term, with states and controls of their natural sizes.
    """

    x: Array
    u: Array
    level: float
    in_x: Array
    in_u: Array
    terms: tuple[Array, ...]


def floors(extremal: Extremal, sizes: tuple[Array, Array] | None = None) -> Floors:
    """Return the least scales of a problem along a trajectory, whose components have these sizes, (n,) and (m,).

    The default are those of the extremal's own problem; of one with modes, the extremal knows the average only.
    """
    problem, T = extremal.problem, extremal.problem.horizon
    x, u = trajectory_sizes(problem, extremal.trajectory) if sizes is None else sizes
    steady = np.tile(x, (T + 1, 1)), np.tile(u, (T, 1))
    terms = tuple(SCALE_FLOOR * priced.term.map.sizes(*steady).max(0) for priced in extremal.terms)
    if extremal.multipliers.eta_C == 0:  # any multiple of abnormal multipliers is as good
        before = np.abs(extremal.eta_before) + extremal.in_x_terms
        level = stage = SCALE_FLOOR * float(max((before @ x).max(), (extremal.in_u_terms @ u).max()))
    else:
        in_x, in_u = problem.quadratic.gradient_magnitudes(*steady)
        priced = [term.cost(*steady).max(initial=0.0) for term in problem.terms if term.kind.is_cost]
        stage = SCALE_FLOOR * float(max((in_x @ x).max(), (in_u @ u).max(), *priced))
        level = max(cost_scale(problem, extremal.trajectory), stage)
    return Floors(SCALE_FLOOR * x, SCALE_FLOOR * u, level, stage / x, stage / u, terms)
