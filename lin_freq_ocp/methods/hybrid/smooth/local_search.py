"""Local optima of several mode sequences, each improved by changing one mode at a time.

For one or two states, dynamic programming on a grid of states and controls gives trajectories to start from. Values
between grid points are interpolated linearly, so the result is near an optimum and proves nothing. Frequency
constraints couple all times; their multipliers, as functions of time, are in the stage costs instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.formulas.jets import values_of
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.methods.candidate import Attempt, Progress, Reason
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import End, LocalOptimum, is_smooth, smooth_optimum
from lin_freq_ocp.methods.hybrid.smooth.model import Pieces
from lin_freq_ocp.problem.hybrid.affine_mode import REGION
from lin_freq_ocp.problem.hybrid.formula_modes import affine_row
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.transform.sizes import search_scale, stated_sizes
from lin_freq_ocp.transform.starts import Start

# Grid points of each state and of each control, by the numbers of states and controls: some 10^5 pairs
POINTS = {(1, 1): (301, 401), (1, 2): (201, 25), (2, 1): (61, 51), (2, 2): (41, 11)}
FINER = 4  # times as many control points in the forward pass
SAMPLES = 64  # random control sequences, for the range of states without bounds
# Of the distance to the terminal set, relative to the spread of stage costs over the range of a state: no control of
# the grid reaches the set exactly; a high price favours the distance, a low one the cost
END_PRICES = (2.0, 10.0, 50.0)


@dataclass(frozen=True, eq=False)
class ValueGrid:
    """Pairs of states and controls of a problem's grid, with the weights that interpolate values at their successors.

    ``axes`` are those of states, ``pairs`` (states * controls, n + m), ``outside`` those whose successors are not
    within the grid.
    """

    problem: OptimalControlProblem
    axes: list[Array]
    pairs: Array
    weights: sp.csr_array
    outside: Mask

    @classmethod
    def of(cls, problem: OptimalControlProblem) -> ValueGrid | None:
        """Return the grid; None with more than two states, without bounds, or where the map depends on time."""
        n, m = problem.state_dim, problem.control_dim
        bounded = np.isfinite(problem.control_tube.bounds).all()
        if (n, m) not in POINTS or not bounded or piecewise_smooth(problem).depends_on_time:
            return None
        of_states, of_controls = POINTS[n, m]
        axes = [np.linspace(low, high, of_states) for low, high in zip(*_state_range(problem), strict=True)]
        states, controls = _combinations(axes), _controls(problem, of_controls)
        pairs = np.hstack([np.repeat(states, len(controls), axis=0), np.tile(controls, (len(states), 1))])
        return cls(problem, axes, pairs, *_interpolate(axes, _successors(problem, pairs)))

    def trajectories(self, multipliers: Multipliers | None, deadline: float = np.inf) -> Iterator[Trajectory]:
        """Yield trajectories of the grid's values until ``deadline``. Frequency multipliers are in the cost."""
        problem, states = self.problem, _combinations(self.axes)
        costs, end = _StageCosts(problem, multipliers), problem.ends[1]
        cost = costs.at(problem.horizon - 1, self.pairs)
        spread = float(np.ptp(cost))
        distance = np.maximum(np.maximum(end.lower - states, states - end.upper), 0.0)
        to_end = spread * (distance / np.maximum(np.ptp(self.axes, axis=1), 1e-300)).sum(axis=1)
        prices = np.array(END_PRICES if to_end.any() else END_PRICES[:1])
        value = costs.last(states)[:, None] + prices * to_end[:, None]
        # more than any trajectory costs, in any unit of the cost, and with any constant in it
        far = 10 * problem.horizon * (float(max(np.abs(cost).max(), np.abs(value).max())) or 1.0)
        following = [value]  # of each state and price, from the last time to the first
        for t in range(problem.horizon - 1, 0, -1):
            if now() > deadline:
                return
            total = cost[:, None] + np.where(self.outside[:, None], far, self.weights @ value)
            value = np.minimum(total.reshape(len(states), -1, len(prices)).min(axis=1), far)
            following.append(value)
            cost = cost if costs.are_same(t - 1, t) else costs.at(t - 1, self.pairs)
        for price in range(len(prices)):
            trajectory = self._follow(costs, [values[:, price] for values in following[::-1]], far)
            if trajectory is not None:
                yield trajectory

    def _follow(self, costs: _StageCosts, following: list[Array], far: float) -> Trajectory | None:
        problem = self.problem
        controls = _controls(problem, FINER * POINTS[problem.state_dim, problem.control_dim][1])
        box = problem.ends[0]
        x = [np.clip(np.zeros(problem.state_dim), box.lower, box.upper)]
        u: list[Array] = []
        for t in range(problem.horizon):
            pairs = np.hstack([np.tile(x[-1], (len(controls), 1)), controls])
            after = _successors(problem, pairs)
            weights, outside = _interpolate(self.axes, after)
            total = costs.at(t, pairs) + np.where(outside, far, weights @ following[t])
            total = np.where(np.isfinite(after).all(axis=1), total, np.inf)
            best = int(np.argmin(total))
            if not np.isfinite(total[best]):
                return None
            u.append(controls[best])
            x.append(after[best])
        return Trajectory(np.array(x), np.array(u))


