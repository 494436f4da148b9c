"""
A scanner: follow a triangle wave without its resonance
=======================================================

A piezo scanner follows a triangle of 8 um at 25 Hz, line after line.

The cost weighs the distance from the triangle and the drive, which is at most 5 um. The
drive must not contain the frequencies around the resonance at 900 Hz, nor any above the
1.6 kHz of its amplifier. Periodic ends join the lines without a jump.
"""

import numpy as np

import lin_freq_ocp as lfo

resonance_hz = 900.0  # change this number to that of your scanner
samples, sampling_time = 400, 1e-4  # one period of the triangle: 40 ms
w, damping = 2 * np.pi * resonance_hz, 0.02
scanner = lfo.LinearDynamics.from_continuous(
    [[0, 1e3], [-1e-3 * w**2, -2 * damping * w]],  # in um and mm/s
    [[0], [1e-3 * w**2]],
    sampling_time,
    state_names=["position [um]", "speed [mm/s]"],
    control_names=["drive [um]"],
)
triangle = 4 - 16 * np.abs(np.arange(samples + 1) / samples - 0.5)
problem = lfo.OptimalControlProblem(
    scanner,
    horizon=samples,
    cost=lfo.QuadraticCost(
        Q=np.diag([100, 0]),
        R=1.0,
        x_ref=np.column_stack([triangle, 0 * triangle]),
        u_ref=triangle[:-1, None],
    ),
    control_set=lfo.Box(-5, 5),
    terminal_state=lfo.Periodic(),
    control_spectrum=[
        lfo.spectrum.notch(centre_hz=resonance_hz, width_hz=150),
        lfo.low_pass(cutoff_hz=1600),
    ],
    name="scanner",
)
result = lfo.solve(problem)
error = np.abs(result.trajectory.x[:, 0] - triangle).max()
print(f"largest error {1e3 * error:.0f} nm of {8e3:.0f} nm; gap {result.gap:.0e}")
print(f"{result.status}: cost {result.cost:.6g}; {result.certificate.pmp}")
figure = result.plot()
figure.savefig("scanner.png")
print("picture: scanner.png")
