"""
From Python to a microcontroller
================================

C code controls a mass on a spring, and the log of its run is certified afterwards.

The mass of 1 kg on a spring of 4 N/m is pushed every 5 s. The force is at most 0.7 N,
with no frequencies above 4 Hz in each plan; the position stays within 0.35 m if that is
possible.

``lfo.generate`` writes the controller as C99 in ``float``, without heap and libraries.
The program below runs it with a simulated mass, and logs every step. All plans are then
proven optimal in Python, and the logged controls are compared with them.
"""

import shutil
import subprocess
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

# RecedingHorizon warns that the low pass limits each plan, not the applied force.
warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)

SAMPLING = 0.05  # s
CUTOFF_HZ = 4.0  # of each plan: change this number
FIRMWARE = """
#include "controller.h"
#include <stdio.h>

static controller c;

int main(void) {{
  float x[2] = {{0.3f, 0.0f}}, u[1];
  puts("x1,x2,u1,status");
  controller_begin(&c);
  for (int k = 0; k < 400; k++) {{
    int status = controller_step(&c, x, u);
    float p = {A[0][0]}f * x[0] + {A[0][1]}f * x[1] + {B[0][0]}f * u[0];
    float v = {A[1][0]}f * x[0] + {A[1][1]}f * x[1] + {B[1][0]}f * u[0];
    printf("%.9g,%.9g,%.9g,%d\\n", (double)x[0], (double)x[1], (double)u[0], status);
    x[0] = p;
    x[1] = k % 100 == 99 ? v - 0.8f : v; /* a push every 5 s */
  }}
  return 0;
}}
"""

dynamics = lfo.LinearDynamics.from_continuous(
    [[0, 1], [-4.0, -0.1]],
    [[0], [1]],
    SAMPLING,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["force [N]"],
)
problem = lfo.OptimalControlProblem(
    dynamics,
    horizon=60,
    cost=lfo.QuadraticCost(Q=np.diag([10.0, 1.0]), R=0.1, P=np.diag([50.0, 5.0])),
    control_set=lfo.Box(-0.7, 0.7),
    state_set=lfo.Box([-0.35, -1.0], [0.35, 1.0]),
    initial_state=[0.3, 0.0],
    control_spectrum=lfo.low_pass(cutoff_hz=CUTOFF_HZ),
    name="oscillating mass",
)
controller = lfo.RecedingHorizon(problem, soft={"state_set": 100.0})
folder = Path(tempfile.mkdtemp())
print(lfo.generate(controller, folder, real="float", memory="64k"))

compiler = shutil.which("cc") or shutil.which("gcc")
if compiler is None:
    print("There is no C compiler on this machine: nothing is run.")
else:
    A, B = dynamics.A.tolist(), dynamics.B.tolist()
    (folder / "main.c").write_text(FIRMWARE.format(A=A, B=B))
    sources = ["main.c", "controller.c", "lfo_kernel.c"]
    command = [compiler, "-std=c99", "-O2", *sources, "-o", "firmware", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    with (folder / "log.csv").open("w") as log:
        subprocess.run(["./firmware"], cwd=folder, check=True, stdout=log)

    certified = lfo.certify_log(controller, folder / "log.csv")
    print(certified)

    times = SAMPLING * np.arange(len(certified))
    figure, axes = plt.subplots(3, sharex=True, figsize=(7, 5), layout="constrained")
    axes[0].plot(times, certified.states[:, 0])
    axes[1].step(times, certified.controls[:, 0], where="post")
    axes[2].semilogy(times, np.maximum(certified.differences, 1e-12), ".")
    for ax, name in zip(axes, ["position [m]", "force [N]", "difference"], strict=True):
        ax.set_ylabel(name)
    axes[2].set_xlabel("time [s]")
    figure.savefig("oscillating_mass_in_c.png")
    print("picture: oscillating_mass_in_c.png")
shutil.rmtree(folder)
