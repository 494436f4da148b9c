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

shares = (1.0, 0.8, 0.5)  # of the model's limit
figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")

for share in shares:
    stated = partial(lfo.library.mri_gradient, stimulation=share, hardware="y")
    minimum = lfo.minimum_time(stated, horizons=(100, 200))
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
