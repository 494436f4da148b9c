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

problem = lfo.library.double_integrator()
A, B, T = problem.linear.A, problem.linear.B, problem.horizon

x, u = cp.Variable((T + 1, 2)), cp.Variable((T, 1))
removed = np.flatnonzero(problem.control_stop[:, 0])
angle = 2 * np.pi * np.outer(removed, np.arange(T)) / T
constraints = [
    x[1:] == x[:-1] @ A.T + u @ B.T,
    x[0] == problem.initial_box.lower,
    x[T] == problem.terminal_box.lower,
    cp.abs(x[:, 1]) <= problem.state_boxes.upper[0, 1],
    cp.abs(u) <= problem.control_tube.upper,
    np.cos(angle) @ u == 0,
    np.sin(angle[removed < T / 2]) @ u == 0,
]
cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u)), constraints).solve(solver=cp.CLARABEL)

certificate = lfo.certify(problem, lfo.Trajectory(x.value, u.value))
print(f"maximum principle: {certificate.pmp}; gap {certificate.gap:.1e}")

nudged = u.value.copy()
nudged[100] += 0.01
certificate = lfo.certify(problem, nudged)
print(f"after a nudge of 0.01 at t = 100: {certificate.pmp}")
for condition in certificate.failed:
    violation = f"{condition.relative:.1e} at t = {condition.time}"
    print(f"  {condition.label:6}{condition.name}: {violation}")

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.step(
    problem.times[:-1],
    np.column_stack([u.value[:, 0], nudged[:, 0]]),
    where="post",
    label=["CVXPY", "nudged"],
)
axes.set(xlabel="time [s]", ylabel=problem.control_names[0])
axes.legend()
