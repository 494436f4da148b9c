"""Weights and a target are learned from an expert's moves, with a low pass in the layer."""

import numpy as np
import torch

import lin_freq_ocp as lfo

rng, step, rope = np.random.default_rng(2), 0.1, 2.0  # s, m
swing = np.zeros((4, 4))  # trolley and load: positions, then speeds
swing[[0, 1], [2, 3]], swing[3, :2] = 1.0, np.array([9.81, -9.81]) / rope
problem = lfo.OptimalControlProblem(
    lfo.LinearDynamics.from_continuous(swing, [[0], [0], [1], [0]], step),
    horizon=60,
    cost=lfo.QuadraticCost(Q=np.eye(4), R=1.0),  # R is the unit of the cost
    control_set=lfo.Box(-0.6, 0.6),
    initial_state=np.zeros(4),
    control_spectrum=lfo.low_pass(cutoff_hz=0.5),
)
layer = lfo.to_torch(problem, ["Q", "x_ref", "initial_state"])
starts = torch.tensor(rng.uniform(-1, 1, (6, 4)) * [1.0, 0.3, 0.2, 0.2])
trolley, zero = torch.tensor([0.1, 0.0], dtype=torch.double)


def optimal_moves(parameters):
    """Return the controls, (6, 60, 1), for logarithms of two weights, of the load, and a target."""
    load, speed, target = parameters[0].exp(), parameters[1].exp(), parameters[2]
    Q = torch.diag(torch.stack([trolley, load, zero, speed]))
    return layer(Q, torch.stack([target, target, zero, zero]), starts)[1]


secret = torch.tensor([np.log(5.0), np.log(0.5), 0.4])
shown = optimal_moves(secret.double()) + 0.01 * torch.tensor(rng.standard_normal((6, 60, 1)))
learned = torch.zeros(3, dtype=torch.double, requires_grad=True)
fit = torch.optim.LBFGS([learned], max_iter=30, tolerance_grad=1e-3, line_search_fn="strong_wolfe")


def error():
    """Return the squared error of the controls, and leave its gradient in ``learned``."""
    fit.zero_grad()
    value = ((optimal_moves(learned) - shown) ** 2).sum()
    value.backward()
    return value


fit.step(error)
load, speed = learned[:2].detach().exp()
print(f"load {load:.2f} (5), load speed {speed:.3f} (0.5), target {learned[2]:.3f} m (0.4)")
