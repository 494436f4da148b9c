"""
Filter or solve: the pendulum of the paper
==========================================

Filtering the optimal force afterwards violates its bounds and misses the target.

A cart moves an inverted pendulum by 0.3 m within 2.4 s, with the least squared force.
The force is at most 5 N, and the actuator follows up to 40 Hz. A constraint on the
spectrum meets bounds and target, at a known extra cost.
"""

from math import pi

import lin_freq_ocp as lfo

force = 5.0  # N: change this number
cart, mass, length, gravity = 2.5, 0.6, 0.25, 9.8  # kg, kg, half the rod in m, m/s^2
inertia = 4 / 3 * mass * length**2
pivot = inertia + mass * length**2
moved = mass + cart - ((mass * length) ** 2 / inertia + mass * length**2)  # as printed
plant = lfo.LinearDynamics.from_continuous(
    [
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [0, -((mass * length) ** 2) * gravity / (pivot * moved), 0, 0],
        [0, mass * gravity * length * (mass + cart) / (pivot * moved), 0, 0],
    ],
    [[0], [0], [1 / moved], [-mass * length / (pivot * moved)]],
    sampling_time=0.01,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)
states = [0.2, 20 * pi / 180, 15, 30]  # the largest
problem = lfo.OptimalControlProblem(
    plant,
    horizon=240,
    cost=lfo.QuadraticCost(R=2.0),
    control_set=lfo.Box(-force, force),
    state_set=lfo.Box([-largest for largest in states], states),
    initial_state=[-0.15, 0.1, 0, 0],
    terminal_state=[0.15, -0.1, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=40),
    name="pendulum",
)
comparison = lfo.compare(problem, filters=["brickwall", "butterworth"])
for filtered in comparison.filtered:
    measures = filtered.replay.measures
    missed = measures.terminal_errors
    print(
        f"{filtered.name:12} peaks at {measures.max_control:.3f} N "
        f"and misses the end by {missed[0]:.3f} m and {missed[1]:.2f} rad"
    )
extra = comparison.constrained.cost / comparison.classical.cost - 1
largest = comparison.constrained_measures.max_control
print(f"constrained  {largest:.3f} N, meets the end, costs {extra:.1%} more")
print(f"maximum principle: {comparison.constrained.certificate.pmp}")
figure = comparison.plot()
figure.savefig("pendulum.png")
print("picture: pendulum.png")
