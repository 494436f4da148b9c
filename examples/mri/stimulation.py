"""
MRI: the shortest gradient pulse that a patient's nerves take
=============================================================

A fast gradient stimulates nerves. How much longer is a pulse that does so less?

The pulse encodes flow: no zeroth moment, a first moment of 11.74 mT/m ms^2, at most
40 mT/m and 200 T/m/s. The SAFE model limits the stimulation at every sample to a share
of its limit. Its hardware is the published example, which is no real scanner.
"""

from functools import partial

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

shares = (1.0, 0.8, 0.5)  # of the model's limit: change these numbers
raster = 0.01  # ms
amplitude, slew_rate = 40.0, 200.0  # mT/m, T/m/s
first_moment, tolerance = 11.74, 1e-3  # mT/m ms^2
# the SAFE model: time constants [ms], weights, scale and limit [T/m/s] of three filters
constants, weights = np.array([1.5, 2.5, 0.15]), np.array([0.55, 0.15, 0.3])
scale, limit = 0.31, 15.0


def pulse(horizon: int, share: float) -> lfo.OptimalControlProblem:
    """Return the problem of a pulse with so many samples and this stimulation.

    States are both moments, the sample before, and slew, |slew| and slew after filters;
    controls are the gradient and a bound on |slew|.
    """
    a = raster / (constants + raster)
    A, B = np.zeros((6, 6)), np.zeros((horizon, 6, 2))
    A[0, 0] = A[1, 1] = 1.0
    B[:, 0, 0] = raster
    B[:, 1, 0] = raster**2 * np.arange(horizon)
    B[:, 2, 0] = 1.0
    A[3:, 3:] = np.diag(1.0 - a)
    A[[3, 5], 2], B[:, [3, 5], 0], B[:, 4, 1] = -a[::2] / raster, a[::2] / raster, a[1]
    plant = lfo.LinearDynamics(
        A,
        B,
        sampling_time=1e-3 * raster,
        state_names=["zeroth moment", "first moment", "before", "w1", "w2", "w3"],
        control_names=["gradient [mT/m]", "|slew| [T/m/s]"],
    )
    largest = np.tile([amplitude, slew_rate], (horizon, 1))
    largest[0, 0] = 0.0  # the first sample; the last one is the state "before"
    low, high = [-slew_rate, 0.0, -slew_rate], [slew_rate] * 3
    # each sign of both slews: what is felt after the sample
    signs = np.array([(i, 1.0, j) for i in (1.0, -1.0) for j in (1.0, -1.0)])
    felt = signs * weights * scale / limit
    change = np.array([[0, 0, -1, 0, 0, 0], [0, 0, 1, 0, 0, 0]]) / raster
    return lfo.OptimalControlProblem(
        plant,
        horizon,
        cost=lfo.QuadraticCost(R=np.diag([1.0, 0.0])),
        control_set=lfo.Box(largest * [-1.0, 0.0], largest),
        state_set=lfo.Box([None] * 3 + low, [None] * 3 + high),
        initial_state=np.zeros(6),
        terminal_state=lfo.Box(
            [-tolerance, first_moment - tolerance, 0, *low],
            [tolerance, first_moment + tolerance, 0, *high],
        ),
        stage_rows=[
            lfo.StageRows(
                change, [[1 / raster, -1], [-1 / raster, -1]], [0, 0], name="slew"
            ),
            lfo.StageRows(
                felt @ A[3:], felt @ B[0, 3:], np.full(4, share), name="stimulation"
            ),
        ],
        name="gradient pulse",
    )


figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")

for share in shares:
    minimum = lfo.minimum_time(partial(pulse, share=share), horizons=(100, 200))
    print(f"stimulation {share:g}: {minimum.proof}")
    g = minimum.result.control[:, 0]
    times = 0.01 * np.arange(len(g))
    top.plot(times, g, label=f"at most {share:g}")
    bottom.plot(times, np.diff(g, prepend=0) / 0.01)

# %%
# Half of the stimulation costs 0.38 ms. Every shorter pulse is proven not to exist: by
# one infeasible length, as a pulse within the limit stays within it when zeros follow.

top.set_ylabel("gradient [mT/m]")
top.legend()
bottom.set_ylabel("slew [T/m/s]")
bottom.set_xlabel("time [ms]")
figure.savefig("stimulation.png")
print("picture: stimulation.png")
