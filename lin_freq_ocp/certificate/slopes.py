"""Terms h(v) along a direction: by how much a constraint is left, and how fast a price rises."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.terms.penalties import Below, Cone
from lin_freq_ocp.problem.terms.term import Term


def leaving(term: Term, v: Array, change: Array, near: float) -> float:
    """Return by how much a change of v leads out of a hard term that is active, or violated, to first order."""
    if not term.hard:
        return 0.0
    penalty = term.penalty
    if isinstance(penalty, Below):
        return _largest(np.where(v >= penalty.limit - near, change, 0.0))
    if isinstance(penalty, Cone):
        tail = np.sqrt((v[:, 1:] ** 2).sum(1))
        return _largest(
            np.where(tail >= v[:, 0] - near, _slope_of_norm(v[:, 1:], change[:, 1:], 2, near) - change[:, 0], 0)
        )
    radius = np.broadcast_to(penalty.radius, v.shape[:1])
    slope = _slope_of_norm(v, change, penalty.order, near)
    return _largest(np.where(_norm(v, penalty.order) >= radius - near, slope, 0.0))


def slope_of_penalty(term: Term, v: Array, change: Array, near: float) -> float:
    """Return the derivative of a soft term or nonsmooth cost along a change of v; the larger one near a kink."""
    penalty = term.penalty
    if term.hard or isinstance(penalty, Cone):
        return 0.0
    if isinstance(penalty, Below):
        excess, rise = v - penalty.limit, change
    else:
        excess = _norm(v, penalty.order) - penalty.radius
        rise = _slope_of_norm(v, change, penalty.order, near)
        if not np.any(penalty.radius):
            return float((penalty.weight * rise).sum())
    return float(
        (penalty.weight * np.where(excess > near, rise, np.where(excess < -near, 0, np.maximum(rise, 0)))).sum()
    )


def recession(term: Term, change: Array) -> tuple[float, float]:
    """Return by how much a change of v, repeated for ever, leads out of a hard term, and what it costs per unit."""
    penalty = term.penalty
    if isinstance(penalty, Below):
        rising = np.where(np.isfinite(penalty.limit), np.maximum(change, 0.0), 0.0)
    elif isinstance(penalty, Cone):
        rising = penalty.violation(change)
    else:
        rising = np.where(np.isfinite(penalty.radius), _norm(change, penalty.order), 0.0)
    if term.hard:
        return _largest(rising), 0.0
    return 0.0, float((penalty.weight * rising).sum())


def _norm(v: Array, order: float) -> Array:
    return np.asarray(np.linalg.norm(v, order, axis=1), dtype=np.float64)


def _slope_of_norm(v: Array, change: Array, order: float, near: float) -> Array:
    """Return the derivative of |v| along a change, per group; entries nearer than ``near`` to a kink count as on it."""
    if order == 2:
        size = _norm(v, 2)
        along = (v * change).sum(1) / np.where(size > 0, size, 1.0)
        return np.where(size > near, along, _norm(change, 2))
    by_entry = np.where(np.abs(v) > near, np.sign(v) * change, np.abs(change))
    if order == 1:
        return by_entry.sum(1)
    largest = np.abs(v) >= np.abs(v).max(1, keepdims=True) - near
    return np.where(largest, by_entry, -np.inf).max(1)


def _largest(values: Array) -> float:
    return float(np.max(values, initial=0.0))