def _combinations(axes: list[Array]) -> Array:
    """Return all points with a coordinate of each axis, (points, axes)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _interpolate(axes: list[Array], x: Array) -> tuple[sp.csr_array, Mask]:
    """Return the weights of ``_combinations`` that interpolate linearly at x (points, n), and which x are outside.

    The rows of points outside, and of those that are no numbers, are zero.
    """
    outside, numbers = np.zeros(len(x), dtype=bool), np.zeros((len(x), 1), dtype=np.int32)
    weights = np.ones((len(x), 1))
    for axis, values in zip(axes, x.T, strict=True):
        outside |= np.isnan(values) | (values < axis[0]) | (values > axis[-1])
        cell = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, len(axis) - 2).astype(np.int32)
        within = np.nan_to_num(np.clip(values, axis[0], axis[-1]))
        share = ((within - axis[cell]) / (axis[cell + 1] - axis[cell]))[:, None]
        numbers = np.hstack([numbers * len(axis) + cell[:, None], numbers * len(axis) + cell[:, None] + 1])
        weights = np.hstack([weights * (1 - share), weights * share])
    weights[outside] = 0.0
    first = np.arange(0, weights.size + 1, weights.shape[1])
    shape = len(x), int(np.prod([len(axis) for axis in axes]))
    return sp.csr_array((weights.ravel(), numbers.ravel(), first), shape=shape), outside


class _StageCosts:
    """The quadratic costs of pairs (points, n + m), with the signals of frequency multipliers."""

    def __init__(self, problem: OptimalControlProblem, multipliers: Multipliers | None):
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        self._cost, self._n = problem.quadratic, n
        self._hessians = np.broadcast_to(self._cost.stage_hessians, (T, n + m, n + m)).copy()  # BLAS takes no views
        x_ref, u_ref = np.broadcast_to(self._cost.x_ref, (T + 1, n)), np.broadcast_to(self._cost.u_ref, (T, m))
        self._formulas = problem.cost.formulas
        self._references, self._last = np.hstack([x_ref[:-1], u_ref]), x_ref[-1]
        linear = np.hstack([np.broadcast_to(self._cost.q, (T, n)), np.broadcast_to(self._cost.r, (T, m))])
        self._linear, self.end = linear, np.asarray(self._cost.p)
        if multipliers is not None:
            of_x, of_u = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, T)
            self._linear = linear + np.hstack([of_x[:-1], of_u])
            self.end = self.end + of_x[-1]

    def are_same(self, *times: int) -> bool:
        """Whether the costs at two times are the same function; formulas do not depend on time."""
        return all(
            np.array_equal(*(data[t] for t in times)) for data in (self._hessians, self._references, self._linear)
        )

    def at(self, t: int, pairs: Array) -> Array:
        """Return the costs at a time, (points,)."""
        y = pairs - self._references[t]
        values = 0.5 * np.einsum("pi,pi->p", y @ self._hessians[t], y) + y @ self._linear[t]
        return values + _values_of_cost(self._formulas[0], pairs, t)

    def last(self, states: Array) -> Array:
        """Return the costs of the last state, (points,)."""
        a, pairs = states - self._last, np.pad(states, ((0, 0), (0, self._linear.shape[1] - self._n)))
        values = 0.5 * np.einsum("pi,pi->p", a @ self._cost.P, a) + a @ self.end
        return values + _values_of_cost(self._formulas[1], pairs, len(self._linear))


def _values_of_cost(formula: Formula | None, pairs: Array, t: int) -> Array:
    """Return a cost by a formula of pairs (points, n + m) at a time, zeros without one."""
    return np.zeros(len(pairs)) if formula is None else values_of([formula], pairs, np.array([t]))[:, 0]


def states_of_controls(problem: OptimalControlProblem, first: Array, controls: Array) -> Array:
    """Return states (trials, T + 1, n) from the ``first`` by controls (trials, T, m); NaN once no mode holds."""
    x = [first]
    for t, u in enumerate(controls.swapaxes(0, 1)):
        x.append(_successors(problem, np.hstack([x[-1], u]), t))
    return np.stack(x, axis=1)


def _successors(problem: OptimalControlProblem, pairs: Array, time: int = 0) -> Array:
    """Return the successors of pairs in the first mode that holds, (points, n); NaN where none does."""
    dynamics = piecewise_smooth(problem)
    successors = np.full((len(pairs), problem.state_dim), np.nan)
    missing, at = np.ones(len(pairs), dtype=bool), np.array([time])
    for mode in dynamics.modes:
        values, region, domain = (values_of(part, pairs, at) for part in (mode.f, mode.region, mode.domain))
        holds = missing & (region <= 0).all(axis=1) & (domain > 0).all(axis=1) & np.isfinite(values).all(axis=1)
        successors[holds] = values[holds]
        missing &= ~holds
    return successors


def _controls(problem: OptimalControlProblem, points: int) -> Array:
    """Return a grid over the bounds of the controls, (points, m)."""
    tube = problem.control_tube
    lower, upper = tube.lower.min(axis=0), tube.upper.max(axis=0)
    return _combinations([np.linspace(low, high, points) for low, high in zip(lower, upper, strict=True)])


def _state_range(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return bounds of the states, (n,) and (n,): as stated, else by simulation with random controls."""
    tube, rng = problem.state_tube, np.random.default_rng(0)
    lower, upper = tube.lower.min(axis=0), tube.upper.max(axis=0)
    if np.isfinite(lower).all() and np.isfinite(upper).all():
        return lower, upper
    start = np.clip(np.zeros(problem.state_dim), problem.ends[0].lower, problem.ends[0].upper)
    low, high = problem.control_tube.lower, problem.control_tube.upper
    shares = np.array([rng.random(low.shape) if i % 2 else np.full(low.shape, rng.random()) for i in range(SAMPLES)])
    reached = states_of_controls(problem, np.tile(start, (SAMPLES, 1)), low + shares * (high - low))
    states = np.vstack([start, *reached[np.isfinite(reached).all(axis=(1, 2))]])
    margin = 0.05 * np.ptp(states, axis=0) + 1e-3
    return (
        np.where(np.isfinite(lower), lower, states.min(axis=0) - margin),
        np.where(np.isfinite(upper), upper, states.max(axis=0) + margin),
    )


