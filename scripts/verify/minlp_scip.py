# pyright: reportAttributeAccessIssue=false
"""SCIP on piecewise-smooth dynamics: formulas as its nonlinear constraints, solved by spatial branch and bound.

Every node of a formula that is no sum is a variable of its own, in units in which its enclosure is of order 1, and one
constraint; a norm is the root of a sum of squares, since w^2 = |a|^2, met to 1e-6, would leave |w - |a|| up to 1e-3 at
zero. What holds in one of several modes only is relaxed while its binary is 0: by the largest violation that the
enclosures allow, or, where these know none, as an indicator constraint. A formula that is not defined everywhere in
the box has copies of its arguments, which are defined and are tied to the arguments only while the mode holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pyscipopt import cos, exp, log, quicksum, sin, sqrt

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.formulas.nodes import Formula, nodes_in_order
from lin_freq_ocp.formulas.operations import NORM, POWER, PRODUCT, QUOTIENT, SUM, VARIABLE
from lin_freq_ocp.program.backends.base import CONTRADICTION, NO_POINT, Solution
from lin_freq_ocp.program.backends.scip_ import convex_model, decide_claim, run_scip, set_objective
from verify.minlp_program import ModeFormulas, SmoothProgram, enclosures

FUNCTIONS = {"exp": exp, "log": log, "sqrt": sqrt, "sin": sin, "cos": cos}
# Of a row of order 1. A binary that is 1 up to SCIP's 1e-6 relaxes it by 1e-2 then; above, indicators do it.
LARGEST_RELAXATION = 1e4
LARGEST_UNIT = 1e6  # enclosures beyond this say little of what a formula takes: its variable keeps this unit
SMALLEST_UNIT = 1e-30  # enclosures below this are those of zero, rounded outwards
Range = tuple[float, float]


def solve(program: SmoothProgram, time_limit: float | None, gap: float) -> Solution:
    """Solve; z has the variables of the program, then delta_{t,i}, (T * modes,), time after time.

    Raises
    ------
    UnsupportedError
        If SCIP has no function of a formula.
    """
    end, convex = np.inf if time_limit is None else now() + time_limit, program.program
    rows = convex.single_bounds()
    if program.excluded or rows.violation > CONTRADICTION:
        return NO_POINT
    units, origin = program.units, program.origin
    below, above = rows.below.copy(), rows.above.copy()
    count = len(units)
    below[:count] = np.maximum(below[:count], (program.lower - origin) / units)
    above[:count] = np.minimum(above[:count], (program.upper - origin) / units)
    above = np.maximum(below, above)
    model, z = convex_model(convex, replace(rows, below=below, above=above))
    deltas = _add_dynamics(model, program, z)
    set_objective(model, convex, z)
    found = run_scip(model, [*z, *deltas], seconds_left(end), gap)
    if found is None:
        return decide_claim(lambda free: solve(replace(program, program=free), seconds_left(end), gap), convex)
    return found


def _add_dynamics(model: Any, program: SmoothProgram, z: list[Any]) -> list[Any]:
    """Add all modes at all times; return their binaries."""
    pairs = zip(program.units, program.origin, z[: len(program.units)], strict=True)
    signals = [float(unit) * one + float(zero) for unit, zero, one in pairs]
    deltas: list[Any] = []
    for t, possible in enumerate(program.possible):
        least = float(possible.sum() == 1)
        binaries = [model.addVar(vtype="B", lb=least * can_hold, ub=float(can_hold)) for can_hold in possible]
        model.addCons(quicksum(binaries) == 1)
        _Stage.of(model, program, signals, t).add(possible, binaries)
        deltas += binaries
    return deltas


@dataclass
class _Stage:
    """The constraints of one time.

    Attributes
    ----------
    signals, after : list of expressions
        (x_t, u_t) and x_{t+1}, in the problem's units.
    bounds : list of ranges
        Of x_{t+1}.
    units : (n,)
        Of x_{t+1}.
    ranges : mapping from formulas to what they take
    partial : set of Formula
        Those that are not defined everywhere in the box, and what is made of them.
    made : mapping from (formula, mode) to expressions
        A formula that is not partial has mode -1: all modes share it.
    """

    model: Any
    modes: Sequence[ModeFormulas]
    signals: list[Any]
    after: list[Any]
    bounds: list[Range]
    units: Array
    ranges: dict[Formula, Range]
    partial: set[Formula] = field(default_factory=set[Formula])
    made: dict[tuple[Formula, int], Any] = field(default_factory=dict[tuple[Formula, int], Any])

    @classmethod
    def of(cls, model: Any, program: SmoothProgram, signals: list[Any], t: int) -> _Stage:
        """Return the stage of time t, to which nothing was added."""
        now, then = program.stage(t), program.state(t + 1)
        formulas = nodes_in_order([one for mode in program.modes for one in mode.all])
        lower, upper = enclosures(formulas, program.lower[now], program.upper[now])
        ranges = {one: (float(a), float(b)) for one, a, b in zip(formulas, lower, upper, strict=True)}
        bounds = [(float(program.lower[j]), float(program.upper[j])) for j in then]
        after = [signals[j] for j in then]
        stage = cls(model, program.modes, [signals[j] for j in now], after, bounds, program.units[then], ranges)
        for one in formulas:
            if stage._undefined(one) or any(argument in stage.partial for argument in one.arguments):
                stage.partial.add(one)
        return stage

    def add(self, possible: Mask, binaries: Sequence[Any]) -> None:
        """Add the modes that are possible."""
        for i, mode in enumerate(self.modes):
            if not possible[i]:
                continue
            delta = binaries[i] if possible.sum() > 1 else None
            for one in mode.domain:
                low, high = self.ranges[one]
                self._nonpositive(self._expression(one, i, delta) * -1.0, (-high, -low), delta)
            for one in mode.region:
                self._nonpositive(self._expression(one, i, delta), self.ranges[one], delta)
            for one, after, (least, most), unit in zip(mode.f, self.after, self.bounds, self.units, strict=True):
                low, high = self.ranges[one]
                self._zero(after - self._expression(one, i, delta), (least - high, most - low), float(unit), delta)

    def _zero(self, rest: Any, within: Range, unit: float, delta: Any) -> None:
        """Add rest = 0, where delta is 1, for an expression that is within a range."""
        if delta is None:
            self.model.addCons(rest * (1.0 / unit) == 0)
            return
        self._nonpositive(rest, within, delta, unit)
        self._nonpositive(rest * -1.0, (-within[1], -within[0]), delta, unit)

    def _nonpositive(self, rest: Any, within: Range, delta: Any, unit: float | None = None) -> None:
        """Add rest <= 0, where delta is 1, for an expression that is within a range."""
        unit = unit or _unit(within)
        rest, most = rest * (1.0 / unit), within[1] / unit
        if most <= 0:
            return
        if delta is None:
            self.model.addCons(rest <= 0)
        elif most <= LARGEST_RELAXATION:
            self.model.addCons(rest + most * delta <= most)
        else:
            self.model.addConsIndicator(rest <= 0, binvar=delta)

    def _expression(self, formula: Formula, mode: int, delta: Any) -> Any:
        """Return a formula of a mode as a linear expression of variables; with other modes it has the mode's binary."""
        for one in nodes_in_order([formula]):
            if self._key(one, mode) not in self.made:
                self.made[self._key(one, mode)] = self._node(one, mode, delta)
        return self.made[self._key(formula, mode)]

    def _key(self, one: Formula, mode: int) -> tuple[Formula, int]:
        return one, mode if one in self.partial else -1

    def _node(self, one: Formula, mode: int, delta: Any) -> Any:
        arguments = [self.made[self._key(argument, mode)] for argument in one.arguments]
        if one.kind == VARIABLE:
            return self.signals[int(one.data[0])]
        if one.kind == SUM:
            terms = (factor * argument for factor, argument in zip(one.data[:-1], arguments, strict=True))
            return quicksum(terms) + one.data[-1]
        if self._undefined(one):
            last = one.arguments[-1]
            positive = one.kind != QUOTIENT or last in self.modes[mode].domain
            arguments[-1] = self._copy(arguments[-1], last, positive, delta)
        elif one.kind == POWER and one.data[0] > 2:
            arguments[0] = self._copy(arguments[0], one.arguments[0], False, None)
        unit = _unit(self.ranges[one])
        variable = self._variable(self.ranges[one], unit)
        self.model.addCons(variable == (1.0 / unit) * _function(one, arguments))
        return unit * variable

    def _copy(self, argument: Any, formula: Formula, positive: bool, delta: Any) -> Any:
        """Return a variable that is the argument where delta is 1, and never below zero if it is to be positive."""
        low, high = self.ranges[formula]
        least, unit = max(low, 0.0) if positive else low, _unit((low, high))
        copied = unit * self._variable((least, high), unit)
        self._zero(argument - copied, (low - high, high - least), unit, delta)
        return copied

    def _variable(self, within: Range, unit: float) -> Any:
        low, high = (bound / unit if np.isfinite(bound) else None for bound in within)
        return self.model.addVar(lb=low, ub=high)

    def _undefined(self, one: Formula) -> bool:
        """Whether a node is not defined everywhere where its last argument is."""
        if one.kind not in (QUOTIENT, "log", "sqrt"):
            return False
        low, high = self.ranges[one.arguments[-1]]
        if one.kind == QUOTIENT:
            return low <= 0 <= high
        return low <= 0 if one.kind == "log" else low < 0


def _function(one: Formula, arguments: Sequence[Any]) -> Any:
    """Return a node as a nonlinear expression of its arguments."""
    if one.kind == PRODUCT:
        return arguments[0] * arguments[1]
    if one.kind == QUOTIENT:
        return arguments[0] / arguments[1]
    if one.kind == POWER:
        return arguments[0] ** int(one.data[0])
    if one.kind == NORM:
        return sqrt(quicksum(argument * argument for argument in arguments))
    if one.kind in FUNCTIONS:
        return FUNCTIONS[one.kind](arguments[0])
    raise UnsupportedError(f"dynamics: got a {one.kind} in a mode; SCIP has no such function.")


def _unit(within: Range) -> float:
    """Return a unit in which a range is of order 1, as far as it is known."""
    size = max(abs(within[0]), abs(within[1]))
    return min(size, LARGEST_UNIT) if SMALLEST_UNIT < size < np.inf else 1.0
