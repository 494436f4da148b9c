"""A proof of the answer to a problem: its sections in turn, and the interval that the checker derives from them.

A lower bound follows from the multipliers, or from those of the leaves of a search tree; an upper one from a point
strictly inside all inequalities. The checker runs in this process on the lines: the file is never whole in memory.

The checker requires Hessians that are semidefinite exactly, and not only up to rounding. The rounded least eigenvalue
of a matrix such as C'C may be -1e-17 instead of 0, and then no cost is bounded below over free states. So the proof
states such a Hessian with a larger diagonal, by the least multiple of a rounding that makes it semidefinite exactly.
The cost J+ of this problem is nowhere below the given J, and in a box above it by at most ``raised_by``. Hence an upper
bound of J+ is one of J, and a lower bound of J+ less ``raised_by`` is one of J.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from flint import arb, ctx

from lin_freq_ocp.base.arrays import Array, stack_signals
from lin_freq_ocp.base.errors import SolveError
from lin_freq_ocp.base.semidefinite import is_semidefinite
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import NEVER_NEGATIVE, RIGOROUS, optimum_box
from lin_freq_ocp.certificate.hamiltonian import extremal_at
from lin_freq_ocp.certificate.hybrid.tree import IntervalReach, within_level
from lin_freq_ocp.certificate.reach import Region, stated_bounds
from lin_freq_ocp.certificate.sizes import cost_scale
from lin_freq_ocp.certificate.tolerances import FINITE, GAP_TOLERANCE, RADIUS_MARGIN
from lin_freq_ocp.problem.costs.quadratic import CONVEXITY_TOLERANCE, CostSum
from lin_freq_ocp.problem.hybrid.mode_tree import ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.dual import Dual, dual_of, precision
from lin_freq_ocp.proof.enclosure import Enclosure
from lin_freq_ocp.proof.lfo_check import Failed, check
from lin_freq_ocp.proof.point import InteriorPoint, points
from lin_freq_ocp.proof.statement import line, problem_lines
from lin_freq_ocp.proof.train import NOTHING, TrainProof, train_proof
from lin_freq_ocp.proof.tree import TreeDual, sequence_problem, written_nodes
from lin_freq_ocp.solving.hybrid.modes import tree_of
from lin_freq_ocp.solving.hybrid.pulse_train import Angles
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.transform.reformulations import at_frequencies

LEAST_RISE = 2.0**-52  # of a diagonal that is tried
LARGER_RISE = 2.0**-46  # with less, a slope along the least eigenvector may cost much; with more, states far away do
RISE_STEP = 4.0  # between rises of the diagonal that are tried


def convex_problem(problem: OptimalControlProblem, least: float = 0.0) -> OptimalControlProblem:
    """Return the problem with Hessians that are symmetric and semidefinite exactly; itself if they are so already.

    The diagonal of each Hessian with other entries grows by at least the fraction ``least``.
    """
    cost, n = problem.quadratic, problem.state_dim
    given = cost.stage_hessians
    hessians, P = np.stack([_semidefinite(matrix, least) for matrix in given]), _semidefinite(cost.P, least)
    if np.array_equal(hessians, given) and np.array_equal(P, cost.P):
        return problem
    stage = hessians[0] if len(hessians) == 1 else hessians
    parts = {"Q": stage[..., :n, :n], "R": stage[..., n:, n:], "S": stage[..., :n, n:]}
    return problem.derived(cost=CostSum([replace(cost, **parts, P=P), *problem.cost.norms]))


def raised_by(given: OptimalControlProblem, raised: OptimalControlProblem, region: Region) -> float:
    """Return a bound on how far a raised cost is above the given one in a region; inf without one."""
    if raised is given:
        return 0.0
    cost, other, total = given.quadratic, raised.quadratic, 0.0
    z = np.maximum(*(np.abs(cost.deviations_of(side)) for side in region.bounds))
    stages = cost.stage_hessians, other.stage_hessians, z[:-1]
    for old, new, v in (stages, (cost.P[None], other.P[None], z[-1:, : given.state_dim])):
        change = np.maximum(np.abs(new - old), np.abs(new - np.swapaxes(old, 1, 2)))
        with np.errstate(invalid="ignore"):  # 0 times inf: components that are not raised may be unbounded
            total += float(np.where(change > 0, change * v[:, :, None] * v[:, None, :], 0.0).sum())
    return RADIUS_MARGIN * total / 2


def _semidefinite(matrix: Array, least: float) -> Array:
    """Return a symmetric matrix with the least rise of the diagonal that makes it semidefinite; itself if none does.

    The difference to the given matrix is also semidefinite, rounding included.
    """
    symmetric, diagonal = (matrix + matrix.T) / 2, np.diag(np.diagonal(matrix))
    if np.array_equal(matrix, diagonal):
        return matrix
    rise = least
    while rise <= CONVEXITY_TOLERANCE:
        raised = symmetric + rise * diagonal
        if is_semidefinite(raised) and is_semidefinite(raised - matrix):
            return raised
        rise = max(RISE_STEP * rise, LEAST_RISE)
    return matrix


UNCHECKED_MARGIN = (2.0**-36,)  # distance to limits relative to sizes, of a point that is not checked
UNCHECKED_SLACK = 1e-6  # by which an unchecked claim is wider than the certificate's interval, relative to the cost
CLAIM_SLACK = 1e-9  # by which a claim is wider than the proven interval, relative to its ends
TREE_BITS = 192  # of balls: no linear system is solved in them, and products of three doubles are exact


@dataclass(frozen=True, eq=False)
class Proof:
    """A lower bound by a dual, or by those of a search tree, and an upper one by a point."""

    problem: OptimalControlProblem
    bits: int
    claim: Enclosure
    point: InteriorPoint | None
    dual: Dual | TreeDual

    def lines(self) -> Iterator[str]:
        """Yield the file, line by line."""
        yield line(format="lfo-proof", version=1, bits=self.bits)
        yield from problem_lines(self.problem)
        yield line(section="claim", lower=self.claim.lower, upper=self.claim.upper)
        if self.point is not None:
            yield from self.point.lines()
        yield from self.dual.lines()
        yield line(section="end")


def proof_of(outcome: Outcome) -> tuple[Proof | TrainProof, Enclosure]:
    """Return a proof of the answer of a solve, and the interval that the checker confirms.

    Raises
    ------
    UnsupportedError
        If the format does not hold the problem.
    SolveError
        If there is nothing to prove, the multipliers prove nothing, or the cost lies outside the proven interval.
    """
    searched = tree_of(outcome)
    if outcome.method == Angles.shorthand:
        proof = train_proof(outcome)
        enclosure = checked_enclosure(proof.lines())
    else:
        proof, enclosure = _linear_proof(outcome) if searched is None else _tree_proof(outcome, searched.tree)
    certificate = outcome.certificate
    if certificate is not None and certificate.feasible:  # an optimal cost lies in the interval, others not below it
        cost, slack = certificate.cost, certificate.allowed_gap
        above = outcome.status == Status.OPTIMAL and cost > enclosure.upper + slack
        if above or cost < enclosure.lower - slack:
            raise SolveError(
                f"The certified cost {cost!r} lies outside of the proven interval, {enclosure}: one of them is wrong. "
                "Report the problem, and solve it with another method.",
                outcome,
            )
    return replace(proof, claim=_relaxed_claim(enclosure)), enclosure


def _linear_proof(outcome: Outcome) -> tuple[Proof, Enclosure]:
    """Return a proof of an answer for linear dynamics, without a claim, with a point if the checker accepts one.

    If Hessians are singular, exactly or up to rounding, two rises are tried, and the narrower interval counts.
    """
    proven = _raised_proof(outcome, 0.0)
    stated = outcome.ray is not None or convex_problem(outcome.problem) is outcome.problem
    if not (stated and proven[1].lower > -np.inf):
        with suppress(SolveError):
            proven = min(proven, _raised_proof(outcome, LARGER_RISE), key=lambda answer: answer[1].width)
    return proven


def _raised_proof(outcome: Outcome, least: float) -> tuple[Proof, Enclosure]:
    """Return a proof of the problem with Hessians raised by at least this much, and the interval of the given one."""
    bare, at = _bound_proof(outcome, least)
    nearest_first = () if outcome.ray is not None else points(bare.problem, outcome, at)
    proof, enclosure = _first_accepted((replace(bare, point=point) for point, _ in nearest_first), bare, outcome)
    given, multipliers = outcome.problem, outcome.multipliers
    if outcome.ray is None and multipliers is not None and convex_problem(given, least) is not given:
        given = at_frequencies(given, multipliers.frequencies)
        region = optimum_box(extremal_at(given, at, multipliers), GAP_TOLERANCE * cost_scale(given, at))
        lower = _subtract_downwards(enclosure.lower, raised_by(given, bare.problem, region))
        enclosure = replace(enclosure, lower=min(lower, region.level))
    return proof, enclosure


def _bound_proof(outcome: Outcome, least: float = 0.0) -> tuple[Proof, Trajectory]:
    """Return a proof of a lower bound alone, without a claim, and the trajectory at which it is tight."""
    at, multipliers = outcome.trajectory, outcome.multipliers
    if outcome.ray is not None:
        given, sizes = outcome.problem, (outcome.problem.state_dim, outcome.problem.control_dim)
        x, u = (np.zeros((given.horizon + 1 - k, size)) for k, size in enumerate(sizes))
        # The point nearest to zero within the bounds, at every time
        at, multipliers = Trajectory(given.state_tube.project(x), given.control_tube.project(u)), outcome.ray
    if at is None or multipliers is None:
        raise SolveError(f"There is nothing to prove: the solve ended as '{outcome.status}'.", outcome)
    problem = convex_problem(at_frequencies(outcome.problem, multipliers.frequencies), least)
    _require_statement(problem)
    bits = precision(problem.linear.A, problem.horizon)
    with ctx.workprec(bits):
        dual = dual_of(problem, at, multipliers)
    return Proof(problem, bits, NOTHING, None, dual), at


def _require_statement(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError if the format does not hold the problem."""
    for _ in problem_lines(problem):
        pass


