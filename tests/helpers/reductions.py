"""Every reduction of the package, with problems that it accepts: a new reduction is a new entry of ``REDUCTIONS``.

Problems are feasible, infeasible and unbounded; the names of the last two say so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.methods import absorb_cost
from lin_freq_ocp.methods.spectral import SoftBounds, priced_bounds, row_form, soft_bins
from lin_freq_ocp.problem import HARD, FrequencyConstraint, HalfSpaces, StageMap, SumMap, Term
from lin_freq_ocp.sets import Polyhedron, Soft
from lin_freq_ocp.solving.hybrid import fix_modes
from lin_freq_ocp.transform import (
    RATE_LIMIT,
    Reduction,
    few_between_levels,
    rate_limit,
    sampled_masks,
    translated_by,
    translation_of,
)
from lin_freq_ocp.transform.hybrid import cost_as_state

Problem = lfo.OptimalControlProblem
T, SEEDS = 16, seeds(range(3))
HIGH = 1e4  # a price above all multipliers of these problems
SOFT_BAND = lfo.MagnitudeBound(0.0, bins=[3, 7], penalty=HIGH)
INFEASIBLE, UNBOUNDED = "infeasible", "unbounded"


@dataclass(frozen=True)
class Entry:
    """A reduction, problems by name, and the given problem of a reduced one where the reduction itself constrains."""

    reduction: Reduction
    problems: Mapping[str, Callable[[], Problem]]
    stated: Callable[[Problem], Problem] = lambda given: given


def random_problem(seed: int, **changes) -> Problem:
    """Return a controllable problem of two states, one control within bounds, and a free end."""
    rng = np.random.default_rng(seed)
    A = np.array([[1.0, 0.3], [0.0, 1.0]]) + 0.05 * rng.standard_normal((2, 2))
    dynamics = lfo.LinearDynamics(A, [[0.05], [0.3]], offset=0.01 * rng.standard_normal(2))
    cost = lfo.QuadraticCost(Q=np.diag(rng.uniform(0.1, 1.0, 2)), R=0.5, P=2.0)
    given = {"cost": cost, "control_set": lfo.Box(-1, 1), "initial_state": rng.uniform(-0.5, 0.5, 2)}
    return lfo.OptimalControlProblem(dynamics, T, **{**given, **changes})


def random_kinds(**changes) -> dict[str, Callable[[], Problem]]:
    """Return random problems with these constraints: feasible, infeasible by two rows at once, unbounded upwards."""
    limits = np.full((T, 2), np.inf)
    limits[5] = [0.2, -0.4]
    contradiction = lfo.StageRows(None, [[1.0], [-1.0]], limits, name="contradiction")
    upwards = {"cost": lfo.QuadraticCost(q=[-1.0, 0.0]), "control_set": None}
    return {
        **{f"seed {seed}": partial(random_problem, seed, **changes) for seed in SEEDS},
        INFEASIBLE: partial(random_problem, 3, **{**changes, "stage_rows": contradiction}),
        UNBOUNDED: partial(random_problem, 4, **{**changes, **upwards}),
    }


class RateConstraint(FrequencyConstraint):
    """|u_t - u_{t-1}| <= limit on the controls themselves, without further states; u_{-1} = previous."""

    def __init__(self, limit: float, previous: float):
        self.limit, self.previous = limit, previous

    def describe(self, names):
        return "limited rates"

    def terms(self, signal, field, source) -> Iterator[Term]:
        samples, m = signal.length, len(signal.names)
        changes = np.kron(np.eye(samples) - np.eye(samples, k=-1), np.eye(m)).reshape(samples, m, samples, m)
        both = np.concatenate([changes, -changes], axis=1).reshape(2 * samples * m, samples, m)
        constant = np.zeros((samples, 2, m))
        constant[0] = [[-self.previous], [self.previous]]
        stages = StageMap(np.arange(samples), None, np.swapaxes(both, 0, 1), np.zeros(len(both)))
        rates = SumMap((stages,), constant.ravel())
        yield Term(RATE_LIMIT, signal.kind, rates, HalfSpaces(np.full(len(both), self.limit), HARD), source)

    def augmented(self, n, k):
        return [self]


def far_away(given: Callable[[], Problem]) -> Problem:
    """Return a problem with its states counted from far away."""
    return translated_by(given(), np.array([-(2.0**20), 0.0])).problem


def duty_cycles() -> Problem:
    """Return a move of least switching cost with three levels, whose mean over a sample may lie between them."""
    levels = lfo.FiniteSet([-1, 0, 1], [0.5, 0.0, 0.5], duty_cycles=True)
    given = random_problem(0, control_set=levels, terminal_state=[0.1, 0.0])
    return replace(given, cost=lfo.QuadraticCost())


def soft_bounds(problem: Problem) -> SoftBounds | None:
    """Return the problem with all bounds, hard and soft, as hard ones; None unless bounds can express all its sets."""
    bounds, n = priced_bounds(problem), problem.state_dim
    if bounds is None or not bounds.sets:
        return None
    changed = replace(
        problem,
        state_set=lfo.Box(bounds.lower[:, :n], bounds.upper[:, :n]),
        control_set=lfo.Box(bounds.lower[:-1, n:], bounds.upper[:-1, n:]),
        initial_state=problem.initial_box,
        terminal_state=problem.terminal_box,
    )
    return SoftBounds(problem, changed, bounds.sets)


RATE = 0.3, -0.2  # the limit, and the control before the first


def averaging(*, closed: bool, seed: int = 0, unbounded: bool = False) -> Problem:
    """Return a problem of least power sum y_t u_t, which is convex at each bin and not at each time."""
    rng, samples = np.random.default_rng(seed), 12
    w = 2 * np.pi * np.arange(samples // 2 + 1 if closed else samples + 1) / (samples if closed else 2 * samples)
    G = 1 / (rng.uniform(1.2, 2.0) - np.exp(-1j * w))  # its real part is above zero
    dynamics = lfo.FrequencyResponse(G, 0.5, mode="periodic" if closed else "zero-padded")
    cost = lfo.QuadraticCost(S=[[1.0]], r=[0.3] if unbounded else rng.standard_normal((samples, 1)))
    bands = lfo.stop_band(bins=[1, 2]) if closed and not unbounded else None
    return Problem(dynamics, samples, cost, None if unbounded else lfo.Box(-0.4, 0.4), control_spectrum=bands)


def mask(**changes) -> Problem:
    """Return a rest-to-rest move whose control has little content at high frequencies, at every one of them."""
    bound = lfo.MagnitudeBound(changes.pop("limit", 0.75), band=lfo.low_pass(1.2), every_frequency=True)
    return replace(lfo.library.double_integrator(horizon=50, sampling_time=0.08), control_spectrum=bound, **changes)


def sampled(problem: Problem):
    """Return the mask at the frequencies that the exchange ends with."""
    result = lfo.solve(problem, throw=False)
    multipliers = result.multipliers or result.ray
    points = {} if multipliers is None else multipliers.frequencies
    return sampled_masks(problem, {term.name: points.get(term.name, term.map.locations) for term in problem.terms})


def with_levels(**changes) -> Problem:
    """Return a problem of six samples with three levels."""
    dynamics = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]])
    cost, levels = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), P=5.0), lfo.FiniteSet([-1, 0, 1], [0.2, 0.0, 0.2])
    given = {"control_set": levels, "state_set": lfo.Box(-9, 9), "initial_state": [1.3, 0.4], **changes}
    return Problem(dynamics, 6, cost, **given)


def with_formula(stage: str) -> lfo.OptimalControlProblem:
    """Return a problem of one state with a cost by a formula, without bounds: a global bound declines it at once."""
    cost = lfo.costs.SmoothCost(stage=stage)
    return lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 4, cost, initial_state=[1.0])


REDUCTIONS = {
    "soft bins": Entry(
        soft_bins,
        {
            **random_kinds(control_spectrum=SOFT_BAND),
            INFEASIBLE: partial(  # a ray may use no bins: opening them might help
                random_problem, 3, control_spectrum=SOFT_BAND, state_set=Polyhedron([[1.0, 0.0]], [-2.0])
            ),
        },
    ),
    "joint rows": Entry(
        row_form,
        {
            **random_kinds(state_set=Polyhedron([[-0.3, -1.0], [0.0, -1.0]], [0.12, 0.25]), initial_state=[0.3, -0.2]),
            **{
                f"terminal, {name}": given
                for name, given in random_kinds(terminal_state=Polyhedron([[-1.0, 0.2]], [-0.3])).items()
            },
        },
    ),
    "soft sets": Entry(
        soft_bounds,
        {
            **random_kinds(state_set=Soft(lfo.Box([None, -0.15], None), HIGH)),
            **{
                f"controls, {name}": given
                for name, given in random_kinds(control_set=Soft(lfo.Box(-0.5, 0.4), HIGH)).items()
                if name != UNBOUNDED  # the controls
            },
        },
    ),
    "absorbed cost": Entry(
        absorb_cost,
        {
            "periodic": partial(averaging, closed=True),
            "zero-padded": partial(averaging, closed=False),
            "wave energy": partial(lfo.library.wave_energy, horizon=60),
            INFEASIBLE: lambda: replace(
                averaging(closed=True), control_set=lfo.Box(0.2, 0.4), control_spectrum=lfo.stop_band(bins=[0])
            ),
        },
    ),
    "far origin": Entry(
        lambda problem: translation if (translation := translation_of(problem)).moves else None,
        {
            name: partial(far_away, given)
            for name, given in random_kinds(
                terminal_state=lfo.Box([0.2, None], None), state_set=lfo.Box([None, -3], None)
            ).items()
        },
    ),
    "rate limit": Entry(
        lambda problem: rate_limit(problem, *RATE),
        {**random_kinds(), UNBOUNDED: lambda: replace(random_kinds()[UNBOUNDED](), initial_state=None)},
        lambda given: replace(given, control_spectrum=RateConstraint(*RATE)),
    ),
    "masks at every frequency": Entry(
        sampled,
        {"double integrator": mask, "a tighter one": partial(mask, limit=0.5), INFEASIBLE: partial(mask, limit=0.01)},
    ),
    "few samples between levels": Entry(
        few_between_levels,
        {"pulse pattern": partial(lfo.library.pulse_pattern, samples=32), "no state cost": duty_cycles},
    ),
    "cost by formulas as a state": Entry(
        lambda problem: cost_as_state(problem, lfo.simulate(problem, np.zeros((4, 1)))),
        {stage: partial(with_formula, stage) for stage in ("cosh(x_0) + u_0**2", "abs(x_0) + u_0**2")},
    ),
    "fixed modes": Entry(
        lambda problem: fix_modes(problem, lfo.solve(problem).sequence),
        {"a wall": partial(lfo.library.pendulum_with_wall, horizon=4), "levels": with_levels},
    ),
}
