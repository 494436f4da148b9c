"""How far time limits are exceeded, on problems that take far longer: every method, and explanations.

Part of scripts/verify.py. Measured is the wall time of solve() without that of the judge's certificate, which is never
left out where there is a point. A native solver cannot be left within a step: what one step needs is estimated.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from benchmark.cases import bang_bang, fine_pendulum, oscillator, pendulum
from benchmark.structured_cases import masked as finely_masked
from benchmark.structured_cases import rate_limited, rendezvous, time_varying
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo

LIMITS = 1.0, 3.0
"""Seconds."""

ALLOWED = 0.5
"""Seconds beyond a limit, on a machine that does nothing else."""


def balls(horizon: int) -> lfo.OptimalControlProblem:
    """Return the double integrator with a ball for its force: cones and dense rows."""
    return replace(bang_bang(horizon), control_set=lfo.sets.Ball(0.27))


def masked(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with a mask in place of its stop band: a cone and dense rows for every bin."""
    weaker = lfo.MagnitudeBound(0.5, band=lfo.low_pass(0.8 * np.pi))
    return replace(pendulum(horizon), control_spectrum=weaker)


def too_weak(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with too little force: infeasible, and to be explained."""
    return replace(pendulum(horizon), control_set=lfo.Box(-0.01, 0.01))


CASES: tuple[tuple[str, Callable[[], lfo.OptimalControlProblem], str], ...] = (
    ("balls, T = 300", lambda: balls(300), "auto"),
    ("balls, T = 1000", lambda: balls(1000), "auto"),
    ("balls, T = 4000", lambda: balls(4000), "auto"),
    ("mask, T = 500", lambda: masked(500), "auto"),
    ("fine pendulum, T = 20 000", lambda: fine_pendulum(20_000), "spectral"),
    ("oscillator, T = 100 000", lambda: oscillator(100_000), "spectral"),
    ("pendulum, T = 2000, sparse program", lambda: pendulum(2000), "convex"),
    ("infeasible pendulum, T = 240", lambda: too_weak(240), "auto"),
    ("cart-pole between walls", lfo.library.cart_pole_with_walls, "branch_and_bound"),
    ("cart-pole between walls", lfo.library.cart_pole_with_walls, "enumerate"),
    ("cart-pole between walls", lfo.library.cart_pole_with_walls, "miqp"),
    ("ball and paddle", lfo.library.ball_and_paddle, "branch_and_bound"),
    ("ball and paddle", lfo.library.ball_and_paddle, "miqp"),
    ("dynamics with a norm", lfo.library.norm_dynamics, "nonsmooth"),
    ("dynamics with a norm", lfo.library.norm_dynamics, "auto"),
)

LARGE = {"time-varying": time_varying, "rate-limited": rate_limited, "mask": finely_masked, "rendezvous": rendezvous}
CASES += tuple(
    (f"{name}, T = {horizon}", partial(make, horizon), method)
    for name, make in LARGE.items()
    for horizon in (4000, 20_000)
    for method in ("structured", "auto", "convex", "spectral")
)


@dataclass(frozen=True)
class Run:
    """One solve with a limit: how it ended, and wall times in seconds."""

    limit: float
    ended: str
    seconds: float
    judged: float

    @property
    def beyond(self) -> float:
        """Return by how much the limit was exceeded."""
        return max(0.0, self.seconds - self.judged - self.limit)


def run(problem: lfo.OptimalControlProblem, method: str, limit: float) -> Run:
    """Solve a problem with a limit."""
    started = time.perf_counter()
    try:
        result = lfo.solve(problem, method=method, time_limit=limit)
    except lfo.errors.SolveError as error:
        result = error.result
    except lfo.errors.UnsupportedError:
        return Run(limit, "refused", time.perf_counter() - started, 0.0)
    seconds = time.perf_counter() - started
    modes = result.tree is not None or result.method == "nonsmooth"
    judged = 0.0 if modes else result.seconds["certify"]  # over modes, that is the time of the proof
    return Run(limit, result.status, seconds, judged)


def verify(console: Console) -> bool:
    """Run all cases, print a table, and return whether every limit was observed."""
    table = Table("problem", "method", "limit [s]", "ended", "took [s]", "judge [s]", "beyond [s]")
    kept = True
    for name, make, method in CASES:
        problem = make()
        for limit in LIMITS:
            one = run(problem, method, limit)
            kept &= one.beyond <= ALLOWED
            figures = (f"{one.limit:g}", one.ended, f"{one.seconds:.2f}", f"{one.judged:.2f}", f"{one.beyond:.2f}")
            table.add_row(name, method, *figures, style=None if one.beyond <= ALLOWED else "red")
    console.print(table)
    return kept
