"""A lower bound on the cost of every pulse train, by dynamic programming on a lattice of angles.

With any r_k for the odd orders k whose amplitudes have bounds, l_k <= b_k <= h_k, R = -sum_k r_k cos k theta,
I = -sum_k (b_k / k) cos k theta over all odd k, and E = 4/pi times the integral of I^2 over the quarter,

    E >= min L_r - sum_k r_k^2 + 2 sum_k min(r_k l_k, r_k h_k) / k,    L_r = 4/pi int (I - R)^2 = sum_k (b_k/k - r_k)^2.

The minimum of L_r is a tracking problem with one state. On angles i h, h = pi/(2N), the integral of the level over the
rest of the quarter is h times the step s times an integer: the recursion over angle, integer, level and switches done
is exact. In r the right side is concave, with the slope 2(l_k or h_k)/k - 2 b_k/k of its minimiser: cutting planes in a
trust region find its largest value, and any r gives a bound.

*Angles between those of the lattice.* Of a train a with m switches, |I - R| <= e, let A_i be one of the two multiples
of h next to a_i, at random, with the mean a_i. With g_i = max(theta, A_i) - max(theta, a_i), I changes by the sum of
+-s g_i. |g_i| <= |A_i - a_i| up to the end of the cell of a_i, and is zero from there; its mean is zero but within the
cell, where it is >= 0 with an integral of half the variance of A_i, h^2/8 at most. Hence 2 int (I - R) sum_i +-s g_i
has a mean of at most m s e h^2/4. Draw one offset U for each cell, A_i = h floor(a_i/h + U): for angles of different
cells means of products vanish, and those of f angles within a cell raise the mean of the squares at most f times. If
the cell of a_i ends at t_i or before, t_i = min(a_i + h, pi/2), the mean of L_r grows in all by at most

    h^2 sum_i (f s^2 t_i/pi + s e/pi),

and some train of the lattice costs no more than that. Angles stay in order, and of a dwell d, floor(d/h) - 1 steps
remain, floor(d/h) at both ends. f = 1 if dwells between switches are longer than h; else f is the number of angles that
may follow each other at less than h.

*Least dwells.* Where the best train of the lattice has a dwell that is too short, draw one U for each chain of angles
whose dwells may be less than floor(d/h) h + h: floor(d/h) steps remain of each dwell. The squares of a chain of f
angles rise at most f times.

*Tube.* I - R is zero at pi/2, with a slope of at most q. A train that leaves |I - R| <= w costs L_r >= 4 w^3/(3 pi q):
w is such that this is enough. The lattice has the trains within w and the m s h by which angles move I: the least cost
of these, less the loss for e = w, or the cost of leaving, whichever is less, bounds L_r. If the steps of a part are
known, I differs from that of its middle angles by no more than s times the sum of its half widths: where this band is
narrower, no train leaves it.

*Open cells.* A_i is at an end of the cell of a_i, whatever is drawn. Where all trains of the lattice with angle i at
these ends, and a step up there, cost too much less the loss, no train of interest has its angle i in the cell with a
step up. A recursion from the end and one from the start give the least cost of the trains through every state, and so
through every switch.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid.quarter import RANGE_ROUNDING, Quarter
from lin_freq_ocp.methods.native_code import compiled_library
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER

# Roundings, on which claims rest
TRACKING_ROUNDING = 1e-13  # of L_r, whose terms are of order 1: their rounding telescopes over the lattice
SUM_ROUNDING = 2.0**-52  # of a sum of costs, relative: twice what one addition rounds
WHOLE = 1e-12  # of a step, by which a dwell is longer than its whole steps: its rounding is smaller
# Effort: bounds hold whatever these are. Lattices that lose a step of a dwell have worse bounds; the rest is time
COUNTS = 100  # numbers N among which one lets dwells be multiples of h, or just above: less of them is lost
MOST_STATES = 2**25  # of a recursion, half a gigabyte for the costs from and to each; larger parts are halved
RADIUS = 0.05  # of the first trust region of r, in units of b_k
MOST_CUTS, SHARE_OF_LOSS = 40, 0.1  # recursions for one part; gain of the bound, of its loss, that is not worth one
PATIENCE, SHARE_OF_MISSING = 4, 0.1  # recursions in which the bound rises by this share of what it lacks of ``enough``


class RecursionInC(ctypes.Structure):
    """lfo_lattice of lattice.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("count", "switches", "levels", "lowest", "half")),
        *((name, ctypes.c_void_p) for name in ("centre", "hold", "low", "high", "sign", "first", "last", "start")),
        *(("moments", ctypes.c_void_p), ("h", ctypes.c_double), ("step", ctypes.c_double)),
    ]


