"""A step of a generated controller in C: times, sizes and accuracy, and other solvers at the same states.

    python scripts/benchmark.py embedded [--cases ...] [--steps 1000] [--compared 20] [--write]

Each case is a disturbed loop with a push every 40 steps. Times are microseconds of one core, gcc -O3, in double, least
of several runs of the same loop. "active": median of steps with active rows; "worst": of steps where all hard
constraints can be satisfied, and of all steps; "changes": most of the working set in a step. "apart" is the largest
difference from the control of a plan that is proven optimal, relative to its bound. The cap is on changes; "reached"
says at how many steps, and "its cost" is that of the loop with soft bounds, relative to the loop without the cap.
"condensed" solvers get the dense program of the condensed method, "sparse" ones the program in states and controls;
each is set up once, and updated and called from Python; their times are CPU times.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.embedded_cases import CASES, Case, disturbed_states
from benchmark.loop import dense, sparse
from benchmark.record import Record, build_parser
from helpers.generated import CompiledController, write_log
from lin_freq_ocp.loop.step_problem import free_first_state

RUNS = 9
CAP = 20
LONGEST = 6.0  # seconds of another solver in a case
FLAGS = ("gcc", "-std=c99", "-O3", "-fPIC", "-shared")
SMALL = {  # compilers for sizes of code, where they are installed
    "x86-64": ("gcc", "size"),
    "Cortex-M4": ("arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard", "arm-none-eabi-size"),
}


@dataclass(frozen=True)
class Measured:
    """Controls, statuses, nanoseconds, changes and active rows of the steps of a loop."""

    u: np.ndarray
    status: np.ndarray
    ns: np.ndarray
    changes: np.ndarray
    active: np.ndarray


def run_bench(folder: Path, real: str, states: np.ndarray, controls: int, runs: int = RUNS) -> Measured:
    """Compile the controller of a folder with its bench, and run it."""
    source = Path(__file__).with_name("embedded_bench.c")
    target = folder / "bench.so"
    command = [*FLAGS, f"-I{folder}", "controller.c", "lfo_kernel.c", str(source), "-o", str(target), "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    kind, count = np.float64 if real == "double" else np.float32, len(states)
    x, u = np.ascontiguousarray(states, kind), np.zeros((count, controls), kind)
    status, changes, active = (np.zeros(count, np.int32) for _ in range(3))
    ns = np.full(count, 1e18)
    pointers = [ctypes.c_void_p(part.ctypes.data) for part in (x, u, status, ns, changes, active)]
    library = ctypes.CDLL(str(target))
    for _ in range(runs):
        library.bench(count, *pointers)
    return Measured(u.astype(float), status, ns, changes, active)


def code_sizes(folder: Path) -> dict[str, int]:
    """Return the bytes of code, without tables, by processor, where its compiler is found."""
    found = dict[str, int]()
    for name, (compiler, size) in SMALL.items():
        try:
            command = f"{compiler} -std=c99 -Os -c controller.c lfo_kernel.c && {size} controller.o lfo_kernel.o"
            done = subprocess.run(command, shell=True, cwd=folder, check=True, capture_output=True, text=True)
        except subprocess.CalledProcessError:
            continue
        text = sum(int(line.split()[0]) + int(line.split()[1]) for line in done.stdout.splitlines()[1:])
        header = (folder / "controller.h").read_text()
        found[name] = text - int(header.split("CONTROLLER_TABLE_BYTES ")[1].split()[0])
    return found


def loop_cost(case: Case, folder: Path, steps: int) -> float:
    """Return the sum of the stage costs of a disturbed loop with the controller of a folder."""
    problem, total = case.problem, 0.0
    compiled, cost = compiled_controller(case, folder), problem.quadratic

    def step(x: np.ndarray) -> np.ndarray:
        nonlocal total
        u = compiled.step(x[: compiled.measured])[1]
        total += float(x @ cost.Q @ x + u @ cost.R @ u) / 2
        return u

    disturbed_states(case, step, steps)
    return total


def compiled_controller(case: Case, folder: Path, real: str = "double") -> CompiledController:
    """Return the controller of a folder."""
    problem = case.problem
    return CompiledController(folder, real, problem.state_dim, problem.control_dim, problem.horizon)


def compare_others(case: Case, states: np.ndarray, count: int) -> list[str]:
    """Return the median microseconds of other solvers at so many of the states; empty where one takes none."""
    problem = free_first_state(case.problem).with_ends(states[0])
    makers = [partial(dense, problem), partial(dense, problem, "PIQP")] if case.hard else [None, None]
    makers += [partial(sparse, problem, "PIQP"), partial(sparse, problem, "OSQP")]
    cells = list[str]()
    for make in makers:
        times, ends = list[float](), time.perf_counter() + LONGEST
        step = None if make is None else make()
        for x in states[:count]:
            began = time.process_time()  # of one thread, so that other processes do not count
            if step is None or time.perf_counter() > ends:
                break
            step(x)
            times.append(1e6 * (time.process_time() - began))
        cells.append(f"{np.median(times):.0f}" if times else "")
    return cells


def measure_case(case: Case, steps: int, compared: int, out: Path) -> tuple[list[str], list[str], list[str]]:
    """Return the cells of a case: times, sizes and accuracy, other solvers."""
    written = {real: lfo.generate(case.controller, out / real, real) for real in ("double", "float")}
    compiled = compiled_controller(case, out / "double")
    states = disturbed_states(case, lambda x: compiled.step(x[: compiled.measured])[1], steps)
    m, apart, found = case.problem.control_dim, list[str](), dict[str, Measured]()
    for real in written:
        found[real] = run_bench(out / real, real, states[:, : compiled.measured], m)
        log = write_log(out / "log.csv", states[:, : compiled.measured], found[real].u, found[real].status.tolist())
        certified = lfo.certify_log(case.controller, log)
        apart.append(f"{np.nanmax(certified.differences[np.isin(certified.statuses, (0, 1))]):.0e}")
    own, hard = found["double"], found["double"].status == 0
    if not case.hard:
        hard = own.status <= 1
    us, active = own.ns / 1e3, own.active > 0
    lfo.generate(case.controller, out / "capped", changes=CAP)
    capped = run_bench(out / "capped", "double", states, m)
    costs = [] if case.hard else [loop_cost(case, out / name, steps) for name in ("capped", "double")]
    times = [
        f"{written['double'].unknowns}",
        f"{np.median(us):.1f}",
        f"{np.median(us[active]):.1f}",
        f"{us[hard].max():.0f}",
        f"{us.max():.0f}",
        f"{own.changes.max()}",
        f"{found['float'].changes.max()}",
        f"{capped.ns.max() / 1e3:.0f}",
        f"{(capped.status == 2).sum()}",
        "" if case.hard else f"{costs[0] / costs[1]:.4f}",
    ]
    small = written["float"]
    sizes = [f"{part / 1000:.1f}" for part in (small.flash, small.ram, small.stack)]
    sizes += [f"{size / 1000:.1f}" for size in code_sizes(out / "float").values()]
    chosen = states[hard & active]
    others = [f"{np.median(us[hard & active]):.1f}", *compare_others(case, chosen, compared)]
    return times, [*sizes, *apart], others


def main(arguments: Sequence[str]) -> None:
    """Measure the cases and print three tables."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=CASES)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--compared", type=int, default=20, help="steps of the other solvers")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
    times = Table("case", title="microseconds of a step, double")
    for column in (
        "unknowns",
        "median",
        "active",
        "worst",
        "of all",
        "changes",
        "in float",
        f"cap {CAP}",
        "reached",
        "its cost",
    ):
        times.add_column(column, justify="right")
    sizes = Table("case", title="kB in float, and the largest difference of a control in double and in float")
    for column in ("tables", "RAM", "stack", *(f"code, {name}" for name in SMALL), "apart, double", "apart, float"):
        sizes.add_column(column, justify="right")
    others = Table("case", title="microseconds of a step with active rows, median")
    for column in ("generated", "DAQP, condensed", "PIQP, condensed", "PIQP, sparse", "OSQP, sparse"):
        others.add_column(column, justify="right")
    with Record(options.write) as record:
        for name in options.cases:
            with tempfile.TemporaryDirectory() as out:
                rows = measure_case(CASES[name](), options.steps, options.compared, Path(out))
            for table, cells in zip((times, sizes, others), rows, strict=True):
                table.add_row(name, *cells)
            record.console.print(name, *rows)
        for table in (times, sizes, others):
            record.show(table)
