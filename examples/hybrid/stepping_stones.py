"""
Stepping stones: regions with gaps
==================================

A point may stand only on the stones: outside all regions, no trajectory is feasible.

The point goes from 0.5 m to 3.5 m in eight steps of at most 1 m, over stones at 0 to
1 m, 1.6 to 1.9 m and 2.8 to 4 m. The cost is half the sum of the squared steps. The
search proves which steps are best.
"""

import numpy as np

import lin_freq_ocp as lfo

stones = [(0.0, 1.0), (1.6, 1.9), (2.8, 4.0)]  # in m: change these numbers
modes = [
    lfo.AffineMode(
        [[1.0]], [[1.0]], G=[[-1.0], [1.0]], h=[-low, high], name=f"stone {k}"
    )
    for k, (low, high) in enumerate(stones, start=1)
]
problem = lfo.OptimalControlProblem(
    lfo.PiecewiseAffineDynamics(
        modes, state_names=["position [m]"], control_names=["step [m]"]
    ),
    horizon=8,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-1, 1),
    state_set=lfo.Box(-1, 5),
    initial_state=[0.5],
    terminal_state=[3.5],
    name="stepping stones",
)
print("no mode", problem.gap)
result = lfo.solve(problem)
print("positions", np.round(result.trajectory.x[:, 0], 4))
print(f"cost {result.cost:.6f}, no trajectory below {result.lower_bound:.6f}")
figure = result.plot()
figure.savefig("stepping_stones.png")
print("picture: stepping_stones.png")
