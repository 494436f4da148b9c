"""A random LTI problem by the Fourier-domain method against a sparse QP: every difference of the two explained.

The reference is Clarabel at 1e-11 on the sparse program; PIQP where Clarabel is not sure or contradicts the witness (a
trajectory that the problem was built around). A difference of the two costs is explained only by a proof that the
reference is inaccurate (our certificate is tighter than the difference), or by the reference's own residuals times its
multipliers. The generator makes R positive definite, so every refusal is a failure.
"""

from __future__ import annotations

import signal
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.lti import kind_of, with_witness
from lin_freq_ocp.certificate import GAP_TOLERANCE, extremal_at, judge, prove_infeasible
from lin_freq_ocp.methods import Candidate, SolveOptions, solve_convex
from lin_freq_ocp.problem import one_step_residual
from lin_freq_ocp.transform import stated_sizes

REFERENCE_TOLERANCE = 1e-11  # what is asked of both reference solvers
# Statuses of answers: without any bound on a free end, no bound on the cost is rigorous
ANSWERS = ("optimal", "locally_optimal")
AGREEMENT = 1e-8  # difference of two costs, relative to max(1, |J|), up to which they agree
EXPLAINING = 0.5  # share of a difference that the reference's errors must be worth to explain it
# Relative residual up to which a witness counts: of very unstable dynamics none is known to more digits
WITNESS_RESIDUAL = 1e-9
FAR = 1e4  # multiple of the sizes in the data beyond which an optimum is ill-posed: free ends almost without cost
SOLVER_SECONDS, PROBLEM_SECONDS = 20.0, 60.0  # time for each solver, and for both solves here together


class Verdict(StrEnum):
    """How both answers to one problem compare."""

    AGREES = "both solved it, same cost"
    PROVEN = "both solved it, reference proven wrong"
    EXPLAINED = "both solved it, reference's residuals"
    UNEXPLAINED = "both solved it, not explained"
    RAY = "both infeasible, verified ray"
    NO_RAY = "reference infeasible, not proven here"
    ALONE = "solved here, reference unsure"
    RAY_ALONE = "verified ray here, reference unsure"
    UNDECIDED = "both unsure"
    UNSOLVED = "feasible, not solved here"
    CONTRADICTED = "feasible, infeasible here"
    REFUSED = "refused"
    BROKEN = "exception, or not in time"


BOTH_SOLVED = Verdict.AGREES, Verdict.PROVEN, Verdict.EXPLAINED, Verdict.UNEXPLAINED
UNSURE = Verdict.ALONE, Verdict.RAY_ALONE, Verdict.UNDECIDED
GOOD = *BOTH_SOLVED[:-1], Verdict.RAY, *UNSURE


