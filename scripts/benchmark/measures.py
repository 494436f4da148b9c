"""Measures of an answer: its time, its residuals from the problem's data alone, and its certificate."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import lin_freq_ocp as lfo
from benchmark.contenders import Answer, Contender
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import time_signal

PROVEN_GAP = 1e-8  # relative gap up to which the reference cost of a case counts as proven


@dataclass(frozen=True)
class Row:
    """One contender on one problem: a line of the tables, and of the CSV file; None where there is nothing to say.

    Attributes
    ----------
    status : str
        That of the answer, or "skipped".
    seconds, fastest, slowest : float
        Median and range over ``runs``.
    ratio : float
        Median time over ours.
    error : float
        (cost - reference) / max(1, |reference|); see ``Reference``. Below zero: not feasible to that accuracy.
    gap : float
        Of its own certificate.
    dynamics : float
        Largest |x_{t+1} - A x_t - B u_t - d| over max |x|.
    stop_band : float
        Largest |DFT of u| at a stopped bin over the 2-norm of that component.
    bounds : float
        Largest distance outside a bound, ends included, over the largest bound of that component.
    adjoint : float
        Largest |eta_{t-1} - A'eta_t + D_x c_t + mu_t| over max |eta|, transversality at both ends included.
    iterations : int
        Of the solver, or rounds.
    remark : str
        Why there is no time, or what the solver said if not that it solved the problem.
    """

    family: str
    horizon: int
    contender: str
    status: str
    runs: int = 0
    seconds: float | None = None
    fastest: float | None = None
    slowest: float | None = None
    ratio: float | None = None
    cost: float | None = None
    error: float | None = None
    gap: float | None = None
    dynamics: float | None = None
    stop_band: float | None = None
    bounds: float | None = None
    adjoint: float | None = None
    iterations: int | None = None
    remark: str = ""


@dataclass(frozen=True)
class Reference:
    """The best estimate of the optimal cost of a problem, and how far it is proven.

    Attributes
    ----------
    cost : float
        The lower bound of the contender whose cost is closest to it, both as computed.
    gap, kind : float, str
        The gap of that contender's certificate, which allows for every rounding error, and the kind of bound.
    contender : str
    """

    cost: float
    gap: float
    kind: str
    contender: str

    def __str__(self) -> str:
        proven = "proven" if abs(self.gap) <= PROVEN_GAP else "NOT proven"
        return f"cost {self.cost:.13g}, {proven} to {self.gap:.0e} by the {self.kind} bound of {self.contender}"


@dataclass(frozen=True, eq=False)
class Runs:
    """The first answer of a contender to a problem, and the seconds of every run."""

    answer: Answer
    seconds: tuple[float, ...]


def timed(contender: Contender, problem: lfo.OptimalControlProblem, limit: float) -> Runs:
    """Run once, in seconds of the process; as in ``timeit``, garbage is collected before and not meanwhile."""
    gc.collect()
    gc.disable()
    start = time.process_time()
    try:
        answer = contender(problem, limit)
    except (lfo.errors.LinFreqOCPError, MemoryError) as error:
        answer = Answer("failed", type(error).__name__)
    finally:
        seconds = time.process_time() - start
        gc.enable()
    return Runs(answer, (seconds,))


def measured(
    family: str, problem: lfo.OptimalControlProblem, runs: Mapping[str, Runs]
) -> tuple[list[Row], Reference | None]:
    """Return a row per contender, and the reference of their errors if a bound was proven."""
    judged = {name: judge(problem, one.answer) for name, one in runs.items()}
    best = reference({name: one for name, one in judged.items() if one and runs[name].answer.status == "optimal"})
    our_time = np.median(runs["ours"].seconds) if "ours" in runs else None
    rows = []
    for name, one in runs.items():
        answer, certificate = one.answer, judged[name]
        median, found = float(np.median(one.seconds)), {}
        times = {"seconds": median, "fastest": min(one.seconds), "slowest": max(one.seconds)}
        times["ratio"] = None if our_time is None else median / our_time
        if certificate is not None:
            found = residuals(problem, answer) | {"cost": certificate.cost, "gap": certificate.gap}
            found["error"] = None if best is None else (certificate.cost - best.cost) / max(1.0, abs(best.cost))
        remark = "" if answer.status == "optimal" else answer.words
        row = Row(family, problem.horizon, name, answer.status, len(one.seconds), iterations=answer.iterations)
        rows.append(Row(**(vars(row) | times | found | {"remark": remark})))
    return rows, best


def judge(problem: lfo.OptimalControlProblem, answer: Answer) -> lfo.results.Certificate | None:
    """Return the certificate of an answer with a trajectory."""
    if answer.trajectory is None or answer.multipliers is None:
        return None
    return lfo.certify(problem, answer.trajectory, answer.multipliers)


def reference(certificates: Mapping[str, lfo.results.Certificate]) -> Reference | None:
    """Return the lower bound, without its allowance for rounding errors, that is closest to its contender's cost."""
    proven = {name: one for name, one in certificates.items() if one.bound is not None and one.gap is not None}
    computed = {name: one.bound.value + one.bound.rounding for name, one in proven.items()}
    if not proven:
        return None
    name = min(proven, key=lambda name: abs(proven[name].cost - computed[name]))
    return Reference(computed[name], proven[name].gap, proven[name].bound.kind, name)


def residuals(problem: lfo.OptimalControlProblem, answer: Answer) -> dict[str, float]:
    """Return the relative residuals of an answer under their names in ``Row``."""
    x, u = answer.trajectory.x, answer.trajectory.u
    multipliers, dynamics = answer.multipliers, problem.dynamics
    step = x[1:] - x[:-1] @ dynamics.A.T - u @ dynamics.B.T - dynamics.offset
    spectrum = np.where(problem.control_stop, np.abs(np.fft.rfft(u, axis=0)), 0.0).max(0)
    none = np.zeros(problem.state_dim)
    before, after = np.vstack([none, multipliers.eta]), np.vstack([multipliers.eta @ dynamics.A, none])
    gradient = problem.cost.gradient(x, u)[0]
    adjoint = before - after + gradient + multipliers.mu + time_signal(multipliers.rho_x, len(x))
    return {
        "dynamics": over(np.abs(step).max(), np.abs(x).max()),
        "stop_band": float(max(over(*pair) for pair in zip(spectrum, np.linalg.norm(u, axis=0), strict=True))),
        "bounds": max(beyond(problem.state_tube, x), beyond(problem.control_tube, u)),
        "adjoint": over(np.abs(adjoint).max(), np.abs(multipliers.eta).max()),
    }


def beyond(tube: Box, signal: np.ndarray) -> float:
    """Return the largest distance outside, relative to the largest finite bound, else to the largest value."""
    bounds = np.abs(np.stack([tube.lower, tube.upper]))
    size = np.where(np.isfinite(bounds), bounds, 0.0).max((0, 1))
    size = np.where(size > 0, size, np.abs(signal).max(0))
    return max(over(*pair) for pair in zip(tube.violation(signal).max(0), size, strict=True))


def over(residual: float, scale: float) -> float:
    """Return residual / scale, and 0 for 0 / 0."""
    return 0.0 if residual == 0 else float(np.divide(residual, scale))
