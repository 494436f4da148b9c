"""certify() of a trajectory alone must say what solve proved of it: satisfied, and globally optimal.

any      random problems of every shape, in units of 1e-9 to 1e9
uncosted controls of which all, one or none has a quadratic cost
masked   plain and held masks at every frequency, over limits and edges
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.linear import random_linear

KINDS = "any", "uncosted", "masked"
METHODS = "auto", "structured", "convex"
MARGIN = 0.2  # part of the tolerance that the residuals of a proven optimum stay below
AS_GOOD = (
    1.5  # or this multiple of those with the multipliers of the solve: a trajectory may be that far from the optimum
)
TOLERANCE = 1e-6  # of the judge


@dataclass(frozen=True)
class Outcome:
    """What solve and certify say of one problem.

    Attributes
    ----------
    status : str
        Of the solve; problems that it does not prove optimal say nothing.
    worst : float
        The largest residual of the trajectory alone, relative to its tolerance.
    own : float
        The same with the multipliers of the solve.
    """

    name: str
    kind: str
    status: str
    pmp: str = ""
    globally_optimal: bool = True
    worst: float = 0.0
    own: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the trajectory alone is certified, with a margin or as by the solve, or was not proven optimal."""
        allowed = max(MARGIN, AS_GOOD * self.own)
        return self.status != "optimal" or (self.pmp == "satisfied" and self.globally_optimal and self.worst < allowed)


def check(seed: int) -> Outcome:
    """Solve one problem, of the kind that the seed says, and certify its trajectory alone."""
    kind, number = KINDS[seed % len(KINDS)], seed // len(KINDS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        problem = {"any": any_problem, "uncosted": uncosted_problem, "masked": masked_problem}[kind](number)
        return judged_alone(replace(problem, name=f"seed {seed}"), METHODS[number % len(METHODS)], kind)


def judged_alone(problem: lfo.OptimalControlProblem, method: str, kind: str) -> Outcome:
    """Solve a problem by a method, and certify the trajectory alone."""
    result, name = lfo.solve(problem, method, throw=False), f"{problem.name} by {method}"
    if result.status != "optimal":
        return Outcome(name, kind, result.status)
    certificate = lfo.certify(problem, result.trajectory)
    worst, own = (one.worst.relative / TOLERANCE for one in (certificate, result.certificate))
    return Outcome(name, kind, result.status, certificate.pmp, certificate.globally_optimal, worst, own)


def any_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a random problem in random units."""
    return random_linear(seed).problem


def uncosted_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a stable plant with bounded controls of linear cost; all, one or none has a quadratic cost, too."""
    rng = np.random.default_rng([13, seed])
    n, m, T = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(1, 12))
    A, B = rng.normal(size=(n, n)) * 0.6 / np.sqrt(n) + 0.3 * np.eye(n), rng.normal(size=(n, m))
    quadratic = [np.zeros((m, m)), np.diag(0.1 * np.eye(m)[0]), 0.1 * np.eye(m)][seed % 3]
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B),
        T,
        lfo.QuadraticCost(Q=1.0, R=quadratic, r=np.full(m, 0.3)),
        lfo.Box(np.zeros(m), np.ones(m)),
        initial_state=np.ones(n),
    )


def masked_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a move of a double integrator with a mask at every frequency, plain or held."""
    rng = np.random.default_rng([17, seed])
    band = lfo.low_pass(cutoff_hz=rng.uniform(1.8, 4.0))
    mask = lfo.MagnitudeBound(rng.uniform(0.85, 1.2), band=band, every_frequency=True, hold=bool(seed % 2))
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [1]], sampling_time=0.05),
        int(rng.integers(40, 70)),
        lfo.QuadraticCost(R=1.0),
        lfo.Box(-3, 3),
        initial_state=[0.0, 0.0],
        terminal_state=[1.0, 0.0],
        control_spectrum=mask,
    )
