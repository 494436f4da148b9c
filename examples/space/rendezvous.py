"""
A rendezvous in an elliptic orbit
=================================

A satellite approaches another one in an elliptic orbit with a slowly changing thrust.

The chaser starts 10 km behind its target and meets it after 4 h. Both thrusts are at
most 0.1 mm/s^2, with no frequencies above 0.3 mHz, and the radial distance is at most
0.8 km. The equations of Tschauner and Hempel describe the relative motion; in each
period of 80 s they are those of its middle. The dynamics vary in time, so the
structured interior-point method solves the problem. Without a C compiler, the sparse
program takes less time and is solved instead.
"""

import numpy as np
from scipy.integrate import solve_ivp

import lin_freq_ocp as lfo

eccentricity, perigee = 0.7, 6.9e6  # of the target's orbit, in m: change these numbers
horizon, period = 180, 80.0  # s
slowest = np.sqrt(3.986004418e14 / (perigee * (1 + eccentricity)) ** 3)


def turn_rate(anomaly: np.ndarray) -> np.ndarray:
    """Return how fast the target turns about the Earth, in rad/s."""
    return slowest * (1 + eccentricity * np.cos(anomaly)) ** 2


middles = period * (np.arange(horizon) + 0.5)
orbit = solve_ivp(
    lambda t, anomaly: turn_rate(anomaly),
    (0, middles[-1]),
    [-0.9 * np.pi],  # the target's true anomaly at the start
    t_eval=middles,
    rtol=1e-9,
)
thrust = np.vstack([np.zeros((2, 2)), 1e-3 * np.eye(2)])  # mm/s^2 to m/s^2
sampled = []
for anomaly in orbit.y[0]:
    w, approach = turn_rate(anomaly), 1 + eccentricity * np.cos(anomaly)
    gravity = w**2 / approach  # 1/s^2
    change = -2 * gravity * eccentricity * np.sin(anomaly)  # of w, in rad/s^2
    motion = [  # of distances in km and speeds in m/s
        [0, 0, 1e-3, 0],
        [0, 0, 0, 1e-3],
        [1e3 * (w**2 + 2 * gravity), 1e3 * change, 0, 2 * w],
        [-1e3 * change, 1e3 * (w**2 - gravity), -2 * w, 0],
    ]
    sampled.append(lfo.LinearDynamics.from_continuous(motion, thrust, period))

problem = lfo.OptimalControlProblem(
    dynamics=lfo.LinearDynamics(
        np.stack([step.A for step in sampled]),
        np.stack([step.B for step in sampled]),
        sampling_time=period,
        state_names=[
            "radial distance [km]",
            "along-track distance [km]",
            "radial speed [m/s]",
            "along-track speed [m/s]",
        ],
        control_names=["radial thrust [mm/s^2]", "along-track thrust [mm/s^2]"],
    ),
    horizon=horizon,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-0.1, 0.1),
    state_set=lfo.Box({"radial distance": (-0.8, 0.8)}),
    initial_state=[0, -10, 0, 0],
    terminal_state=[0, 0, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=3e-4),
    name="rendezvous",
)
result = lfo.solve(problem)
used = period * abs(result.control).sum(axis=0) / 1e3  # m/s
print(f"solved by method {result.method}: cost {result.cost:.6g}, gap {result.gap:.1e}")
print(f"thrust for {used[0]:.3f} m/s radially and {used[1]:.3f} m/s along the track")
figure = result.plot()
figure.savefig("rendezvous.png")
print("picture: rendezvous.png")
