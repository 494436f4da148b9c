"""Loops whose measured state jumps, up to 1e30 and to what is no number: every control keeps its hard limits exactly.

The loop runs in Python, and as generated C in double. A state that is no number is refused in words, in C by status 4.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.outcome import Outcome, finding_of
from helpers.generated import CompiledController
from lin_freq_ocp.methods import compiler

Answer = tuple[str, np.ndarray | None]
Step = Callable[[np.ndarray, np.ndarray], Answer]  # of a measured state and the control before

STEPS = 12
KINDS = ("box", "rate limit", "soft states")
NO_STATE, NO_STEP = 4, "refused"  # status of generated C, and of this check


@dataclass(frozen=True, eq=False)
class Loop:
    """A loop of random dynamics, with its bounds on controls and their changes; the plant's states come first."""

    problem: lfo.OptimalControlProblem
    kind: str
    plant_dim: int
    bounds: np.ndarray  # (2, m)
    rate: np.ndarray  # (m,)
    soft: dict[str, float] | None

    def excesses(self, before: np.ndarray, u: np.ndarray) -> list[str]:
        """Return in words which hard limits a control exceeds after the control before."""
        found = [] if (self.bounds[0] <= u).all() and (u <= self.bounds[1]).all() else [f"{u} outside its box"]
        for limit, old, new in zip(self.rate, before, u, strict=True):
            if np.isfinite(limit) and not abs(Fraction(new) - Fraction(old)) <= Fraction(limit):
                found.append(f"from {old} to {new}, more than {limit}")
        return found


def random_loop(seed: int) -> Loop:
    """Return a loop of up to three states and two controls."""
    rng = np.random.default_rng([seed, 41])
    n, m, kind = int(rng.integers(1, 4)), int(rng.integers(1, 3)), KINDS[seed % len(KINDS)]
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    A *= rng.choice([0.7, 1.0, 1.1]) / np.abs(np.linalg.eigvals(A)).max()
    bounds = rng.uniform(0.3, 2.0, (2, m)) * [[-1.0], [1.0]]
    cost = lfo.QuadraticCost(Q=np.eye(n), R=rng.uniform(0.1, 1.0) * np.eye(m))
    states = lfo.Box(np.full(n, -2.0), np.full(n, 2.0)) if kind == "soft states" else None
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B), int(rng.integers(4, 16)), cost, lfo.Box(*bounds), states, np.zeros(n)
    )
    rate = np.full(m, np.inf)
    if kind == "rate limit":
        rate = rng.uniform(0.1, 1.0, m)
        problem = lfo.rate_limited(problem, rate, previous=np.zeros(m))
    return Loop(problem, kind, n, bounds, rate, {"state_set": 100.0} if states else None)


def jumping_states(seed: int, size: int) -> np.ndarray:
    """Return measured states of order one, of which every other one jumps."""
    rng = np.random.default_rng([seed, 42])
    states = rng.standard_normal((STEPS, size))
    for x in states[1::2]:
        far = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(3, 30)
        x[rng.integers(size)] = rng.choice([far, far, far, np.inf, -np.inf, np.nan])
    return states


def check(seed: int) -> Outcome:
    """Run the loop of a seed in Python and, with a compiler, in C."""
    loop, statuses, wrong = random_loop(seed), list[str](), list[str]()
    states = jumping_states(seed, loop.plant_dim)
    with warnings.catch_warnings(), TemporaryDirectory() as folder:
        warnings.simplefilter("error")
        controller = lfo.RecedingHorizon(loop.problem, soft=loop.soft, certify=("each", "later")[seed // 3 % 2])
        steps: dict[str, Step] = {"Python": partial(step_in_python, controller)}
        if compiler() is not None:
            steps["C"] = step_in_c(loop, Path(folder))
        for name, step in steps.items():
            before = np.zeros(loop.problem.control_dim)
            for x in states:
                try:
                    status, u = step(x, before)
                except Exception as error:  # whatever a step raises but the refusal in words is the finding
                    wrong.append(f"{name}, {x}: {finding_of(error)}")
                    continue
                statuses.append(f"{name} {status}")
                if np.isfinite(x).all() == (u is None):
                    wrong.append(f"{name}, {x}: {status}")
                if u is not None:
                    wrong += [f"{name}, {x}: {words}" for words in loop.excesses(before, u)]
                    before = u
        controller.certify()
    return Outcome(seed, loop.kind, tuple(statuses), tuple(wrong))


def step_in_python(controller: lfo.RecedingHorizon, x: np.ndarray, before: np.ndarray) -> Answer:
    """Return what a step in Python says, and its control."""
    try:
        u = controller.step(x)
    except lfo.errors.ProblemError as error:
        return f"{NO_STEP} {error.field.split('[')[0]}", None
    return str(controller.log.steps[-1].status), u


def step_in_c(loop: Loop, folder: Path) -> Step:
    """Return a step of the loop as generated C; a state without a plan may be too large for it."""
    problem = loop.problem
    lfo.generate(lfo.RecedingHorizon(problem, soft=loop.soft), folder)
    compiled = CompiledController(folder, "double", problem.state_dim, problem.control_dim, problem.horizon)

    def step(x: np.ndarray, before: np.ndarray) -> Answer:
        status, u = compiled.step(x)
        return str(status), (u.copy() if status != NO_STATE or np.isfinite(x).all() else None)

    return step