def _first_accepted(proofs: Iterable[Proof], bare: Proof, outcome: Outcome) -> tuple[Proof, Enclosure]:
    """Return the first proof that the checker accepts, with its interval; if none, that without a point.

    SolveError if that proves nothing.
    """
    for proof in proofs:
        with suppress(Failed):
            return proof, checked_enclosure(proof.lines())
    try:
        return bare, checked_enclosure(bare.lines())
    except Failed as failed:
        raise SolveError(f"The multipliers prove nothing ({failed}).", outcome) from failed


def _subtract_downwards(lower: float, by: float) -> float:
    """Return the difference, rounded downwards."""
    return float(np.nextafter(lower - by, -np.inf))


def _relaxed_claim(proven: Enclosure) -> Enclosure:
    """Return a claim a little wider than the proven interval: on another machine the checker may round differently."""
    if proven.infeasible:
        return proven
    ends = [abs(end) for end in (proven.lower, proven.upper) if np.isfinite(end)]
    slack = CLAIM_SLACK * max(ends, default=0.0)
    return Enclosure(proven.lower - slack, proven.upper + slack)


def _tree_proof(outcome: Outcome, tree: ModeTree) -> tuple[Proof, Enclosure]:
    """Return a proof by a search over modes, with the point of the best sequence alone if the checker accepts it."""
    problem, with_point = convex_problem(outcome.problem), list[Proof]()
    _require_statement(problem)
    inside = within_level(problem, tree.level)
    dual = TreeDual(inside, written_nodes(inside, tree), tree.level)
    bare = Proof(problem, TREE_BITS, NOTHING, None, dual)
    if outcome.sequence is not None:
        with suppress(SolveError):
            alone, _ = _linear_proof(solve_judged(sequence_problem(problem, outcome.sequence)))
            point = alone.point and replace(alone.point, modes=outcome.sequence.tolist())
            with_point = [replace(bare, bits=max(TREE_BITS, alone.bits), point=point)]
    proof, enclosure = _first_accepted(with_point, bare, outcome)
    if problem is not outcome.problem:
        given = within_level(outcome.problem, tree.level)
        region, whole = stated_bounds(given), IntervalReach(given).whole
        if whole is not None:  # a box around all trajectories
            lower, upper = whole.lower, whole.upper
            x = np.where(lower > -FINITE, lower, -np.inf), np.where(upper < FINITE, upper, np.inf)
            low, high = map(stack_signals, x, given.control_tube.bounds)
            region = Region((low, high), np.inf, "forward reach")
        by = raised_by(outcome.problem, problem, region)
        enclosure = replace(enclosure, lower=_subtract_downwards(enclosure.lower, by))
    return proof, enclosure


