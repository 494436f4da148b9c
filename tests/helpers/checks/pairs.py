"""Every pair of features in one small problem, every feature with what one does with a problem, and some triples.

A pair or a triple works, with a verdict that CVXPY shares where the problem is convex, or it is refused by an error
that names a field and gives the reason. Everything else is wrong.
"""

from __future__ import annotations

import inspect
import re
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from operator import add, and_, or_
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.outcome import finding_of
from lin_freq_ocp.base import Array, register_all
from lin_freq_ocp.proof import lfo_check
from lin_freq_ocp.solving import FAMILIES, family_of

Fields = dict[str, Any]
Problem = lfo.OptimalControlProblem

T = 6
A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]])
WAVE = np.sin(1.3 * np.arange(T + 1))
AGREEMENT = 1e-5  # difference of two costs, relative to max(1, |J|)
ANSWERS = "optimal", "locally_optimal"
FIELDS = *inspect.signature(Problem).parameters, "u_0", "x_0", "x_1", "method", *("explain", "generate")
REASON = re.compile(rf"({'|'.join(FIELDS)})\b.*: .{{20,}}", re.DOTALL)
"""A field of the problem, a component, the method or the use, and words about it."""

TOGETHER: dict[str, Callable[[Any, Any], Any]] = {
    "cost": add,
    "quadratic": or_,
    **dict.fromkeys(("control_set", "state_set", "initial_state", "terminal_state"), and_),
    **dict.fromkeys(("control_spectrum", "state_spectrum", "output_spectrum", "stage_rows"), add),
}
"""How two features share a field; two of any other field are no pair."""


def _kinked_map() -> lfo.PiecewiseSmoothDynamics:
    formulas = ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 - 0.1*abs(x_1)"]
    return lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1, sampling_time=1.0)


def _smooth_map() -> lfo.PiecewiseSmoothDynamics:
    formulas = ["x_0 + x_1 + 0.5*u_0", "x_1 + u_0 - 0.1*sin(x_0)"]
    return lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1, sampling_time=1.0)


def _map_of_numbers() -> lfo.PiecewiseSmoothDynamics:
    def value(x: Array, u: Array) -> Array:
        return A @ x + B @ u - [0, 0.1 * np.sin(x[0])]

    def jacobian(x: Array, u: Array) -> Array:
        return np.hstack([A - [[0, 0], [0.1 * np.cos(x[0]), 0]], B])

    f = lfo.DifferentiableFunction(value, jacobian, outputs=2)
    return lfo.PiecewiseSmoothDynamics([lfo.dynamics.SmoothMode(f)], 2, 1, sampling_time=1.0)


def _affine_map() -> lfo.PiecewiseAffineDynamics:
    modes = [lfo.AffineMode(A + np.diag([0, slope]), B, [0, 0], [[0, sign]], [[0]], [0]) for slope, sign in MODES]
    return lfo.PiecewiseAffineDynamics(modes, sampling_time=1.0)


MODES = (0.1, 1.0), (-0.1, -1.0)  # of the speed: a change of A where it is negative, and where it is positive


