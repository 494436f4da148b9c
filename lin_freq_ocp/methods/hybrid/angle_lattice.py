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
cells means of products vanish, and those of f angles within a cell raise the mean of the squares at most f times. In
all, the mean of L_r grows by at most

    h^2 m (f s^2/2 + e s/pi),

and some train of the lattice costs no more than that. Angles stay in order, and of a dwell d, floor(d/h) - 1 steps
remain, floor(d/h) at both ends. f = 1 if dwells between switches are longer than h, else m.

*Tube.* I - R is zero at pi/2, with a slope of at most q. A train that leaves |I - R| <= w costs L_r >= 4 w^3/(3 pi q).
The lattice holds |I - R| <= w and the m s h by which angles move I: what it finds, less the loss for e = w, or that
cost of leaving, whichever is less, bounds L_r.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid.quarter import Quarter
from lin_freq_ocp.methods.native_code import compiled_library
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER

TRACKING_ROUNDING = 1e-13  # of L_r, whose terms are of order 1: rounding of some 10^3 sums that telescope is smaller
LEAST_FRACTION = 1e-9  # of d/h above a whole number: its rounding is smaller
COUNTS = 100  # numbers N among which one lets dwells be just above multiples of h
MOST_CHOICES = 2**29  # bytes: a tube that needs more is not searched
FIRST_WIDTH = 0.1  # half width of the first tube [rad]
WIDER = 1.02  # of the width at which leaving the tube costs as much as the answer: at 1, rounding asks for more
RADIUS, LEAST_RADIUS, PROGRESS = 0.05, 1e-7, 1e-5  # trust region of r: the first, the least; relative gain that is none
MOST_CUTS = 40


