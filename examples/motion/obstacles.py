"""
Between two obstacles, with a low pass on the force
===================================================

A mass moves between two discs, while its actuator follows up to 1.5 Hz.

The discs are path constraints h(x) <= 0, which are not convex. Without the low pass,
the best path touches both discs. Filtered afterwards, its force leads through one of
them and misses the end. With the low pass as a constraint, the path stays outside of
both.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle

import lin_freq_ocp as lfo

CENTRES, RADII = [(-0.4, -0.25), (0.4, 0.25)], [0.4, 0.4]  # in m


def inside(x, u):
    """Return how far the mass is within each disc, in m^2: zero or less is outside."""
    parts = zip(CENTRES, RADII, strict=True)
    return [r**2 - (x[0] - a) ** 2 - (x[1] - b) ** 2 for (a, b), r in parts]


mass = lfo.LinearDynamics.from_continuous(
    np.eye(4, k=2),
    np.eye(4, 2, k=-2),
    sampling_time=0.05,
    state_names=["x [m]", "y [m]", "speed x [m/s]", "speed y [m/s]"],
    control_names=["force x [N]", "force y [N]"],
)
problem = lfo.OptimalControlProblem(
    mass,
    horizon=60,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-8, 8),
    initial_state=[-1, 0, 0, 0],
    terminal_state=[1, 0, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=1.5),  # change this number
    stage_rows=lfo.sets.PathConstraint(inside, name="discs"),
    name="obstacles",
)
print("The searches with and without the low pass take some seconds.")
comparison = lfo.compare(problem, ["brickwall"])
replay = comparison.filtered[0].replay
(discs,) = problem.stage_rows
for name, path in (
    ("without", comparison.classical.trajectory),
    ("filtered", replay.trajectory),
    ("constrained", comparison.constrained.trajectory),
):
    depth = discs.violation(path.x, path.u).max()
    missed = np.abs(path.x[-1, :2] - problem.terminal_box.lower[:2]).max()
    print(f"{name:12} within a disc by {depth:.4f} m^2, ends {missed:.3f} m away")
print(f"maximum principle: {comparison.constrained.certificate.pmp}")

figure, axes = plt.subplots(figsize=(7, 4))
for centre, radius in zip(CENTRES, RADII, strict=True):
    axes.add_patch(Circle(centre, radius, color="0.85"))
for name, path in (
    ("without low pass", comparison.classical.trajectory),
    ("filtered afterwards", replay.trajectory),
    ("low pass as constraint", comparison.constrained.trajectory),
):
    axes.plot(path.x[:, 0], path.x[:, 1], ".-", markersize=4, label=name)
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()
figure.savefig("obstacles.png")
print("picture: obstacles.png")