@dataclass(frozen=True, eq=False)
class AngleRange:
    """Some trains: bounds of their angles (m,) [rad], and the signs of their steps (m,), 0 where both are allowed."""

    low: Array
    high: Array
    sign: Indices

    def is_near(self, steps: Array, angles: Array) -> bool:
        """Whether a train is one of these, or would be if each range were twice as wide."""
        signs = (self.sign == 0) | (self.sign == np.sign(steps))
        return bool((signs & (np.abs(angles - (self.low + self.high) / 2) <= self.high - self.low)).all())

    def halves(self) -> list[AngleRange]:
        """Return two parts: by the first sign that is free, or else by the widest range of an angle."""
        free = np.flatnonzero(self.sign == 0)
        where = np.arange(len(self.sign)) == (free[0] if len(free) else (self.high - self.low).argmax())
        if len(free):
            return [replace(self, sign=np.where(where, s, self.sign)) for s in (1, -1)]
        middle = (self.low + self.high) / 2
        return [replace(self, **{side: np.where(where, middle, getattr(self, side))}) for side in ("high", "low")]


@dataclass(frozen=True, eq=False)
class LatticePoint:
    """A bound on E of a part by one r, its loss, and the steps and angles (m,) of the best train of the lattice.

    Without a train, steps are zero. Of trains that cost the same, each angle may be that of another.
    ``open`` are the cells (m, 2, N) that may hold an angle, with a step up or down, of a train below what is enough.
    With ``whole``, all whole steps of each dwell between switches are kept.
    """

    bound: float
    loss: float
    r: Array
    steps: Array
    angles: Array
    open: Mask
    whole: bool