SHARES = (0.5, 0.1, 0.9, 0.3, 0.7)  # constant controls to start from, between lower and upper bound
# Sizes of random controls that follow where nothing bounds controls and no start led to a trajectory: from near, the
# violation has local minima. The last one that random problems needed was the 12th or 13th, by rounding
FAR_REACHES = 8 * (16.0, 64.0, 256.0)
SIDES = (1.0, -1.0)  # of an obstacle
REACHES = tuple(2.0**k for k in range(-16, 12))  # sizes of a state by which a line is bent to pass an obstacle
BETWEEN = tuple(k / 8 for k in range(1, 8))  # parts of a step at which a line that passes an obstacle is outside, too
# Starts that are enough if there is an answer and no modes are searched: with bounds of all controls or if the last
# start led to the best answer again, and else
SMOOTH_STARTS, UNBOUNDED_STARTS = 2, 4
LONGEST_REPLAY = 2000  # steps of a start, where it need not be a trajectory
DIVERGED_STATES = 1e2  # size of a state, relative to its data, from which a straight line is a better start
DECREASE = 1e-9  # part of the cost by which a better sequence is cheaper


@dataclass(frozen=True)
class SmoothProgress(Progress):
    """How far the search over piecewise-smooth dynamics is.

    Attributes
    ----------
    tried : int
        Starts of local searches.
    level : int
        Of the lattices of the bound; 0 before.
    share : float
        How much of the level is done, from 0 to 1.
    """

    tried: int
    level: int = 0
    share: float = 0.0

    def __str__(self) -> str:
        message = [f"cost {self.cost:.6g}" if np.isfinite(self.cost) else "no trajectory yet", f"{self.tried} starts"]
        if self.level:
            message.append(f"bound {self.lower_bound:.6g}, {self.share:.0%} of level {self.level}")
        return ", ".join(message)


