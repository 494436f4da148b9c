"""A two-mass drive whose torque may not excite its resonance: limits on the applied spectrum, in Python and in C.

    python scripts/benchmark.py closed_loop [--steps 2000] [--write]

The resonance is at 12 Hz, damped by 1 %, and not in the model of the controller; 200 Hz, 60 steps of horizon, windows
of 100 samples, pushes every 0.7 s, noise. "points": largest amplitude at 8 to 16 Hz at the points of the windows, and
"everywhere" at 161 frequencies in all windows; the limit is 0.03. Times are microseconds of a step: of C, gcc -O3,
least of several replays; of Python, CPU time, least of so many. "no plan": steps without an answer.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.embedded import RUNS, run_bench
from benchmark.record import Record, build_parser
from helpers.generated import CompiledController

STEP, HORIZON, LENGTH, AMPLITUDE = 0.005, 60, 100, 0.03
BAND = lfo.spectrum.notch(centre_hz=12, width_hz=8)
Control = Callable[[np.ndarray], tuple[int, float]]


def filtered(price: float | None = None, limit: float | None = None) -> lfo.OptimalControlProblem:
    """Return the rigid drive with a filter of its torque that has a price or a limit."""
    return lfo.filtered_control(problem(), BAND, price=price, limit=limit)


def problem(hop: int | None = None, of_plan: bool = False) -> lfo.OptimalControlProblem:
    """Return the rigid drive, with windows that begin so often, or a notch of each plan."""
    dynamics = lfo.LinearDynamics.from_continuous(
        [[0, 1], [0, -0.5]], [[0], [1]], STEP, state_names=["angle", "speed"], control_names=["torque"]
    )
    cost = lfo.QuadraticCost(Q=np.diag([40.0, 1.0]), R=0.02, P=np.diag([2000.0, 100.0]))
    spectrum = BAND if of_plan else None
    if hop is not None:
        spectrum = lfo.spectrum.closed_loop(BAND, AMPLITUDE, STEP, length=LENGTH, hop=hop, past=0)
    return lfo.OptimalControlProblem(
        dynamics, HORIZON, cost, lfo.Box(-1, 1), initial_state=[0.3, 0.0], control_spectrum=spectrum
    )


def run_loop(control: Control, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return measured states, applied controls, statuses and the cost of a loop with the true drive."""
    rng, J, k, d = np.random.default_rng(0), 0.5, 1421.0, 0.38
    A = [[0, 1, 0, 0], [-k / J, -(d + 0.25) / J, k / J, d / J], [0, 0, 0, 1], [k / J, d / J, -k / J, -(d + 0.25) / J]]
    true = lfo.LinearDynamics.from_continuous(A, [[0], [1 / J], [0], [0]], STEP)
    push = np.zeros(steps)
    push[70::140] = rng.uniform(-0.5, 0.5, len(push[70::140]))
    noise, x = rng.normal(scale=[2e-4, 5e-3], size=(steps, 2)), np.array([0.3, 0, 0.3, 0])
    states, controls, statuses, cost = np.zeros((steps, 2)), np.zeros(steps), np.zeros(steps, dtype=int), 0.0
    for t in range(steps):
        states[t] = x[:2] + noise[t]
        statuses[t], controls[t] = control(states[t])
        cost += (40 * x[2] ** 2 + x[3] ** 2 + 0.02 * controls[t] ** 2) / 2
        x = true.A @ x + true.B[:, 0] * controls[t] + push[t] * np.array([0, 1, 0, 1])
    return states, controls, statuses, cost


def largest(u: np.ndarray, hop: int, frequencies_hz: np.ndarray) -> float:
    """Return the largest amplitude of the windows of a signal that was zero before."""
    taper, whole = np.hanning(LENGTH), np.append(np.zeros(LENGTH - 1), u)
    waves = taper[:, None] * np.exp(-2j * np.pi * STEP * np.outer(np.arange(LENGTH), frequencies_hz))
    pieces = np.stack([whole[b : b + LENGTH] for b in range(0, len(whole) - LENGTH + 1, hop)])
    return float(2 * np.abs(pieces @ waves).max() / taper.sum())


