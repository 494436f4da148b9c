"""Small problems over stages, solved by Clarabel with all rows dense: an oracle for the structured method."""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.methods.structured import Stages


def stage_operator(stages: Stages) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the matrices A and right-hand sides b of all rows b - A y, in the order of duals, y (T+1, n+k) flat."""
    (N, width), n, coupling = stages.h.shape, stages.states, stages.coupling
    every = np.eye(N * width).reshape(N, width, -1)
    x = every[:, :n]
    dynamics = np.zeros((N, n, N * width))
    dynamics[:-1] = x[1:] - np.einsum("tij,tjk->tik", np.dstack([stages.A, stages.B])[:-1], every[:-1])
    signals = every[:, coupling.channels]
    matrices = [
        dynamics.reshape(-1, N * width),
        x[0] * stages.fixed[:, None],
        np.einsum("tpi,tik->tpk", stages.G, every).reshape(-1, N * width),
        np.concatenate([every[-1, coupling.terminal], *(part.rows.forward(signals) for part in coupling.equations)]),
        np.concatenate([np.zeros((0, N * width)), *(part.rows.forward(signals) for part in coupling.inequalities)]),
    ]
    right = [
        stages.d.ravel(),
        np.where(stages.fixed, stages.initial, 0.0),
        stages.g.ravel(),
        np.concatenate([coupling.terminal_state, *(part.right for part in coupling.equations)]),
        np.concatenate([np.zeros(0), *(part.limits for part in coupling.inequalities)]),
    ]
    for part in coupling.balls:
        rows = np.zeros((len(part.radius), 1 + part.dim, N * width))
        rows[:, 1:] = -part.rows.forward(signals).reshape(len(part.radius), part.dim, -1)
        if part.heads is not None:
            rows[:, 0] = -part.heads.forward(signals)
        matrices.append(rows.reshape(-1, N * width))
        right.append(part.right.ravel())
    return matrices, right


def solved_stages(stages: Stages) -> tuple[str, np.ndarray, list[np.ndarray]]:
    """Return Clarabel's status, y (T+1, n+k), and the duals in the order of the structured method."""
    matrices, right = stage_operator(stages)
    P = sp.csc_array(sp.block_diag([sp.csc_array(H) for H in stages.H]))
    kinds, order, cones = [], [], []
    zero, plus = [0, 1, 3], [2, 4]
    offsets = np.cumsum([0, *map(len, right)])
    single = stages.G.shape[1] - sum(stages.cones)
    stage_index = np.arange(stages.g.size).reshape(stages.g.shape)
    present = stages.present
    for block in zero:
        order.append(offsets[block] + np.arange(len(right[block])))
    kinds.append(clarabel.ZeroConeT(sum(len(right[block]) for block in zero)))
    chosen = stage_index[:, :single][present[:, :single]]
    order += [offsets[plus[0]] + chosen, offsets[plus[1]] + np.arange(len(right[plus[1]]))]
    kinds.append(clarabel.NonnegativeConeT(len(order[-2]) + len(order[-1])))
    first = single
    for size in stages.cones:
        for t in np.flatnonzero(present[:, first]):
            order.append(offsets[2] + stage_index[t, first : first + size])
            cones.append(size)
        first += size
    for block, part in enumerate(stages.coupling.balls, start=5):
        order.append(offsets[block] + np.arange(len(right[block])))
        cones += [1 + part.dim] * len(part.radius)
    rows = np.concatenate(order)
    A, b = sp.csc_array(np.concatenate(matrices)[rows]), np.concatenate(right)[rows]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    settings.tol_infeas_abs = settings.tol_infeas_rel = 1e-10
    kinds += [clarabel.SecondOrderConeT(size) for size in cones]
    run = clarabel.DefaultSolver(sp.triu(P, format="csc"), stages.h.ravel(), A, b, kinds, settings).solve()
    duals = np.zeros(offsets[-1])
    duals[rows] = run.z
    z = np.split(duals, offsets[1:-1])
    shapes = [stages.d.shape, (-1,), stages.g.shape, (-1,), (-1, 1)]
    shapes += [(len(part.radius), 1 + part.dim) for part in stages.coupling.balls]
    z = [part.reshape(shape) for part, shape in zip(z, shapes, strict=True)]
    return str(run.status), np.array(run.x).reshape(stages.h.shape), z
