"""A local optimum of one mode sequence of piecewise-smooth dynamics, by sequential quadratic programming.

Each program has the dynamics of the modes, and their regions, linearised at the last trajectory; frequency constraints,
sets and costs stand in it as they are. The curvature of <eta_t, f_t> is added to that of the cost as far as the sum of
a stage stays convex, so that the last steps are Newton's. Steps are limited to a trust region in natural units, and
dynamics and regions may be violated at a price: then every program has a solution. A step is taken if it improves

    cost + price * (sum |x_{t+1} - f_t(x_t, u_t)| + sum of what lies outside the regions),     all in natural units.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.backends.base import Claim, backend
from lin_freq_ocp.problem.dynamics.affine_mode import REGION
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.linear.units import natural_scaling
from lin_freq_ocp.transcription.program import Program, Scaling

# Of violations, in a cost whose slopes are of order 10: above the multipliers it leaves none; the next is taken if some
# are left
PRICES = (1e2, 1e4, 1e6)
# Of the trust region, in natural units, in which trajectories are of order 1
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 1.0, 1e3, 1e-9
# Shares of the predicted improvement from which a step is taken, and from which the trust region grows
ACCEPTED, GOOD = 1e-4, 0.7
CONVERGED = 1e-9  # steps in natural units below which the last program is the answer; its solver is as accurate
VIOLATION = 1e-8  # violations of order-1 rows up to which a point is feasible
# Of the slacks of costs and soft constraints, where the nearest trajectory within the sets is looked for
SLACK_PRICE = 1e-3
ROUNDING = 16 * float(np.finfo(np.float64).eps)  # predicted improvements below this part of the merit are rounding
MOST_STEPS = 60
QP_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class LocalOptimum:
    """Where a sequence of programs ended.

    Attributes
    ----------
    sequence : (T,)
    trajectory, multipliers
        The multipliers of the linearised problem of the sequence: those of its regions under REGION.
    cost, violation : float
        The violation of dynamics and regions is in natural units.
    steps : int
    """

    sequence: Indices
    trajectory: Trajectory
    multipliers: Multipliers
    cost: float
    violation: float
    steps: int

    @property
    def feasible(self) -> bool:
        """Whether it is a trajectory of its mode sequence."""
        return self.violation <= VIOLATION


def local_optimum(
    problem: OptimalControlProblem,
    start: Trajectory,
    sequence: Indices,
    prices: Sequence[float] = PRICES,
    end: float = np.inf,
) -> LocalOptimum | None:
    """Return the local optimum of a mode sequence that is found from a trajectory, which need not be feasible.

    None if no program could be solved, as where a piece is not defined. At ``end``, by ``time.perf_counter``, what was
    reached until then.
    """
    best: LocalOptimum | None = None
    for price in prices:
        found = _descended(problem, start if best is None else best.trajectory, sequence, price, end)
        if found is None:
            return best
        best = found
        if best.feasible or time.perf_counter() > end:
            break
    return best


def flipped(problem: OptimalControlProblem, local: LocalOptimum) -> Iterator[Indices]:
    """Yield the sequences with one mode changed: across regions that hold back the cost first, then all others."""
    T, modes = problem.horizon, len(problem.smooth_pieces.modes)
    pull = local.multipliers.stage.get(REGION, np.zeros((T, 1))).max(axis=1, initial=0.0)
    for t in np.argsort(-pull, kind="stable"):
        for i in range(modes):
            if i != local.sequence[t]:
                changed = local.sequence.copy()
                changed[t] = i
                yield changed


def _descended(
    problem: OptimalControlProblem, start: Trajectory, sequence: Indices, price: float, end: float
) -> LocalOptimum | None:
    frame = _Frame.of(problem, start, sequence)
    z = None if frame is None else frame.within_sets(start)
    place = None if frame is None or z is None else frame.place(z, None)
    radius, taken, steps = FIRST_RADIUS, None, 0
    multipliers: Multipliers | None = None
    while place is not None and steps < MOST_STEPS and radius > SMALLEST_RADIUS:
        if time.perf_counter() > end:
            break
        steps += 1
        step = _step(place, price, radius)
        if step is None:
            break
        z, y, predicted = step
        moved = float(np.abs(z - place.z).max())
        found = place.frame.multipliers(y)
        after = place.frame.place(z, found.eta)
        gained = -np.inf if after is None else place.merit(price) - after.merit(price)
        if moved <= CONVERGED or predicted <= ROUNDING * abs(place.merit(price)):
            multipliers, taken = found, place if gained < 0 else after
            break
        if after is not None and gained >= ACCEPTED * predicted:
            place, multipliers, taken = after, found, after
            radius = min(2 * radius, LARGEST_RADIUS) if gained >= GOOD * predicted else radius
        else:
            radius = 0.25 * min(radius, moved)
            place = replace(place, eta=found.eta)
    if taken is None or multipliers is None:
        return None
    cost = problem.value(taken.trajectory.x, taken.trajectory.u)
    return LocalOptimum(sequence, taken.trajectory, multipliers, cost, taken.violation, steps)


@dataclass(frozen=True, eq=False)
class _Frame:
    """What the programs of a mode sequence have in common: all rows but those of its maps and regions.

    Attributes
    ----------
    program : Program
        In natural units; the rows of maps have x_{t+1} only, those of regions nothing.
    signals : (T, n + m)
        The variables of (x_t, u_t); the states (T+1, n) come first.
    maps : (T, n), regions : (T, rows)
        The rows of the program.
    """

    problem: OptimalControlProblem
    sequence: Indices
    transcription: LinearTranscription
    scaling: Scaling
    program: Program
    signals: Indices
    maps: Indices
    regions: Indices

    @classmethod
    def of(cls, problem: OptimalControlProblem, start: Trajectory, sequence: Indices) -> _Frame | None:
        """Return the frame in units that suit the dynamics at the start; None if a piece is not defined there."""
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        dynamics = problem.smooth_pieces
        y = np.hstack([start.x[:T], start.u])
        if not dynamics.jets_at(y).defined()[np.arange(T), sequence].all():
            return None
        transcription = LinearTranscription(problem.affine_at(start).with_modes(sequence))
        scaling = natural_scaling(transcription)
        program = transcription.program.scaled(scaling)
        numbers = transcription.multipliers(np.arange(1.0, 1.0 + len(program.lower)), 1.0)
        maps, regions = (part.astype(np.intp) - 1 for part in (numbers.eta, numbers.stage[REGION]))
        signals = np.hstack([np.arange(T * n).reshape(T, n), (T + 1) * n + np.arange(T * m).reshape(T, m)])
        entries = sp.coo_array(program.A)
        row, column = entries.coords
        of_maps, of_regions = np.isin(row, maps), np.isin(row, regions[regions >= 0])
        after = np.full(len(program.lower), -1)
        after[maps] = np.arange(n, (T + 1) * n).reshape(T, n)
        kept = np.where(of_maps, after[row] == column, ~of_regions)
        A = sp.csc_array((entries.data[kept], (row[kept], column[kept])), shape=program.A.shape)
        program = replace(program, A=A)
        return cls(problem, sequence, transcription, scaling, program, signals, maps, regions)

    def trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory of a point of the program."""
        return self.transcription.trajectory(self.scaling.primal(z))

    def multipliers(self, y: Array) -> Multipliers:
        """Return the multipliers of duals of which the first are those of the program."""
        return self.transcription.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    def within_sets(self, trajectory: Trajectory) -> Array | None:
        """Return the nearest point that satisfies everything but maps and regions; None if it was not found."""
        z, program = self.scaling.scaled_primal(self.transcription.point(trajectory)), self.program
        kept = np.ones(len(program.lower), dtype=bool)
        kept[self.maps] = kept[self.regions[self.regions >= 0]] = False
        lower, upper = np.where(kept, program.lower, -np.inf), np.where(kept, program.upper, np.inf)
        sets = replace(program, lower=lower, upper=upper)
        if sets.residuals(z, np.zeros(len(lower))).primal <= VIOLATION:
            return z
        near = np.zeros(len(z))
        near[: self.transcription.signals] = 1.0
        P, q = sp.csc_array(sp.diags_array(near)), SLACK_PRICE * (1 - near) - near * z
        solution = backend("clarabel")(replace(sets, P=P, q=q), QP_TOLERANCE, None)
        return solution.z if solution.claim is Claim.SOLVED else None

    def place(self, z: Array, eta: Array | None) -> _Place | None:
        """Return a point with its program; None if a piece is not defined there."""
        problem, T = self.problem, self.problem.horizon
        trajectory, times = self.trajectory(z), np.arange(T)
        found = problem.smooth_pieces.jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
        if not found.defined()[times, self.sequence].all():
            return None
        values, slopes, curvatures = (
            np.stack([getattr(one, part) for one in found.f], axis=1)[times, self.sequence]
            for part in ("values", "slopes", "curvatures")
        )
        most = self.regions.shape[1]
        excess, facets = np.full((T, most), -np.inf), np.zeros((T, most, self.signals.shape[1]))
        for i, region in enumerate(found.regions):
            here, rows = self.sequence == i, region.values.shape[1]
            excess[here, :rows], facets[here, :rows] = region.values[here], region.slopes[here]
        return _Place.of(self, trajectory, z, eta, (values, -slopes, curvatures), (excess, facets))


