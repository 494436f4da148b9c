"""The problems of the benchmark: families of one shape and growing horizon, each with sizes for a short and a long run.

Dynamics, sets and cost are constant in time, both ends are points, and only controls have stop bands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from math import pi

import numpy as np

import lin_freq_ocp as lfo

FINE_SECONDS = 2.4  # duration of the pendulum of the family "fine", whatever its horizon
# Standard deviations of the pendulum's new initial states: position [m], angle [rad], and their rates
MOVES = (2e-3, 4e-3, 2e-2, 4e-2)


@dataclass(frozen=True)
class Family:
    """Problems that differ in their horizon.

    Attributes
    ----------
    words : str
        What it is, in a line.
    problem : callable
        Horizon -> problem.
    sizes, full : tuple of int
        Horizons of the default run and of the long one.
    """

    words: str
    problem: Callable[[int], lfo.OptimalControlProblem]
    sizes: tuple[int, ...]
    full: tuple[int, ...]


def pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return the library's pendulum, at 0.01 s: a longer horizon is a longer time."""
    return lfo.library.pendulum(horizon=horizon)


def slow_pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum at 0.1 s: over 240 steps its unstable mode grows by more than 1e40."""
    return lfo.library.pendulum(horizon=horizon, sampling_time=0.1)


def fine_pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum over 2.4 s: the finer the grid, the more samples lie on a bound."""
    return lfo.library.pendulum(horizon=horizon, sampling_time=FINE_SECONDS / horizon)


def bang_bang(horizon: int) -> lfo.OptimalControlProblem:
    """Return the double integrator over 4 s with 8 % more acceleration than the shortest transfer needs."""
    return lfo.library.double_integrator(
        horizon=horizon, sampling_time=4 / horizon, cutoff_hz=horizon / 40, speed_bound=None, control_bound=0.27
    )


def chain(horizon: int) -> lfo.OptimalControlProblem:
    """Return four masses between two walls: two forces, each with a low pass of its own."""
    return lfo.library.mass_chain(horizon=horizon)


def narrow(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with the lowest tenth of the bins only."""
    return lfo.library.pendulum(horizon=horizon, cutoff=0.1 * pi)


def state_arcs(horizon: int) -> lfo.OptimalControlProblem:
    """Return the double integrator at 0.02 s under a speed limit 12 % above its mean speed."""
    distance = 0.25 * 0.02 * horizon
    return lfo.library.double_integrator(horizon=horizon, terminal_state=(distance, 0.0), speed_bound=0.28)


def oscillator(horizon: int, damping: float = 0.05) -> lfo.OptimalControlProblem:
    """Return a mass on a spring, 2 rad/s and 0.01 s, pushed within +-1 below 5 Hz; damping ratio < 0: unstable."""
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics.from_continuous([[0, 1], [-4, -4 * damping]], [[0], [1]], 0.01),
        horizon=horizon,
        cost=lfo.QuadraticCost(Q=np.diag([10, 0.1]), R=0.1),
        control_set=lfo.Box(-1, 1),
        initial_state=(1, 0),
        control_spectrum=lfo.low_pass(2 * pi * 5 * 0.01),
        name=f"oscillator, damping ratio {damping:g}",
    )


FAMILIES = {
    "pendulum": Family(
        "pendulum on a cart, 0.01 s, lowest 80 % of the spectrum kept",
        pendulum,
        (240, 480, 960, 10_000, 100_000),
        (240, 480, 960, 1920, 10_000, 100_000, 1_000_000),
    ),
    "pendulum-slow": Family("pendulum at 0.1 s, strongly unstable", slow_pendulum, (240,), (240,)),
    "fine": Family(
        "pendulum over 2.4 s, on finer and finer grids", fine_pendulum, (240, 1000, 5000), (240, 1000, 5000, 20_000)
    ),
    "bang-bang": Family(
        "double integrator, control nearly always at a bound", bang_bang, (200,), (200, 400, 800, 4000)
    ),
    "chain": Family("chain of masses, two controls, two stop bands", chain, (400,), (200, 400, 800, 4000)),
    "narrow": Family("pendulum, lowest 10 % of the spectrum kept", narrow, (480,), (480, 960, 4800)),
    **{
        name: Family(words, partial(oscillator, damping=damping), (5000, 100_000), (5000, 50_000, 100_000, 1_000_000))
        for name, damping, words in (
            ("oscillator", 0.05, "oscillator at 0.01 s, damping ratio 0.05, free end, low pass at 5 Hz"),
            ("critical", 1.0, "oscillator, critically damped"),
            ("undamped", 0.0, "oscillator, undamped"),
            ("unstable-pair", -0.05, "oscillator, with an unstable pair of eigenvalues"),
        )
    },
    "state-arcs": Family("double integrator, speed limit active for long", state_arcs, (200,), (200, 400, 800, 4000)),
}
# Families solved again and again from new initial states
RESOLVED = {"resolve": "pendulum", "resolve-slow": "pendulum-slow"}
RESOLVE_SIZES = (240,)


def small() -> lfo.OptimalControlProblem:
    """Return a problem to load every library with, before anything is measured."""
    return lfo.library.double_integrator(horizon=40, sampling_time=0.1, cutoff_hz=2.0, speed_bound=0.5)


def moved(problem: lfo.OptimalControlProblem, count: int, seed: int = 0) -> Iterator[lfo.OptimalControlProblem]:
    """Yield the pendulum from new initial states, each moved at random from the first."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        move = np.array(MOVES) * rng.standard_normal(len(MOVES))
        yield replace(problem, initial_state=problem.initial_state.lower + move)
