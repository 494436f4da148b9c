"""
Ten thousand steps, and repeated solves
=======================================

The Fourier-domain method solves a long horizon, and many initial states with one
set-up.

A cart moves an inverted pendulum by 0.3 m with a low-passed force of at most 5 N: first
over 10 000 steps of 10 ms, then over 240 steps from different initial states.
"""

import numpy as np

import lin_freq_ocp as lfo

cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
    [[0], [0], [0.38277512], [-0.65618592]],
    sampling_time=0.01,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)


def pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return the problem with so many steps of 10 ms."""
    return lfo.OptimalControlProblem(
        cart,
        horizon,
        cost=lfo.QuadraticCost(R=2.0),
        control_set=lfo.Box(-5, 5),
        state_set=lfo.Box([-0.2, -np.pi / 9, -15, -30], [0.2, np.pi / 9, 15, 30]),
        initial_state=[-0.15, 0.1, 0, 0],
        terminal_state=[0.15, -0.1, 0, 0],
        control_spectrum=lfo.low_pass(cutoff_hz=40),
        name="pendulum",
    )


problem = pendulum(horizon=10_000)  # change this number
result = lfo.solve(problem)  # "auto" chooses the Fourier-domain method
print(f"{problem.horizon} steps by method {result.method}: gap {result.gap:.1e}")

problem = pendulum(horizon=240)
solver = lfo.SpectralSolver(problem)  # sets up what ends and bounds do not change
nominal = solver.solve()
for moved in ([0.002, 0, 0, 0], [0, 0.004, 0, 0], [0, 0, 0.02, 0]):
    start = problem.initial_box.lower + moved
    solution = solver.solve(initial_state=start, warm_start=nominal)
    largest = np.abs(solution.trajectory.u).max()
    print(f"from {start}: {solution.status}, largest control {largest:.3f} N")
figure = result.plot()
figure.savefig("long_horizons.png")
print("picture: long_horizons.png, of the 10 000 steps")
