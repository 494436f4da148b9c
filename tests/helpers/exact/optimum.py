"""The optimal cost of a convex program in balls: Newton's method on an active set, and a proof that it is optimal.

With the active rows and cones (as 1/2 (|V w + v|^2 - (r w + r_0)^2) = 0) as equations, the first-order conditions are
F(w, y) = 0. The interval Newton operator proves a zero within a tiny box around what Newton's method finds; there every
multiplier must be above zero and every other row below zero: in a convex program such a point is optimal. Else the
set is changed and tried again. None: not regular, or multipliers that no 60 digits tell from zero.
"""

from __future__ import annotations

import numpy as np
from flint import arb, arb_mat, ctx
from scipy.linalg import qr

from helpers.exact.statement import Program, Statement, program_of

BITS = 400  # of the balls; what is left is far more than 50 digits
NEAR = 1e-6  # of the guess, relative: a row that is so close to its limit is taken for active
CHANGES = 40  # of the active set, at most
STEPS = 12  # of Newton's method: quadratic, from 6 digits on
RADIUS = 2.0**-220  # of the box in which a zero is proven
INDEPENDENT = 1e-11  # of rows, relative


def optimal_cost(statement: Statement, sequence=None) -> arb | None:
    """Return the optimal cost of a sequence of modes (of POINT, by default) as a ball, or None if it is not proven."""
    before, ctx.prec = ctx.prec, BITS
    try:
        return _optimum(program_of(statement, sequence))
    finally:
        ctx.prec = before


def _optimum(program: Program) -> arb | None:
    system = _System(program)
    w = system.start()
    rows = [k for k, slack in enumerate(system.slacks(w)) if float(slack) < NEAR * system.scale]
    cones = [k for k, slack in enumerate(system.cone_slacks(w)) if float(slack) < NEAR * system.scale]
    tried = set[tuple[int, ...]]()
    for _ in range(CHANGES):
        found = None if (*rows, -1, *cones) in tried else system.solve(w, rows, cones)
        if found is None:
            return None
        tried.add((*rows, -1, *cones))
        w_found, multipliers, kept = found
        missed = [k for k, slack in enumerate(system.slacks(w_found)) if not (slack > 0 or k in rows)]
        opened = [k for k, slack in enumerate(system.cone_slacks(w_found)) if not (slack > 0 or k in cones)]
        if missed or opened:
            rows, cones = [*missed, *sorted(rows)], [*opened, *cones]  # what is missed comes first, where rows depend
        elif all(value > 0 for value in multipliers):
            return system.cost(w_found) if system.meets(w_found, rows, cones) else None
        else:
            least = min(range(len(multipliers)), key=lambda index: float(multipliers[index]))
            (rows if least < len(kept) else cones).remove((kept + cones)[least])
        if not cones:
            w = [value.mid() for value in w_found]
    return None