class AngleLattice:
    """The lattice of N or some more angles for a quarter."""

    def __init__(self, quarter: Quarter, count: int):
        dwells = quarter.dwells[quarter.dwells > 0] / QUARTER
        lost = [float(((dwells * N - WHOLE) % 1.0).max(initial=0.0)) for N in range(count, count + COUNTS)]
        self.count = count + int(np.argmin(lost))
        self.quarter, self.h = quarter, QUARTER / self.count
        self._whole = np.maximum(np.floor(quarter.dwells / self.h - WHOLE), 0).astype(np.int64)

    def bound(self, r: Array, part: AngleRange, enough: float = np.inf) -> LatticePoint:
        """Return the bound for some r; infinity if the part has no train. No tube is wider than ``enough`` asks for."""
        point = self._bound(r, part, enough, whole=False)
        short = np.diff(point.angles) / self.h < self._whole[1:-1] - 0.5
        if point.bound < enough and short.any() and point.steps.all():
            return max(point, self._bound(r, part, enough, whole=True), key=lambda one: one.bound)
        return point

    def open_cells(self, part: AngleRange, opened: Mask) -> tuple[Indices, Indices, Indices] | None:
        """Return the first open cell (m, 2, N) of each angle, the first after the last, and signs; None without one."""
        cells, (up, down) = np.logical_or.reduce(opened, axis=1), np.logical_or.reduce(opened, axis=2).T
        if not np.logical_or(up, down).all():
            return None
        ends = cells.shape[1] - cells[:, ::-1].argmax(axis=1)
        return cells.argmax(axis=1), ends, np.where(up & down, part.sign, np.where(up, 1, -1))

    def narrow(self, part: AngleRange, opened: Mask) -> AngleRange | None:
        """Return the range of the cells (m, 2, N) of a part that are open; None if an angle has none."""
        if (cells := self.open_cells(part, opened)) is None:
            return None
        edge, (first, end, sign) = RANGE_ROUNDING * self.h, cells
        return AngleRange(np.maximum(part.low, first * self.h - edge), np.minimum(part.high, end * self.h + edge), sign)

    def _bound(self, r: Array, part: AngleRange, enough: float, whole: bool) -> LatticePoint:
        """Return the bound by trains with all whole steps of each dwell between switches, or with one less."""
        q, h, hold, m = self.quarter, self.h, self._whole.copy(), len(part.sign)
        if not whole:
            hold[1:-1] = np.maximum(hold[1:-1] - 1, 0)
        apart = not whole and float(q.dwells[1:-1].min(initial=QUARTER)) > h
        f = np.ones(m) if apart else self._chains(part, hold if whole else 0 * hold)
        most = max(enough - q.shift(r) + TRACKING_ROUNDING, 0.0)  # of L_r
        middle, width, e, leaving = self._tube(r, part, most)
        loss = h**2 * q.step / np.pi * float(q.step * f @ np.minimum(part.high + h, QUARTER) + m * e)
        least = (1 - self.count * SUM_ROUNDING) * _least_through(self, r, middle, width, part, hold) - loss
        cells = np.minimum(least[:, :, 1:], least[:, :, :-1]) <= most
        bound = min(float(least[0].min(initial=np.inf)), leaving) - TRACKING_ROUNDING + q.shift(r)
        down, at = np.array([np.unravel_index(one.argmin(), one.shape) for one in least]).T
        return LatticePoint(bound, loss, r, np.isfinite(least).any() * q.step * (1.0 - 2 * down), at * h, cells, whole)

    def _tube(self, r: Array, part: AngleRange, most: float) -> tuple[Array, float, float, float]:
        """Return the middle of a tube around -I, its half width, a bound e on |I - R|, and the least L_r outside."""
        q, h, k = self.quarter, self.h, np.array(self.quarter.orders, dtype=float)
        theta, middle = self.theta[: self.count + 1], self.waves[: self.count + 1] @ r
        slope = np.sin(np.outer(theta, k)) @ (k * r)
        steepest = max(q.highest * q.step - slope.min(), slope.max() - q.lowest * q.step)
        steepest += h / 2 * float(np.abs(r) @ k**2)  # between the angles of the lattice
        farthest = QUARTER * max(q.highest, -q.lowest) * q.step + float(np.abs(r).sum())
        width = (3 * np.pi / 4 * steepest * most) ** (1 / 3)
        band = float((part.high - part.low).sum() / 2 * q.step)
        if part.sign.all() and band <= width:
            rest = np.minimum(QUARTER - theta[:, None], QUARTER - (part.low + part.high) / 2) @ part.sign
            e = float(np.abs(middle - q.step * rest).max()) + band + steepest * h / 2
            return np.asarray(q.step * rest, dtype=float), band, min(e, farthest), np.inf
        return (middle, width, width, most) if width < farthest else (middle, farthest, farthest, np.inf)

    def _chains(self, part: AngleRange, hold: Indices) -> Array:
        """Return for each angle how many may be in one chain with it."""
        free = part.low[1:] - part.high[:-1] >= (hold[1:-1] + 1 + RANGE_ROUNDING) * self.h
        _, chain, count = np.unique(np.cumsum([0, *free]), return_inverse=True, return_counts=True)
        return count[chain].astype(float)

    @cached_property
    def theta(self) -> Array:
        """The angles of the lattice, and those after the quarter that a dwell may reach."""
        return self.h * np.arange(self.count + 1 + int(self._whole.max(initial=1)), dtype=np.float64)

    @cached_property
    def waves(self) -> Array:
        """The cosines of all orders at these angles."""
        return np.cos(np.outer(self.theta, self.quarter.orders))

    @cached_property
    def primitives(self) -> tuple[Array, Array, Array]:
        """Primitives of R and of that primitive, for each r_k, and of R^2, for each product r_a r_b."""
        k, theta = np.array(self.quarter.orders, dtype=float), self.theta[:, None]
        products = [
            ((theta if a == b else np.sin((a - b) * theta) / (a - b)) + np.sin((a + b) * theta) / (a + b)) / 2
            for a in k
            for b in k
        ]
        return -np.sin(theta * k) / k, self.waves / k**2, np.hstack([np.zeros((len(theta), 0)), *products])

    def moments(self, r: Array, span: int) -> Array:
        """Return the integrals (3, N + 1) of R, (t - start) R and R^2 from every angle over ``span`` steps."""
        of_R, of_that, of_square = self.primitives
        F, G, S = of_R @ r, of_that @ r, of_square @ np.outer(r, r).ravel()
        here, there = slice(self.count + 1), slice(span, self.count + 1 + span)
        return np.array([F[there] - F[here], span * self.h * F[there] - (G[there] - G[here]), S[there] - S[here]])

    def best(self, part: AngleRange, r: Array, end: float, enough: float = np.inf) -> Iterator[LatticePoint]:
        """Yield the points of cutting planes from r on, until the bound is ``enough`` or stays, or time is over.

        The next one is not begun if it would be ready after ``end``, by the time that the last one took.
        """
        from scipy.optimize import linprog  # slow to import

        q, k = self.quarter, np.array(self.quarter.orders, dtype=float)
        fixed = ~np.isfinite(q.low) & ~np.isfinite(q.high)
        least, most = np.where(np.isfinite(q.high), -np.inf, 0.0), np.where(np.isfinite(q.low), np.inf, 0.0)
        centre, best, radius = np.clip(r, least, most), -np.inf, RADIUS
        r, rows, limits = centre, list[Array](), list[float]()
        # rows over (r, t, z): t <= E - 2 sum r_k b_k/k of a train, z_k <= r_k times each bound of b_k/k
        for values in (q.low, q.high):
            for i in np.flatnonzero(np.isfinite(values)):
                row = np.zeros(2 * len(k) + 1)
                row[i], row[len(k) + 1 + i] = -values[i] / k[i], 1.0
                rows.append(row)
                limits.append(0.0)
        begin, missing = now(), [np.inf] * PATIENCE
        for _ in range(MOST_CUTS):
            point = self.bound(r, part, enough)
            yield point
            if point.bound >= enough:
                return
            energy, amplitudes = q.energy(point.steps, point.angles)[0], q.amplitudes(point.steps, point.angles)[0]
            rows.append(np.concatenate([2 * amplitudes / k, [1.0], np.zeros(len(k))]))
            limits.append(energy)
            if point.bound > best:
                best, centre, radius = point.bound, r, 1.5 * radius
            else:
                radius /= 3
            begin, before = now(), begin
            missing.append(enough - best)
            stays = missing[-1] < np.inf and missing[-1] > (1 - SHARE_OF_MISSING) * missing[-1 - PATIENCE]
            if stays or missing[-1] < 2 * point.loss or 2 * begin - before > end:
                return
            box = [*zip(np.maximum(centre - radius, least), np.minimum(centre + radius, most), strict=True)]
            box += [(None, None), *((None, 0.0) if free else (None, None) for free in fixed)]
            objective = np.concatenate([np.zeros(len(k)), [-1.0], np.full(len(k), -2.0)])
            answer = linprog(objective, np.array(rows), np.array(limits), bounds=box, method="highs")
            if answer.x is None or answer.fun is None or -answer.fun - best < SHARE_OF_LOSS * point.loss:
                return
            r = answer.x[: len(k)]


