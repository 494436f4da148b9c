"""Compare the speed of two checkouts: alternating runs, each in a new process, and their medians.

    git worktree add --detach ../before COMMIT
    python scripts/benchmark.py commits ../before . [--runs 5] [--write]

A process imports the package of its checkout, calls the case once to fill the caches, and then takes its CPU time; of
the two cases that start processes, the time that passes.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.progress import track
from rich.table import Table

from benchmark.record import Record, build_parser

LEAST = """
import subprocess, sys, time
import lin_freq_ocp as lfo
print(lfo.__file__)

def least(call, repeats, clock=time.process_time):
    call()
    seconds = []
    for _ in range(repeats):
        start = clock()
        call()
        seconds.append(clock() - start)
    return min(seconds)
"""

LOOP = """
import numpy as np
from dataclasses import replace
base = lfo.library.pendulum(horizon=60)
cost = lfo.QuadraticCost(Q=np.diag([1.0, 10.0, 0.1, 0.1]), R=0.1, P=np.diag([10.0, 100.0, 1.0, 1.0]))
problem = replace(base, cost=cost, terminal_state=None, control_spectrum=None)
start = problem.initial_box.lower
"""

JUDGED = """
from dataclasses import replace
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.solving.judging import judge_candidate
problem = lfo.library.pendulum()
result = lfo.solve(problem)
solution = Candidate(result.status, result.trajectory, result.multipliers)
claim = [problem, solution, "spectral", None, None]
"""

CASES = {
    "solve, T = 240": "print(least(lambda: lfo.solve(lfo.library.pendulum()), 20))",
    "solve, T = 960": """
problem = lfo.library.pendulum(horizon=960, sampling_time=0.0025)
print(least(lambda: lfo.solve(problem), 10))""",
    "structured, time-varying, T = 1000": """
import numpy as np
base = lfo.library.pendulum(horizon=1000, cutoff=None)
drift = 1 + 1e-3 * np.sin(np.arange(1000))[:, None, None]
dynamics = lfo.LinearDynamics(base.linear.A * drift, base.linear.B * drift, sampling_time=base.sampling_time)
problem = lfo.OptimalControlProblem(dynamics, 1000, base.cost, base.control_set, base.state_set, base.initial_state)
print(least(lambda: lfo.solve(problem, "structured"), 5))""",
    "node of a mode search": """
problem = lfo.library.pendulum_with_wall()
nodes = len(lfo.solve(problem).tree.nodes)
print(least(lambda: lfo.solve(problem), 1) / nodes)""",
    "swing-up": "print(least(lambda: lfo.solve(lfo.library.cart_pole(), global_bound=False), 1))",
    "step of a control loop": """
problem = lfo.library.pendulum()
loop = lfo.RecedingHorizon(problem)
print(least(lambda: loop.step(problem.initial_box.lower), 20))""",
    "certified step, T = 60": LOOP
    + """
loop = lfo.RecedingHorizon(problem)
print(least(lambda: loop.step(start), 50))""",
    "100 plans judged at once, T = 60": LOOP
    + """
loop = lfo.RecedingHorizon(problem, certify="later")
seconds = []
for _ in range(10):
    for k in range(100):
        loop.step((1 - 1e-3 * k) * start)
    begin = time.process_time()
    loop.certify()
    seconds.append(time.process_time() - begin)
print(min(seconds))""",
    "judgement, T = 240": JUDGED + "print(least(lambda: judge(problem, result.trajectory, result.multipliers), 50))",
    "judgement with repair, T = 240": JUDGED + "print(least(lambda: judge_candidate(*claim), 50))",
    "judgement with correction, T = 240": JUDGED
    + """
wrong = replace(claim[1].multipliers, eta=1.001 * claim[1].multipliers.eta)
claim[1] = replace(claim[1], multipliers=wrong)
print(least(lambda: judge_candidate(*claim), 20))""",
    "1000 states, T = 240": """
import numpy as np
problem = lfo.library.pendulum()
states = problem.initial_box.lower * (1 + 1e-3 * np.random.default_rng(0).standard_normal((1000, 1)))
print(least(lambda: lfo.solve_many(problem, states), 2))""",
    "import": """
command = [sys.executable, "-c", "import lin_freq_ocp"]
print(least(lambda: subprocess.run(command, check=True), 5, time.perf_counter))""",
    "--help": """
command = [sys.executable, "-m", "lin_freq_ocp", "--help"]
print(least(lambda: subprocess.run(command, check=True, capture_output=True), 5, time.perf_counter))""",
}


def seconds(checkout: Path, case: str) -> float:
    """Return the seconds of a case with the package of a checkout, in a new process."""
    # -P: else Python looks for packages in the folder of the caller before it looks in the checkout
    command = [sys.executable, "-P", "-c", LEAST + CASES[case]]
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve()), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    *_, source, least = done.stdout.split("\n")[:-1]
    if not Path(source).is_relative_to(checkout.resolve()):
        raise RuntimeError(f"checkout {checkout}: the package came from {source}; install nothing that hides it")
    return float(least)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the median milliseconds of every case for both checkouts, and their ratio."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    given = parser.parse_args(arguments)
    table = Table("case", "before [ms]", "after [ms]", "after / before", title=f"medians of {given.runs} runs by turns")
    for case in track(CASES):
        pairs = [(seconds(given.before, case), seconds(given.after, case)) for _ in range(given.runs)]
        before, after = (statistics.median(column) for column in zip(*pairs, strict=True))
        table.add_row(case, f"{1e3 * before:.4g}", f"{1e3 * after:.4g}", f"{after / before:.2f}")
    with Record(given.write) as record:
        record.show(table)


if __name__ == "__main__":
    main()
