"""Gradients of random losses through layers of PyTorch and JAX, beside those of ``derivatives``."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.derivatives import random_problem, weights_of
from lin_freq_ocp.derivatives import data_of

NAMES = ("A", "B", "Q", "x_ref", "initial_state", "control_upper", "sum")
Gradients = dict[str, np.ndarray]


def sample(seed: int) -> tuple[lfo.OptimalControlProblem, list[np.ndarray], dict[str, np.ndarray]]:
    """Return a problem, its data, and weights of states and controls; the cost has the weight 1."""
    problem = random_problem(seed)
    return problem, [data_of(problem)[name] for name in NAMES], weights_of(problem, np.random.default_rng(seed))


def by_derivatives(seed: int) -> Gradients:
    """Return the gradients, and second derivatives of the cost along x_ref, by this package alone."""
    problem, data, weights = sample(seed)
    found = lfo.solve(problem).derivatives
    gradient, curved = found.vjp(**weights), found.prices_along(x_ref=np.ones(data[3].shape))
    first = {name: np.nan_to_num(gradient[name] + found.prices[name]) for name in NAMES}
    return first | {f"along x_ref, {name}": np.nan_to_num(curved[name]) for name in NAMES}


def by_torch(seed: int) -> Gradients:
    """Return the same by PyTorch."""
    import torch

    problem, data, weights = sample(seed)
    tensors = [torch.tensor(np.array(one), requires_grad=True) for one in data]
    w_x, w_u = (torch.tensor(weights[name]) for name in "xu")
    layer = lfo.to_torch(problem, NAMES)
    x, u, cost = layer(*tensors)
    ((w_x * x).sum() + (w_u * u).sum() + cost).backward()
    slopes = torch.autograd.grad(layer(*tensors)[2], tensors, create_graph=True)
    curved = torch.autograd.grad(slopes[3].sum(), tensors)
    found = {name: tensor.grad.numpy() for name, tensor in zip(NAMES, tensors, strict=True)}
    return found | {f"along x_ref, {name}": one.numpy() for name, one in zip(NAMES, curved, strict=True)}


def by_jax(seed: int) -> Gradients:
    """Return the first derivatives by JAX, under jit."""
    import jax

    jax.config.update("jax_enable_x64", True)
    problem, data, weights = sample(seed)
    layer = lfo.to_jax(problem, NAMES)

    def loss(*arrays: jax.Array) -> jax.Array:
        x, u, cost = layer(*arrays)
        return (weights["x"] * x).sum() + (weights["u"] * u).sum() + cost

    found = jax.jit(jax.grad(loss, argnums=tuple(range(len(NAMES)))))(*map(jax.numpy.asarray, data))
    return {name: np.asarray(one) for name, one in zip(NAMES, found, strict=True)}


def apart(found: Gradients, known: Gradients) -> float:
    """Return the largest difference, relative to the largest value of its datum."""
    sizes = {name: float(np.abs(known[name]).max()) or 1.0 for name in found}
    return max(float(np.abs(found[name] - known[name]).max()) / sizes[name] for name in found)
