"""Controllers as C: their problems and disturbed loops, for the benchmark and for verify.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import lin_freq_ocp as lfo
from benchmark.loop_cases import ARRIVAL, pendulum, random_plant, soft_pendulum
from lin_freq_ocp.loop.step_problem import known_states

PUSH_EVERY = 40  # steps
PENALTY = 1e3  # of the state set, where it is hard otherwise


@dataclass(frozen=True)
class Case:
    """A problem, the largest pushes and the standard deviations of its states, and whether its bounds are hard."""

    problem: lfo.OptimalControlProblem
    push: np.ndarray
    noise: np.ndarray
    hard: bool = True

    @property
    def controller(self) -> lfo.RecedingHorizon:
        """Return a new controller."""
        return lfo.RecedingHorizon(self.problem, soft={"state_set": PENALTY} if self.hard else None)


def slow_pendulum(horizon: int = 240, share: float = 0.1, fixed: bool = False) -> Case:
    """Return the pendulum with this share of the bins, the lowest ones, with a terminal cost or a fixed end."""
    base = lfo.library.pendulum(horizon=horizon, cutoff=share * np.pi)
    if fixed:
        push = np.array([0.04, 0.02, 0.05, 0.1])
        return Case(replace(base, terminal_state=(0.0,) * 4), push, np.full(4, 1e-4))
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 10.0, 0.1, 0.1]), R=0.1, P=ARRIVAL)
    return Case(replace(base, cost=cost, terminal_state=None), np.array([0.05, 0.03, 0.1, 0.3]), np.full(4, 1e-3))


def masses(horizon: int) -> Case:
    """Return the chain of four masses with two forces."""
    problem = lfo.library.mass_chain(horizon=horizon, terminal_state=None)
    return Case(problem, np.repeat([0.5, 0.7], 4), np.full(8, 3e-3))


def random_case(seed: int) -> Case:
    """Return a random plant whose states have units from 1e-3 to 1e3."""
    problem = random_plant(seed, 20)
    size = problem.state_tube.upper[1] / 3
    return Case(problem, 0.7 * size, 3e-3 * size)


PUSH, NOISE = np.array([0.05, 0.03, 0.1, 0.25]), np.full(4, 1e-3)

CASES: dict[str, Callable[[], Case]] = {
    "pendulum, T = 60, low pass": lambda: Case(pendulum(60, low_pass=True), PUSH, NOISE),
    "pendulum, T = 20, rate limit": lambda: Case(
        lfo.rate_limited(pendulum(20), 1.0, previous=0.0),
        np.array([0.04, 0.03, 0.1, 0.25, 0.0]),
        np.array([1e-3] * 4 + [0.0]),
    ),
    "pendulum, T = 240, lowest 10 %": slow_pendulum,
    "the same, fixed end": lambda: slow_pendulum(fixed=True),
    "4 masses, 2 forces, T = 60": lambda: masses(60),
    "soft bounds, T = 60": lambda: Case(soft_pendulum(60), PUSH, NOISE, hard=False),
    "soft bounds, T = 240": lambda: Case(soft_pendulum(240), PUSH, NOISE, hard=False),
}

PLANTS: dict[str, Callable[[], Case]] = {  # with horizons for which the sparse program is not too slow
    **{name: CASES[name] for name in list(CASES)[:2]},
    "soft bounds, T = 60": CASES["soft bounds, T = 60"],
    "pendulum, T = 100, lowest 20 %": lambda: slow_pendulum(100, 0.2),
    "double integrator, T = 100, fixed end": lambda: Case(
        replace(lfo.library.double_integrator(horizon=100), terminal_state=(0.0, 0.0)),
        np.array([0.5, 0.25]),
        np.array([1e-3, 1e-3]),
    ),
    "4 masses, 2 forces, T = 30": lambda: masses(30),
    "soft bounds, T = 100": lambda: Case(soft_pendulum(100), PUSH, NOISE, hard=False),
    "quadcopter, T = 20": lambda: Case(
        lfo.library.quadcopter(horizon=20, terminal_state=None), np.full(12, 0.05), np.full(12, 1e-3)
    ),
    "random plant 3": lambda: random_case(3),
    "random plant 6": lambda: random_case(6),
}


def disturbed_states(case: Case, step: Callable[[np.ndarray], np.ndarray], steps: int, seed: int = 0) -> np.ndarray:
    """Return the measured states of a disturbed loop; a plant beyond its bounds begins again at zero."""
    rng, problem = np.random.default_rng(seed), case.problem
    limits = np.abs(problem.state_boxes.upper[1])
    begin, found, n = problem.initial_box.lower, list[np.ndarray](), problem.state_dim
    known = known_states(problem.linear)
    x, advance = np.where(np.isfinite(begin), begin, 0.0), problem.dynamics.stepper(1)
    for k in range(steps):
        if k and k % PUSH_EVERY == 0:
            x = x + case.push * rng.uniform(-1, 1, n)
        if (np.abs(x) > limits).any():
            x = np.where(known, x, 0.0)
        found.append(x)
        x = advance(0, x, step(x)) + case.noise * rng.standard_normal(n)
    return np.array(found)
