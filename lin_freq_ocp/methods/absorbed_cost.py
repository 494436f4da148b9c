"""Costs that are convex over a frequency response, but not at each time, as squares of further outputs.

With H_k = L_k^2 >= 0, L_k Hermitian (transform/response_curvature.py), the quadratic part of the cost is 1/2 sum w_t^2
of the outputs w = L u, for x = Y u + g and up to a constant:

    1/2 x'Q x + x'S u + 1/2 u'R u  =  1/2 w'w + (Q g)'x + (S'g)'u.

Zero-padded, Q stays as it is, and w has 2T samples: two outputs at each time. The multipliers differ by the gradients
in x, Q (x - g) + S u, and, where a band removes some controls from a bin, by those of H_k in these controls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import with_columns
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reformulations import OwnStates, augment_states
from lin_freq_ocp.transform.response_curvature import BinCurvature, bin_curvature


@dataclass(frozen=True, eq=False)
class AbsorbedCost(OwnStates):
    """The problem with further outputs, and the response and the curvature of the given one."""

    response: Response
    curvature: BinCurvature

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers of the given states; at a trajectory, with the gradients of the given cost there."""
        own = super().multipliers(reduced)
        if at is None:
            return own
        cost, link = self.given.quadratic, self.given.links[-1].name
        absorbed = at.u @ cost.S.T
        if self.response.closed:
            absorbed = absorbed + (at.x - self.response.base)[:-1] @ cost.Q
        eta, on_link = own.eta.copy(), own.stage[link].copy()
        eta[:-1] -= absorbed[1:]
        if self.response.closed:
            eta[-1] -= absorbed[0]
            on_link += absorbed[0]
        else:
            on_link -= absorbed[0]
        H, inside = self.curvature.hessians, self.curvature.within
        rho_u = own.rho_u.copy()
        if self.response.closed:
            spectrum = np.fft.rfft(at.u, axis=0)
            missing = ((H - inside) @ spectrum[:, :, None])[:, :, 0] * ~self.curvature.passed
            rho_u -= self.response.weight[:, None] * missing / self.response.record
        return replace(own, eta=eta, rho_u=rho_u, stage={**own.stage, link: on_link})


def absorb_cost(problem: OptimalControlProblem) -> AbsorbedCost | None:
    """Return the problem whose cost is convex at each time; None if the given one's is, or has no response."""
    response = problem.response
    curvature = None if response is None else bin_curvature(problem, response)
    if response is None or curvature is None or problem.quadratic.nonconvexity() is None:
        return None
    values, vectors = np.linalg.eigh(curvature.within)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2).conj()
    if not response.closed:  # the samples from T on, as outputs that lead by T
        lead = np.where(np.arange(len(root)) % 2 == 0, 1.0, -1.0)[:, None, None]
        root = np.concatenate([root, lead * root], axis=1)
    k = root.shape[1]
    dynamics = FrequencyResponse(
        np.concatenate([response.G, root], axis=1),
        problem.sampling_time,
        disturbance=with_columns(response.base[:-1] if response.closed else response.base, k),
        mode="periodic" if response.closed else "zero-padded",
        state_names=[*problem.state_names, *(f"square root of the cost {i}" for i in range(k))],
        control_names=problem.control_names,
    )
    free = np.full(k, np.inf)
    # the part of the cost that stays one of the given outputs and controls
    cost, n, m = problem.quadratic, problem.state_dim, problem.control_dim
    x_ref = np.broadcast_to(cost.x_ref, (problem.horizon + 1, n))[:-1]
    remaining, moved = (np.zeros((n, n)), cost.Q) if response.closed else (cost.Q, np.zeros((n, n)))
    deviation = (response.base[:-1] - x_ref) @ moved, (response.base[:-1] - x_ref) @ cost.S
    q, r = cost.q - cost.u_ref @ cost.S.T + deviation[0], cost.r - cost.u_ref @ cost.R + deviation[1]
    none = {"R": np.zeros((m, m)), "S": np.zeros((n, m)), "u_ref": np.zeros(m)}
    output_cost = replace(cost, Q=remaining, q=q, r=r, **none)
    further = augment_states(problem, dynamics, Box(-free, free), -free, output_cost, weight=1.0)
    return AbsorbedCost(problem, further, response, curvature)
