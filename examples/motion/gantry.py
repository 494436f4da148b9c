"""
A gantry: least time with a jerk limit and two resonances
=========================================================

Move a gantry by 0.3 m at 1 kHz, and leave neither of two resonances vibrating.

The speed is at most 1 m/s, the acceleration 10 m/s^2, and its change 2 m/s^2 per
sample. The resonances at 12.3 and 31 Hz are known to 10 %; their vibration after the
move is at most 0.2 m/s^2. The move starts and ends without a jump of the acceleration.
``lfo.compare`` finds the shortest move with a proof, and the shortest move with an
input shaper for both resonances.
"""

import lin_freq_ocp as lfo

jerk = 2.0  # change of the acceleration per 1 ms, in m/s^2: change this number
axis = lfo.LinearDynamics.from_continuous(
    [[0, 1], [0, 0]],
    [[0], [1]],
    sampling_time=0.001,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["acceleration [m/s^2]"],
)
vibration = [
    lfo.ResidualVibration((0.9 * f, 1.1 * f), damping=0.02, limit=0.2)
    for f in (12.3, 31.0)
]
move = lfo.OptimalControlProblem(
    axis,
    horizon=450,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-10, 10),
    state_set=lfo.Box([None, -1], [None, 1]),
    initial_state=[0, 0],
    terminal_state=[0.3, 0],
    control_spectrum=vibration,
    name="gantry",
)
limited = lfo.rate_limited(move, jerk, previous=0, following=0)
print("The search for the shortest moves takes some seconds.")
comparison = lfo.compare(limited, ["ZVD"])
for plan in comparison.moves.all:
    print(f"{plan.name:10}{plan}")
print("no shorter one exists:", comparison.moves.proof)
figure = comparison.plot()
figure.savefig("gantry.png")
print("picture: gantry.png")