def _least_through(
    lattice: AngleLattice, r: Array, middle: Array, around: float, part: AngleRange, hold: Indices
) -> Array:
    """Return the least L_r (m, 2, N + 1) of all trains of a part, in a tube, with a switch, up or down, at an angle."""
    q, h, N, m = lattice.quarter, lattice.h, lattice.count, len(part.sign)
    half, centre = int(np.ceil(around / (h * q.step))) + m + 1, np.round(middle / (h * q.step)).astype(np.int64)
    # where switches may be, in view of those before and after them, and the states after c switches
    after = np.concatenate([[0], np.cumsum(hold[1:])])
    low = np.maximum(np.floor(part.low / h - RANGE_ROUNDING).astype(np.int64), hold[0]) - after[:-1]
    high = np.minimum(np.ceil(part.high / h + RANGE_ROUNDING).astype(np.int64), N - hold[-1]) - after[:-1]
    low = np.maximum.accumulate(low) + after[:-1]
    high = np.minimum.accumulate(high[::-1])[::-1] + after[:-1]
    first, last = np.concatenate([[0], low + hold[1:]]), np.concatenate([high, [N]])
    start, states, reached = np.full((m + 1, q.highest - q.lowest + 1), -1), 0, {0}
    for c, sign in enumerate([*part.sign, 0]):
        for level in reached:
            start[c, level - q.lowest], states = states, states + int(last[c] - first[c] + 1)
        reached = {v + s for v in reached for s in (1, -1) if sign != -s and q.lowest <= v + s <= q.highest}
    least = np.full((m, 2, N + 1), np.inf)
    if (low > high).any() or (start[m] < 0).all():
        return least
    if states * (2 * half + 1) > MOST_STATES:
        raise UnsupportedError(f"no bound on a lattice of {N} angles: its tube needs more than half a gigabyte.")
    moments = np.array([lattice.moments(r, int(span)) for span in (1, *hold)])
    arrays = [centre, hold, low, high, part.sign.astype(np.int64), first, last, start, moments]
    arrays = list(map(np.ascontiguousarray, arrays))
    sizes = N, m, start.shape[1], q.lowest, half
    model = RecursionInC(*sizes, *(one.ctypes.data for one in arrays), h, q.step)
    V, W = np.full((2, states, 2 * half + 1), np.inf)
    library = compiled_library(__file__, "lattice.c")
    if library is None:
        _recursion(model, arrays, V, W, least)
    else:
        given = V, W, least, np.empty(2 * half + 1)
        library.lfo_lattice_run(ctypes.byref(model), *(ctypes.c_void_p(one.ctypes.data) for one in given))
    return 4 / np.pi * least


