"""
A notch in the spectrum of a state
==================================

Move two masses joined by a spring without exciting the frequency of the spring.

A force of at most 1 N on the first of two unit masses moves them by 9 m in 10 s, with
the least squared force. The constraint acts on the spectrum of a *state*, the
deflection of the spring of 1 N/m: its bins within 0.1 Hz of the resonance at 0.225 Hz
are zero.
"""

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

spring = 1.0  # N/m, between masses of 1 kg: change this number
resonance_hz = np.sqrt(2 * spring) / (2 * np.pi)
masses = lfo.LinearDynamics.from_continuous(
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, spring, 0, 0], [0, -2 * spring, 0, 0]],
    [[0], [0], [1], [-1]],
    sampling_time=0.05,
    state_names=[
        "position [m]",
        "deflection [m]",
        "speed [m/s]",
        "deflection rate [m/s]",
    ],
    control_names=["force [N]"],
)
problem = lfo.OptimalControlProblem(
    masses,
    horizon=200,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-1, 1),
    state_set=lfo.Box({"deflection": (-1, 1)}),
    initial_state=[0, 0, 0, 0],
    terminal_state=[9, 0, 0, 0],
    state_spectrum=lfo.spectrum.notch(
        centre_hz=resonance_hz, width_hz=0.2, component="deflection"
    ),
    name="two masses",
)
result = lfo.solve(problem)
free = lfo.solve(replace(problem, state_spectrum=None))

stopped = problem.state_stop.any(axis=1)
for name, answer in (("without", free), ("with", result)):
    deflection = np.abs(np.fft.rfft(answer.trajectory.x[:, 1]))
    largest = deflection[stopped].max()
    print(f"{name:8} notch: cost {answer.cost:.4f}, largest notched bin {largest:.2e}")
print(f"maximum principle: {result.certificate.pmp}; global gap {result.gap:.1e}")
figure = result.plot()
figure.savefig("state_frequency_constraint.png")
print("picture: state_frequency_constraint.png")
