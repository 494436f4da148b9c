"""Measure the semismooth Newton method near known optima: how often it comes back, in how many steps, and how fast.

    python scripts/semismooth_newton.py [--starts 200] [--seed 0] [--figure docs/newton.png]

Every start is an optimum of Examples 2 and 3 of the paper with normal noise on all states and controls, of the given
size relative to theirs, cut at the bounds; multipliers are those of least squares. It *converged* if |Phi| <= 1e-9, and
*returned* if the cost is that of the optimum, too: other points satisfy the conditions as well. About twenty minutes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.methods.nonsmooth.newton import NewtonRun, newton

LEVELS = (1e-3, 1e-2, 2e-2)
"""Noise, relative to the largest value of each state and control."""

SAME_COST = 1e-8

NEAR = 3.0
"""Kinks within so many times the noise get a selection."""

PROBLEMS = {
    "norm, x_0 = (1, 1), T = 10": lambda: lfo.library.norm_dynamics((1.0, 1.0), 10),
    "buck, T = 8": lambda: lfo.library.buck_converter(8),
    "buck, T = 8, bins 3 to 5": lambda: lfo.library.buck_converter(8, control_spectrum=[3, 4, 5]),
    "buck on the border, T = 4": lambda: lfo.library.buck_converter(4, terminal_state=None, terminal_price=-40.0),
}


def noisy(problem: lfo.OptimalControlProblem, result: lfo.Result, level: float, rng: np.random.Generator):
    """Return the optimum's trajectory with noise, within the bounds."""
    x, u = result.trajectory.x, result.trajectory.u
    x = x + level * np.abs(x).max(axis=0) * rng.standard_normal(x.shape)
    u = u + level * np.abs(u).max(axis=0) * rng.standard_normal(u.shape)
    tubes = problem.state_tube, problem.control_tube
    return lfo.Trajectory(*(np.clip(one, tube.lower, tube.upper) for one, tube in zip((x, u), tubes, strict=True)))


def run(problem: lfo.OptimalControlProblem, result: lfo.Result, level: float, seed: int) -> tuple[NewtonRun, bool]:
    """Return one run from a noisy start, and whether it returned to the optimum."""
    start = noisy(problem, result, level, np.random.default_rng(seed))
    sequence = problem.dynamics.sequence_of(start.x, start.u)
    found = newton(problem, start, None, sequence, near=max(NEAR * level, 1e-3))
    cost = problem.value(found.trajectory.x, found.trajectory.u)
    return found, found.converged and abs(cost - result.cost) <= SAME_COST * max(1.0, abs(result.cost))


def rates(starts: int, seed: int) -> Table:
    """Return success rates and numbers of steps, one row for each problem and noise level."""
    table = Table("problem", title=f"semismooth Newton method, {starts} starts each")
    for heading in ("noise", "converged", "returned", "steps, median", "most"):
        table.add_column(heading, justify="right")
    for name, build in track(PROBLEMS.items(), "starting", console=Console(stderr=True), transient=True):
        problem = build()
        result = lfo.solve(problem, throw=False)
        for level in LEVELS:
            runs = [run(problem, result, level, seed + i) for i in range(starts)]
            steps = [len(found.residuals) - 1 for found, _ in runs if found.converged] or [0]
            shares = [sum(found.converged for found, _ in runs), sum(returned for _, returned in runs)]
            table.add_row(
                name,
                f"{level:g}",
                *(f"{100 * share / starts:.1f} %" for share in shares),
                f"{np.median(steps):g}",
                str(max(steps)),
            )
            name = ""
    return table


def drawn(path: Path, seed: int) -> None:
    """Draw |Phi| against steps of one run for each problem."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.4), layout="constrained")
    for name, build in PROBLEMS.items():
        problem = build()
        result = lfo.solve(problem, throw=False)
        found, _ = run(problem, result, LEVELS[2], seed)
        axes.semilogy(range(len(found.residuals)), np.maximum(found.residuals, 1e-17), "o-", label=name)
    axes.set(xlabel="step", ylabel="|Φ|, equations of order 1", title="Digits double with every step near the end")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Run what the options ask for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="also draw the residuals of one run for each problem")
    options = parser.parse_args()
    Console(width=None if Console().is_terminal else 110).print(rates(options.starts, options.seed))
    if options.figure:
        drawn(options.figure, options.seed)


if __name__ == "__main__":
    main()
