"""The contenders of the benchmark: each takes a problem and a time limit, and returns its answer.

ours             the Fourier-domain solver, lfo.SpectralSolver
cvxpy+clarabel   a vectorised CVXPY model, written here as a user would, with Clarabel's own tolerance (1e-8)
clarabel, piqp   the sparse program of lin_freq_ocp in natural units, tolerance 1e-10: made once, solved once
osqp             the same, tolerance 1e-7 and polishing

Multipliers are part of every answer.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.units import scaled_program

CLAIMS = {Claim.SOLVED: "optimal", Claim.INFEASIBLE: "infeasible", Claim.LIMIT: "limit"}
# Words of backends and of CVXPY in those of this project; anything else is a failure
STATUSES = {"optimal": "optimal", "optimal_inaccurate": "optimal", "infeasible": "infeasible", "user_limit": "limit"}
UNLIMITED = ("piqp",)  # solvers that cannot stop at a time limit


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of a contender.

    Attributes
    ----------
    status : str
        "optimal", "infeasible", "limit" or "failed", by the contender's own word.
    words : str
        That word.
    iterations : int or None
        Of the solver, or rounds.
    """

    status: str
    words: str
    trajectory: lfo.Trajectory | None = None
    multipliers: lfo.results.Multipliers | None = None
    iterations: int | None = None


Contender = Callable[[lfo.OptimalControlProblem, float], Answer]


def ours(problem: lfo.OptimalControlProblem, limit: float) -> Answer:
    """Solve in the Fourier domain; nothing that is not in the problem is known before."""
    return _our_answer(lfo.SpectralSolver(problem).solve(time_limit=limit))


def cvxpy_clarabel(problem: lfo.OptimalControlProblem, limit: float) -> Answer:
    """Write the problem in CVXPY and solve it."""
    return CvxpyModel(problem, problem.initial_state.lower).solve(limit)


def direct(solver: str) -> Contender:
    """Return a contender that solves our sparse program with a backend."""

    def solve(problem: lfo.OptimalControlProblem, limit: float) -> Answer:
        linear, scaling, program = scaled_program(problem)
        solution = backend(solver)(program, DEFAULT_TOLERANCE, None if solver.endswith(UNLIMITED) else limit)
        status = CLAIMS.get(solution.claim, "failed")
        if solution.z is None or solution.y is None or status == "infeasible":
            return Answer(status, solution.message)
        multipliers = linear.multipliers(scaling.dual(solution.y), 1.0)
        return Answer(status, solution.message, linear.trajectory(scaling.primal(solution.z)), multipliers)

    return solve


CONTENDERS: dict[str, Contender] = {
    "ours": ours,
    "cvxpy+clarabel": cvxpy_clarabel,
    "clarabel": direct("clarabel"),
    "piqp": direct("qpsolvers:piqp"),
    "osqp": direct("osqp"),
}


