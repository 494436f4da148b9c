"""A piecewise-smooth problem as one program with binaries: a convex part, and formulas with boxes around their signals.

Sets, costs and frequency constraints are the rows of linear.py, in natural units; the maps and regions of the modes
remain formulas, which a solver of nonlinear programs gets one by one:

    x_{t+1} = f_i(x_t, u_t),    s_i(x_t, u_t) <= 0,    d_i(x_t, u_t) >= 0    while the binary delta_{t,i} is 1,
    sum_i delta_{t,i} = 1.

States and controls lie in boxes: those of the problem and, from one time to the next, the enclosures of the maps over
them. A mode whose enclosures leave nothing of its region, domain or image cannot hold at that time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.formulas.intervals import Interval
from lin_freq_ocp.formulas.jets import interval_jets
from lin_freq_ocp.formulas.nodes import Formula, nodes_in_order
from lin_freq_ocp.formulas.operations import QUOTIENT
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.units import common_scaling
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.sizes import stated_sizes


@dataclass(frozen=True, eq=False)
class ModeFormulas:
    """One mode; subexpressions that occur several times, in this mode or another, are one node.

    Attributes
    ----------
    f, region, domain : tuple of Formula
        As in ``SmoothMode``.
    """

    f: tuple[Formula, ...]
    region: tuple[Formula, ...]
    domain: tuple[Formula, ...]

    @property
    def all(self) -> tuple[Formula, ...]:
        """Return all of them."""
        return (*self.f, *self.region, *self.domain)


@dataclass(frozen=True, eq=False)
class SmoothProgram:
    """The program of a problem with piecewise-smooth dynamics, with its own inverse.

    Attributes
    ----------
    problem : OptimalControlProblem
    program : Program
        All rows but those of dynamics and modes, in natural units; its variables are deviations from the references.
    scaling : Scaling
        Of the variables and the cost; its rows are those of the host.
    host : LinearProgram
        Its variables are those of the program: states, controls, slacks.
    modes : tuple of ModeFormulas
    lower, upper : (signals,)
        Bounds of states and controls, in the problem's units; infinite where none is known.
    possible : (T, modes)
        Which modes can hold when.
    """

    problem: OptimalControlProblem
    program: Program
    scaling: Scaling
    host: LinearProgram
    modes: tuple[ModeFormulas, ...]
    lower: Array
    upper: Array
    possible: Mask

    @property
    def excluded(self) -> bool:
        """Whether intervals prove that there is no trajectory: at some time, no mode can hold."""
        return not self.possible.any(axis=1).all()

    @property
    def origin(self) -> Array:
        """Return the origin of the program's variables, (signals,), in the problem's units."""
        T, n, m = self.problem.horizon, self.problem.state_dim, self.problem.control_dim
        return -self.host.point(Trajectory(np.zeros((T + 1, n)), np.zeros((T, m))))[: self.host.signals]

    @property
    def units(self) -> Array:
        """Return one unit per state and control, (signals,)."""
        return self.scaling.columns[: self.host.signals]

    def state(self, t: int) -> Indices:
        """Return which variables are x_t, (n,)."""
        n = self.problem.state_dim
        return np.arange(t * n, (t + 1) * n)

    def stage(self, t: int) -> Indices:
        """Return which variables are (x_t, u_t), (n + m,)."""
        m = self.problem.control_dim
        first = (self.problem.horizon + 1) * self.problem.state_dim + t * m
        return np.concatenate([self.state(t), np.arange(first, first + m)])

    def trajectory(self, z: Array) -> Trajectory:
        """Return (x, u) from the variables of the program."""
        return self.host.trajectory(self.scaling.primal(z))

    def cost(self, objective: float) -> float:
        """Return the cost J, in the problem's units, from a value of the program's objective."""
        return objective / self.scaling.cost


def smooth_program(problem: OptimalControlProblem) -> SmoothProgram:
    """Return the program of a problem with piecewise-smooth dynamics.

    Raises
    ------
    UnsupportedError
        If the dynamics are not piecewise smooth.
    """
    modes = _interned(problem)
    lower, upper, possible = _reach(problem, modes)
    hosts = _hosts(problem, lower, upper)
    host, scaling = hosts[0], common_scaling(hosts, stated_sizes(problem))
    whole = host.sparse.scaled(scaling)
    first = whole.rows[Block.DYNAMICS].stop  # the host's first rows
    program = replace(
        whole,
        A=sp.csc_array(whole.A[first:]),
        lower=whole.lower[first:],
        upper=whole.upper[first:],
        rows={
            block: slice(place.start - first, place.stop - first)
            for block, place in whole.rows.items()
            if block is not Block.DYNAMICS
        },
        cones=tuple(slice(cone.start - first, cone.stop - first) for cone in whole.cones),
    )
    return SmoothProgram(problem, program, scaling, host, modes, lower, upper, possible)


def enclosures(formulas: Sequence[Formula], lower: Array, upper: Array) -> Interval:
    """Return the ranges of formulas over the box lower <= (x, u) <= upper (n + m,), a pair of (formulas,)."""
    values = interval_jets(formulas, lower[None], upper[None]).values
    return values[0][0], values[1][0]


def _interned(problem: OptimalControlProblem) -> tuple[ModeFormulas, ...]:
    """Return the modes with every formula that is written twice made one node."""
    table: dict[tuple[object, ...], Formula] = {}
    made: dict[Formula, Formula] = {}
    found: list[ModeFormulas] = []
    for mode in piecewise_smooth(problem).modes:
        for one in nodes_in_order((*mode.f, *mode.region, *mode.domain)):
            arguments = tuple(made[argument] for argument in one.arguments)
            key = one.kind, one.data, one.function, *(id(argument) for argument in arguments)
            made[one] = table.setdefault(key, replace(one, arguments=arguments))
        parts = (tuple(made[one] for one in part) for part in (mode.f, mode.region, mode.domain))
        found.append(ModeFormulas(*parts))
    return tuple(found)


def _reach(problem: OptimalControlProblem, modes: Sequence[ModeFormulas]) -> tuple[Array, Array, Mask]:
    """Return boxes that all trajectories stay in, (signals,), and which modes can hold when."""
    T, n = problem.horizon, problem.state_dim
    tube, controls = problem.state_tube, problem.control_tube
    states = np.stack([tube.lower, tube.upper])
    possible = np.zeros((T, len(modes)), dtype=bool)
    for t in range(T):
        low, high = (
            np.append(states[side, t], bound[t]) for side, bound in enumerate((controls.lower, controls.upper))
        )
        images: list[Array] = []
        for i, mode in enumerate(modes):
            values = np.stack(enclosures(mode.all, low, high))
            rows, domains = values[:, n : n + len(mode.region)], values[:, n + len(mode.region) :]
            image = np.stack([np.maximum(values[0, :n], states[0, t + 1]), np.minimum(values[1, :n], states[1, t + 1])])
            defined = (domains[1] > 0).all() and not _nowhere(mode, low, high)
            if defined and (rows[0] <= 0).all() and (image[0] <= image[1]).all():
                possible[t, i] = True
                images.append(image)
        if not images:
            break
        hull = np.stack(images)
        states[:, t + 1] = hull[:, 0].min(axis=0), hull[:, 1].max(axis=0)
    lower, upper = (
        np.append(states[side].ravel(), bound.ravel()) for side, bound in enumerate((controls.lower, controls.upper))
    )
    return lower, upper, possible


def _nowhere(mode: ModeFormulas, lower: Array, upper: Array) -> bool:
    """Whether something in a mode is defined nowhere in a box."""
    nodes = [one for one in nodes_in_order(mode.all) if one.kind in ("sqrt", "log", QUOTIENT)]
    low, high = enclosures([one.arguments[-1] for one in nodes], lower, upper)
    return any(
        a == b == 0 if one.kind == QUOTIENT else b < 0 or (b == 0 and one.kind == "log")
        for one, a, b in zip(nodes, low, high, strict=True)
    )


def _hosts(problem: OptimalControlProblem, lower: Array, upper: Array) -> list[LinearProgram]:
    """Return the problem with the map of each mode, linearised in the middle of the boxes, and no regions."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    low, high = np.where(np.isfinite(lower), lower, np.minimum(upper, 0.0)), upper
    low = np.where(np.isfinite(low), low, 0.0)
    middle = np.where(np.isfinite(high), (low + np.where(np.isfinite(high), high, 0.0)) / 2, low)
    x, u = np.split(middle, [(T + 1) * n])
    affine = piecewise_smooth(problem).affine_at(x.reshape(T + 1, n), u.reshape(T, m))
    return [LinearProgram(replace(problem, dynamics=affine.along(np.full(T, i)))) for i in range(len(affine.modes))]
