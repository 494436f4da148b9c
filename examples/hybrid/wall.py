"""
Contact: a pendulum at an elastic wall
======================================

A pendulum may lean on an elastic wall, which gives two affine modes.

The inverted pendulum of 1 kg and 1 m, linearised at the top, falls towards a wall at
0.1 rad. Over 20 steps of 20 ms, the cost weighs angle, rate and torque. The torque is
at most 4 N m and has no frequencies above 15 Hz. The search proves that no other mode
sequence costs less.
"""

import numpy as np

import lin_freq_ocp as lfo

h = 0.02  # s
B = [[0.0], [h]]
free = lfo.AffineMode([[1, h], [10 * h, 1]], B, G=[[1, 0]], h=[0.1], name="free")
contact = lfo.AffineMode(
    [[1, h], [-90 * h, 1]], B, [0, 10 * h], G=[[-1, 0]], h=[-0.1], name="contact"
)
dynamics = lfo.PiecewiseAffineDynamics(
    [free, contact],
    sampling_time=h,
    state_names=["angle [rad]", "rate [rad/s]"],
    control_names=["torque [N m]"],
)
problem = lfo.OptimalControlProblem(
    dynamics=dynamics,
    horizon=20,
    cost=lfo.QuadraticCost(Q=np.diag([200, 20]), R=2.0, P=np.diag([200, 20])),
    control_set=lfo.Box(-4, 4),  # change this number
    state_set=lfo.Box([-0.2, -1.5], [0.2, 1.5]),
    initial_state=[0.08, 0.6],
    control_spectrum=lfo.low_pass(cutoff_hz=15),
    name="pendulum at a wall",
)

for boundary in problem.borders:
    kind = "continuous" if boundary.continuous else "a jump"
    print(f"switching boundary of {free.name} and {contact.name}: {kind}")

result = lfo.solve(problem)
names = np.array(dynamics.mode_names)
print("modes    ", " ".join(names[result.sequence]))
print(f"cost      {result.cost:.6f}, no trajectory below {result.lower_bound:.6f}")
print(f"maximum principle {result.certificate.pmp}; {result.certificate.borders}")

# the optimum without the limit, filtered, and simulated with the true modes
comparison = lfo.compare(problem)
for filtered in comparison.filtered:
    measures = filtered.replay.measures
    energy = measures.stopband_energy
    print(
        f"{filtered.name:15} cost {measures.cost:.4f}, energy in the band {energy:.2g}"
    )
figure = comparison.plot()
figure.savefig("wall.png")
print("picture: wall.png")
