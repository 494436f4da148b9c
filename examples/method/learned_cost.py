"""
What an expert cares about
==========================

Weights and a target are learned from an expert's moves, with a low pass in the layer.

An expert swings a load on a rope by a trolley and never moves the trolley above 0.5 Hz.
The cost behind it is unknown. Each step of the fit solves the moves for a guess of the
cost and takes the exact gradient of the error through these optimal controls,
``solve_many(...).vjp``: bounds and removed frequencies hold for every guess. Layers of
PyTorch and JAX (``lfo.to_torch``, ``lfo.to_jax``) have the same gradient:
:doc:`/how_to/learn` fits the same moves in PyTorch.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import lin_freq_ocp as lfo

moves, noise = 6, 0.01  # of the expert; the noise in m/s^2: change these numbers
T, step, rope = 60, 0.1, 2.0  # steps, s, m
rng = np.random.default_rng(2)
starts = rng.uniform(-1, 1, (moves, 4)) * [1.0, 0.3, 0.2, 0.2]
swing = np.zeros((4, 4))  # trolley and load: positions, then speeds
swing[[0, 1], [2, 3]], swing[3, :2] = 1.0, np.array([9.81, -9.81]) / rope
trolley = lfo.LinearDynamics.from_continuous(
    swing,
    [[0.0], [0.0], [1.0], [0.0]],
    step,
    state_names=["trolley [m]", "load [m]", "trolley speed [m/s]", "load speed [m/s]"],
    control_names=["acceleration [m/s^2]"],
)


def optimal_moves(parameters):
    """Return the moves for logarithms of two weights, of the load, and a target."""
    weights, target = np.exp(parameters[:2]), parameters[2]
    cost = lfo.QuadraticCost(
        Q=np.diag([0.1, weights[0], 0.0, weights[1]]),
        R=1.0,
        x_ref=[target, target, 0.0, 0.0],
    )
    problem = lfo.OptimalControlProblem(
        trolley,
        T,
        cost,
        control_set=lfo.Box(-0.6, 0.6),
        control_spectrum=lfo.low_pass(cutoff_hz=0.5),
    )
    return lfo.solve_many(problem, starts)


def error(parameters, shown):
    """Return the squared error of the controls, and its gradient."""
    found = optimal_moves(parameters)
    wrong = found.controls - shown
    gradient = found.vjp(u=2 * wrong)
    weights = np.exp(parameters[:2]) * np.diag(gradient["Q"])[[1, 3]]
    target = gradient["x_ref"][..., :2].sum()
    return float((wrong**2).sum()), np.array([*weights, target])


secret = np.array([np.log(5.0), np.log(0.5), 0.4])
shown = optimal_moves(secret).controls
shown = shown + noise * rng.standard_normal(shown.shape)
first = np.array([0.0, 0.0, 0.0])
fit = minimize(error, first, (shown,), jac=True, method="BFGS", options={"gtol": 1e-3})
load, speed = np.exp(fit.x[:2])
print(f"{fit.nfev} batches of {moves} moves, each with its gradient")
print(
    f"load {load:.2f} (5), load speed {speed:.3f} (0.5), target {fit.x[2]:.3f} m (0.4)"
)

figure, axes = plt.subplots(2, 1, figsize=(6.4, 4.8), sharex=True, layout="constrained")
times = step * np.arange(T + 1)
for name, style, guess in (("first guess", "--", first), ("learned", "-", fit.x)):
    found = optimal_moves(guess)
    axes[0].plot(times, found.states[0, :, 1], style, label=name)
    axes[1].step(times[:-1], found.controls[0, :, 0], style, where="post", label=name)
axes[1].plot(
    times[:-1] + step / 2, shown[0, :, 0], "k.", ms=3, label="expert, measured"
)
axes[0].set(ylabel="load [m]")
axes[1].set(ylabel="acceleration [m/s²]", xlabel="time [s]")
axes[0].legend()
axes[1].legend()
figure.savefig("learned_cost.png", dpi=150)
print("picture: learned_cost.png, one of the moves")
