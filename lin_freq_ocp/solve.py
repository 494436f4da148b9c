"""solve() and certify(): the two functions that know every stage, from a problem to a judged result."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from lin_freq_ocp.certificate.conflict import Conflict, prove_infeasible
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.errors import (
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    NumericalError,
    SolveError,
    UnboundedError,
    UnsupportedError,
)
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.convex import solve_convex
from lin_freq_ocp.methods.multipliers import fit_multipliers
from lin_freq_ocp.methods.spectral import SpectralSolver
from lin_freq_ocp.problem.arrays import Array
from lin_freq_ocp.problem.costs import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem, simulate
from lin_freq_ocp.problem.sensitivities import Sensitivities, sensitivities
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from lin_freq_ocp.explain import Explanation

PROVER = "clarabel"
"""The backend that proves infeasibility and unboundedness, whichever backend met it."""

LEAST_TIME = 1e-3
"""Seconds that are left to a second method when the first one has used them all: it ends at once, with its words."""

EXPLAIN_SECONDS = 5.0
"""Time for saying why a problem has no solution, unless a time limit leaves less."""

METHODS = ("auto", "convex", "spectral")

ERRORS: dict[str, type[SolveError]] = {
    "infeasible": InfeasibleError,
    "unbounded": UnboundedError,
    "limit": LimitError,
    "numerical_error": NumericalError,
}


@dataclass(frozen=True, eq=False)
class Result:
    """What a solve ended with; everything that does not exist is None.

    Attributes
    ----------
    problem : OptimalControlProblem
    status : str
        "optimal", "infeasible", "unbounded", "limit" or "numerical_error": why it stopped.
    method : str
        What was used.
    backend : str or None
        The solver of the method "convex"; others need none.
    seconds : dict
        Wall time of "setup" (transcription, scaling), "solve" (the backend) and "certify".
    trajectory, multipliers, certificate : or None
        The best point found, whatever the status, and what is proven of it.
    conflict : tuple of Conflict or None
        If infeasible: the blocks of constraints that the proof rests on.
    ray : Multipliers or None
        If infeasible: the verified multipliers with eta_C = 0.
    message : str
        In words, how it ended.
    interrupted : bool
        Whether Ctrl-C was pressed; what was found until then is here, be it complete or not.
    explanation : Explanation or None
        If an InfeasibleError was raised: what it says of the family in conflict and of cures. Else ``lfo.explain``.
    options : dict
        What solve was given: "method", "backend", "time_limit" and "tolerance".
    """

    problem: OptimalControlProblem
    status: str
    method: str
    backend: str | None
    seconds: dict[str, float]
    trajectory: Trajectory | None = None
    multipliers: Multipliers | None = None
    certificate: Certificate | None = None
    conflict: tuple[Conflict, ...] | None = None
    ray: Multipliers | None = field(default=None, repr=False)
    message: str = ""
    interrupted: bool = False
    explanation: Explanation | None = None
    options: dict[str, Any] = field(default_factory=dict[str, Any], repr=False)

    @property
    def primal(self) -> bool:
        """Whether there is a point that satisfies every constraint, within the judge's tolerance."""
        return self.certificate is not None and self.certificate.feasible

    @property
    def dual(self) -> bool:
        """Whether there is a proof: a lower bound on the cost, or a verified infeasibility ray."""
        return self.ray is not None or self.lower_bound is not None

    @property
    def cost(self) -> float | None:
        """Return J of the trajectory."""
        return None if self.certificate is None else self.certificate.cost

    @property
    def lower_bound(self) -> float | None:
        """Return the judge's bound on the optimal cost."""
        return None if self.certificate is None else self.certificate.lower_bound

    @property
    def gap(self) -> float | None:
        """Return (cost - lower_bound) / max(1, |cost|)."""
        return None if self.certificate is None else self.certificate.gap

    @property
    def solver(self) -> str:
        """Return the method, with its backend if it has one."""
        return self.method if self.backend is None else f"{self.method}, {self.backend}"

    @property
    def control(self) -> Array | None:
        """Return u, shape (T, m)."""
        return None if self.trajectory is None else self.trajectory.u

    @property
    def sensitivities(self) -> Sensitivities:
        """Return the derivatives of the optimal cost by bounds, ends, bins and offsets; SolveError if there is none."""
        if self.status != "optimal" or self.multipliers is None:
            raise SolveError(f"Only an optimum has sensitivities; this solve ended as '{self.status}'.", self)
        return sensitivities(self.problem, self.multipliers)

    def __str__(self) -> str:
        certificate = self.certificate
        lines = [f"status    {self.status}" + (f": {self.message}" if self.message else "")]
        if certificate is not None:
            kind = "" if certificate.bound is None else f" ({certificate.bound.kind})"
            worst, normal = certificate.worst, "normal" if certificate.normal else "abnormal"
            lines += [
                f"cost      {certificate.cost:.12g}",
                f"bound     {_number(certificate.lower_bound)}{kind}",
                f"gap       {_number(certificate.gap, '.2e')}"
                + (" (global optimum)" if certificate.globally_optimal else ""),
                f"theorem   {certificate.pmp}, {normal}",
                f"worst     {worst.relative:.1e} relative, {worst.label} {worst.name}",
            ]
        lines.append(f"method    {self.solver}")
        lines.append("time      " + ", ".join(f"{what} {seconds:.3g} s" for what, seconds in self.seconds.items()))
        return "\n".join([str(self.problem), *lines])

    def plot(self) -> Figure:
        """Return a figure of controls, spectra and states."""
        from lin_freq_ocp.report.figures import result_figure

        return result_figure(self)

    def save(self, path: str | Path) -> None:
        """Write trajectory and multipliers to an .npz file."""
        from lin_freq_ocp.interchange.results import save_solution
        from lin_freq_ocp.interchange.summary import result_summary

        save_solution(path, self._require_trajectory(), self.multipliers, result_summary(self))

    def to_csv(self, path: str | Path) -> None:
        """Write the trajectory as a table, one row per time."""
        from lin_freq_ocp.interchange.results import save_csv

        save_csv(path, self.problem, self._require_trajectory())

    def to_mat(self, path: str | Path) -> None:
        """Write the trajectory for MATLAB: x (T+1, n), u (T, m), t (T+1, 1), one row per time, and the names."""
        from lin_freq_ocp.interchange.mat_file import save_mat

        save_mat(path, self.problem, self._require_trajectory())

    def to_time_response(self) -> Any:
        """Return the trajectory as a ``control.TimeResponseData``; the states are its outputs, too."""
        from lin_freq_ocp.interchange.time_response import to_time_response

        return to_time_response(self.problem, self._require_trajectory())

    def dump(self, path: str | Path) -> None:
        """Write problem, options, result and versions to one .zip file; ``lfo.load_run`` reads it."""
        from lin_freq_ocp.interchange.run_file import dump_run

        dump_run(path, self.problem, self.options, self)

    def to_json(self, path: str | Path) -> None:
        """Write the object that ``lin-freq-ocp solve --json`` prints."""
        from lin_freq_ocp.interchange.summary import result_summary, save_json

        save_json(path, result_summary(self))

    def _require_trajectory(self) -> Trajectory:
        if self.trajectory is None:
            raise SolveError(f"The solve ended without a trajectory ({self.status}).", self)
        return self.trajectory


