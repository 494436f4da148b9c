"""Layers of PyTorch and JAX beside ``derivatives``; --save records their gradients for the tests."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
from rich.console import Console

from helpers.checks.layers import apart, by_derivatives, by_jax, by_torch

SEEDS = range(6)
LEARNING = Path(__file__).parents[2] / "docs" / "how_to" / "learn_a_cost.py"
LEARNED = 0.02  # of logarithms of weights and of a target, whose data have noise of 0.01


def verify(console: Console, save: Path | None, against: Path | None) -> bool:
    """Compare the gradients of both packages with those of this one, and learn a cost; return whether all is right.

    Gradients agree to 1e-9.
    """
    recorded, worst = dict[str, np.ndarray](), 0.0
    for package, gradients in (("torch", by_torch), ("jax", by_jax)):
        for seed in SEEDS:
            try:
                found = gradients(seed)
            except ImportError:
                console.print(f"layers: {package} is not installed; the tests compare with its recorded gradients")
                break
            distance = apart(found, by_derivatives(seed))
            console.print(f"layers: {package}, seed {seed}: {len(found)} gradients, apart {distance:.1e}")
            worst = max(worst, distance)
            recorded |= {f"{package}/{seed}/{name}": values for name, values in found.items()}
    if save is not None:
        np.savez_compressed(save, **recorded)
    try:
        found = runpy.run_path(str(LEARNING))
    except ImportError:
        return worst <= 1e-9
    away = float((found["learned"].detach() - found["secret"]).abs().max())
    console.print(f"layers: torch, weights and a target learned from moves with noise: {away:.1e} away")
    return worst <= 1e-9 and away <= LEARNED