@dataclass
class LocalSearch:
    """One search; ``run`` it once, then ``look_near`` other starts.

    ``best`` is the cheapest trajectory, else the point of least violation; ``tried`` counts starts; ``attempts`` say
    how each ended, and ``message`` why the search stopped early; ``progress`` is called after every start, the first
    being ``start``. No trajectory costs less than ``least``: one that costs no more ends the search. Of smooth
    problems, a local optimum that ``is_proven`` to be global ends it, as does a trajectory that grows without a bound.
    """

    problem: OptimalControlProblem
    seconds: float = np.inf
    progress: Callable[[SmoothProgress], None] | None = None
    start: Start | None = None
    is_proven: Callable[[LocalOptimum], bool] = lambda _: False
    least: float = -np.inf
    best: LocalOptimum | None = None
    tried: int = 0
    message: str = ""
    interrupted: bool = False

    def __post_init__(self):
        self.end = now() + self.seconds
        self._known, self._decided = set[tuple[object, ...]](), set[bytes]()
        self._repeated, self._proven, self.attempts = False, False, list[Attempt]()
        self._sizes, self._units = stated_sizes(self.problem)
        self._smooth, self._lines = is_smooth(self.problem), list[Trajectory]()
        self._bounded = bool(np.isfinite(self.problem.control_tube.bounds).all())
        alone = Pieces.of(self.problem, np.zeros(self.problem.horizon, dtype=np.intp))
        if self._smooth and (obstacles := alone.with_regions(self.problem).path_constraints):
            line = self._trajectory_at(SHARES[0], replayed=False)
            self._lines = lines_around_obstacles(obstacles, line, self._sizes) or [line]

    def run(self) -> LocalSearch:
        """Search from all starts, then improve the best; from a given start alone if no modes are to be searched."""
        try:
            for start, sequence, warm in self._all_starts():
                reason = self._try(start, sequence, warm=warm)
                if self._late() or reason in (Reason.PROVEN, Reason.UNBOUNDED):
                    return self
            while not (self._late() or self._proven) and (self._on_grid(self.best) or self._improve_neighbours()):
                pass
        except KeyboardInterrupt:
            self.interrupted, self.message = True, "interrupted"
        return self

    def _all_starts(self) -> Iterator[tuple[Trajectory, Indices, bool]]:
        """Yield the given start, then those of ``starts`` until there are enough; the flag says if it is near."""
        if self.start is not None:
            given = self.start.trajectory or self._trajectory_at(SHARES[0])
            for warm in (True, False) if self._smooth else (True,):
                yield given, self.start.sequence, warm
                if self._smooth and self.best is not None and self.best.reason is Reason.LOCALLY_OPTIMAL:
                    return
        self._on_grid(None)
        for trajectory, sequence in self.starts():
            enough = self._cost < np.inf and self.tried >= self.enough_starts
            if enough and len(piecewise_smooth(self.problem).modes) == 1:
                break
            yield trajectory, sequence, False
        if self._smooth and self.best is not None and not self.best.feasible:
            yield self.best.trajectory, self.best.sequence, True

    @property
    def enough_starts(self) -> int:
        """Return how many starts are enough if there is an answer and there are no modes to search."""
        return max(len(self._lines), SMOOTH_STARTS if self._bounded or self._repeated else UNBOUNDED_STARTS)

    def look_near(self, trajectory: Trajectory, sequence: Indices) -> bool:
        """Try one more start, and improve its local optimum; return whether that is a better trajectory."""
        before = self.best
        self._try(trajectory, sequence, self._cost, warm=True)
        while self.best is not before and self._improve_neighbours():
            pass
        return self.best is not before and self.best is not None and self.best.feasible

    @cached_property
    def _grid(self) -> ValueGrid | None:
        return ValueGrid.of(self.problem)

    def _on_grid(self, local: LocalOptimum | None) -> bool:
        """Try the trajectory of a grid, with the frequency multipliers of a local optimum; return if it is better."""
        before = self.best
        constrained = self.problem.control_stop.any() or self.problem.state_stop.any()
        if self._smooth or (local is not None and (not constrained or not local.feasible)) or self._grid is None:
            return False
        multipliers = None if local is None else local.multipliers
        for trajectory in self._grid.trajectories(multipliers, self.end):
            self._try(trajectory, piecewise_smooth(self.problem).sequence_of(trajectory.x, trajectory.u))
        return self.best is not before

    def _improve_neighbours(self) -> bool:
        """Try the neighbours of the best sequence; return whether one of them is better."""
        before = self.best
        if before is None:
            return False
        for sequence in neighbouring_sequences(self.problem, before):
            if self._late():
                return False
            self._try(before.trajectory, sequence, self._cost)
            if self.best is not before:
                return True
        return False

    def _try(self, start: Trajectory, sequence: Indices, below: float = np.inf, warm: bool = False) -> Reason | None:
        """Search from a start; return why another one may be tried, None if this one was tried before."""
        own = (start.x.tobytes(), warm) if self._smooth else ()  # of one map, states need not follow from the controls
        key = sequence.tobytes(), np.round(start.u / self._units, 6).tobytes(), own
        if self._late() or self._proven or key in self._known or sequence.tobytes() in self._decided:
            return None
        self._known.add(key)
        self.tried += 1
        useful = np.inf  # of one map, starts that repeat an optimum end the search
        if not self._smooth and self.best is not None and self.best.reason is Reason.LOCALLY_OPTIMAL:
            useful = self.best.cost + self._least_decrease(self.best)
        optimum, ended = smooth_optimum(self.problem, start, sequence, self.end, warm, useful)
        self.interrupted = ended is End.INTERRUPTED
        if self._convex and ended in (End.OPTIMAL, End.DEARER):  # whatever the start is
            self._decided.add(sequence.tobytes())
        reason = Reason.REFUSED if optimum is None else optimum.reason
        if optimum is not None and self._improves(optimum):
            self.best = optimum
            self._proven = reason is Reason.LOCALLY_OPTIMAL and self._is_least(optimum)
            if self._proven:
                reason = Reason.PROVEN
            elif self._smooth and reason is Reason.FEASIBLE and self._diverges(optimum.trajectory):
                reason = Reason.UNBOUNDED
        if self.best is optimum or below == np.inf:  # of neighbouring sequences, the better ones
            self.attempts.append(Attempt("barrier", None, reason))
        if self.progress is not None:
            self.progress(SmoothProgress(self._cost, -np.inf, self.tried))
        return reason

    @cached_property
    def _convex(self) -> bool:
        """Whether a mode sequence is a convex problem: maps and regions are affine, and there are no other formulas."""
        modes, given = piecewise_smooth(self.problem).modes, self.problem
        formulas = [one for mode in modes for one in (*mode.f, *mode.region)]
        others = given.path_constraints or given.cost.has_formulas or any(mode.domain for mode in modes)
        return not others and all(affine_row(one) is not None for one in formulas)

    def _is_least(self, optimum: LocalOptimum) -> bool:
        """Whether an optimum is proven to be global: of one map by ``is_proven``, else by ``least``."""
        if self._smooth:
            return self.is_proven(optimum)
        return optimum.cost - self._least_decrease(optimum) <= self.least

    def _improves(self, optimum: LocalOptimum) -> bool:
        """Whether an optimum is preferred to the best one, by its reason, then with less violation or cost."""
        best, self._repeated = self.best, False
        if best is None or optimum.reason is not best.reason:
            return best is None or optimum.reason > best.reason
        if not best.feasible:
            return optimum.violation < best.violation
        prices = float((np.abs(optimum.multipliers.eta) @ self._sizes).sum())  # of its violation, which is no gain
        decrease = max(self._least_decrease(best), prices * optimum.violation)
        self._repeated = best.converged and abs(optimum.cost - best.cost) <= decrease
        return optimum.cost < best.cost - decrease

    def _least_decrease(self, best: LocalOptimum) -> float:
        """Return how much cheaper than an optimum another one is to be."""
        return DECREASE * search_scale(self.problem, best.trajectory)

    @property
    def _cost(self) -> float:
        """The cost of the best trajectory, infinite without one."""
        return self.best.cost if self.best is not None and self.best.feasible else np.inf

    def _late(self) -> bool:
        if self.interrupted:
            self.message = "interrupted"
            return True
        if now() <= self.end:
            return False
        self.message = f"time limit of {self.seconds:g} s"
        return True

    def _diverges(self, trajectory: Trajectory) -> bool:
        return not (np.abs(trajectory.x) <= DIVERGED_STATES * self._sizes).all()

    def starts(self) -> Iterator[tuple[Trajectory, Indices]]:
        """Yield trajectories of constant controls with their mode sequences, then with each mode alone.

        Of one smooth map, a straight line between the ends comes last; with path constraints first, after the lines
        that pass obstacles on either side. Without bounds of controls it is third, and random controls come last.
        """
        dynamics = piecewise_smooth(self.problem)
        alone = np.zeros(self.problem.horizon, dtype=np.intp)
        yield from ((line, alone) for line in self._lines)
        for i, share in enumerate(SHARES):
            trajectory = self._trajectory_at(share)
            yield trajectory, alone if self._smooth else dynamics.sequence_of(trajectory.x, trajectory.u)
            if self._smooth and i == (len(SHARES) - 1 if self._bounded else 1):
                yield self._trajectory_at(SHARES[0], replayed=False), alone
        rng = np.random.default_rng(0)
        for reach in FAR_REACHES if self._smooth and not self._bounded else ():
            yield self._trajectory_at(rng.random(self.problem.control_tube.lower.shape), reach=reach), alone
        for mode in range(0 if self._smooth else len(dynamics.modes)):
            yield self._trajectory_at(SHARES[0]), np.full(self.problem.horizon, mode, dtype=np.intp)

    def _trajectory_at(self, share: Array | float, replayed: bool = True, reach: float = 1.0) -> Trajectory:
        """Return the trajectory of controls at a share between their bounds, or ``reach`` sizes where they have none.

        Where there is none, the state is constant. Of one smooth map, whose replay may take long or diverge, it then
        goes straight from one end to the other.
        """
        tube, middle = self.problem.control_tube, np.full(self.problem.state_dim, 0.5)
        u = _middle(tube, np.broadcast_to(share, tube.lower.shape), reach * self._units)
        start = _middle(self.problem.ends[0], middle)
        if replayed and (not self._smooth or self.problem.horizon <= LONGEST_REPLAY):
            with suppress(NumericalError):
                trajectory = simulate(self.problem, u, start)
                if not self._smooth or not self._diverges(trajectory):
                    return trajectory
        box = self.problem.ends[1]
        bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
        end = np.where(bounded & self._smooth, _middle(box, middle), start)
        part = np.linspace(0.0, 1.0, self.problem.horizon + 1)[:, None]
        return Trajectory((1 - part) * start + part * end, u)