def in_python(given: lfo.OptimalControlProblem, steps: int, cap: int | None = None) -> list[str]:
    """Return the cells of a loop with RecedingHorizon."""
    runs, controller = list[list[int]](), lfo.RecedingHorizon(given, certify="later", max_changes=cap)

    def control(x: np.ndarray) -> tuple[int, float]:
        began = time.process_time_ns()
        u = controller.step(x)
        runs[-1].append(time.process_time_ns() - began)
        return (2 if controller.log.steps[-1].status == "limit" else 0), float(u[0])

    runs.append([])
    found = run_loop(control, steps)
    for _ in range(RUNS - 1):
        runs.append([])
        controller = lfo.RecedingHorizon(given, certify="later", max_changes=cap)
        for x in found[0]:
            control(x)
    return cells(given, found, np.min(runs, axis=0)[1:], "")


def in_c(
    given: lfo.OptimalControlProblem, steps: int, real: str = "double", cap: int | None = None, soft: float = 0
) -> list[str]:
    """Return the cells of a loop with generated C, with its sizes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        controller = lfo.RecedingHorizon(given, soft={"stage_rows": soft} if soft else None)
        written = lfo.generate(controller, folder, real, changes=cap)
        compiled = CompiledController(folder, real, given.state_dim, 1, HORIZON)
        found = run_loop(lambda x: (lambda status, u: (status, float(u[0])))(*compiled.step(x)), steps)
        ns = run_bench(folder, real, found[0], 1).ns
    return cells(given, found, ns, f"{written.ram / 1000:.0f}, {written.flash / 1000:.0f}")


def cells(
    given: lfo.OptimalControlProblem, found: tuple[np.ndarray, np.ndarray, np.ndarray, float], ns: np.ndarray, size: str
) -> list[str]:
    """Return the cells of a loop."""
    hop = getattr(given.control_spectrum, "hop", None) or LENGTH // 8
    _, u, status, cost = found
    points, dense = np.arange(16, 33) / (4 * LENGTH * STEP), np.linspace(8, 16, 161)
    us = ns / 1e3
    return [
        f"{largest(u, hop, points):.4f}",
        f"{largest(u, 1, dense):.4f}",
        f"{cost:.1f}",
        *(f"{value:.0f}" for value in (np.median(us), np.quantile(us, 0.99), us.max())),
        size,
        f"{(status > 1).sum()}",
    ]


def main(arguments: Sequence[str]) -> None:
    """Measure the loops and print a table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--steps", type=int, default=2000)
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
    table = Table(
        "limit of the torque, and controller", title="2000 steps of a drive with a limit of 0.03 Nm at 8 to 16 Hz"
    )
    for column in ("points", "everywhere", "cost", "us, median", "99 %", "worst", "kB: RAM, tables", "no plan"):
        table.add_column(column, justify="right")
    quarter, eighth = problem(LENGTH // 4), problem(LENGTH // 8)
    with Record(options.write) as record:
        for name, row in (
            ("none, C", lambda: in_c(problem(), options.steps)),
            ("of each plan, C", lambda: in_c(problem(of_plan=True), options.steps)),
            ("hop L/8, Python", lambda: in_python(eighth, options.steps)),
            ("hop L/4, Python", lambda: in_python(quarter, options.steps)),
            ("hop L/8, C", lambda: in_c(eighth, options.steps)),
            ("hop L/4, C", lambda: in_c(quarter, options.steps)),
            ("hop L/8, C, float", lambda: in_c(eighth, options.steps, "float")),
            ("hop L/4, C, float", lambda: in_c(quarter, options.steps, "float")),
            ("hop L/4, C, cap of 20", lambda: in_c(quarter, options.steps, cap=20)),
            ("hop L/4, C, cap of 0", lambda: in_c(quarter, options.steps, cap=0)),
            ("filter, price 300, C", lambda: in_c(filtered(price=300.0), options.steps)),
            ("filter, price 500, C", lambda: in_c(filtered(price=500.0), options.steps)),
            ("filter, price 500, C, float", lambda: in_c(filtered(price=500.0), options.steps, "float")),
            ("filter, limit 0.0125, soft, C", lambda: in_c(filtered(limit=0.0125), options.steps, soft=100.0)),
        ):
            table.add_row(name, *row())
        record.show(table)
