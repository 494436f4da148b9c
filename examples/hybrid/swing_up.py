"""
A smooth map: swing up a pendulum
=================================

The torque is too small to lift the pendulum at once.

A pendulum of 1 kg and 1 m hangs at rest, and must stand upright at rest after 4 s. The
torque is at most 5 N m, half of the torque that holds the pendulum level. The cost
weighs torque, angle and rate. Newton's method on the maximum principle finds a local
optimum, and the status says so.
"""

import numpy as np

import lin_freq_ocp as lfo

torque = 5.0  # largest torque in N m: change this number
period = 0.05  # s


def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the derivatives of angle and rate in time."""
    return np.array([x[1], u[0] - 9.81 * np.sin(x[0])])


def after_a_period(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the next state, by one step of the Runge-Kutta method."""
    a = rates(x, u)
    b = rates(x + period / 2 * a, u)
    c = rates(x + period / 2 * b, u)
    d = rates(x + period * c, u)
    return x + period / 6 * (a + 2 * b + 2 * c + d)


problem = lfo.OptimalControlProblem(
    dynamics=lfo.PiecewiseSmoothDynamics.from_formulas(
        after_a_period,
        2,
        1,
        sampling_time=period,
        state_names=["angle [rad]", "rate [rad/s]"],
        control_names=["torque [N m]"],
    ),
    horizon=80,
    cost=lfo.QuadraticCost(Q=np.diag([0.05, 0.01]), R=0.1, x_ref=[np.pi, 0]),
    control_set=lfo.Box(-torque, torque),
    initial_state=[0, 0],
    terminal_state=[np.pi, 0],
    name="swing up",
)
result = lfo.solve(problem, global_bound=False)
lowest = result.trajectory.x[:, 0].min()
print(f"{result.status}: cost {result.cost:.6f}; {result.certificate.pmp}")
print(f"the pendulum first swings back to {np.degrees(lowest):.0f} deg")
figure = result.plot()
figure.savefig("swing_up.png")
print("picture: swing_up.png")
