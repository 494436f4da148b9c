"""The order in which many initial states are solved: each begins with the answer of one that is near it."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices

BLOCK = 1000  # states among which the nearest is looked for: 1000 steps of some 20 microseconds


def tour(states: Array) -> Indices:
    """Return an order of states (N, n), each near the one before, measured in their own spread."""
    spread = states.std(0)
    scaled = (states - states.mean(0)) / np.where(spread > 0, spread, 1.0)
    along = np.argsort(scaled[:, int(np.argmax(np.abs(scaled).max(0)))], kind="stable")
    blocks = [along[first : first + BLOCK] for first in range(0, len(along), BLOCK)]
    return np.concatenate([block[_nearest(scaled[block])] for block in blocks])


def _nearest(points: Array) -> Indices:
    """Return an order that begins at the first point and goes on to the nearest that is left."""
    order, left = np.zeros(len(points), dtype=np.intp), np.ones(len(points), dtype=bool)
    for step in range(1, len(points)):
        left[order[step - 1]] = False
        distance = ((points - points[order[step - 1]]) ** 2).sum(1)
        order[step] = np.argmin(np.where(left, distance, np.inf))
    return order
