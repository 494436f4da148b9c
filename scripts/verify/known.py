"""Problems with known optimal costs, by Clarabel, PIQP and OSQP, and the certificate of Clarabel's answer.

And bodies that turn in the least time, whose answers no other test can wait for.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.published import LEAST_TIMES
from lin_freq_ocp.testing import INSTANCES, MASKED, PENDULUM, STATED, reference_problem

# Relative error of the cost that each solver must keep on the pendulum, and Clarabel on all known problems
PROMISED = {"clarabel": 1e-7, "qpsolvers:piqp": 1e-7, "osqp": 1e-5}
LONGER = 1e-6  # part of a known least time by which an answer may be longer


def verify(console: Console) -> bool:
    """Print a table of relative errors on known problems; return whether all are within their limits."""
    table, good = Table("problem", "optimal cost", title="known optima: relative error of the cost"), True
    for column in (*PROMISED, "worst condition", "gap"):
        table.add_column(column, justify="right")
    for name, (problem, optimum) in known_problems().items():
        cells = []
        for backend, promise in PROMISED.items():
            if backend != "clarabel" and name not in STATED and name in INSTANCES:
                cells.append("no cones")
                continue
            promise = promise if name in STATED or name not in INSTANCES else MASKED
            result = lfo.solve(problem, backend=backend, throw=False)
            if result.status != "optimal" or result.cost is None:
                cells.append(result.status)
                good &= name not in PENDULUM
                continue
            error = abs(result.cost / optimum - 1)
            good &= error <= promise or (backend != "clarabel" and name not in PENDULUM)
            cells.append(f"{error:.1e}")
        certificate = lfo.solve(problem).certificate
        assert certificate is not None
        good &= certificate.pmp == "satisfied" and certificate.globally_optimal
        table.add_row(name, f"{optimum:.12g}", *cells, f"{certificate.worst.relative:.1e}", f"{certificate.gap:.1e}")
    console.print(table)
    return verify_least_times(console) and good


def verify_least_times(console: Console) -> bool:
    """Print a table of least times; return whether all are local minima and none is longer than known."""
    table, good = Table("problem", "status", "known", "longer by", "worst condition", title="least times"), True
    for name, (build, horizon, known) in LEAST_TIMES.items():
        result = lfo.solve(build(horizon), global_bound=False, throw=False)
        longer = np.inf if result.cost is None else result.cost / known - 1
        good &= result.status == "locally_optimal" and longer <= LONGER
        worst = "none" if result.certificate is None else f"{result.certificate.worst.relative:.1e}"
        table.add_row(name, result.status, f"{known:.8g}", f"{longer:.1e}", worst)
    console.print(table)
    return good


def known_problems() -> dict[str, tuple[lfo.OptimalControlProblem, float]]:
    """Return the problems with known optimal values: the pendulum's, and those of the tests' reference data."""
    known = {name: (lfo.library.pendulum(**keywords), cost) for name, (keywords, cost) in PENDULUM.items()}
    known["physical, constrained"] = lfo.library.pendulum(parameters="physical"), 3611.455894278
    known["physical, classical"] = lfo.library.pendulum(parameters="physical", cutoff=None), 3204.426641194
    return known | {name: (reference_problem(name), INSTANCES[name]["optimal_value"]) for name in INSTANCES}
