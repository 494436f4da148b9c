"""
A gantry: least time with a jerk limit and two resonances
=========================================================

Move a gantry by 0.3 m at 1 kHz, and leave neither of two resonances vibrating.

Speed, acceleration and the change of the acceleration per sample are limited. The
resonances at 12.3 and 31 Hz are known to 10 %. ``rate_limited`` adds the previous
acceleration as a state: its terminal value of zero makes the move end without a jump,
and lets ``minimum_time`` bisect.
"""

from dataclasses import replace
from functools import partial

import lin_freq_ocp as lfo

jerk = 2.0  # change of the acceleration per 1 ms, in m/s^2: change this number
axis = lfo.LinearDynamics.from_continuous(
    [[0, 1], [0, 0]],
    [[0], [1]],
    sampling_time=0.001,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["acceleration [m/s^2]"],
)
calm = [
    lfo.ResidualVibration((0.9 * f, 1.1 * f), damping=(0.02, 0.02), limit=0.2)
    for f in (12.3, 31.0)
]


def gantry(horizon: int, vibration: list | None) -> lfo.OptimalControlProblem:
    """Return the move in so many milliseconds."""
    move = lfo.OptimalControlProblem(
        axis,
        horizon,
        cost=lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-10, 10),
        state_set=lfo.Box([None, -1], [None, 1]),
        initial_state=[0, 0],
        control_spectrum=vibration,
        name="gantry",
    )
    limited = lfo.rate_limited(move, jerk, previous=[0.0])
    return replace(limited, terminal_state=[0.3, 0, 0])  # position, speed, acceleration


rough = lfo.minimum_time(partial(gantry, vibration=None), horizons=(400, 500))
print(f"without the limits on vibration: {rough.horizon} ms")
minimum = lfo.minimum_time(partial(gantry, vibration=calm), horizons=(400, 500))
print(f"with them: {minimum.horizon} ms; {minimum.proof}")
figure = minimum.result.plot()
