"""A local optimum of one mode sequence of piecewise-smooth dynamics, by sequential quadratic programming.

Each program has the dynamics of the modes, and their regions, linearised at the last trajectory; frequency constraints,
sets and costs stand in it as they are. The curvature of <eta_t, f_t> is added to that of the cost as far as the sum of
a stage stays convex, so that the last steps are Newton's. Steps are limited to a trust region in natural units, and
dynamics and regions may be violated at a price: then every program has a solution. A step is taken if it improves

    cost + price * (sum |x_{t+1} - f_t(x_t, u_t)| + sum of what lies outside the regions),     all in natural units.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.backends.base import Claim, backend
from lin_freq_ocp.problem.affine_mode import REGION
from lin_freq_ocp.problem.arrays import Array, Indices
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.linear import LinearTranscription
from lin_freq_ocp.transcription.program import Block, Program, Scaling
from lin_freq_ocp.transcription.units import natural_scaling

PRICES = (1e2, 1e4, 1e6)
"""Of violations, in a cost whose slopes are of order 10: above the multipliers it leaves none; the next is taken if some
are left."""

FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 1.0, 1e3, 1e-9
"""Of the trust region, in natural units, in which trajectories are of order 1."""

ACCEPTED, GOOD = 1e-4, 0.7
"""Shares of the predicted improvement from which a step is taken, and from which the trust region grows."""

CONVERGED = 1e-9
"""Steps in natural units below which the last program is the answer; its solver is as accurate."""

VIOLATION = 1e-8
"""Violations of order-1 rows up to which a point is feasible."""

SLACK_PRICE = 1e-3
"""Of the slacks of costs and soft constraints, where the nearest trajectory within the sets is looked for."""

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


def local_optimum(problem: OptimalControlProblem, start: Trajectory, sequence: Indices) -> LocalOptimum | None:
    """Return the local optimum of a mode sequence that is found from a trajectory, which need not be feasible.

    None if no program could be solved, as where a piece is not defined.
    """
    best: LocalOptimum | None = None
    for price in PRICES:
        found = _descended(problem, start if best is None else best.trajectory, sequence, price)
        if found is None:
            return best
        best = found
        if best.feasible:
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
    problem: OptimalControlProblem, start: Trajectory, sequence: Indices, price: float
) -> LocalOptimum | None:
    place = _Place.of(problem, start, sequence)
    place = None if place is None else place.within_sets()
    radius, taken, steps = FIRST_RADIUS, None, 0
    multipliers: Multipliers | None = None
    while place is not None and steps < MOST_STEPS and radius > SMALLEST_RADIUS:
        steps += 1
        step = _step(place, price, radius)
        if step is None:
            break
        z, y, predicted = step
        moved = float(np.abs(z - place.z).max())
        found = place.multipliers(y)
        after = _Place.of(problem, place.trajectory_at(z), sequence, found.eta, place.scaling)
        gained = -np.inf if after is None else place.merit(price) - after.merit(price)
        if moved <= CONVERGED or predicted <= np.spacing(abs(place.merit(price))) * 16:
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
class _Place:
    """A trajectory with the program of the mode sequence linearised there, in natural units.

    Attributes
    ----------
    defects : (T * n,)
        x_{t+1} - f_t(x_t, u_t); outside : (region rows,), how far the switching functions are above zero.
    bent : sparse
        What is added to the Hessian.
    """

    problem: OptimalControlProblem
    sequence: Indices
    trajectory: Trajectory
    transcription: LinearTranscription
    scaling: Scaling
    program: Program
    z: Array
    regions: Indices
    defects: Array
    outside: Array
    eta: Array | None

    @classmethod
    def of(
        cls,
        problem: OptimalControlProblem,
        trajectory: Trajectory,
        sequence: Indices,
        eta: Array | None = None,
        scaling: Scaling | None = None,
    ) -> _Place | None:
        """Return the place, in the units of another if they are given; None if a piece is not defined there."""
        dynamics, T = problem.smooth_pieces, problem.horizon
        y = np.hstack([trajectory.x[:T], trajectory.u])
        if not dynamics.jets_at(y).defined()[np.arange(T), sequence].all():
            return None
        transcription = LinearTranscription(problem.affine_at(trajectory).with_modes(sequence))
        scaling = natural_scaling(transcription) if scaling is None else scaling
        program = scaling.apply(transcription.program)
        numbers = transcription.multipliers(np.arange(1.0, 1.0 + len(program.lower)), 1.0)
        region = numbers.stage[REGION].ravel().astype(int)
        rows = region[region > 0] - 1
        z = transcription.point(trajectory) / scaling.columns
        Az, dynamic = program.A @ z, program.rows[Block.DYNAMICS]
        return cls(
            problem=problem,
            sequence=sequence,
            trajectory=trajectory,
            transcription=transcription,
            scaling=scaling,
            program=program,
            z=z,
            regions=rows,
            defects=(Az - program.upper)[dynamic],
            outside=np.maximum((Az - program.upper)[rows], 0.0),
            eta=eta,
        )

    def within_sets(self) -> _Place | None:
        """Return the nearest place that satisfies everything but the dynamics and the regions."""
        program, signals = self.program, self.transcription.signals
        kept = np.ones(len(program.lower), dtype=bool)
        kept[program.rows[Block.DYNAMICS]] = kept[self.regions] = False
        lower, upper = np.where(kept, program.lower, -np.inf), np.where(kept, program.upper, np.inf)
        if program.residuals(self.z, np.zeros(len(lower))).primal <= VIOLATION:
            return self
        near = np.zeros(len(self.z))
        near[:signals] = 1.0
        P, q = sp.csc_array(sp.diags_array(near)), -near * self.z
        nearest = replace(program, P=P, q=q + SLACK_PRICE * (1 - near), lower=lower, upper=upper)
        solution = backend("clarabel")(nearest, QP_TOLERANCE, None)
        if solution.z is None or solution.claim is not Claim.SOLVED:
            return None
        return _Place.of(self.problem, self.trajectory_at(solution.z), self.sequence, None, self.scaling)

    @property
    def violation(self) -> float:
        """Return the largest violation of a row of dynamics or regions."""
        return max(float(np.abs(self.defects).max()), float(self.outside.max(initial=0.0)))

    def merit(self, price: float) -> float:
        """Return the cost with the price of violations, in the units of the program."""
        cost = self.scaling.cost * self.problem.value(self.trajectory.x, self.trajectory.u)
        return cost + price * float(np.abs(self.defects).sum() + self.outside.sum())

    def trajectory_at(self, z: Array) -> Trajectory:
        """Return the trajectory of a point of the program."""
        return self.transcription.trajectory(self.scaling.primal(z))

    def multipliers(self, y: Array) -> Multipliers:
        """Return the multipliers of duals of which the first are those of the program."""
        return self.transcription.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    def bent(self) -> sp.csc_array:
        """Return what the curvature of -<eta_t, f_t> adds to the Hessian, stage by stage, as far as they stay convex."""
        variables, T = len(self.z), self.problem.horizon
        n, m = self.problem.state_dim, self.problem.control_dim
        if self.eta is None:
            return sp.csc_array((variables, variables))
        found = self.problem.smooth_pieces.jets_at(np.hstack([self.trajectory.x[:T], self.trajectory.u]))
        curvatures = np.stack([one.curvatures for one in found.f], axis=1)[np.arange(T), self.sequence]
        own = np.broadcast_to(self.problem.quadratic.stage_hessians(), (T, n + m, n + m))
        whole = own - np.einsum("ti,tijk->tjk", self.eta, curvatures)
        values, vectors = np.linalg.eigh(whole)
        added = np.einsum("tij,tj,tkj->tik", vectors, np.maximum(values, 0.0), vectors) - own
        at = np.hstack([np.arange(T * n).reshape(T, n), (T + 1) * n + np.arange(T * m).reshape(T, m)])
        units = self.scaling.columns[at]
        scaled = self.scaling.cost * added * units[:, :, None] * units[:, None, :]
        row = np.broadcast_to(at[:, :, None], scaled.shape).ravel()
        column = np.broadcast_to(at[:, None, :], scaled.shape).ravel()
        return sp.csc_array(sp.coo_array((scaled.ravel(), (row, column)), shape=(variables, variables)))


def _step(place: _Place, price: float, radius: float) -> tuple[Array, Array, float] | None:
    """Return the point that the program in the trust region leads to, its duals, and the improvement it predicts."""
    program, count = place.program, len(place.z)
    dynamic = np.arange(place.program.rows[Block.DYNAMICS].start, place.program.rows[Block.DYNAMICS].stop)
    relaxed = np.concatenate([dynamic, dynamic, place.regions])
    signs = np.concatenate([np.ones(len(dynamic)), -np.ones(len(dynamic) + len(place.regions))])
    slacks, bent = len(relaxed), place.bent()
    elastic = sp.csc_array((signs, (relaxed, np.arange(slacks))), shape=(len(program.lower), slacks))
    signals = place.transcription.signals
    bounds = sp.vstack(
        [
            sp.eye_array(signals, count + slacks),
            sp.hstack([sp.csc_array((slacks, count)), sp.eye_array(slacks)]),
        ]
    )
    P, q = sp.csc_array(program.P + bent), program.q - bent @ place.z
    widened = Program(
        P=sp.csc_array(sp.block_diag([P, sp.csc_array((slacks, slacks))])),
        q=np.append(np.asarray(q), np.full(slacks, price)),
        constant=0.0,
        A=sp.csc_array(sp.vstack([sp.hstack([program.A, elastic]), bounds])),
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
