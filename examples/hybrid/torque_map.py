"""
A measured torque map
=====================

A motor, whose torque is a spline through measured points, drives wheels that may slip.

The motor accelerates from 20 to 190 rad/s in five steps of 0.5 s. The control is the
current, from 0 to 1 of its largest value. The torque at full current falls with the
speed from 9.6 to 3 N m, and the wheels transmit at most 5 N m of it. The cost is the
sum of the squared currents, without a component at the frequency that would shake the
driver.
"""

import numpy as np
from scipy.interpolate import CubicSpline

import lin_freq_ocp as lfo

SPEEDS = [0.0, 50.0, 100.0, 150.0, 200.0, 250.0]  # rad/s
TORQUES = [9.6, 9.2, 8.4, 6.5, 4.4, 3.0]  # N m at full current, as measured
GRIP = 5.0  # largest torque of the wheels in N m: change this number
torque_at = CubicSpline(SPEEDS, TORQUES)
slope_at = torque_at.derivative()


def torque(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the torque [Nm] at many speeds and parts of the full current."""
    return u[:, 0] * torque_at(x[:, 0])


def slopes(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the derivatives with respect to speed and current, (points, 2)."""
    return np.stack([u[:, 0] * slope_at(x[:, 0]), torque_at(x[:, 0])], axis=1)


motor = lfo.DifferentiableFunction(
    torque,
    slopes,
    vectorized=True,
    sizes=[100.0, 1.0],
    # at these points, the derivatives are compared with differences
    check_at=[([70.0], [0.4]), ([180.0], [0.9])],
)


def speed_after(x: np.ndarray, u: np.ndarray) -> list:
    """Return the speed after 0.5 s: the wheels transmit at most 5 Nm of the torque."""
    driving = lfo.minimum(motor(x, u)[0], GRIP, names=("grip", "slip"))
    return [x[0] + 0.5 / 0.05 * (driving - 1e-4 * x[0] ** 2)]


problem = lfo.OptimalControlProblem(
    dynamics=lfo.PiecewiseSmoothDynamics.from_formulas(
        speed_after,
        1,
        1,
        sampling_time=0.5,
        state_names=["speed [rad/s]"],
        control_names=["current"],
    ),
    horizon=5,
    cost=lfo.QuadraticCost(R=2.0),
    control_set=lfo.Box(0, 1),
    state_set=lfo.Box(0, 250),
    initial_state=[20.0],
    terminal_state=[190.0],
    control_spectrum=lfo.stop_band(
        bins=[2]
    ),  # the frequency that would shake the driver
)
result = lfo.solve(problem)
certificate = result.certificate
print("current", np.round(result.control[:, 0], 4))
print("speed  ", np.round(result.trajectory.x[:, 0], 1))
print("wheels ", " ".join(problem.mode_names[i] for i in result.sequence))
print(f"maximum principle {certificate.pmp}; {certificate.borders}")
print(f"cost {result.cost:.6f}, {result.message}")
figure = result.plot()
figure.savefig("torque_map.png")
print("picture: torque_map.png")