def unchecked_proof(outcome: Outcome) -> Proof:
    """Return a proof of an answer for linear dynamics, without a check; errors are those of ``proof_of``.

    It claims a little less than the certificate, and a lower end only where its multipliers bound all trajectories.
    """
    bare, at = _bound_proof(outcome)
    if outcome.ray is not None:
        return replace(bare, claim=Enclosure(np.inf, np.inf))
    certificate, lower = outcome.certificate, -np.inf
    bound, scale = (None, 0.0) if certificate is None else (certificate.bound, certificate.cost_scale)
    slack = UNCHECKED_SLACK * scale
    if bound is not None and bound.kind == RIGOROUS and bound.sets != NEVER_NEGATIVE:
        lower = bound.value - slack
    for point, moved in points(bare.problem, outcome, at, UNCHECKED_MARGIN):
        upper = bare.problem.value(moved.x, moved.u) + slack
        return replace(bare, point=point, claim=Enclosure(lower, upper))
    return replace(bare, claim=Enclosure(lower, np.inf))


def checked_enclosure(lines: Iterable[str]) -> Enclosure:
    """Return the interval that the checker derives from the lines of a proof; it raises ``Failed`` if it is none."""
    rest = iter(lines)
    stream = SimpleNamespace(readline=lambda limit: next(rest, "").encode())  # lines as a file of bytes
    with ctx.workprec(ctx.prec):  # the checker sets the precision
        lower, upper = check(stream, lambda summary: None)
    return Enclosure(_round_towards(lower, -np.inf), _round_towards(upper, np.inf))


def _round_towards(exact: arb, towards: float) -> float:
    """Return an exact ball as a float, rounded one way."""
    found = float(exact)
    while arb(found) > exact if towards < 0 else arb(found) < exact:
        found = float(np.nextafter(found, towards))
    return found
