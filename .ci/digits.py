"""Print the digits of what the three C libraries of an installed package compute.

If a compiler runs, it may take MOST_SECONDS of processor time in all.
"""

import resource
import sys

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.methods import library
from lin_freq_ocp.methods.hybrid import path_library
from lin_freq_ocp.methods.structured.kkt.recursions import loops_library

MOST_SECONDS = 10.0

assert None not in (library(), path_library(), loops_library()), "a library is missing"
loop = lfo.RecedingHorizon(lfo.library.pendulum(horizon=60, cutoff=None, terminal_state=None))
controls = [loop.step(scale * np.array([-0.15, 0.1, 0.0, 0.0])) for scale in (1.0, 0.8, 0.7)]
controls.append(lfo.solve(lfo.rate_limited(lfo.library.pendulum(), 2.0), "structured").control)
controls.append(lfo.solve(lfo.library.switched_rotation(horizon=7)).control)
for control in controls:
    print(np.asarray(control).tobytes().hex())
compilers = resource.getrusage(resource.RUSAGE_CHILDREN)
seconds = compilers.ru_utime + compilers.ru_stime
assert seconds <= MOST_SECONDS, f"compilers took {seconds:.1f} s of processor time"
print(f"compilers took {seconds:.1f} s of processor time", file=sys.stderr)
