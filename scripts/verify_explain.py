"""Random infeasible problems: the ray is verified, the family cannot spare a block, each cure helps, and less does not.

What can be satisfied is asked of CVXPY and Clarabel on a program written by ``to_cvxpy``, never of what explains.
"""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.analysis.measures import stated_sizes
from lin_freq_ocp.certificate.conflict import PRACTICAL
from lin_freq_ocp.explain.blocks import ENDS, Block, blocks, widened, without

LESS = 0.95
"""Part of a cure that must not help."""

LONGEST, LARGEST = 50, 4
"""Horizon and states of the problems."""

KINDS = ("too weak", "too far", "too narrow", "too slow")


@dataclass(frozen=True)
class Outcome:
    """What became of one problem: what is wrong, if anything, what was not decided, and the blocks of the cures."""

    seed: int
    kind: str
    family: tuple[str, ...]
    cures: tuple[str, ...]
    wrong: tuple[str, ...]
    unsure: int

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def random_infeasible(seed: int) -> tuple[str, lfo.OptimalControlProblem]:
    """Return how a problem around a random trajectory was made infeasible, and the problem."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        kind, problem = KINDS[rng.integers(len(KINDS))], _around_a_trajectory(rng)
        for _ in range(6):
            problem = _tightened(rng, kind, problem)
            if lfo.solve(problem, throw=False).status == "infeasible":
                return kind, problem
    raise RuntimeError(f"seed {seed}: every problem remained feasible")


def _around_a_trajectory(rng: np.random.Generator) -> lfo.OptimalControlProblem:
    n, m, T = int(rng.integers(1, LARGEST + 1)), int(rng.integers(1, 3)), int(rng.integers(8, LONGEST + 1))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.7, 1.03) / np.abs(np.linalg.eigvals(A)).max()
    if rng.random() < 0.25:
        A = A * np.minimum(1.0, 1 + 0.1 * np.sin(np.arange(T)))[:, None, None]
    dynamics = lfo.LinearDynamics(A, rng.standard_normal((n, m)), offset=0.1 * rng.standard_normal(n))
    bands = [lfo.low_pass(float(rng.uniform(1.0, 3.0)), component=j) for j in range(m) if rng.random() < 0.7]
    free = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(), control_spectrum=bands)
    u = np.fft.irfft(np.where(free.control_stop, 0, np.fft.rfft(rng.standard_normal((T, m)), axis=0)), n=T, axis=0)
    x = lfo.simulate(free, u, rng.standard_normal(n)).x
    return replace(
        free,
        cost=lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(u.min(0) - 0.1, u.max(0) + 0.1),
        state_set=lfo.Box(x.min(0) - 0.1, x.max(0) + 0.1) if rng.random() < 0.5 else None,
        initial_state=x[0],
        terminal_state=x[-1],
    )


def _tightened(rng: np.random.Generator, kind: str, problem: lfo.OptimalControlProblem) -> lfo.OptimalControlProblem:
    if kind == "too weak":
        tube = problem.control_tube
        return replace(problem, control_set=lfo.Box(0.6 * tube.lower, 0.6 * tube.upper))
    if kind == "too far":
        away = problem.terminal_state.lower + 0.5 * rng.standard_normal(problem.state_dim)
        boxes = problem.state_boxes
        within = np.clip(away, boxes.lower[-1], boxes.upper[-1])
        return replace(problem, terminal_state=within)
    if kind == "too narrow":
        passed = ~problem.control_stop
        highest = int(np.flatnonzero(passed.any(1)).max())
        narrower = problem.control_stop.copy()
        narrower[max(1, int(0.7 * highest)) :] = True
        bands = [
            lfo.stop_band(bins=np.flatnonzero(narrower[:, j]).tolist(), component=j) for j in range(passed.shape[1])
        ]
        return replace(problem, control_spectrum=bands)
    row = rng.standard_normal((1, problem.control_dim))
    families = [*problem.stage_rows, lfo.StageRows(None, row, [0.02], name=f"family {len(problem.stage_rows)}")]
    return replace(problem, stage_rows=families)


def feasible(problem: lfo.OptimalControlProblem) -> bool | None:
    """Return what Clarabel says of the constraints alone; None where it is not sure, or the trajectory impractical."""
    for cost in (lfo.QuadraticCost(), lfo.QuadraticCost(R=1.0)):  # some solver's trouble goes away with a cost
        oracle = lfo.to_cvxpy(replace(problem, cost=cost))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                oracle.solve(solver="CLARABEL")
            except cp.SolverError:
                continue
        if oracle.status in ("optimal", "infeasible"):
            break
    if oracle.status == "optimal":
        signals = {variable.name(): np.abs(variable.value).max(0) for variable in oracle.variables()}
        x, u = stated_sizes(problem)
        practical = (signals["x"] <= PRACTICAL * x).all() and (signals["u"] <= PRACTICAL * u).all()
        return True if practical else None
    return False if oracle.status == "infeasible" else None


def check(seed: int) -> Outcome:
    """Explain one problem, and try everything that is said."""
    kind, problem = random_infeasible(seed)
    explanation = lfo.explain(problem)
    named = {block.name: block for block in blocks(problem)}
    family = [named[name] for name in explanation.family]
    others = [block for block in named.values() if block not in family]
    wrong, answers = [] if explanation.irreducible else ["not shown to be irreducible"], list[bool | None]()

    def expect(answer: bool | None, expected: bool, what: str) -> None:
        answers.append(answer)
        if answer is not None and answer != expected:
            wrong.append(what)

    expect(feasible(without(problem, others)), False, "the family can hold together")
    for block in family:
        expect(feasible(without(problem, [*others, block])), True, f"the family can spare the {block.name}")
    for cure in explanation.cures:
        enough, less = amounts(problem, named[cure.block], cure.amount)
        expect(feasible(widened(problem, named[cure.block], enough)), True, f"no cure: {cure}")
        expect(feasible(widened(problem, named[cure.block], less)), False, f"less would do: {cure}")
    cures = tuple(named[cure.block].kind for cure in explanation.cures)
    return Outcome(seed, kind, explanation.family, cures, tuple(wrong), answers.count(None))


def amounts(problem: lfo.OptimalControlProblem, block: Block, amount: float) -> tuple[object, object]:
    """Return a little more than a cure, and less than it, as ``widened`` takes them."""
    if block.kind.endswith("stop band"):
        return amount, amount - 1
    units = stated_sizes(problem)[0] if block.kind in ENDS else 1.0
    return 1.0001 * amount * units + 1e-9, LESS * amount * units


def verify(console: Console, seeds: range) -> bool:
    """Check the problems of these seeds and print what became of them; return whether nothing is wrong."""
    outcomes = [check(seed) for seed in track(seeds, "explaining", console=Console(stderr=True), transient=True)]
    table = Table(
        "made infeasible", "problems", "blocks", "cures", "not decided", "failed", title="infeasible, explained"
    )
    for kind in [*KINDS, "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        if some:
            sizes, cures = [len(one.family) for one in some], Counter(cure for one in some for cure in one.cures)
            told = ", ".join(f"{count} {what}" for what, count in cures.most_common())
            unsure, failed = sum(one.unsure for one in some), sum(not one.passed for one in some)
            table.add_row(kind, str(len(some)), f"{min(sizes)} to {max(sizes)}", told, str(unsure), str(failed))
    console.print(table)
    for one in outcomes:
        if not one.passed:
            console.print(f"FAILED seed {one.seed}, {one.kind}: {'; '.join(one.wrong)}", markup=False)
    return all(one.passed for one in outcomes)
