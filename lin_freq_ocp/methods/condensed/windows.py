"""Limits on the spectrum of the applied controls in windows: their tables for kernel.c (docs/condensed.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.methods.condensed.tables import CondensedTables

FACETS = 16  # LFO_FACETS of kernel.h: of the polygon in the disc of a point
FACET_LEVEL = float(np.cos(np.pi / FACETS))  # of a facet, relative to the radius of the disc
WAVE_ROUNDING = 1e-12  # relative; a row of rounding errors alone would have a multiplier without a limit
DIRECTIONS = np.exp(2j * np.pi * np.arange(FACETS) / FACETS)


@dataclass(frozen=True, eq=False)
class WindowSet:
    """The limit |V| <= 1 of one control, V = sum_j taper_j exp(-iwj) v_{b+j} / level, in every window from b on.

    Windows begin every ``hop`` samples. ``begin`` is that of the oldest one which is not over at the first step,
    counted from the begin of its plan; ``past`` are the samples before.
    """

    component: int
    hop: int
    begin: int
    taper: Array  # (length,)
    frequencies: Array  # (points,), rad/sample
    levels: Array  # (points,), in the unit of the control
    past: Array  # (P,), in the unit of the control

    @property
    def length(self) -> int:
        """Return the number of samples of a window."""
        return len(self.taper)

    def slots(self, horizon: int) -> int:
        """Return how many windows have begun before a plan ends and are not over; the last one holds a constant."""
        return (horizon + self.length - 2) // self.hop + 2

    def begins(self, first: int, begin: int, horizon: int) -> Indices:
        """Return the begins of the windows of all slots from that of a plan, (slots,).

        ``first`` is the slot of the oldest window, which begins at ``begin``.
        """
        ring = self.slots(horizon) - 1
        return np.append(begin + (np.arange(ring) - first) % ring * self.hop, horizon - 1)

    @property
    def waves(self) -> ComplexArray:
        """Return the coefficients of the samples of a window in V, (length, points)."""
        angles = np.outer(np.arange(self.length), self.frequencies)
        waves = self.taper[:, None] * np.exp(-1j * angles) / self.levels
        least = WAVE_ROUNDING * np.abs(waves).max(axis=0)
        parts = (np.where(np.abs(part) > least, part, 0.0) for part in (waves.real, waves.imag))
        return np.asarray(next(parts) + 1j * next(parts), dtype=np.complex128)

    def past_values(self, horizon: int) -> Array:
        """Return Re and Im of the sums of the past of all slots, (slots, 2 points)."""
        sums = np.zeros((self.slots(horizon), 2, len(self.frequencies)))
        for slot, samples in enumerate(sums[:-1]):
            age = -(self.begin + slot * self.hop)  # samples of the past in this window
            known = self.past[max(len(self.past) - age, 0) :] if age > 0 else self.past[:0]
            value = known @ self.waves[age - len(known) : age] if len(known) else np.zeros(1)
            samples[:] = value.real, value.imag
        return sums.reshape(len(sums), -1)

    def forces(self, of_set: WindowDuals, horizon: int) -> Array:
        """Return the forces of multipliers on the controls of a plan, (T,), which holds the last one."""
        found = np.zeros(horizon)
        on_samples = (self.waves[:, of_set.points] * of_set.duals.conj()).real
        times = of_set.begins + np.arange(self.length)[:, None]
        np.add.at(found, np.minimum(times[times >= 0], horizon - 1), on_samples[times >= 0])
        return found


@dataclass(frozen=True, eq=False)
class WindowDuals:
    """Multipliers of V at points of windows of a set, (count,): begins of the windows from that of the plan, points."""

    begins: Indices
    points: Indices
    duals: ComplexArray  # those of the facets of a point sum to that of the disc


@dataclass(frozen=True, eq=False)
class ControlWindows:
    """The limits of all controls, and the states that follow from the controls alone, (n,)."""

    sets: tuple[WindowSet, ...]
    known: Mask

    def cells(self, horizon: int) -> list[int]:
        """Return how many points the windows of each set have."""
        return [one.slots(horizon) * len(one.frequencies) for one in self.sets]

    def duals(self, horizon: int, rows: Indices, weights: Array, first: Indices, begin: Indices) -> list[WindowDuals]:
        """Return the multipliers of each set from the active rows, of which those from 0 on are of windows.

        ``first`` are the slots of the oldest windows, and ``begin`` when these begin, (sets,).
        """
        (cells, facets), found, end = np.divmod(rows, FACETS), list[WindowDuals](), 0
        for one, count, oldest, when in zip(self.sets, self.cells(horizon), first, begin, strict=True):
            slots, points = np.divmod(cells - end, len(one.frequencies))
            own, end = (cells >= end) & (cells < end + count), end + count
            on_points = np.asarray(weights[own] * DIRECTIONS[facets[own]], dtype=np.complex128)
            found.append(WindowDuals(one.begins(oldest, when, horizon)[slots[own]], points[own], on_points))
        return found

    def integers(self, horizon: int) -> dict[str, int]:
        """Return integers of lfo_model."""
        return {"sets": len(self.sets), "cells": sum(self.cells(horizon)), "inner": int(self.known.sum())}

    def fields(self, horizon: int) -> list[dict[str, int]]:
        """Return the integers of lfo_windows of each set."""
        firsts = np.cumsum([0, *self.cells(horizon)]).tolist()
        return [
            {
                "length": one.length, "hop": one.hop, "points": len(one.frequencies), "slots": one.slots(horizon),
                "component": one.component, "begin": one.begin, "cell": first,
            }
            for one, first in zip(self.sets, firsts, strict=False)
        ]  # fmt: skip

    def arrays(self, tables: CondensedTables) -> dict[str, NDArray[np.floating | np.integer]]:
        """Return arrays of lfo_model by their names, and the waves of the sets as ``wave0``, ``wave1`` and so on."""
        (T, _, m), known, C = tables.loop.shape, self.known, tables.C
        on_controls = ~C[:, ~known].any(axis=1) & tables.D.any(axis=1)
        alone = ~C.any(axis=1) & (np.count_nonzero(tables.D, axis=1) == 1)
        kinds = np.where(alone, 1 + np.abs(tables.D).argmax(axis=1), -1) if m else np.zeros(len(C))
        return {
            "past": np.concatenate([one.past_values(T).ravel() for one in self.sets]),
            "inner_A": tables.loop.lti.A[np.ix_(known, known)],
            "inner_C": C[:, known],
            "inner_state": np.flatnonzero(known).astype(np.int16),
            "of_controls": np.where(on_controls, kinds, 0).astype(np.int16),
            **{f"wave{i}": np.hstack([one.waves.real, one.waves.imag]) for i, one in enumerate(self.sets)},
        }
