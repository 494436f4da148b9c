"""
An active suspension: less vibration where passengers feel it
=============================================================

A car crosses a bump without vertical motion of its body at 4 to 8 Hz.

The bump is 8 cm high and 0.25 s long. The suspension has a force of at most 2 kN and a
travel of 7.5 cm. The cost weighs the acceleration of the body, the deflection of the
tyre and the force. Passengers are most sensitive between 4 and 8 Hz: the speed of the
body has no bins in this band.
"""

import numpy as np

import lin_freq_ocp as lfo

bump = 0.08  # height in m: change this number
body, wheel = 290.0, 59.0  # kg
spring, damper, tyre = 16812.0, 1000.0, 190000.0  # N/m, N s/m, N/m
step, horizon = 0.01, 300  # 3 s
A = np.array(
    [
        [0, 1, 0, -1],
        [-spring / body, -damper / body, 0, damper / body],
        [0, 0, 0, 1],
        [spring / wheel, damper / wheel, -tyre / wheel, -damper / wheel],
    ]
)
force = np.array([0, 1000 / body, 0, -1000 / wheel])  # of 1 kN
climb = np.array([0, 0, -1, 0])  # of a road that rises by 1 m/s
sampled = lfo.LinearDynamics.from_continuous(A, np.column_stack([force, climb]), step)

times = step * np.arange(horizon + 1)
height = bump / 2 * (1 - np.cos(8 * np.pi * times))
road = np.where((times >= 0.5) & (times <= 0.75), height, 0)
car = lfo.LinearDynamics(
    sampled.A,
    sampled.B[:, :1],
    offset=np.outer(np.diff(road) / step, sampled.B[:, 1]),
    sampling_time=step,
    state_names=[
        "travel [m]",
        "body speed [m/s]",
        "tyre deflection [m]",
        "wheel speed [m/s]",
    ],
    control_names=["force [kN]"],
)
acceleration = np.append(A[1], force[1])  # of the body, from states and force
weights = np.outer(acceleration, acceleration) + np.diag([0, 0, 1000, 0, 0.1])
problem = lfo.OptimalControlProblem(
    car,
    horizon,
    cost=lfo.QuadraticCost(Q=weights[:4, :4], S=weights[:4, 4:], R=weights[4:, 4:]),
    control_set=lfo.Box(-2, 2),
    state_set=lfo.Box({"travel": (-0.075, 0.075)}),
    initial_state=[0, 0, 0, 0],
    state_spectrum=lfo.spectrum.notch(centre_hz=6, width_hz=4, component="body speed"),
    name="suspension",
)
comparison = lfo.compare(problem)
constrained, classical = comparison.constrained, comparison.classical
print(f"with the stop band: cost {constrained.cost:.6g}; without: {classical.cost:.6g}")
stopped = problem.state_stop.any(axis=1)
for name, answer in (("with", constrained), ("without", classical)):
    spectrum = np.abs(np.fft.rfft(answer.trajectory.x[:, 1]))[stopped]
    speed = 2e3 / len(times) * spectrum.max()  # amplitude in mm/s
    print(f"{name:8}the body moves at up to {speed:.2g} mm/s between 4 and 8 Hz")
figure = comparison.plot()
figure.savefig("suspension.png")
print("picture: suspension.png")
