"""
MRI: three gradients at once, and the nerves feel all of them
=============================================================

A pulse on three axes stimulates nerves by the root of the sum of squares of the axes.

Each axis is the pulse of the library, with the SAFE model of its published example
hardware (no real scanner). A control per axis bounds what the axis adds, and a
second-order cone bounds the three together.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import block_diag

import lin_freq_ocp as lfo

shares = {
    "x": 0.6,
    "y": 0.6,
    "z": 0.6,
}  # of the moment on each axis: change these numbers
moment = 11.74  # mT/m ms^2, of one axis alone


def pulse(horizon: int, limit: float = 1.0) -> lfo.OptimalControlProblem:
    """Return the problem of three pulses with so many samples."""
    axes = [
        lfo.library.mri_gradient(
            horizon, first_moment=moment * share, stimulation=1.0, hardware=axis
        )
        for axis, share in shares.items()
    ]
    plants, boxes = [one.dynamics for one in axes], [one.control_tube for one in axes]
    ends = [one.terminal_state for one in axes]
    slews, felts = ([one.stage_rows[i] for one in axes] for i in (0, 1))
    n = sum(one.state_dim for one in plants)
    B = np.array([block_diag(*(one.B[t] for one in plants)) for t in range(horizon)])
    none = np.zeros((horizon, 3))
    # a control of each axis is at least what each sign of its filters feels
    above = np.kron(np.eye(3), -np.ones((4, 1)))
    size = np.hstack([np.zeros((3, 6)), np.eye(3)])
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(
            block_diag(*(one.A for one in plants)),
            np.concatenate([B, np.zeros((horizon, n, 3))], axis=2),
            sampling_time=1e-5,
        ),
        horizon,
        lfo.QuadraticCost(R=np.diag([1.0, 0, 1, 0, 1, 0, 0, 0, 0])),
        control_set=lfo.sets.Intersection(
            [
                lfo.Box(
                    np.hstack([*(one.lower for one in boxes), none]),
                    np.hstack([*(one.upper for one in boxes), none + 10]),
                ),
                lfo.sets.SecondOrderCone(size, np.zeros(3), np.zeros(9), limit),
            ]
        ),
        state_set=lfo.Box(
            np.concatenate([one.state_set.lower for one in axes]),
            np.concatenate([one.state_set.upper for one in axes]),
        ),
        initial_state=np.zeros(n),
        terminal_state=lfo.Box(
            np.concatenate([one.lower for one in ends]),
            np.concatenate([one.upper for one in ends]),
        ),
        stage_rows=[
            lfo.StageRows(
                block_diag(*(one.C for one in slews)),
                np.hstack([block_diag(*(one.D for one in slews)), np.zeros((6, 3))]),
                np.zeros(6),
                name="slew rate",
            ),
            lfo.StageRows(
                block_diag(*(one.C for one in felts)),
                np.hstack([block_diag(*(one.D for one in felts)), above]),
                np.zeros(12),
                name="stimulation of an axis",
            ),
        ],
        name="three gradients",
    )


found = lfo.minimum_time(pulse, horizons=(100, 160))
print(found.proof)
g = found.result.control[:, [0, 2, 4]]
felt = np.linalg.norm(found.result.control[:, 6:], axis=1)
print(f"largest stimulation {felt.max():.4f} of 1")
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(0.01 * np.arange(len(g)), g, label=list(shares))
axes.set(xlabel="time [ms]", ylabel="gradient [mT/m]")
axes.legend()
figure.savefig("three_axes.png")
print("picture: three_axes.png")
