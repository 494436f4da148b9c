"""
A 3D printer: the shortest move without vibration
=================================================

Move a print head by 40 mm and leave its frame at rest, compared with input shapers.

The acceleration is at most 8 m/s^2, the speed 0.5 m/s. The frame resonates at 25 Hz,
known to 10 %, and its vibration after the move is at most 5 % of the largest
acceleration. ``lfo.compare`` finds the shortest move with a proof that one sample less
is infeasible, and the shortest move with each shaper.
"""

import lin_freq_ocp as lfo

resonance_hz = 25.0  # change this number to that of your machine
axis = lfo.LinearDynamics.from_continuous(
    [[0, 1], [0, 0]],
    [[0], [1]],
    sampling_time=0.004,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["acceleration [m/s^2]"],
)
vibration = lfo.ResidualVibration(
    frequency=(0.9 * resonance_hz, 1.1 * resonance_hz), damping=(0.02, 0.1), limit=0.4
)
problem = lfo.OptimalControlProblem(
    axis,
    horizon=45,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-8, 8),
    state_set=lfo.Box([None, -0.5], [None, 0.5]),
    initial_state=[0, 0],
    terminal_state=[0.04, 0],
    control_spectrum=vibration,
    name="printer move",
)
print("The search for the shortest moves takes some seconds.")
comparison = lfo.compare(problem)
for move in comparison.moves.all:
    print(f"{move.name:10}{move}")
figure = comparison.plot()
figure.savefig("printer_move.png")
print("picture: printer_move.png")
