"""
A drive that does not excite its resonance, in Python and in C
==============================================================

Motor and load of a drive are joined by a spring, and swing against each other at 12 Hz.

The controller measures angle and speed of the motor 200 times a second, and takes
both masses for one. The drive is pushed every 0.7 s. Between 8 and 16 Hz, the applied
torque stays below 0.03 Nm: in each window of 100 samples, whatever is measured.

``lfo.generate`` writes the same controller as C, and a plant in C is pushed as well.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

AMPLITUDE = 0.03  # Nm, of a sinusoid at 8 to 16 Hz: change this number
SAMPLING, STEPS, LENGTH = 0.005, 600, 100  # s, samples of the loop and of a window
BAND = lfo.spectrum.notch(centre_hz=12, width_hz=8)
INERTIA, SPRING, DAMPER, FRICTION = 0.5, 1421.0, 0.38, 0.25  # of each mass; at 12 Hz

FIRMWARE = """
#include "controller.h"
#include <stdio.h>

static const float A[4][4] = {A}, B[4] = {B};
static controller c;

int main(void) {{
  float x[4] = {{0.3f, 0.0f, 0.3f, 0.0f}}, u[1], next[4];
  puts("x1,x2,u1,status");
  controller_begin(&c);
  for (int k = 0; k < {steps}; k++) {{
    int status = controller_step(&c, x, u); /* it measures the first two states */
    printf("%.9g,%.9g,%.9g,%d\\n", x[0], x[1], u[0], status);
    for (int i = 0; i < 4; i++) {{
      next[i] = B[i] * u[0];
      for (int j = 0; j < 4; j++) next[i] += A[i][j] * x[j];
      if (k % 140 == 70 && i % 2) next[i] += 0.4f; /* a push of both masses */
    }}
    for (int i = 0; i < 4; i++) x[i] = next[i];
  }}
  return 0;
}}
"""

rigid = lfo.LinearDynamics.from_continuous(
    [[0, 1], [0, -FRICTION / INERTIA]],
    [[0], [0.5 / INERTIA]],
    SAMPLING,
    state_names=["angle [rad]", "speed [rad/s]"],
    control_names=["torque [Nm]"],
)
motor = [-SPRING / INERTIA, -(DAMPER + FRICTION) / INERTIA]
joint = [SPRING / INERTIA, DAMPER / INERTIA]
true = lfo.LinearDynamics.from_continuous(
    [[0, 1, 0, 0], [*motor, *joint], [0, 0, 0, 1], [*joint, *motor]],
    [[0], [1 / INERTIA], [0], [0]],
    SAMPLING,
)
free = lfo.OptimalControlProblem(
    rigid,
    horizon=60,
    cost=lfo.QuadraticCost(Q=np.diag([40.0, 1.0]), R=0.02, P=np.diag([2000.0, 100.0])),
    control_set=lfo.Box(-1, 1),
    initial_state=[0.3, 0.0],
    name="two-mass drive",
)
limit = lfo.spectrum.closed_loop(BAND, AMPLITUDE, SAMPLING, length=LENGTH, past=0)
limited = replace(free, control_spectrum=limit)


def torque_of(controller: lfo.RecedingHorizon) -> np.ndarray:
    """Return the torque of a loop with the true drive."""
    x = np.array([0.3, 0, 0.3, 0])
    for k in range(STEPS):
        u = controller.step(x[:2])
        x = true.A @ x + true.B @ u
        x[1::2] += 0.4 if k % 140 == 70 else 0.0
    return controller.log.controls[:, 0]


def vibration(torque: np.ndarray) -> float:
    """Return the largest amplitude at 12 Hz by which the spring twists, in mrad."""
    x, twist = np.array([0.3, 0, 0.3, 0]), []
    for k, u in enumerate(torque):
        twist.append(1e3 * (x[0] - x[2]))
        x = true.A @ x + true.B[:, 0] * u
        x[1::2] += 0.4 if k % 140 == 70 else 0.0
    return spectrum(np.array(twist), np.array([12.0]))[0]


def spectrum(signal: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return the largest amplitude of all windows of a signal, zero before the loop."""
    whole, taper = np.append(np.zeros(LENGTH - 1), signal), np.hanning(LENGTH)
    times = SAMPLING * np.arange(LENGTH)
    waves = taper * np.exp(-2j * np.pi * np.outer(frequencies, times))
    windows = np.lib.stride_tricks.sliding_window_view(whole, LENGTH)[:: limit.hop]
    return 2 * np.abs(windows @ waves.T).max(axis=0) / taper.sum()


controller = lfo.RecedingHorizon(limited, certify="later")
loops = {
    "no limit": torque_of(lfo.RecedingHorizon(free, certify="later")),
    "limit, in Python": torque_of(controller),
}
compiler = shutil.which("cc") or shutil.which("gcc")
if compiler is None:
    print("There is no C compiler on this machine: no C is run.")
else:
    folder = Path(tempfile.mkdtemp())
    lfo.generate(lfo.RecedingHorizon(limited), folder, real="float", memory="64k")
    rows = ["{" + ", ".join(f"{entry:.9g}" for entry in row) + "}" for row in true.A]
    column = ", ".join(f"{entry:.9g}" for entry in true.B[:, 0])
    text = FIRMWARE.format(
        A="{" + ", ".join(rows) + "}", B="{" + column + "}", steps=STEPS
    )
    (folder / "main.c").write_text(text)
    sources = ["main.c", "controller.c", "lfo_kernel.c"]
    command = [compiler, "-std=c99", "-O2", *sources, "-o", "firmware", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    with (folder / "log.csv").open("w") as log:
        subprocess.run(["./firmware"], cwd=folder, check=True, stdout=log)
    logged = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)
    loops["limit, in C"] = logged[:, 2]
    shutil.rmtree(folder)

figure, axes = plt.subplots(2, figsize=(7, 6), layout="constrained")
frequencies = np.linspace(0.25, 40, 300)
points = np.arange(16, 33) / (4 * LENGTH * SAMPLING)  # of the windows, 8 to 16 Hz
for (name, torque), line in zip(loops.items(), ("-", "-", "--"), strict=False):
    print(
        f"{name:18}{spectrum(torque, points).max():8.4f} Nm at 8 to 16 Hz, "
        f"twist of the spring at 12 Hz {vibration(torque):.3f} mrad"
    )
    axes[0].step(SAMPLING * np.arange(STEPS), torque, line, where="post", label=name)
    axes[1].semilogy(frequencies, spectrum(torque, frequencies), line, label=name)
axes[1].plot([8, 16], [AMPLITUDE, AMPLITUDE], color="black", label="limit")
axes[0].set(xlabel="time [s]", ylabel="torque [Nm]")
axes[1].set(xlabel="frequency [Hz]", ylabel="largest amplitude [Nm]")
axes[1].legend()
figure.savefig("two_mass_drive.png")
print("picture: two_mass_drive.png")