def solve(
    problem: OptimalControlProblem,
    method: str = "auto",
    backend: str = "auto",
    time_limit: float | None = None,
    tolerance: float | None = None,
    throw: bool = True,
) -> Result:
    """Solve a problem, and judge the answer.

    Parameters
    ----------
    problem : OptimalControlProblem
    method : {"auto", "convex", "spectral"}
        "spectral": our Fourier-domain method, for time-invariant dynamics. "convex": one sparse quadratic program.
        "auto": spectral where it applies and its answer is proven, else convex; convex if a backend is named.
    backend : str
        Of "convex": "auto" (Clarabel), "clarabel", "osqp" or "qpsolvers:NAME".
    time_limit : float, optional
        Seconds for the solver.
    tolerance : float, optional
        Convex: relative residuals asked of the solver, on a program scaled to order 1. Spectral: relative violation of
        bounds to stop at.
    throw : bool
        Whether to raise if the status is not "optimal"; the error holds the result.

    Returns
    -------
    Result

    Raises
    ------
    InfeasibleError, UnboundedError, LimitError, NumericalError
        With ``throw``; a subclass of SolveError, with ``.result``.
    UnsupportedError
        If the method or backend does not exist or cannot take this problem.
    """
    if method not in METHODS:
        raise UnsupportedError(f"method: got {method!r}; expected {', '.join(map(repr, METHODS[:-1]))} or 'spectral'.")
    if method == "spectral" and backend != "auto":
        raise UnsupportedError(f"backend: got {backend!r}; the method 'spectral' needs none: leave it 'auto'.")
    _require_positive("time_limit", time_limit)
    _require_positive("tolerance", tolerance)
    started, result = time.perf_counter(), None
    if method == "spectral" or (method == "auto" and backend == "auto"):
        result = _spectral(problem, method == "spectral", tolerance, time_limit)
    if result is None:
        left = None if time_limit is None else max(time_limit - (time.perf_counter() - started), LEAST_TIME)
        result = _convex(problem, PROVER if backend == "auto" else backend, tolerance, left)
    options = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    result = replace(result, options=options)
    if throw and result.status == "infeasible":
        left = EXPLAIN_SECONDS if time_limit is None else time_limit - (time.perf_counter() - started)
        result = explained(result, min(left, EXPLAIN_SECONDS))
    if throw and result.status != "optimal":
        raise ERRORS[result.status](_complaint(result), result)
    return result


