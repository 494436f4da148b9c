"""
A drive and its control together
================================

Stiffness and inertia are chosen with the optimal control, by the exact gradient.

A motor turns a load through a shaft by 1 rad in 1.6 s. A stiff shaft and a light load
cost something; so does torque. The derivative of the optimal cost by A and B,
``result.sensitivities``, needs no solve: with the chain rule through the sampled plant
it is the gradient for ``scipy.optimize``. Differences need a solve a parameter.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm
from scipy.optimize import minimize

import lin_freq_ocp as lfo

STEP, T = 0.02, 80


def plant(stiffness, inertia):
    """Return A and B of angles and speeds of motor and load, sampled."""
    shaft = np.array([stiffness, -stiffness, 0.02, -0.02])  # its torque
    both = np.zeros((5, 5))
    both[:2, 2:4], both[2, :4], both[3, :4] = np.eye(2), -shaft, shaft / inertia
    both[2, 4] = 1.0
    both = expm(STEP * both)
    return both[:4, :4], both[:4, 4:]


def design(p):
    """Return the cost of a design, and its gradient."""
    cost = lfo.QuadraticCost(Q=np.diag([0, 10.0, 0, 0]), R=0.01, x_ref=[1.0, 1.0, 0, 0])
    ends = {"initial_state": np.zeros(4), "terminal_state": [1.0, 1.0, 0, 0]}
    dynamics = lfo.LinearDynamics(*plant(*p))
    problem = lfo.OptimalControlProblem(dynamics, T, cost, lfo.Box(-9, 9), **ends)
    found = lfo.solve(problem)
    prices = found.sensitivities.A, found.sensitivities.B
    slopes = np.array([0.02, -4.0 / p[1] ** 2])
    for i, h in enumerate(1e-5 * p):  # differences of the plant alone cost no solve
        near = [plant(*(p + s * h * np.eye(2)[i])) for s in (1, -1)]
        for above, below, price in zip(*near, prices, strict=True):
            slopes[i] += ((above - below) * price).sum() / (2 * h)
    return found.cost + 0.02 * p[0] + 4.0 / p[1], slopes


start, bounds = np.array([20.0, 1.0]), [(2, 200), (0.2, 5)]
exact = minimize(design, start, jac=True, bounds=bounds)
differences = minimize(lambda p: design(p)[0], start, bounds=bounds)
print(f"stiffness {exact.x[0]:.1f} Nm/rad, inertia {exact.x[1]:.2f} kg m^2")
print(f"{exact.nfev} solves with the gradient, {differences.nfev} with differences")

figure, axis = plt.subplots(figsize=(6, 4))
stiffnesses, inertias = np.linspace(10, 160, 6), np.linspace(0.25, 1.1, 6)
costs = [[design(np.array([k, J]))[0] for k in stiffnesses] for J in inertias]
axis.contour(stiffnesses, inertias, costs, 20)
axis.plot(*start, "o", label="start")
axis.plot(*exact.x, "*", label="optimum")
axis.set(xlabel="stiffness [Nm/rad]", ylabel="inertia of the load [kg m$^2$]")
axis.legend()
figure.tight_layout()
figure.savefig("co_design.png")
print("picture: co_design.png")