class CvxpyModel:
    """A problem with constant data, point ends and control stop bands in CVXPY, with no loop over time.

    Parameters
    ----------
    problem : OptimalControlProblem
    start : (n,) or cvxpy.Parameter
        The initial state.
    """

    def __init__(self, problem: lfo.OptimalControlProblem, start: Any):
        import cvxpy as cp  # here, so that the memory of the others does not hold it

        self._problem = problem
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        cost, dynamics = problem.cost, problem.dynamics
        x, u = cp.Variable((n, T + 1)), cp.Variable((m, T))
        self._x, self._u = x, u
        self._dynamics = x[:, 1:] == dynamics.A @ x[:, :-1] + dynamics.B @ u
        self._first, self._last = x[:, 0] == start, x[:, T] == problem.terminal_state.lower
        self._states = Bounds(x[:, 1:-1], problem.state_tube.lower[1], problem.state_tube.upper[1])
        self._controls = Bounds(u, problem.control_tube.lower[0], problem.control_tube.upper[0])
        self._stops = {
            j: stop_rows(T, stopped) @ u[j] == 0 for j, stopped in enumerate(problem.control_stop.T) if stopped.any()
        }
        parts = ((cost.Q, x[:, :-1]), (cost.R, u), (cost.P, x[:, -1:]))
        objective = cp.Minimize(sum(half_square(weight, signal) for weight, signal in parts if weight.any()))
        boxes = [*self._states.constraints, *self._controls.constraints]
        ends = [self._first, self._last]
        self._model = cp.Problem(objective, [self._dynamics, *ends, *boxes, *self._stops.values()])

    def solve(self, limit: float) -> Answer:
        """Solve with Clarabel."""
        import cvxpy as cp

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the residuals tell
            try:
                self._model.solve(solver=cp.CLARABEL, max_threads=1, time_limit=limit)
            except cp.SolverError:
                return Answer("failed", "SolverError")
        words = str(self._model.status)
        status, iterations = STATUSES.get(words, "failed"), self._model.solver_stats.num_iters
        if self._x.value is None or status == "infeasible":
            return Answer(status, words, iterations=iterations)
        trajectory = lfo.Trajectory(self._x.value.T, self._u.value.T)
        return Answer(status, words, trajectory, self._multipliers(), iterations)

    def _multipliers(self) -> lfo.results.Multipliers:
        T, n = self._problem.horizon, self._problem.state_dim
        ends = self._first.dual_value[None], self._last.dual_value[None]
        rho = np.zeros(self._problem.control_stop.shape, dtype=complex)
        for j, stop in self._stops.items():
            stopped = self._problem.control_stop[:, j]
            rho[stopped, j] = stop_multipliers(T, stopped, stop.dual_value)
        return lfo.results.Multipliers(
            eta_C=1.0,
            eta=self._dynamics.dual_value.T,
            mu=np.vstack([ends[0], self._states.multipliers.T, ends[1]]),
            nu=self._controls.multipliers.T,
            rho_u=rho,
            rho_x=np.zeros(((T + 1) // 2 + 1, n), dtype=complex),
        )


class Bounds:
    """The finite ones among constant bounds on the rows of a CVXPY expression."""

    def __init__(self, signal: Any, lower: np.ndarray, upper: np.ndarray):
        self._shape = signal.shape
        self._sides = [
            (sign, here, sign * signal[here] <= (sign * bound[here])[:, None])
            for sign, bound in ((-1, lower), (1, upper))
            if len(here := np.flatnonzero(np.isfinite(bound)))
        ]

    @property
    def constraints(self) -> list[Any]:
        """Return the inequalities."""
        return [constraint for _, _, constraint in self._sides]

    @property
    def multipliers(self) -> np.ndarray:
        """Return the duals, positive at an upper bound and negative at a lower one; the signal's shape."""
        result = np.zeros(self._shape)
        for sign, here, constraint in self._sides:
            result[here] += sign * constraint.dual_value
        return result


def half_square(weight: np.ndarray, signal: Any) -> Any:
    """Return 1/2 sum_t v_t'W v_t for the columns v_t of a CVXPY expression."""
    import cvxpy as cp

    if (weight == weight[0, 0] * np.eye(len(weight))).all():
        return 0.5 * weight[0, 0] * cp.sum_squares(signal)
    return 0.5 * cp.sum_squares(np.linalg.cholesky(weight).T @ signal)


def stop_rows(length: int, stopped: np.ndarray) -> np.ndarray:
    """Return the real, then the imaginary parts of the stopped rows of the DFT matrix, without those that are zero."""
    k = np.flatnonzero(stopped)
    rows = np.exp(-2j * np.pi * (np.outer(k, np.arange(length)) % length) / length)
    return np.vstack([rows.real, rows.imag[(k > 0) & (2 * k != length)]])


def stop_multipliers(length: int, stopped: np.ndarray, duals: np.ndarray) -> np.ndarray:
    """Return the complex multipliers of the stopped bins from the duals of ``stop_rows``."""
    k = np.flatnonzero(stopped)
    real, imaginary = np.split(duals, [len(k)])
    rho = real.astype(complex)
    rho[(k > 0) & (2 * k != length)] += 1j * imaginary
    return rho


def _our_answer(solution: Any) -> Answer:
    trajectory, multipliers = solution.trajectory, solution.multipliers
    return Answer(solution.status, solution.message, trajectory, multipliers, getattr(solution, "rounds", None))


class OurResolver:
    """The Fourier-domain solver, set up once; every solve starts from the one before."""

    def __init__(self, problem: lfo.OptimalControlProblem):
        self._solver = lfo.SpectralSolver(problem)
        self._last = self._solver.solve()

    def __call__(self, problem: lfo.OptimalControlProblem, limit: float) -> Answer:
        """Solve from the problem's initial state."""
        solution = self._solver.solve(problem.initial_state.lower, warm_start=self._last, time_limit=limit)
        answer = _our_answer(solution)
        if answer.status == "optimal":
            self._last = solution
        return answer


class CvxpyResolver:
    """The CVXPY model with the initial state as its parameter, compiled once."""

    def __init__(self, problem: lfo.OptimalControlProblem):
        import cvxpy as cp

        self._start = cp.Parameter(problem.state_dim, value=problem.initial_state.lower)
        self._model = CvxpyModel(problem, self._start)
        self._model.solve(np.inf)

    def __call__(self, problem: lfo.OptimalControlProblem, limit: float) -> Answer:
        """Solve from the problem's initial state."""
        self._start.value = problem.initial_state.lower
        return self._model.solve(limit)


# Contender -> what it makes of the first problem, outside the time measured. "clarabel" starts from scratch.
RESOLVERS: dict[str, Callable[[lfo.OptimalControlProblem], Contender]] = {
    "ours": OurResolver,
    "cvxpy+clarabel": CvxpyResolver,
    "clarabel": lambda problem: direct("clarabel"),
}