@dataclass(frozen=True, eq=False)
class _Place:
    """A trajectory with the program of the mode sequence linearised there, in natural units.

    Attributes
    ----------
    defects : (T * n,)
        x_{t+1} - f_t(x_t, u_t).
    outside : (region rows,)
        How far the switching functions are above zero.
    curvatures : (T, n, n + m, n + m)
        Of the maps, in the problem's units.
    """

    frame: _Frame
    trajectory: Trajectory
    program: Program
    z: Array
    defects: Array
    outside: Array
    curvatures: Array
    eta: Array | None

    @classmethod
    def of(
        cls,
        frame: _Frame,
        trajectory: Trajectory,
        z: Array,
        eta: Array | None,
        maps: tuple[Array, Array, Array],
        regions: tuple[Array, Array],
    ) -> _Place:
        values, negative, curvatures = maps
        excess, facets = regions
        scale, columns, base = frame.scaling.rows, frame.scaling.columns, frame.program
        chosen = frame.regions >= 0
        rows = np.concatenate([frame.maps.ravel(), frame.regions[chosen]])
        times = np.concatenate([np.repeat(np.arange(len(values)), values.shape[1]), np.nonzero(chosen)[0]])
        at = frame.signals[times]
        slopes = np.vstack([negative.reshape(-1, at.shape[1]), facets[chosen]]) * scale[rows, None] * columns[at]
        row, column = np.broadcast_to(rows[:, None], at.shape).ravel(), at.ravel()
        A = base.A + sp.csc_array((slopes.ravel(), (row, column)), shape=base.A.shape)
        Az = A @ z
        defects = scale[frame.maps.ravel()] * (trajectory.x[1:] - values).ravel()
        outside = scale[frame.regions[chosen]] * excess[chosen]
        lower, upper = base.lower.copy(), base.upper.copy()
        lower[frame.maps] = upper[frame.maps] = (Az[frame.maps.ravel()] - defects).reshape(frame.maps.shape)
        upper[frame.regions[chosen]] = Az[frame.regions[chosen]] - outside
        program = replace(base, A=sp.csc_array(A), lower=lower, upper=upper)
        return cls(frame, trajectory, program, z, defects, np.maximum(outside, 0.0), curvatures, eta)

    @property
    def violation(self) -> float:
        """Return the largest violation of a row of maps or regions."""
        return max(float(np.abs(self.defects).max()), float(self.outside.max(initial=0.0)))

    def merit(self, price: float) -> float:
        """Return the cost with the price of violations, in the units of the program."""
        cost = self.frame.scaling.cost * self.frame.problem.value(self.trajectory.x, self.trajectory.u)
        return cost + price * float(np.abs(self.defects).sum() + self.outside.sum())

    def bent(self) -> sp.csc_array:
        """Return what the curvature of -<eta_t, f_t> adds to the Hessian, as far as every stage stays convex."""
        shape, frame = (len(self.z), len(self.z)), self.frame
        if self.eta is None:
            return sp.csc_array(shape)
        own = np.broadcast_to(frame.problem.quadratic.stage_hessians(), self.curvatures[:, 0].shape)
        values, vectors = np.linalg.eigh(own - np.einsum("ti,tijk->tjk", self.eta, self.curvatures))
        added = np.einsum("tij,tj,tkj->tik", vectors, np.maximum(values, 0.0), vectors) - own
        units = frame.scaling.columns[frame.signals]
        scaled = frame.scaling.cost * added * units[:, :, None] * units[:, None, :]
        row = np.broadcast_to(frame.signals[:, :, None], scaled.shape).ravel()
        column = np.broadcast_to(frame.signals[:, None, :], scaled.shape).ravel()
        return sp.csc_array(sp.coo_array((scaled.ravel(), (row, column)), shape=shape))


