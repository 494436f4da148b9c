"""
Certify a trajectory from another tool
======================================

CVXPY solves a program written by hand, and ``lfo.certify`` checks its trajectory.

A unit mass moves 1 m in 4 s with the least squared acceleration. The acceleration is at
most 1 m/s^2 and has no frequencies above 5 Hz, the speed is at most 0.3 m/s. After a
small change of one sample, the certificate names the violated conditions.
"""

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

h, T = 0.02, 200  # 4 s
A, B = np.array([[1, h], [0, 1]]), np.array([[h**2 / 2], [h]])
x, u = cp.Variable((T + 1, 2)), cp.Variable((T, 1))
removed = np.arange(21, T // 2 + 1)  # bins of 0.25 Hz, above 5 Hz
angle = 2 * np.pi * np.outer(removed, np.arange(T)) / T
constraints = [
    x[1:] == x[:-1] @ A.T + u @ B.T,
    x[0] == [0, 0],
    x[T] == [1, 0],
    cp.abs(x[:, 1]) <= 0.3,
    cp.abs(u) <= 1,
    np.cos(angle) @ u == 0,
    np.sin(angle[:-1]) @ u == 0,
]
cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u)), constraints).solve(solver=cp.CLARABEL)

# the same problem in words that the certificate can check
problem = lfo.OptimalControlProblem(
    lfo.LinearDynamics(
        A,
        B,
        sampling_time=h,
        state_names=["position [m]", "speed [m/s]"],
        control_names=["acceleration [m/s^2]"],
    ),
    horizon=T,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-1, 1),
    state_set=lfo.Box({"speed": (-0.3, 0.3)}),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=5),
    name="unit mass",
)
certificate = lfo.certify(problem, lfo.Trajectory(x.value, u.value))
print(f"maximum principle: {certificate.pmp}; gap {certificate.gap:.1e}")

nudged = u.value.copy()
nudged[100] += 0.01  # change this number
certificate = lfo.certify(problem, nudged)
print(f"after a nudge at t = 100: {certificate.pmp}")
for condition in certificate.failed:
    violation = f"{condition.relative:.1e} at t = {condition.time}"
    print(f"  {condition.label:6}{condition.name}: {violation}")

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
both = np.column_stack([u.value[:, 0], nudged[:, 0]])
axes.step(problem.times[:-1], both, where="post", label=["CVXPY", "nudged"])
axes.set(xlabel="time [s]", ylabel=problem.control_names[0])
axes.legend()
figure.savefig("certify_another_tool.png")
print("picture: certify_another_tool.png")