def _response(mode: str) -> Fields:
    """Return dynamics by a response of a damped mass, whose initial state is free."""
    samples = T if mode == "periodic" else 2 * T
    z = np.exp(2j * np.pi * np.arange(samples // 2 + 1) / samples)
    G = np.linalg.solve(z[:, None, None] * np.eye(2) - 0.8 * A, np.broadcast_to(B, (len(z), 2, 1)).astype(complex))
    G[[0, -1]] = G[[0, -1]].real
    return {"dynamics": lfo.FrequencyResponse(G, 1.0, mode=mode), "initial_state": lfo.sets.Everything()}


mask, energy, soft = lfo.MagnitudeBound, lfo.spectrum.EnergyBound, lfo.sets.Soft

FEATURES: dict[str, Callable[[], Fields]] = {
    "linear dynamics": lambda: {},
    "time-varying dynamics": lambda: {
        "dynamics": lfo.LinearDynamics(A * (1 - 0.1 * WAVE[:-1, None, None]), B, 0.1 * np.outer(WAVE[:-1], [1, 0]), 1.0)
    },
    "periodic frequency response": partial(_response, "periodic"),
    "zero-padded frequency response": partial(_response, "zero-padded"),
    "piecewise-affine dynamics": lambda: {"dynamics": _affine_map()},
    "smooth dynamics": lambda: {"dynamics": _smooth_map()},
    "piecewise-smooth dynamics": lambda: {"dynamics": _kinked_map()},
    "dynamics by functions": lambda: {"dynamics": _map_of_numbers()},
    "references per time": lambda: {"quadratic": {"x_ref": np.outer(WAVE, [1, 0]), "u_ref": 0.3 * WAVE[:-1, None]}},
    "cross terms": lambda: {"quadratic": {"S": [[0.2], [0.1]], "q": [0.1, 0.0], "r": [0.3]}},
    "linear cost": lambda: {"quadratic": {"Q": 0.0, "R": 0.0, "P": 0.0, "q": [0.3, -0.2], "r": [0.1], "p": [0.5, 0.1]}},
    "indefinite cost": lambda: {"quadratic": {"Q": np.diag([-0.4, 0.2])}},
    "L1 cost": lambda: {"cost": lfo.costs.L1Cost(x=[0.1, 0.0], u=0.2, terminal=1.0)},
    "L-infinity cost": lambda: {"cost": lfo.costs.LInfCost(x=0.3, u=0.4, terminal=1.0)},
    "cost by formulas": lambda: {"cost": lfo.costs.SmoothCost(stage="u_0**4 + 0.1*sin(x_0)", terminal="cos(x_1)")},
    "cost by formulas with a kink": lambda: {"cost": lfo.costs.SmoothCost(stage="abs(x_0 - 0.3)")},
    "polyhedron": lambda: {"control_set": lfo.sets.Polyhedron([[-2.0]], [0.7])},
    "ball": lambda: {"control_set": lfo.sets.Ball(0.35)},
    "ellipsoid": lambda: {"state_set": lfo.sets.Ellipsoid(np.diag([0.2, 1.0]), 0.4)},
    "second-order cone": lambda: {"state_set": lfo.sets.SecondOrderCone(np.eye(2), [0.0, 0.0], [0.8, 0.0], 0.31)},
    "sets per time": lambda: {"control_set": [lfo.Box(-0.35, 0.2 + 0.1 * t) for t in range(T)]},
    "a fixed control": lambda: {"control_set": [lfo.Box(0.1, 0.1) if t == 2 else lfo.Box(-1, 1) for t in range(T)]},
    "levels": lambda: {"control_set": lfo.FiniteSet([-1, 0, 1], costs=[0.1, 0, 0.1])},
    "duty cycles": lambda: {"control_set": lfo.FiniteSet([-1, 0, 1], costs=[0.1, 0, 0.1], duty_cycles=True)},
    "terminal point": lambda: {"terminal_state": lfo.sets.Point([0.2, 0.0])},
    "terminal ball": lambda: {"terminal_state": lfo.sets.Ball(0.3, [0.2, 0.0])},
    "terminal polyhedron": lambda: {"terminal_state": lfo.sets.Polyhedron([[1.0, 1.0]], [0.1])},
    "initial box": lambda: {"initial_state": lfo.Box([0.5, -0.1], [1.0, 0.1])},
    "initial ball": lambda: {"initial_state": lfo.sets.Ball(0.2, [1.0, 0.0])},
    "free initial state": lambda: {"initial_state": lfo.sets.Everything()},
    "periodic ends": lambda: {"terminal_state": lfo.Periodic(), "initial_state": lfo.sets.Everything()},
    "linked ends": lambda: {"terminal_state": lfo.sets.LinkedEnds([[-0.4, 0.0]], [[1.0, 0.0]], [-0.1])},
    "soft box": lambda: {"state_set": soft(lfo.Box(-0.5, 0.5), 0.3)},
    "soft terminal ball": lambda: {"terminal_state": soft(lfo.sets.Ball(0.1), 0.5)},
    "soft rows": lambda: {"stage_rows": [lfo.StageRows([[1.0, 0.5]], None, [0.3], "soft rows", penalty=0.3)]},
    "soft mask": lambda: {"control_spectrum": [mask(0.3, bins=[1, 2], penalty=0.2)]},
    "soft path constraint": lambda: {
        "stage_rows": [lfo.sets.PathConstraint("x_0 + 0.1*sin(x_1)", "soft path", 0.8, price=0.3)]
    },
    "joint rows": lambda: {"stage_rows": [lfo.StageRows([[0.0, -1.0]], [[-0.2]], [0.38], "joint rows")]},
    "rows per time": lambda: {"stage_rows": [lfo.StageRows([[0.0, -1.0]], None, 0.3 - 0.1 * WAVE[1:, None] ** 2)]},
    "path constraint": lambda: {"stage_rows": [lfo.sets.PathConstraint("-x_1 - 0.05*x_0**2", "path", 0.3)]},
    "convex path constraint": lambda: {"stage_rows": [lfo.sets.PathConstraint("x_1**2 + u_0**2", "convex path", 0.2)]},
    "rate limits": lambda: {"rates": {"limit": 0.4}},
    "price of changes": lambda: {"rates": {"price": 0.3, "previous": 0.0}},
    "low pass": lambda: {"control_spectrum": [lfo.low_pass(2.5)]},
    "notch": lambda: {"control_spectrum": [lfo.spectrum.notch(np.pi * 2 / 3, 0.2)]},
    "stop band of states": lambda: {"state_spectrum": [lfo.stop_band(bins=[2], component=1)]},
    "mask": lambda: {"control_spectrum": [mask(0.3, bins=[2, 3])]},
    "oversampled mask": lambda: {"control_spectrum": [mask(0.18, bins=[2, 3, 4], window="hann", oversampling=2)]},
    "mask at every frequency": lambda: {"control_spectrum": [mask(0.5, band=lfo.low_pass(2.2), every_frequency=True)]},
    "mask on a held control": lambda: {
        "control_spectrum": [mask(0.35, band=lfo.low_pass(cutoff_hz=0.4), every_frequency=True, hold=True)]
    },
    "mask of states": lambda: {"state_spectrum": [mask(0.4, bins=[2, 3], component=0)]},
    "harmonics in amplitudes": lambda: {"control_spectrum": [mask(harmonics={2: 0.08}, fundamental_hz=1 / T)]},
    "part of the fundamental": lambda: {
        "control_spectrum": [mask(percent=40, of="fundamental", phase=2.0, fundamental_hz=1 / T, bins=[2])]
    },
    "energy bound": lambda: {"control_spectrum": [energy(0.5, bins=[1, 2])]},
    "energy bound of states": lambda: {"state_spectrum": [energy(0.4, bins=[1, 2], component=1)]},
    "linear constraint": lambda: {
        "control_spectrum": [lfo.spectrum.LinearConstraint(WAVE[:-1, None, None], [0.05], penalty=None)]
    },
    "spectrogram": lambda: {"control_spectrum": [lfo.spectrum.Spectrogram(mask(0.4, bins=[1, 2]), 4, 2)]},
    "residual vibration": lambda: {"control_spectrum": [lfo.ResidualVibration((0.15, 0.2), 0.05, 0.2)]},
    "mask of outputs": lambda: {
        "output_spectrum": [lfo.spectrum.OutputSpectrum([[1.0, 0.5]], [[0.3]], mask(0.45, bins=[2]))]
    },
    "stop band of outputs": lambda: {
        "output_spectrum": [lfo.spectrum.OutputSpectrum([[1.0, 0.5]], None, lfo.stop_band(bins=[3]))]
    },
}


def exclude_each_other(one: str, other: str) -> bool:
    """Whether two features need different values of a field that cannot be shared."""
    return bool((fields_of(one).keys() & fields_of(other).keys()) - TOGETHER.keys())


@cache
def fields_of(name: str) -> Fields:
    """Return the fields of a feature."""
    return FEATURES[name]()


def _combine_values(field: str, one: Any, other: Any) -> Any:
    """Return two values of a field as one; sets for each time meet time by time."""
    if not field.endswith("set") or not (isinstance(one, list) or isinstance(other, list)):
        return TOGETHER[field](one, other)
    every = [part if isinstance(part, list) else [part] * T for part in (one, other)]
    return [a & b for a, b in zip(*every, strict=True)]


def problem_of(*names: str) -> Problem:
    """Return the problem with these features; ProblemError or UnsupportedError if there is none."""
    return problem_with([fields_of(name) for name in names], ", ".join(names))


def problem_with(parts: Sequence[Fields], name: str) -> Problem:
    """Return the problem with the fields of some features; ProblemError or UnsupportedError if there is none."""
    fields: Fields = {}
    for part in parts:
        for field, value in part.items():
            fields[field] = _combine_values(field, fields[field], value) if field in fields else value
    quadratic = {"Q": 0.5, "R": 0.2, "P": 1.0, "x_ref": [0.6, 0.0]} | fields.pop("quadratic", {})
    cost = lfo.QuadraticCost(**quadratic)
    cost = cost + fields.pop("cost") if "cost" in fields else cost
    rates = fields.pop("rates", None)
    base: Fields = {
        "dynamics": lfo.LinearDynamics(A, B, sampling_time=1.0),
        "initial_state": lfo.sets.Point([1.5, 0.0]),
    }
    base |= {"control_set": lfo.Box(-1, 1), "state_set": lfo.Box(-5, 5)}
    problem = Problem(horizon=T, cost=cost, name=name, **base | fields)
    return problem if rates is None else lfo.rate_limited(problem, **rates)


@dataclass(frozen=True)
class Outcome:
    """What became of a pair or a triple: "works", "refused" or "wrong", and the reason."""

    pair: tuple[str, ...]
    verdict: str
    words: str = ""

    @property
    def kind(self) -> str:
        """Return the dynamics."""
        return type(problem_of(self.pair[0]).dynamics).__name__

    @property
    def statuses(self) -> tuple[str]:
        """Return the verdict."""
        return (self.verdict,)

    @property
    def passed(self) -> bool:
        """Whether it works, or is refused."""
        return self.verdict != "wrong"


def outcome_of(pair: tuple[str, ...], tried: Callable[[], str]) -> Outcome:
    """Return the outcome of a trial that returns what is wrong, or raises."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for harmless in (lfo.errors.BandWarning, lfo.errors.ClosedLoopWarning):
                warnings.simplefilter("ignore", harmless)
            wrong = tried()
    except (lfo.errors.ProblemError, lfo.errors.UnsupportedError) as error:
        words = str(error)
        return Outcome(pair, "refused" if REASON.match(words) else "wrong", words)
    except Exception as error:  # whatever else it is, is the finding
        return Outcome(pair, "wrong", finding_of(error))
    return Outcome(pair, "wrong" if wrong else "works", wrong)


KNOWN: dict[tuple[str, str], str] = {}
"""Pairs that are wrong today, and why."""

LEFT_OUT = {
    "PulseTrain": "its states are an angle, a level, a charge and an energy: few other features have a meaning there",
    "ContinuousPlant": "it tells states between samples, and changes no answer",
    "SmoothPiece": "a mode of given dynamics on the way to an answer",
    "CostSum": "two costs together",
    "Intersection": "two sets together",
}
"""Kinds of dynamics, costs, sets and frequency constraints that are no features, and why."""


def pairs() -> list[tuple[str, str]]:
    """Return all pairs: of two features, and of a feature and a use."""
    of_features = [pair for pair in combinations(FEATURES, 2) if not exclude_each_other(*pair)]
    return of_features + [(feature, use) for feature in FEATURES for use in USES]


def is_long(pair: tuple[str, str]) -> bool:
    """Whether a use looks for a global bound over smooth pieces, for seconds."""
    return pair[1] in ("compare", "explain") and "nonsmooth" in family_of(problem_of(pair[0])).shorthands


def check(pair: tuple[str, str]) -> Outcome:
    """Return the outcome of a pair."""
    one, other = pair
    if other in FEATURES:
        return outcome_of(pair, lambda: solved_wrongly(pair))
    return outcome_of(pair, lambda: USES[other](one))


def triple(seed: int) -> tuple[str, ...]:
    """Return three features at random that do not exclude each other."""
    rng, every = np.random.default_rng(seed), list(FEATURES)
    while True:
        names = tuple(every[i] for i in sorted(rng.choice(len(every), 3, replace=False).tolist()))
        if not any(exclude_each_other(*pair) for pair in combinations(names, 2)):
            return names


def check_triple(seed: int) -> Outcome:
    """Return the outcome of a triple."""
    names = triple(seed)
    return outcome_of(names, lambda: solved_wrongly(names))


def quick_method(problem: Problem) -> str:
    """Return "auto", but "nonsmooth" where that would bound the cost of all trajectories for seconds."""
    return "nonsmooth" if "nonsmooth" in family_of(problem).shorthands else "auto"


def solve_quickly(problem: Problem) -> lfo.results.Result:
    """Return the result by the quick method."""
    return lfo.solve(problem, quick_method(problem), throw=False)


def solved_wrongly(names: Sequence[str], method: str | None = None, **options: Any) -> str:
    """Return what is wrong with the answer to a problem of these features; an empty text if nothing is."""
    problem = problem_of(*names)
    result = lfo.solve(problem, method or quick_method(problem), throw=False, **options)
    model = independent(problem, names)
    theirs = None if model is None else model.solve(solver=cp.CLARABEL)
    if result.status == "infeasible":
        return "" if model is None or np.isinf(theirs) else f"infeasible, and {theirs:g} by CVXPY"
    if result.status not in ANSWERS:
        return f"{result.status}: {result.message}"
    if model is None:
        return ""
    if result.status != "optimal" and not problem.mode_names:
        return f"{result.status}, and the problem is convex"
    below = any(term.semi_infinite is not None for term in problem.terms)  # CVXPY has the mask at some frequencies
    excess = (result.cost - theirs) / max(1.0, abs(theirs))
    return (
        ""
        if -AGREEMENT < excess < (np.inf if below else AGREEMENT)
        else f"cost {result.cost:.9g}, {theirs:.9g} by CVXPY"
    )


CONVEX: dict[str, Callable[[Any, Any], tuple[Any, list[Any]]]] = {
    "cost by formulas with a kink": lambda x, u: (cp.sum(cp.abs(x[:-1, 0] - 0.3)), []),
    "convex path constraint": lambda x, u: (0, [cp.square(x[:-1, 1]) + cp.square(u[:, 0]) <= 0.2]),
}
"""Convex features by formulas: their cost and constraints in CVXPY."""


def independent(problem: Problem, names: Sequence[str]) -> cp.Problem | None:
    """Return a problem in CVXPY, with convex features by formulas stated in it; None if it is not convex."""
    if problem.mode_names and not set(names) & set(CONVEX):
        return None
    try:
        others = [name for name in names if name not in CONVEX]
        model = lfo.to_cvxpy(problem_of(*others))
    except lfo.errors.LinFreqOCPError:
        return None
    x, u = model.var_dict["x"], model.var_dict["u"]
    parts = [CONVEX[name](x, u) for name in names if name in CONVEX]
    rows = [row for _, new in parts for row in new]
    return cp.Problem(cp.Minimize(model.objective.expr + sum(cost for cost, _ in parts)), model.constraints + rows)


START = [1.5, 0.0]


def _wrong_status(*statuses: str) -> str:
    return ", ".join(str(status) for status in statuses if status not in ANSWERS)


def _solve_by(method: str, feature: str) -> str:
    """Solve by a method; a global bound of smooth pieces is cut short by its gap."""
    smooth = quick_method(problem_of(feature)) == "nonsmooth" and method == "auto"
    return solved_wrongly([feature], method, **({"gap": 0.5} if smooth else {}))


def _certify(problem: Problem) -> str:
    result = solve_quickly(problem)
    for given in ((result.multipliers,), ()):
        certificate = lfo.certify(problem, result.trajectory, *given)
        if certificate.pmp != result.certificate.pmp:
            return f"{certificate.pmp}, and {result.certificate.pmp} by the solve"
    return ""


def _explain(problem: Problem) -> str:
    contradiction = lfo.StageRows(None, np.ones((1, problem.control_dim)), [-50.0], name="contradiction")
    explanation = lfo.explain(replace(problem, stage_rows=[*problem.stage_rows, contradiction]))
    return "" if any("contradiction" in one for one in explanation.family) else f"family {explanation.family}"


def _find_minimum_time(problem: Problem) -> str:
    found = lfo.minimum_time(problem, (T - 1, T), quick_method(problem))
    return "" if found.horizon else str(found)


def _step_twice(problem: Problem) -> str:
    controller = lfo.RecedingHorizon(problem)
    for start in _starts(problem):
        controller.step(start)
    return _wrong_status(*controller.log.statuses)


def _starts(problem: Problem) -> list[Array]:
    """Return two initial states that the problem can begin with."""
    x = solve_quickly(problem).trajectory.x
    return [x[0], 0.9 * x[0]]


def _solve_many(problem: Problem) -> str:
    return _wrong_status(*lfo.solve_many(problem, _starts(problem), method=quick_method(problem)).statuses)


def _sweep(problem: Problem) -> str:
    found = lfo.sweep(problem, {"initial_state": _starts(problem)}, method=quick_method(problem))
    return _wrong_status(*found.column("status"))


def _write_proof(problem: Problem) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "proof"
        solve_quickly(problem).write_proof(path)
        with path.open("rb") as file:
            lfo_check.check(file, lambda words: None)
    return ""


def _generate(problem: Problem) -> str:
    with tempfile.TemporaryDirectory() as folder:
        lfo.generate(lfo.RecedingHorizon(problem), folder)
    return ""


def _compare(problem: Problem) -> str:
    return _wrong_status(lfo.compare(problem).constrained.status)


def _store(problem: Problem) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.toml"
        lfo.write_problem(problem, path)
        again = lfo.read_problem(path)
    one, other = solve_quickly(problem).cost, solve_quickly(again).cost
    return "" if one == other else f"cost {other}, and {one} before"


register_all()

METHODS = dict.fromkeys(
    name for kind, family in FAMILIES.items() if kind is not lfo.dynamics.PulseTrain for name in family.shorthands
)
TRIALS: dict[str, Callable[[Problem], str]] = {
    "certify": _certify,
    "explain": _explain,
    "minimum_time": _find_minimum_time,
    "RecedingHorizon": _step_twice,
    "solve_many": _solve_many,
    "sweep": _sweep,
    "write_proof": _write_proof,
    "generate": _generate,
    "compare": _compare,
    "problem file": _store,
}
USES: dict[str, Callable[[str], str]] = {f'"{method}"': partial(_solve_by, method) for method in METHODS}
USES |= {use: lambda feature, trial=trial: trial(problem_of(feature)) for use, trial in TRIALS.items()}