def _step(place: _Place, price: float, radius: float) -> tuple[Array, Array, float] | None:
    """Return the point that the program in the trust region leads to, its duals, and the improvement it predicts."""
    program, frame, count = place.program, place.frame, len(place.z)
    maps, regions = frame.maps.ravel(), frame.regions[frame.regions >= 0]
    relaxed = np.concatenate([maps, maps, regions])
    signs = np.concatenate([np.ones(len(maps)), -np.ones(len(maps) + len(regions))])
    slacks, bent, signals = len(relaxed), place.bent(), frame.transcription.signals
    bounded = np.concatenate([np.arange(signals), np.arange(count, count + slacks)])
    rows = np.arange(len(bounded)) + len(program.lower)
    entries = sp.coo_array(program.A)
    A = sp.csc_array(
        (
            np.concatenate([entries.data, signs, np.ones(len(bounded))]),
            (
                np.concatenate([entries.coords[0], relaxed, rows]),
                np.concatenate([entries.coords[1], np.arange(count, count + slacks), bounded]),
            ),
        ),
        shape=(len(program.lower) + len(bounded), count + slacks),
    )
    P = sp.coo_array(program.P + bent)
    widened = Program(
        P=sp.csc_array((P.data, (P.coords[0], P.coords[1])), shape=(count + slacks, count + slacks)),
        q=np.append(np.asarray(program.q - bent @ place.z), np.full(slacks, price)),
        constant=0.0,
        A=A,
        lower=np.concatenate([program.lower, place.z[:signals] - radius, np.zeros(slacks)]),
        upper=np.concatenate([program.upper, place.z[:signals] + radius, np.full(slacks, np.inf)]),
        rows=program.rows,
        cones=program.cones,
    )
    solution = backend("clarabel")(widened, QP_TOLERANCE, None)
    if solution.z is None or solution.y is None or solution.claim not in (Claim.SOLVED, Claim.FAILED):
        return None
    here = np.concatenate([np.maximum(-place.defects, 0.0), np.maximum(place.defects, 0.0), place.outside])
    before = widened.objective(np.append(place.z, here))
    return solution.z[:count], solution.y, before - widened.objective(solution.z)