@dataclass(frozen=True, eq=False)
class Reference:
    """What the sparse program ends with: "solved", "infeasible" or "unsure", in the solvers' words, and the point."""

    status: str
    message: str
    point: Candidate | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one random problem; ``ours`` and ``reference`` are how they ended, in words.

    If both solved it, ``difference`` is that of their costs relative to max(1, |J|); the certificate is there if it was
    solved here.
    """

    seed: int
    ours: str
    reference: str
    verdict: Verdict
    why: str = ""
    difference: float | None = None
    certificate: lfo.results.Certificate | None = None
    rounds: int | None = None
    far: bool = False

    @property
    def certified(self) -> bool:
        """Whether the maximum principle holds and the gap to a bound, be it numerical, is closed."""
        one = self.certificate
        return one is not None and one.pmp == "satisfied" and one.gap is not None and abs(one.gap) <= GAP_TOLERANCE

    @property
    def passed(self) -> bool:
        """Whether this problem meets every requirement."""
        return self.far or (self.verdict in GOOD and (self.certificate is None or self.certified))

    def __str__(self) -> str:
        text = f"seed {self.seed}, {kind_of(self.seed)}: {self.verdict} (here {self.ours}; reference {self.reference})"
        reasons = [self.why] if self.why else []
        if self.certificate is not None and not self.certified:
            reasons += [f"{one.label} {one.name} {one.relative:.0e}" for one in self.certificate.failed]
            reasons.append(f"not certified, gap {self.certificate.gap}")
        if self.far:
            reasons.append(f"ill-posed: the optimum is beyond {FAR:g} times the sizes in the data")
        return ("" if self.passed else "FAILED ") + "; ".join([text, *reasons])


def check(seed: int) -> Outcome:
    """Solve one random problem with both, and compare."""
    problem, witness = with_witness(seed)
    if witness is not None and not satisfies(problem, witness):
        witness = None
    reference = reference_answer(problem, witness)
    try:
        with alarm(PROBLEM_SECONDS):
            result = lfo.solve(problem, method="spectral", throw=False, time_limit=SOLVER_SECONDS)
            rounds = lfo.SpectralSolver(problem).solve().rounds if result.status in ANSWERS else None
    except Exception as error:  # whatever it is, it must not end a run over many problems
        verdict = Verdict.REFUSED if isinstance(error, lfo.errors.UnsupportedError) else Verdict.BROKEN
        return Outcome(seed, type(error).__name__, reference.message, verdict, str(error))
    far = reference.point is not None and is_far(problem, reference.point.trajectory)
    if result.status in ANSWERS and reference.point is not None:
        verdict, why, difference = compare_costs(problem, result, reference.point)
        judged = result.certificate
        return Outcome(seed, result.status, reference.message, verdict, why, difference, judged, rounds, far)
    verdict = compare_statuses(result.status, reference.status, feasible=witness is not None)
    certificate = result.certificate if result.status in ANSWERS else None
    return Outcome(seed, result.status, reference.message, verdict, result.message, None, certificate, rounds, far)


def satisfies(problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory) -> bool:
    """Whether a trajectory satisfies every constraint to WITNESS_RESIDUAL."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    nothing = lfo.results.Multipliers(
        1.0,
        np.zeros((T, n)),
        np.zeros((T + 1, n)),
        np.zeros((T, m)),
        np.zeros((T // 2 + 1, m)),
        np.zeros(((T + 1) // 2 + 1, n)),
    )
    conditions = judge(problem, trajectory, nothing).conditions
    labels = "state equation", "C-vi", "C-vii", "S-x", "S-u", "S-z"
    return all(one.relative <= WITNESS_RESIDUAL for one in conditions if one.label in labels or one.name in labels)


def is_far(problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory | None) -> bool:
    """Whether there is a trajectory, and it leaves the range of the sizes in the data."""
    if trajectory is None:
        return False
    x, u = stated_sizes(problem)
    return bool((np.abs(trajectory.x) > FAR * x).any() or (np.abs(trajectory.u) > FAR * u).any())


def reference_answer(problem: lfo.OptimalControlProblem, witness: lfo.Trajectory | None) -> Reference:
    """Return Clarabel's answer; PIQP's where Clarabel is not sure, nor its ray verified, or contradicts the witness."""

    def solved(point: Candidate) -> bool:
        """Whether it claims an optimum, and one that is not above the cost of the witness."""
        if point.status != "optimal" or point.message not in ("Solved", "found: True"):
            return False
        known = np.inf if witness is None else problem.value(witness.x, witness.u)
        return cost_of(problem, point) <= known + AGREEMENT * max(1.0, abs(known))

    first = solve_convex(problem, "clarabel", SolveOptions(tolerance=REFERENCE_TOLERANCE, time_limit=SOLVER_SECONDS))
    message = f"Clarabel {first.message}"
    if solved(first):
        return Reference("solved", message, first)
    proven = first.message == "PrimalInfeasible" or (first.ray is not None and prove_infeasible(problem, first.ray))
    if proven and witness is None:
        return Reference("infeasible", message)
    try:
        with alarm(SOLVER_SECONDS):  # PIQP takes no time limit
            second = solve_convex(problem, "qpsolvers:piqp", SolveOptions(tolerance=REFERENCE_TOLERANCE))
    except TimeoutError:
        return Reference("unsure", f"{message}, PIQP not finished")
    message += f", PIQP {second.message}"
    return Reference("solved", message, second) if solved(second) else Reference("unsure", message)


def cost_of(problem: lfo.OptimalControlProblem, point: Candidate) -> float:
    """Return J of a candidate that has a trajectory."""
    assert point.trajectory is not None
    return problem.value(point.trajectory.x, point.trajectory.u)


def compare_statuses(ours: str, reference: str, feasible: bool) -> Verdict:
    """Return the verdict where not both were solved; ``feasible``: there is a witness."""
    if reference == "infeasible":
        return Verdict.RAY if ours == "infeasible" else Verdict.NO_RAY
    if ours in ANSWERS:
        return Verdict.ALONE
    if feasible or reference == "solved":
        return Verdict.CONTRADICTED if ours == "infeasible" else Verdict.UNSOLVED
    return Verdict.RAY_ALONE if ours == "infeasible" else Verdict.UNDECIDED


def compare_costs(
    problem: lfo.OptimalControlProblem, result: lfo.results.Result, point: Candidate
) -> tuple[Verdict, str, float]:
    """Return the verdict on two solutions, its reason, and the relative difference of their costs."""
    certificate, trajectory, multipliers = result.certificate, result.trajectory, result.multipliers
    assert certificate is not None
    assert trajectory is not None
    assert multipliers is not None
    assert point.trajectory is not None
    assert point.multipliers is not None
    unit, excess = max(1.0, abs(certificate.cost)), cost_of(problem, point) - certificate.cost
    difference = abs(excess) / unit
    if difference <= AGREEMENT:
        return Verdict.AGREES, "", difference
    theirs = cost_errors(problem, point.trajectory, point.multipliers, trajectory)
    ours = cost_errors(problem, trajectory, multipliers, point.trajectory)
    infeasibility = sum(worth for what, worth in ours.items() if what != "duality gap") / unit
    gap = np.inf if certificate.gap is None else abs(certificate.gap)
    factor = sum(theirs.values()) / abs(excess)
    largest = max(theirs, key=lambda what: theirs[what])
    why = (
        f"the reference is {difference:.1e} {'above' if excess > 0 else 'below'}, its {largest} "
        f"and lesser errors are worth {factor:.1e} times that; here gap {gap:.1e}, residuals worth {infeasibility:.1e}"
    )
    if certificate.feasible and max(gap, infeasibility) < difference:
        return Verdict.PROVEN, why, difference
    return (Verdict.EXPLAINED if factor >= EXPLAINING else Verdict.UNEXPLAINED), why, difference


def normal_gap_terms(box: lfo.Box, v: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return per component sigma_i(y_i) - y_i v_i, computed as y_i (bound - v_i): zero iff y_i is normal at v_i."""
    return np.abs(y) * np.where(y > 0, box.upper - v, np.where(y < 0, v - box.lower, 0.0))


def cost_errors(
    problem: lfo.OptimalControlProblem, at: lfo.Trajectory, multipliers: lfo.results.Multipliers, other: lfo.Trajectory
) -> dict[str, float]:
    """Return by how much the cost of a point can be wrong, to first order: each residual times its multiplier.

    "duality gap" is the complementarity of bounds, and the slope of the Lagrangian along the way to ``other``. A
    multiplier against a bound that does not exist belongs to that slope.
    """
    lifted = extremal_at(problem, at, multipliers)
    products, slope, n = [part.gap.ravel() for part in lifted.terms], 0.0, problem.state_dim
    for here, there, normal, tube, residual in (
        (at.x, other.x, multipliers.mu, problem.state_tube, lifted.slopes[:, :n]),
        (at.u, other.u, multipliers.nu, problem.control_tube, lifted.slopes[:-1, n:]),
    ):
        normal = np.where(np.isfinite(np.where(normal > 0, tube.upper, tube.lower)), normal, 0.0)
        products.append(normal_gap_terms(tube, here, normal).ravel())
        slope += float(((residual + normal) * (there - here)).sum())
    bands = (multipliers.rho_x, at.x), (multipliers.rho_u, at.u)
    product = np.concatenate(products)
    return {
        "dynamics residual": float(np.abs(multipliers.eta * one_step_residual(problem, at)).sum()),
        "band residual": float(sum(np.abs(rho * np.fft.rfft(here, axis=0)).sum() for rho, here in bands)),
        "bound violation": float(np.maximum(-product, 0.0).sum()),
        "duality gap": float(np.maximum(product, 0.0).sum()) + abs(slope),
    }


@contextmanager
def alarm(seconds: float) -> Generator[None]:
    """Raise TimeoutError after so many seconds, where the system has such a clock."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"not finished after {seconds:g} s")

    if not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