def _recursion(p: RecursionInC, arrays: list[Array], V: Array, W: Array, least: Array) -> None:
    """Do what lattice.c does, without a compiler."""
    centre, hold, low, high, sign, first, last, start, moments = arrays
    rows = {
        (i, int(c), int(at)): int(start[c, at]) + i - int(first[c])
        for c, at in zip(*np.nonzero(start >= 0), strict=True)
        for i in range(int(first[c]), int(last[c]) + 1)
    }
    for forth in (False, True):
        for i, c, at in sorted(rows, reverse=not forth):
            near, ways = rows[i, c, at], [(c, at, 1, 0, 0)]
            if (i, c) == ((0, 0) if forth else (p.count, p.switches)):
                (W if forth else V)[near, slice(None) if forth else p.half] = 0.0
            if c < p.switches and low[c] <= i <= high[c]:
                ways += [(c + 1, at + s, int(hold[c + 1]), c + 2, s) for s in (1, -1) if sign[c] != -s]
            for to_c, to, span, place, s in ways:
                far = rows.get((i + span, to_c, to))
                if far is None:
                    continue
                v = p.lowest + to
                shift = int(centre[i] - v * span - centre[i + span])
                a = np.arange(max(0, -shift), min(2 * p.half + 1, 2 * p.half + 1 - shift))
                n, q, t, (of_R, of_tR, of_RR) = a + centre[i] - p.half, p.h * p.step, p.h * span, moments[place, :, i]
                v = v * p.step
                cost = (q * q * t * n - q * (v * t * t - 2 * of_R)) * n + (v * v * t**3 / 3 - 2 * v * of_tR + of_RR)
                if forth:
                    cost += W[near, a]
                    W[far, a + shift] = np.minimum(W[far, a + shift], cost)
                    whole = (cost + V[far, a + shift]).min(initial=np.inf)
                    if s:
                        least[c, (1 - s) // 2, i] = min(least[c, (1 - s) // 2, i], whole)
                else:
                    V[near, a] = np.minimum(V[near, a], cost + V[far, a + shift])
