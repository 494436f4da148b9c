"""
Several actuators, each with its own band
=========================================

Two forces act on a chain of masses, and each actuator has a stop band of its own.

Four masses of 1 kg vibrate between two walls, joined by springs of 10 N/m and dampers
of 0.1 N s/m. Forces on the first and on the last one, each at most 0.9 N, bring them to
rest within 20 s. The first actuator follows up to 3.95 Hz, the other one up to 5.95 Hz.
The cost weighs positions, speeds and forces.
"""

import numpy as np

import lin_freq_ocp as lfo

cutoffs_hz = {"first force": 3.95, "last force": 5.95}  # change these numbers
springs = 2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
A = np.block([[np.zeros((4, 4)), np.eye(4)], [-10 * springs, -0.1 * springs]])
B = np.zeros((8, 2))
B[4, 0] = B[7, 1] = 1  # on the first and on the last mass
chain = lfo.LinearDynamics.from_continuous(
    A,
    B,
    sampling_time=0.05,
    state_names=[
        *(f"position {i} [m]" for i in (1, 2, 3, 4)),
        *(f"speed {i} [m/s]" for i in (1, 2, 3, 4)),
    ],
    control_names=["first force [N]", "last force [N]"],
)
problem = lfo.OptimalControlProblem(
    chain,
    horizon=400,
    cost=lfo.QuadraticCost(Q=0.1, R=0.1, P=0.1),
    control_set=lfo.Box(-0.9, 0.9),
    state_set=lfo.Box(-6, 6),
    initial_state=[1, -0.5, 0.7, 0.3, 0, 0, 0, 0],
    terminal_state=np.zeros(8),
    control_spectrum=[
        lfo.low_pass(cutoff_hz=cutoff, component=name)
        for name, cutoff in cutoffs_hz.items()
    ],
    name="mass chain",
)
result = lfo.solve(problem)
for j, name in enumerate(problem.control_names):
    removed = problem.control_stop[:, j].sum()
    largest = abs(result.control[:, j]).max()
    print(f"{name}: {removed} bins removed, largest value {largest:.3f}")
print(f"{result.status}: cost {result.cost:.6g}; {result.certificate.pmp}")
figure = result.plot()
figure.savefig("several_controls.png")
print("picture: several_controls.png")