def certify(problem: OptimalControlProblem, trajectory: Any, multipliers: Multipliers | None = None) -> Certificate:
    """Judge any trajectory, from anywhere, against the maximum principle and the global bound.

    Parameters
    ----------
    problem : OptimalControlProblem
    trajectory : Trajectory or (T, m)
        A trajectory, or controls alone, which are then replayed from the initial state.
    multipliers : Multipliers, optional
        Without, those that fit the trajectory best are looked for first.

    Raises
    ------
    ProblemError
        If a shape does not fit the problem.
    """
    if not isinstance(trajectory, Trajectory):
        trajectory = simulate(problem, trajectory)
    problem.require(trajectory)
    return judge(problem, trajectory, multipliers or fit_multipliers(problem, trajectory))


def _spectral(
    problem: OptimalControlProblem, required: bool, tolerance: float | None, time_limit: float | None
) -> Result | None:
    """Return what the Fourier-domain method ends with; None, unless required, if that is no answer with a proof."""
    try:
        solver = SpectralSolver(problem)
    except UnsupportedError:
        if required:
            raise
        return None
    candidate = solver.solve(tolerance=tolerance, time_limit=time_limit)
    if candidate.status == "unbounded":
        candidate = _if_feasible(problem, candidate, time_limit)
    result = _judged(problem, candidate, "spectral", None)
    certificate = result.certificate
    optimal = certificate is not None and certificate.pmp == "satisfied" and certificate.globally_optimal
    proven = result.status == "optimal" and optimal
    ended = proven or result.interrupted or result.status in ("infeasible", "limit")
    return result if required or ended else None


def _convex(problem: OptimalControlProblem, backend: str, tolerance: float | None, time_limit: float | None) -> Result:
    """Return what the sparse program ends with."""
    candidate = solve_convex(problem, backend, tolerance, time_limit)
    if candidate.status not in ("optimal", "limit") and backend != PROVER:
        candidate = _accounted(problem, candidate, time_limit)
    if candidate.status == "unbounded":
        candidate = _if_feasible(problem, candidate, time_limit)
    return _judged(problem, candidate, "convex", backend)


def _accounted(problem: OptimalControlProblem, candidate: Candidate, time_limit: float | None) -> Candidate:
    """Return the prover's account of a problem that another backend did not solve, if it has one."""
    account = solve_convex(problem, PROVER, None, time_limit)
    return account if account.status in ("infeasible", "unbounded") else candidate


def _if_feasible(problem: OptimalControlProblem, candidate: Candidate, time_limit: float | None) -> Candidate:
    """Return the unbounded candidate, or the account of a problem that has no trajectory for its cost to fall along."""
    feasibility = solve_convex(replace(problem, cost=QuadraticCost()), PROVER, None, time_limit)
    return feasibility if feasibility.status == "infeasible" else candidate


def _judged(problem: OptimalControlProblem, candidate: Candidate, method: str, backend: str | None) -> Result:
    clock = time.perf_counter()
    status, words, conflict, ray, certificate = candidate.status, candidate.words, None, None, None
    if candidate.trajectory is not None and candidate.multipliers is not None:
        certificate = judge(problem, candidate.trajectory, candidate.multipliers)
    if status == "infeasible":
        proof = None if candidate.ray is None else prove_infeasible(problem, candidate.ray)
        if proof is None:
            status, words = "numerical_error", f"{words}, but its ray proves nothing"
        else:
            conflict, ray = proof.conflict, proof.multipliers
            words = f"proven by a {proof.bound.kind} ray"
    return Result(
        problem=problem,
        status=status,
        method=method,
        backend=backend,
        seconds={**candidate.seconds, "certify": time.perf_counter() - clock},
        trajectory=candidate.trajectory,
        multipliers=candidate.multipliers,
        certificate=certificate,
        conflict=conflict,
        ray=ray,
        message="" if status == "optimal" else words,
        interrupted=candidate.interrupted,
    )


def explained(result: Result, seconds: float = EXPLAIN_SECONDS) -> Result:
    """Return an infeasible result with its explanation, if one was found in that time."""
    from lin_freq_ocp.explain import explain

    try:
        return replace(result, explanation=explain(result.problem, seconds) if seconds > 0 else None)
    except LinFreqOCPError:  # the proof stands without it
        return result


def _complaint(result: Result) -> str:
    name = result.problem.name or "the problem"
    if result.status == "infeasible":
        blocks = "; ".join(str(one) for one in result.conflict or ())
        cures = "; or ".join(str(one) for one in result.explanation.cures) if result.explanation else ""
        return f"No trajectory of {name} satisfies all constraints ({result.message}). In conflict: {blocks}. " + (
            f"Least change that helps: {cures}." if cures else "Relax one of these."
        )
    if result.status == "unbounded":
        return f"The cost of {name} has no lower bound. Bound the controls, or give every one of them a cost."
    if result.status == "limit":
        return f"{name}: stopped before the answer was accurate ({result.message}); the best point is in .result."
    return (
        f"{name}: {result.solver} ended with '{result.message}', and its residuals are too large to call it a "
        "solution; what it found is in .result. Try another backend or method."
    )


def _require_positive(name: str, value: float | None) -> None:
    if value is not None and not value > 0:
        raise UnsupportedError(f"{name}: got {value!r}; expected a number above zero, or None.")


def _number(value: float | None, form: str = ".12g") -> str:
    return "none" if value is None else format(value, form)