class _System:
    def __init__(self, program: Program):
        self.program = program
        self.equal = self._independent(program.equal, [])
        self.scale = max([1.0, *(abs(float(value)) for value in program.guess)])

    def value(self, row, w):
        return sum((row[0, k] * value for k, value in enumerate(w)), row[0, self.program.dim])

    def radius(self, w, cone):
        """Return the radius of a cone; above zero, its equation is smooth."""
        return self.value(self.program.cones[cone][1], w)

    def start(self):
        """Return the guess; slack variables are as large as they must be."""
        program = self.program
        w = list(program.guess) + [arb(0)] * (program.dim - len(program.guess))
        for row in program.below:
            for k in range(len(program.guess), program.dim):
                if float(row[0, k]) < 0:
                    excess = self.value(row, w)
                    w[k] = (w[k] + (excess / -row[0, k]).mid()) if float(excess) > 0 else w[k]
        for rows, radius in program.cones:
            for k in range(len(program.guess), program.dim):
                if float(radius[0, k]) > 0:
                    excess = sum((self.value(row, w) ** 2 for row in rows), arb(0)).sqrt() - self.value(radius, w)
                    w[k] = (w[k] + (excess / radius[0, k]).mid()) if float(excess) > 0 else w[k]
        return w

    def slacks(self, w):
        return [-self.value(row, w) for row in self.program.below]

    def cone_slacks(self, w):
        return [
            self.value(radius, w) - sum((self.value(row, w) ** 2 for row in rows), arb(0)).sqrt()
            for rows, radius in self.program.cones
        ]

    def cost(self, w):
        column = arb_mat([[value] for value in w])
        program = self.program
        return (
            (column.transpose() * (program.P * column))[0, 0] / 2 + (program.q.transpose() * column)[0, 0] + program.c
        )

    def meets(self, w, rows, cones):
        """Whether equations that depend on others hold, too, and equations of cones are smooth."""
        if any(self.value(self.program.below[k], w) > 0 for k in rows):
            return False
        smooth = all(self.radius(w, k) > 0 for k in cones)
        return smooth and all(self.value(row, w).contains(0) for row in self.program.equal)

    def _independent(self, rows, given):
        """Return the rows that are independent of the given ones and of each other, in floating point."""
        if not rows:
            return []
        dim = self.program.dim
        floats = np.array([[float(row[0, k]) for k in range(dim)] for row in [*given, *rows]])
        sizes = np.abs(floats).max(axis=1)
        floats = floats / np.where(sizes > 0, sizes, 1.0)[:, None]
        basis = np.zeros((0, dim))
        if given:
            basis = qr(floats[: len(given)].T, mode="economic")[0].T
        kept = []
        for row, vector in zip(rows, floats[len(given) :], strict=True):
            left = vector - basis.T @ (basis @ vector)
            left -= basis.T @ (basis @ left)
            size = np.linalg.norm(left)
            if size > INDEPENDENT:
                basis = np.vstack([basis, left / size])
                kept.append(row)
        return kept

    def solve(self, w, rows, cones):
        """Return w and the multipliers of rows and cones in balls, and the rows that are kept; None if not proven."""
        program, dim = self.program, self.program.dim
        active = self._independent([program.below[k] for k in rows], self.equal)
        kept = [k for k in rows if any(program.below[k] is row for row in active)]
        linear = self.equal + active
        size = dim + len(linear) + len(cones)
        y = self._first_multipliers(w, linear, cones)
        point = list(w) + y
        for _ in range(STEPS if cones else 1):
            F, J = self._conditions(point, linear, cones)
            try:
                step = J.mid().solve(F.mid())
            except ZeroDivisionError:
                return None
            point = [(point[k] - step[k, 0]).mid() for k in range(size)]
            if max(abs(float(step[k, 0])) for k in range(size)) < 1e-60 * self.scale:
                break
        box = [value + arb(0, RADIUS * max(1.0, abs(float(value)))) for value in point]
        F, J = self._conditions(point, linear, cones)[0], self._conditions(box, linear, cones)[1]
        try:
            step = J.solve(F)
        except ZeroDivisionError:
            return None
        zero = [point[k] - step[k, 0] for k in range(size)]
        if not all(inside in outer for inside, outer in zip(zero, box, strict=True)):
            return None
        return zero[:dim], zero[dim + len(self.equal) :], kept

    def _first_multipliers(self, w, linear, cones):
        if not cones:
            return [arb(0)] * len(linear)
        dim = self.program.dim
        gradient = self.program.P * arb_mat([[value] for value in w]) + self.program.q
        rows = [[float(row[0, k]) for k in range(dim)] for row in linear]
        rows += [[float(value) for value in self._cone(k, w)[1]] for k in cones]
        found = np.linalg.lstsq(np.array(rows).T, -np.array([float(gradient[k, 0]) for k in range(dim)]), rcond=None)[0]
        return [arb(value) for value in found]

    def _cone(self, index, w):
        """Return 1/2 (|V w + v|^2 - (r w + r_0)^2), its gradient and its Hessian."""
        (rows, radius), dim = self.program.cones[index], self.program.dim
        signed = [(row, 1) for row in rows] + [(radius, -1)]
        value, gradient, hessian = arb(0), arb_mat(1, dim), arb_mat(dim, dim)
        for row, sign in signed:
            there = self.value(row, w)
            part = arb_mat([[row[0, k] for k in range(dim)]])
            value += sign * there**2 / 2
            gradient += (sign * there) * part
            hessian += sign * (part.transpose() * part)
        return value, gradient.tolist()[0], hessian

    def _conditions(self, point, linear, cones):
        """Return F and its derivative at a point or box (w, y)."""
        program, dim = self.program, self.program.dim
        w, y = point[:dim], point[dim:]
        H, size, found = program.P, len(point), [self._cone(k, w) for k in cones]
        for (_, _, hessian), factor in zip(found, y[len(linear) :], strict=True):
            H = H + factor * hessian
        gradients = [[row[0, k] for k in range(dim)] for row in linear] + [gradient for _, gradient, _ in found]
        F, J = arb_mat(size, 1), arb_mat(size, size)
        smooth = program.P * arb_mat([[value] for value in w]) + program.q
        for k in range(dim):
            F[k, 0] = smooth[k, 0] + sum((g[k] * v for g, v in zip(gradients, y, strict=True)), arb(0))
            for j in range(dim):
                J[k, j] = H[k, j]
        values = [self.value(row, w) for row in linear] + [value for value, _, _ in found]
        for i, (value, gradient) in enumerate(zip(values, gradients, strict=True)):
            F[dim + i, 0] = value
            for k in range(dim):
                J[dim + i, k] = J[k, dim + i] = gradient[k]
        return F, J