class RecursionInC(ctypes.Structure):
    """lfo_lattice of lattice.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("count", "switches", "levels", "lowest", "half", "ring")),
        *((name, ctypes.c_void_p) for name in ("centre", "hold", "low", "high", "sign", "moments")),
        *((name, ctypes.c_double) for name in ("h", "step")),
    ]


@dataclass(frozen=True, eq=False)
class AngleRange:
    """Some trains: bounds of their angles (m,) [rad], and the signs of their steps (m,), 0 where both are allowed."""

    low: Array
    high: Array
    sign: Indices


@dataclass(frozen=True, eq=False)
class LatticePoint:
    """A bound on E of a part by one r, and the steps and angles (m,) of the best train of the lattice."""

    bound: float
    r: Array
    steps: Array
    angles: Array


class AngleLattice:
    """The lattice of N or some more angles for a quarter."""

    def __init__(self, quarter: Quarter, count: int):
        d = float(quarter.dwells[1:-1].min(initial=QUARTER))
        self.count = min(range(count, count + COUNTS), key=lambda N: (d * N / QUARTER - LEAST_FRACTION) % 1.0)
        self._quarter, self._h = quarter, QUARTER / self.count
        hold = np.floor(quarter.dwells / self._h - LEAST_FRACTION).astype(np.int64)
        hold[1:-1] -= 1
        self._hold = np.maximum(hold, 0)
        m, s = len(quarter.dwells) - 1, quarter.step
        self._squares = self._h**2 * m * (1 if d > self._h else m) * s * s / 2
        self._width, self.seconds = FIRST_WIDTH, 0.0
        self._theta: Array = self._h * np.arange(self.count + 1, dtype=np.float64)

    def bound(self, r: Array, part: AngleRange, enough: float = np.inf) -> LatticePoint:
        """Return the bound for some r; infinity if the part has no train. No tube is widened to exceed ``enough``."""
        q, width = self._quarter, self._width
        slope = (np.array(q.orders) * r) @ np.sin(np.outer(q.orders, self._theta))
        steepest = max(q.highest * q.step - slope.min(), slope.max() - q.lowest * q.step)
        steepest += self._h / 2 * float(np.abs(r) @ np.square(q.orders))  # between angles of the lattice
        farthest = QUARTER * max(q.highest, -q.lowest) * q.step + float(np.abs(r).sum())
        while True:
            least, steps, angles = self._least(r, width, part)
            loss = self._squares + self._h**2 * len(steps) * width * q.step / np.pi
            leaving = 4 * width**3 / (3 * np.pi * steepest) if width < farthest else np.inf
            if least - loss <= leaving or leaving - TRACKING_ROUNDING + q.shift(r) >= enough:
                break
            width = WIDER * (3 * np.pi / 4 * steepest * least) ** (1 / 3) if least < np.inf else 2 * width
        if least < np.inf:
            needed = WIDER * (3 * np.pi / 4 * steepest * max(least, 0.0)) ** (1 / 3)
            self._width = min(width, max(needed, self._h))
        return LatticePoint(min(least - loss, leaving) - TRACKING_ROUNDING + q.shift(r), r, steps, angles)

    def best(self, part: AngleRange, r: Array, end: float, enough: float = np.inf) -> Iterator[LatticePoint]:
        """Yield the points of cutting planes from r on, until the bound is ``enough`` or stays, or time is over.

        The next one is not begun if it would be ready after ``end``, by the time that the last one took.
        """
        from scipy.optimize import linprog  # slow to import

        q, k = self._quarter, np.array(self._quarter.orders, dtype=float)
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
        begin = now()
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
            self.seconds = begin - before
            if radius < LEAST_RADIUS or begin + self.seconds > end:
                return
            box = [*zip(np.maximum(centre - radius, least), np.minimum(centre + radius, most), strict=True)]
            box += [(None, None), *((None, 0.0) if free else (None, None) for free in fixed)]
            objective = np.concatenate([np.zeros(len(k)), [-1.0], np.full(len(k), -2.0)])
            answer = linprog(objective, np.array(rows), np.array(limits), bounds=box, method="highs")
            if answer.x is None or answer.fun is None or -answer.fun - best < PROGRESS * (abs(best) + self._squares):
                return
            r = answer.x[: len(k)]

    def _least(self, r: Array, width: float, part: AngleRange) -> tuple[float, Array, Array]:
        """Return the least L_r of the lattice in a tube, with steps and angles (m,); infinity if there is none."""
        q, N, h, m = self._quarter, self.count, self._h, len(part.sign)
        unit = h * q.step
        wave = np.cos(np.outer(self._theta, q.orders)) @ r
        centre = np.round(wave / unit).astype(np.int64)
        half = int(np.ceil(width / unit)) + m + 1
        shape = m + 1, q.highest - q.lowest + 1, 2 * half + 1
        if (N + 1) * np.prod(shape, dtype=float) > MOST_CHOICES:
            raise UnsupportedError(f"no bound on a lattice of {N} angles: its tube needs more than half a gigabyte.")
        low = np.maximum(np.floor(part.low / h - LEAST_FRACTION).astype(np.int64), self._hold[0])
        high = np.ceil(part.high / h + LEAST_FRACTION).astype(np.int64)
        spans = np.concatenate([[1], self._hold])
        moments = np.array([self._moments(r, int(span)) for span in spans])
        ring = int(spans.max()) + 1
        values, choices = np.empty((ring, *shape)), np.empty((N + 1, *shape), dtype=np.int8)
        arrays: list[Array | Indices] = [centre, self._hold, low, high, part.sign.astype(np.int64), moments]
        arrays = list(map(np.ascontiguousarray, arrays))
        model = RecursionInC(N, m, shape[1], q.lowest, half, ring, *(a.ctypes.data for a in arrays), h, q.step)
        library = compiled_library(__file__, "lattice.c")
        if library is None:
            _recursion(model, arrays, values, choices)
        else:
            library.lfo_lattice_run(ctypes.byref(model), *(ctypes.c_void_p(a.ctypes.data) for a in (values, choices)))
        first = values[0, 0, -q.lowest]
        a = int(first.argmin())
        steps, angles = np.zeros(m), np.zeros(m)
        if first[a] < np.inf:  # follow the choices
            i, c, level, n = 0, 0, 0, a - half + int(centre[0])
            while c < m:
                choice, span = choices[i, c, level - q.lowest, n - centre[i] + half], 1
                if choice:
                    level += 1 if choice == 1 else -1
                    steps[c], angles[c] = (1 if choice == 1 else -1) * q.step, i * h
                    c += 1
                    span = int(self._hold[c])
                n -= level * span
                i += span
        return float(4 / np.pi * first[a]), steps, angles

    def _moments(self, r: Array, span: int) -> Array:
        """Return the integrals (3, N + 1) of R, (t - start) R and R^2 from every angle over ``span`` steps."""
        k = np.array(self._quarter.orders, dtype=float)
        stop: Array = self._theta + span * self._h

        def primitives(theta: Array) -> tuple[Array, Array, Array]:
            first, second = -np.sin(np.outer(theta, k)) @ (r / k), np.cos(np.outer(theta, k)) @ (r / k**2)
            square = np.zeros(len(theta))
            for a, of_a in zip(k, r, strict=True):
                for b, of_b in zip(k, r, strict=True):
                    apart = theta if a == b else np.sin((a - b) * theta) / (a - b)
                    square += of_a * of_b / 2 * (apart + np.sin((a + b) * theta) / (a + b))
            return first, second, square

        (F, G, S), (F0, G0, S0) = primitives(stop), primitives(self._theta)
        return np.array([F - F0, span * self._h * F - (G - G0), S - S0])


def _recursion(p: RecursionInC, arrays: Sequence[Array | Indices], V: Array, choices: NDArray[np.int8]) -> None:
    """Do what lattice.c does, without a compiler."""
    centre, hold, low, high, sign, moments = arrays
    q, width = p.h * p.step, 2 * p.half + 1

    def reach(i: int, c: int, at: int, span: int, place: int, to: tuple[int, int], label: int) -> None:
        level = p.lowest + to[1]
        shift = int(centre[i] - level * span - centre[i + span])
        a, b = max(0, -shift), min(width, width - shift)
        if a >= b:
            return
        n, t, v = np.arange(a, b) + float(centre[i] - p.half), p.h * span, p.step * level
        of_R, of_tR, of_RR = moments[place, :, i]
        cost = (q * q * t * n - q * (v * t * t - 2 * of_R)) * n + (v * v * t**3 / 3 - 2 * v * of_tR + of_RR)
        cost += V[(i + span) % p.ring][to][a + shift : b + shift]
        value, choice = V[i % p.ring, c, at, a:b], choices[i, c, at, a:b]
        choice[cost < value] = label
        np.minimum(value, cost, out=value)

    for i in range(p.count, -1, -1):
        V[i % p.ring], choices[i] = np.inf, 0
        for c in range(p.switches, -1, -1):
            if (c and i < low[c - 1]) or (c < p.switches and i > high[c]):
                continue
            for at in range((c + p.lowest) % 2, p.levels, 2):
                if i == p.count and c == p.switches:
                    V[i % p.ring, c, at, p.half - centre[i]] = 0.0
                if i < p.count:
                    reach(i, c, at, 1, 0, (c, at), 0)
                if c < p.switches and low[c] <= i <= high[c] and i + hold[c + 1] <= p.count:
                    for s in (1, -1):
                        if 0 <= at + s < p.levels and sign[c] != -s:
                            reach(i, c, at, int(hold[c + 1]), c + 2, (c + 1, at + s), 1 if s > 0 else 2)
