"""
A satellite: a turn that does not shake its panels
==================================================

Turn a satellite by 45 degrees with a torque that a low pass keeps below two panel
modes.

The turn takes 60 s. The torque is at most 0.8 N m, the rate between -0.025 and 0.0255
rad/s. The plant is a ``StateSpace`` of python-control, assembled from inertia,
couplings and modal frequencies. With the hub free, the modes are at 0.16 and 0.18 Hz;
the torque has no DFT bin above 0.1 Hz.
"""

import control
import numpy as np

import lin_freq_ocp as lfo

cutoff_hz = 0.1  # of the torque: change this number
mass = np.array([[350, 6.5, -1.3], [6.5, 1, 0], [-1.3, 0, 1]])  # hub and two modes
frequencies, damping = np.array([0, 0.96, 1.13]), 0.005  # rad/s, with the hub fixed
stiffness, friction = np.diag(frequencies**2), np.diag(2 * damping * frequencies)
rates = -np.linalg.solve(mass, np.hstack([stiffness, friction]))
A = np.vstack([np.hstack([np.zeros((3, 3)), np.eye(3)]), rates])
B = np.vstack([np.zeros((3, 1)), np.linalg.solve(mass, [[1.0], [0.0], [0.0]])])
plant = control.ss(A, B, np.eye(1, 6), 0)

names = ["angle [rad]", "mode 1", "mode 2"]
problem = lfo.OptimalControlProblem(
    lfo.LinearDynamics.from_statespace(
        plant,
        sampling_time=0.25,
        state_names=[*names, "rate [rad/s]", "mode 1 rate", "mode 2 rate"],
        control_names=["torque [N m]"],
    ),
    horizon=240,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-0.8, 0.8),
    state_set=lfo.Box(
        [None] * 3 + [-0.025, None, None], [None] * 3 + [0.0255, None, None]
    ),
    initial_state=np.zeros(6),
    terminal_state=[np.pi / 4, 0, 0, 0, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=cutoff_hz),
    name="satellite",
)
result = lfo.solve(problem)
print(f"{result.status}: cost {result.cost:.6g}; {result.certificate.pmp}")
deflection = np.abs(result.trajectory.x[:, 1:3]).max(axis=0)
largest = abs(result.control).max()
print(f"largest torque {largest:.3f} N m, deflections {deflection.round(3)}")
figure = result.plot()
figure.savefig("satellite.png")
print("picture: satellite.png")
