"""The section PROBLEM of a proof as affine functions of w = (x_0, u_0, .., u_{T-1}), in balls.

An affine function is a row of dim + 1 numbers, the constant last. For a fixed sequence of modes,

    minimise 1/2 w'P w + q'w + c  over  rows = 0,  rows <= 0,  and cones |V w + v| <= r w + r_0.

Terms with a weight have a variable s >= 0 more, which stands in the cost; those of all frequencies are refused.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from itertools import product

from flint import arb, arb_mat, fmpq

NUMBER = re.compile(r"(-?)0x([0-9a-f]+)(?:\.([0-9a-f]*))?(?:p([+-]?\d+))?")


def number(text: str) -> fmpq:
    """Return the rational number that a hexadecimal text is."""
    sign, whole, part, exponent = NUMBER.fullmatch(text).groups()
    mantissa, shift = int(whole + (part or ""), 16), int(exponent or 0) - 4 * len(part or "")
    value = fmpq(mantissa) * fmpq(2) ** shift
    return -value if sign else value


def column(texts) -> arb_mat:
    """Return a list of numbers as a column of balls."""
    return arb_mat(len(texts), 1, [arb(number(text)) for text in texts])


def matrix(texts) -> arb_mat:
    """Return lists of numbers as a matrix."""
    return arb_mat([[arb(number(text)) for text in row] for row in texts])


def beside(left, right) -> arb_mat:
    """Return two matrices of as many rows as one."""
    return arb_mat([a + b for a, b in zip(matrix(left).tolist(), matrix(right).tolist(), strict=True)])


@dataclass
class Statement:
    """The lines of PROBLEM; the modes of POINT, and its x_0 and controls in a row (empty without POINT)."""

    lines: list
    mode: list
    point: list

    @classmethod
    def read(cls, text: str) -> Statement:
        """Read the sections PROBLEM and POINT of a proof."""
        lines = [json.loads(line) for line in text.splitlines()]
        at = {line["section"]: index for index, line in enumerate(lines) if "section" in line}
        head, *point = lines[at["point"] : at["nodes"]] if "point" in at else [{"x": []}]
        texts = head["x"] + [text for line in point for text in line["u"]]
        modes = [line["mode"] for line in point]
        return cls(lines[at["problem"] : at["claim"]], modes, [number(text) for text in texts])

    @property
    def sizes(self):
        """Return T, n, m."""
        head = self.lines[0]
        return head["horizon"], len(head["states"]), len(head["controls"])

    def over_time(self, kind: str, value) -> list:
        """Return what is valid at each time, from the lines of a kind: later fields over earlier ones."""
        found, line = [], {}
        for given in self.lines:
            if given.get(kind) != value or isinstance(given.get(kind), bool):
                continue
            found += [line] * (given.get("from", len(found)) - len(found))
            line = line | given
            found.append(line)
        return found + [line] * (self.sizes[0] - len(found))

    def end(self, kind: str):
        """Return the line of a kind that is for time T."""
        return next(line for line in self.lines if line.get(kind) == "end")


@dataclass
class Program:
    """The convex program of one sequence of modes, in dim variables."""

    dim: int
    P: arb_mat
    q: arb_mat
    c: arb
    equal: list
    below: list
    cones: list  # of (rows V v, row r)
    guess: list


def program_of(statement: Statement, sequence=None) -> Program:
    """Return the program of a sequence of modes, by default that of POINT."""
    T, n, m = statement.sizes
    terms = [line for line in statement.lines if "term" in line]
    if any(line["gauge"] == "all" for line in terms):
        raise NotImplementedError("a term of all frequencies")
    soft = [line["term"] for line in terms if line["weight"] != "inf"]
    slacks = {index: n + T * m + k for k, index in enumerate(soft)}
    build = _Builder(statement, sequence or statement.mode or [0] * T, n + T * m + len(slacks), slacks)
    build.dynamics()
    build.bounds()
    build.stops()
    for line in terms:
        build.term(line)
    return build.program([number(line["weight"]) for line in terms if line["weight"] != "inf"])


class _Builder:
    def __init__(self, statement, sequence, dim, slacks):
        self.statement, self.sequence, self.dim, self.slacks = statement, sequence, dim, slacks
        self.equal, self.below, self.cones = [], [], []

    def unit(self, index, value=1):
        row = arb_mat(1, self.dim + 1)
        row[0, index] = value
        return row

    def constant(self, value):
        return self.unit(self.dim, value)

    def dynamics(self):
        T, n, m = self.statement.sizes
        modes = {mode: self.statement.over_time("mode", mode) for mode in {*self.sequence}}
        controls = [[self.unit(n + t * m + j) for j in range(m)] for t in range(T)]
        self.v = [[self.unit(i) for i in range(n)] + controls[0]]
        for t, mode in enumerate(self.sequence):
            line = modes[mode][t]
            before = self.stack(self.v[t])
            after = (beside(line["A"], line["B"]) * before).tolist()
            offset = [number(value) for value in line["d"]]
            x = [arb_mat([row]) + self.constant(d) for row, d in zip(after, offset, strict=True)]
            self.v.append(x + (controls[t + 1] if t + 1 < T else []))
            if line["h"]:
                rows = (beside(line["G"], line["H"]) * before).tolist()
                pairs = zip(rows, line["h"], strict=True)
                self.below += [arb_mat([row]) - self.constant(number(limit)) for row, limit in pairs]

    def stack(self, rows):
        return arb_mat([row.tolist()[0] for row in rows])

    def bounds(self):
        lines = [*self.statement.over_time("bounds", "stage"), self.statement.end("bounds")]
        for line, rows in zip(lines, self.v, strict=True):
            for row, low, high in zip(rows, line["lower"], line["upper"], strict=True):
                if low == high:
                    self.equal.append(row - self.constant(number(low)))
                    continue
                self.below += [row - self.constant(number(high))] if high != "inf" else []
                self.below += [self.constant(number(low)) - row] if low != "-inf" else []

    def stops(self):
        for line in self.statement.lines:
            if "stop" not in line:
                continue
            signal = [rows[line["stop"]] for rows in self.v[: line["samples"]]]
            for first, last in line["bins"]:
                for k in range(first, last + 1):
                    for wave in _waves(k, line["samples"]):
                        self.equal.append(self.combined(zip(wave, signal, strict=True)))

    def combined(self, parts):
        total = arb_mat(1, self.dim + 1)
        for factor, row in parts:
            total += factor * row
        return total

    def values(self, value):
        """Return the real affine functions of one value of a term."""
        if "row" in value:
            parts = ((number(c), self.v[t][i]) for t, i, c in value["row"])
            return [self.combined(parts) + self.constant(number(value["constant"]))]
        window, frequency = value["window"], value["frequency"]
        window = [fmpq(1)] * window if isinstance(window, int) else [number(w) for w in window]
        output, signals = [number(c) for c in value["output"]], self.v[value["first"] :]
        rows = [self.combined(zip(output, signals[s], strict=False)) for s in range(len(window))]
        angles = [_angle(frequency, s) for s in range(len(window))]
        real = self.combined((w * a.cos(), row) for w, a, row in zip(window, angles, rows, strict=True))
        imaginary = self.combined((-w * a.sin(), row) for w, a, row in zip(window, angles, rows, strict=True))
        return [real, imaginary]

    def term(self, line):
        rows = [row for value in line["values"] for row in self.values(value)]
        gauge, limit, soft = line["gauge"], number(line["limit"]), line["term"] in self.slacks
        radius = self.constant(limit) + (self.unit(self.slacks[line["term"]]) if soft else self.constant(0))
        if gauge in ("1", "2", "inf") and limit == 0 and not soft:
            self.equal += rows
        elif gauge == "2":
            self.cones.append((rows, radius))
        elif gauge == "cone":
            self.cones.append((rows[1:], rows[0] + radius))
        elif gauge == "max":
            self.below += [row - radius for row in rows]
        elif gauge == "inf":
            self.below += [sign * row - radius for row in rows for sign in (1, -1)]
        else:
            signs = product((1, -1), repeat=len(rows))
            self.below += [self.combined(zip(one, rows, strict=True)) - radius for one in signs]

    def program(self, weights):
        dim = self.dim
        P, q, c = arb_mat(dim, dim), arb_mat(dim, 1), arb(0)
        lines = [*self.statement.over_time("cost", "stage"), self.statement.end("cost")]
        for line, stage in zip(lines, self.v, strict=True):
            rows = self.stack(stage).tolist()
            hessian, linear, center = matrix(line["hessian"]), column(line["linear"]), column(line["center"])
            maps, rest = arb_mat([row[:-1] for row in rows]), arb_mat([[row[-1]] for row in rows])
            moved = rest - center
            P += maps.transpose() * (hessian * maps)
            q += maps.transpose() * (hessian * moved + linear)
            c += (moved.transpose() * hessian * moved)[0, 0] / 2 + (linear.transpose() * rest)[0, 0]
        for index, weight in zip(self.slacks.values(), weights, strict=True):
            q[index, 0] += weight
            self.below.append(-self.unit(index))
        guess = [arb(value) for value in self.statement.point]
        return Program(dim, P, q, c, self.equal, self.below, self.cones, guess)


def _waves(k, N):
    cosine = [arb.cos_pi_fmpq(fmpq(2 * k * t % (2 * N), N)) for t in range(N)]
    sine = [arb.sin_pi_fmpq(fmpq(2 * k * t % (2 * N), N)) for t in range(N)]
    return [cosine] if k == 0 or 2 * k == N else [cosine, sine]


def _angle(frequency, s):
    if isinstance(frequency, list):
        return 2 * arb.pi() * fmpq(frequency[0] * s, frequency[1])
    return arb(number(frequency) * s)