def neighbouring_sequences(problem: OptimalControlProblem, local: LocalOptimum) -> Iterator[Indices]:
    """Yield the sequences with one mode changed, first where the multipliers of regions are largest."""
    T, modes = problem.horizon, len(piecewise_smooth(problem).modes)
    largest = local.multipliers.stage.get(REGION, np.zeros((T, 1))).max(axis=1, initial=0.0)
    for t in np.argsort(-largest, kind="stable"):
        for i in range(modes):
            if i != local.sequence[t]:
                changed = local.sequence.copy()
                changed[t] = i
                yield changed


def lines_around_obstacles(obstacles: Sequence[PathConstraint], line: Trajectory, sizes: Array) -> list[Trajectory]:
    """Return a line through obstacles, bent along each state to either side until it is outside of them.

    Obstacles are hard path constraints that the line violates; ``sizes`` are those of states, (n,). Lines that jump
    over an obstacle from one time to the next pass at no part of the way once they are bent twice as far.
    """
    hard = [one for one in obstacles if one.hard_part is not None]

    def passes(x: Array, parts: Sequence[float] = (0.0,)) -> bool:
        ways = ((x + part * np.diff(x, axis=0, append=x[-1:]), slice(int(part == 0), -1)) for part in parts)
        violations = (one.violation(way, line.u)[times] for way, times in ways for one in hard)
        return all(float(np.nan_to_num(part, nan=np.inf).max(initial=0.0)) == 0 for part in violations)

    bend, bent = np.sin(np.linspace(0.0, np.pi, len(line.x))), list[Trajectory]()
    if passes(line.x):
        return []
    for i in np.flatnonzero(np.any([one.used[:, : len(sizes)].any(axis=0) for one in hard], axis=0)):
        for side in SIDES:
            moves = (np.outer(side * share * sizes[i] * bend, np.arange(len(sizes)) == i) for share in REACHES)
            x = next((line.x + move for move in moves if passes(line.x + move)), None)
            bent += [Trajectory(x, line.u)] if x is not None and passes(2 * x - line.x, BETWEEN) else []
    return bent


def _middle(box: Box, share: Array, reach: Array | float = 0.0) -> Array:
    """Return a point of a box at a share between its bounds; where it has not two, within a reach of zero."""
    nearest = box.project(np.zeros(share.shape))
    low = np.where(np.isfinite(box.lower), box.lower, nearest - reach)
    high = np.where(np.isfinite(box.upper), box.upper, nearest + reach)
    return low + share * (high - low)
