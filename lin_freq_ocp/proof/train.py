"""A proof of the optimum of a pulse train: its quarter, a train that meets all limits, and parts without a better one.

The file has what the checker needs to repeat each step: a lattice with prices, which leaves a narrower part, or none;
where a part is divided; and a local optimum with multipliers whose Lagrangian is convex over a part. The bounds of
angle_lattice.py and angles.py find these steps with a margin: the sums of the checker are coarser in the last digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise
from typing import cast

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import SolveError, UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.hybrid.angle_lattice import AngleLattice, AngleRange
from lin_freq_ocp.methods.hybrid.angles import (
    SUMS,
    bound_near,
    local_angles,
    local_prices,
    multipliers_of_limits,
    nearest_train,
)
from lin_freq_ocp.methods.hybrid.quarter import Quarter
from lin_freq_ocp.problem.hybrid.pulse_train import ANGLE, ENERGY, LEVEL, QUARTER, PulseTrain
from lin_freq_ocp.proof.enclosure import Enclosure
from lin_freq_ocp.proof.statement import line
from lin_freq_ocp.solving.hybrid.pulse_train import GAP, LATTICES, SAME_OPTIMUM, SMALLER
from lin_freq_ocp.solving.outcome import Outcome

TRAIN_BITS = 128  # of balls: a quarter has few angles
AT_LEAST = 1e-9  # distance from a limit of a dwell or an amplitude that is exactly met at the point of the proof
CURVATURE_MARGIN = 1e-12  # of the energy, by which curvature exceeds the level
NOTHING = Enclosure(-np.inf, np.inf)
MOST_LINES = 400  # of a proof, each a second of the checker, or less


@dataclass(frozen=True, eq=False)
class TrainProof:
    """The lines of the sections PROBLEM, POINT and NODES, and the claim between the first two."""

    problem: str
    claim: Enclosure
    body: list[str]

    def lines(self) -> Iterator[str]:
        """Yield the file, line by line."""
        yield line(format="lfo-proof", version=1, bits=TRAIN_BITS)
        yield self.problem
        yield line(section="claim", lower=self.claim.lower, upper=self.claim.upper)
        yield from self.body
        yield line(section="end")


def train_proof(outcome: Outcome) -> TrainProof:
    """Return a proof that the best train of a solve costs no more than the bound allows, or that there is none.

    It has no claim yet.
    """
    problem, certificate = outcome.problem, outcome.certificate
    dynamics, (start, end) = cast("PulseTrain", problem.dynamics), problem.ends  # of the method for angles
    quarter = Quarter.of_problem(problem, dynamics)
    if start.lower[4:].any() or start.upper[4:].any():
        raise UnsupportedError("initial_state: a proof of a pulse train states amplitudes that start at zero.")
    best, level, unit, point = None, np.inf, dynamics.step / quarter.step, list[str]()
    if outcome.trajectory is not None and certificate is not None and certificate.bound is not None:
        steps = quarter.step * np.sign(np.diff(outcome.trajectory.x[:-1, LEVEL]))
        local = local_angles(quarter, steps, outcome.trajectory.x[1:-1, ANGLE])
        if local is None:
            raise SolveError("No angles near the best train meet its limits.", outcome)
        best, level = (steps, local[0]), min(certificate.bound.value, local[1] - GAP * abs(local[1]))
        point = _point_line(quarter, *best)
    elif outcome.status != Status.INFEASIBLE:
        raise SolveError(f"There is nothing to prove: the solve ended as '{outcome.status}'.", outcome)
    stated = line(
        **{"section": "pulse train", "name": problem.name, "switches": len(quarter.dwells) - 1},
        **{"lowest": quarter.lowest, "highest": quarter.highest, "orders": list(quarter.orders)},
        **{"step": float(quarter.step * unit), "price": float(problem.quadratic.p[ENERGY])},
        **{"offset": float(start.lower[ENERGY]), "dwells": quarter.dwells, "low": end.lower[4:], "high": end.upper[4:]},
    )
    energy = level / quarter.price - quarter.offset
    nodes = list(islice(_part_lines(quarter, energy, best, unit), MOST_LINES + 1))
    if len(nodes) > MOST_LINES:
        raise SolveError(f"A proof that no train is better has more than {MOST_LINES} parts of the angles.", outcome)
    return TrainProof(stated, NOTHING, [*point, line(section="nodes", level=float(level)), *nodes])


def _point_line(quarter: Quarter, steps: Array, c: Array) -> list[str]:
    """Return the line of a train with dwells and amplitudes at their limits; none if these leave no angle free."""
    from scipy.linalg import qr  # slow to import

    least = np.diff(np.concatenate([[0.0], c, [QUARTER]])) - quarter.dwells < AT_LEAST
    b, slopes = quarter.amplitudes(steps, c)
    at = [
        "low" if value < low + AT_LEAST else "high" if value > high - AT_LEAST else ""
        for value, low, high in zip(b, quarter.low, quarter.high, strict=True)
    ]
    pinned = [bool(least[j + 1 :].all()) for j in range(len(c))]
    leaders = [j for j in range(len(c)) if not least[j] and not pinned[j]]
    ends = [*leaders, next((j for j in range(len(c)) if pinned[j] and not least[j]), len(c))]
    rows = np.array([slopes[:, i:j].sum(axis=1) for i, j in pairwise(ends)]).reshape(len(leaders), len(b)).T
    rows = rows[[bool(side) for side in at]]
    if len(rows) > len(leaders) or least.all():
        return []
    order = qr(rows, pivoting=True)[2][: len(rows)] if len(rows) else []
    move, signs = [leaders[i] for i in order], np.sign(steps).astype(int).tolist()
    return [line(section="point", signs=signs, angles=c, least=least.tolist(), at=at, move=move)]


def _part_lines(quarter: Quarter, energy: float, best: tuple[Array, Array] | None, unit: float) -> Iterator[str]:
    """Yield what leaves no train below an energy, part by part; ranges are shares of the quarter."""
    lattices, m = [AngleLattice(quarter, N) for N in LATTICES], len(quarter.dwells) - 1
    optima = [] if best is None else [(best[0], best[1], local_prices(quarter, best[0], best[1]))]
    waiting = [([(Fraction(0), Fraction(1))] * m, np.zeros(m, dtype=np.intp), 0, np.zeros(len(quarter.orders)))]
    while waiting:
        ranges, sign, level, r = waiting.pop()
        low_end, high_end = QUARTER * np.array(ranges, dtype=float).T
        part = AngleRange(low_end, high_end, sign)
        excluded_by = nearest_train(quarter, part.low, part.high, sign).excluded_by
        if excluded_by is not None:
            yield line(sums=SUMS, weights=excluded_by)
            continue
        near = [one for one in optima if part.is_near(one[0], one[1])]
        r = near[-1][2] if near else r
        bounds = [bound_near(quarter, s, at, part.low, part.high) for s, at, _ in near] if sign.all() else []
        proven = [one for one, bound in zip(near, bounds, strict=False) if bound >= energy + CURVATURE_MARGIN]
        if proven:
            multipliers = multipliers_of_limits(quarter, proven[0][0], proven[0][1])[2]
            prices, forces = np.split(multipliers, [len(quarter.orders)])
            yield line(optimum=proven[0][1], prices=prices * unit, forces=np.maximum(-forces, 0.0) * unit**2)
            continue
        lattice = lattices[level]
        with suppress(UnsupportedError):
            if best is None:
                raise UnsupportedError("a lattice excludes no part of a problem without a train")
            slope = quarter.step * max(quarter.highest, -quarter.lowest) + float(np.abs(r) @ np.array(quarter.orders))
            width = (3 * np.pi / 4 * slope * max(energy - quarter.shift(r), 0.0)) ** (1 / 3)  # of the checker's tube
            enough = energy + lattice.h**2 * quarter.step * m / np.pi * width
            point = max(lattice.best(part, r, np.inf, enough), key=lambda one: one.bound)
            taken = {"lattice": lattice.count, "whole": point.whole, "prices": point.r * unit}
            cells = lattice.open_cells(part, point.open)
            if cells is None:
                yield line(**taken)
                continue
            found = local_angles(quarter, point.steps, point.angles) if point.steps.all() else None
            if found is not None and all(np.abs(found[0] - one[1]).max() > SAME_OPTIMUM for one in optima):
                optima += [(point.steps, found[0], local_prices(quarter, point.steps, found[0]))]
            low, high, signs = (one.tolist() for one in cells)
            ends = zip(ranges, low, high, strict=True)
            narrow = [(max(a, Fraction(i, lattice.count)), min(b, Fraction(j, lattice.count))) for (a, b), i, j in ends]
            finer = point.loss > (energy - point.bound) / 2 and level + 1 < len(LATTICES)
            fewer = sum(b - a for a, b in narrow) < SMALLER * sum(b - a for a, b in ranges)
            if fewer or (finer and all(signs)):
                yield line(**taken, low=low, high=high, signs=signs)
                waiting.append((narrow, np.array(signs), level + finer, point.r))
                continue
            r = point.r
        free = np.flatnonzero(sign == 0)
        i = int(free[0] if len(free) else (part.high - part.low).argmax())
        yield line(split=i)
        (a, b), middle = ranges[i], (ranges[i][0] + ranges[i][1]) / 2
        halves = [((a, b), s) for s in (-1, 1)] if len(free) else [((middle, b), sign[i]), ((a, middle), sign[i])]
        for half, s in halves:
            waiting.append(([*ranges[:i], half, *ranges[i + 1 :]], np.where(np.arange(m) == i, s, sign), level, r))
