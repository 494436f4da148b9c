"""The section "The problem" says everything that is true of a problem, in short sentences, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.problem import LONGEST_FACT, Band, problem_facts

T = 20


def problem(**fields: Any) -> lfo.OptimalControlProblem:
    """Two states, two controls, with names of one letter among them."""
    dynamics = fields.pop("dynamics", None) or lfo.LinearDynamics(
        [[1, 0.1], [0, 1]],
        [[0.005, 0], [0.1, 0.1]],
        sampling_time=0.1,
        state_names=["position [m]", "V [m/s]"],
        control_names=["force [N]", "I [A]"],
    )
    return lfo.OptimalControlProblem(dynamics, fields.pop("horizon", T), **{"cost": lfo.QuadraticCost(R=1)} | fields)


def said(one: lfo.OptimalControlProblem) -> dict[str, str]:
    """Return the facts by their terms; those of the same term together."""
    facts = dict[str, str]()
    for term, value in problem_facts(one):
        facts[term] = f"{facts[term]} | {value}" if term in facts else value
    return facts


W = np.array([[2.0, 0.0], [0.0, 1.0]])
VARYING = np.linspace(1, 3, T)

SETS: dict[str, tuple[Any, list[str]]] = {
    "ball": (lfo.sets.Ball(2.0, [1.0, 0.0]), ["within 2 of (1, 0)"]),
    "ball at the origin": (lfo.sets.Ball(2.0), ["within 2 of the origin"]),
    "ellipsoid": (lfo.sets.Ellipsoid(W, 3.0, [0.5, 0.0]), ["|W (", "(0.5, 0)", "≤ 3", "W = diag(2, 1)"]),
    "polyhedron": (lfo.sets.Polyhedron([[1, 2], [-1, 0]], [4, 5]), ["+ 2 ", "≤ 4", "≤ 5"]),
    "large polyhedron": (lfo.sets.Polyhedron(np.ones((40, 2)), np.ones(40)), ["40 rows"]),
    "cone": (lfo.sets.SecondOrderCone(np.eye(2), [0, 0], [0, 1], 7.0), ["second-order cone", "7"]),
    "intersection": (lfo.Box(-3, 3) & lfo.sets.Ball(4.0), ["within ±3", "within 4 of the origin"]),
    "soft box": (lfo.sets.Soft(lfo.Box(-3, [3, np.inf]), 10.0), ["soft", "10 per unit", "within ±3"]),
    "soft ball": (lfo.sets.Soft(lfo.sets.Ball(4.0), 11.0), ["soft", "11 per unit", "within 4 of the origin"]),
    "soft rows": (lfo.sets.Soft(lfo.sets.Polyhedron([[1, 2]], [4]), 12.0), ["soft", "12 per unit", "≤ 4"]),
    "soft ellipsoid": (lfo.sets.Soft(lfo.sets.Ellipsoid(W, 3.0), 13.0), ["soft", "13 per unit", "≤ 3"]),
}

PLACES = {
    "state set": lambda one: {"state_set": one},
    "control set": lambda one: {"control_set": one},
    "initial set": lambda one: {"initial_state": one},
    "terminal set": lambda one: {"terminal_state": one},
    "state set at times": lambda one: {"state_set": [lfo.sets.Everything()] * T + [one]},
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", SETS)
def test_every_set_is_described_wherever_it_stands(kind: str, place: str):
    one, words = SETS[kind]
    facts = said(problem(**PLACES[place](one)))
    text = facts[place.removesuffix(" at times")]
    for word in words:
        assert word in text
    if place.endswith("at times"):
        assert f"t = {T}" in text
        assert "no constraint" in text


@pytest.mark.parametrize("place", ["initial", "terminal"])
def test_an_end_in_a_set_is_not_called_free(place: str):
    verb = {"initial": "starts", "terminal": "ends"}[place]
    for one, _ in SETS.values():
        facts = said(problem(**{f"{place}_state": one}))
        assert f"{verb} anywhere" not in facts["state: position [m]"]
    assert f"{verb} anywhere" in said(problem())["state: position [m]"]


ENDS: dict[str, tuple[Any, str, str]] = {
    "point": ([1.0, 0.25], "ends at 1", "ends at 0.25"),
    "box": (lfo.Box([-1, 0], [1, 2]), "ends within ±1", "ends from 0 to 2"),
    "partial": (lfo.Box([0.5, -np.inf], [0.5, np.inf]), "ends at 0.5", "ends anywhere"),
    "no bound in so many words": (lfo.Box([0.5, -1e20], [0.5, 1e30]), "ends at 0.5", "ends anywhere"),
    "free": (None, "ends anywhere", "ends anywhere"),
}


@pytest.mark.parametrize("kind", ENDS)
def test_ends_are_said_per_component(kind: str):
    end, first, second = ENDS[kind]
    facts = said(problem(terminal_state=end))
    assert first in facts["state: position [m]"]
    assert second in facts["state: V [m/s]"]


REFERENCE = np.column_stack([np.linspace(0, 1, T + 1), np.zeros(T + 1)])

COSTS: dict[str, tuple[Any, list[str]]] = {
    "plain": (lfo.QuadraticCost(Q=2.0, R=3.0), ["Q = 2 I", "R = 3 I"]),
    "diagonal": (lfo.QuadraticCost(Q=np.diag([1.0, 4.0]), P=5.0), ["Q = diag(1, 4)", "P = 5 I", "at the end"]),
    "reference": (lfo.QuadraticCost(Q=1.0, x_ref=[0.5, 0.0]), ["(x - x_ref)", "x_ref = (0.5, 0)"]),
    "moving reference": (lfo.QuadraticCost(Q=1.0, x_ref=REFERENCE), ["x_ref depends on time, from 0 to 1"]),
    "control reference": (lfo.QuadraticCost(R=1.0, u_ref=[0.25, 0.0]), ["(u - u_ref)", "u_ref = (0.25, 0)"]),
    "time-varying": (lfo.QuadraticCost(R=VARYING[:, None, None] * np.eye(2)), ["R depends on time"]),
    "cross": (lfo.QuadraticCost(Q=1, R=1, S=[[0.5, 0.1], [0, 0]]), ["x' S u", "S = [0.5 0.1; 0 0]"]),
    "linear": (lfo.QuadraticCost(q=[1.0, 2.0], r=[3.0, 4.0], p=[5, 6]), ["q = (1, 2)", "r = (3, 4)", "p = (5, 6)"]),
    "L1": (lfo.costs.L1Cost(u=[0.1, 0.2]), ["absolute values", "controls with weights (0.1, 0.2)"]),
    "LInf": (lfo.costs.LInfCost(x=3.0), ["largest absolute value", "states with weights 3"]),
    "L1 around references": (lfo.costs.L1Cost(x=1.0, x_ref=[7.0, 0.0]), ["x_ref = (7, 0)"]),
    "terminal L1": (lfo.costs.L1Cost(terminal=[0.0, 9.0]), ["terminal state with weights (0, 9)"]),
    "L1 over time": (lfo.costs.L1Cost(u=VARYING[:, None] * np.ones(2)), ["depend on time, from 1 to 3"]),
    "sum": (
        lfo.QuadraticCost(R=1) + lfo.costs.L1Cost(u=0.1) + lfo.costs.LInfCost(x=0.3),
        ["R = I", "weights 0.1", "weights 0.3"],
    ),
    "none": (lfo.QuadraticCost(), ["nothing: any feasible point will do"]),
}


@pytest.mark.parametrize("kind", COSTS)
def test_every_cost_is_described(kind: str):
    cost, words = COSTS[kind]
    facts = said(problem(cost=cost))
    text = " | ".join(facts.get(term, "") for term in ("minimise", "where", "plus"))
    for word in words:
        assert word in text


NO_OUTPUT = ("equation", "output")
"""Outputs have no such constraint."""


def coefficients(length: int) -> np.ndarray:
    """Return what makes the sum of both components zero."""
    return np.ones((length, 1, 2))


SPECTRA: dict[str, tuple[Callable[[int], Any], list[str]]] = {
    "low pass in Hz": (lambda _: lfo.low_pass(cutoff_hz=2.0), ["above 2 Hz", "every component"]),
    "low pass": (lambda _: lfo.low_pass(1.5, component=1), ["above 1.5 rad/sample"]),
    "high pass": (lambda _: lfo.spectrum.high_pass(cutoff_hz=1.0), ["below 1 Hz"]),
    "band pass": (lambda _: lfo.spectrum.band_pass(lower_hz=1.0, upper_hz=2.0), ["below 1 and above 2 Hz"]),
    "notch": (lambda _: lfo.spectrum.notch(centre_hz=2.0, width_hz=1.0), ["between 1.5 and 2.5 Hz"]),
    "bins": (lambda _: lfo.stop_band(bins=[3, 4, 5, 9], component=0), ["bins 3 to 5 and 9"]),
    "mask": (lambda _: lfo.MagnitudeBound(0.5, band=lfo.low_pass(cutoff_hz=2.0)), ["|DFT| ≤ 0.5", "above 2 Hz"]),
    "mask per bin": (lambda _: lfo.MagnitudeBound([0.1, 0.4], bins=[3, 4]), ["0.1 to 0.4", "bins 3 to 4"]),
    "soft mask": (lambda _: lfo.MagnitudeBound(0.5, bins=[3], penalty=20.0), ["soft", "20 per unit"]),
    "windowed mask": (
        lambda _: lfo.MagnitudeBound(0.5, bins=[3, 4], window="hann", oversampling=4, between=True),
        ["window hann", "4 times as fine", "between"],
    ),
    "own window": (lambda length: lfo.MagnitudeBound(0.5, bins=[3], window=np.ones(length)), ["window"]),
    "energy": (lambda _: lfo.spectrum.EnergyBound(0.7, bins=[3, 4], component=0), ["energy", "≤ 0.7", "bins 3 to 4"]),
    "soft energy": (lambda _: lfo.spectrum.EnergyBound(0.7, bins=[3, 4], penalty=21.0), ["soft", "21 per unit"]),
    "vibration": (
        lambda _: lfo.ResidualVibration((0.9, 1.1), (0.0, 0.05), 23.0),
        ["≤ 23", "every mode of 0.9 to 1.1 Hz", "damping ratio of 0 to 0.05"],
    ),
    "equation": (lambda length: lfo.spectrum.LinearConstraint(coefficients(length)), ["linear equation", "all times"]),
    "soft equation": (
        lambda length: lfo.spectrum.LinearConstraint(coefficients(length), penalty=22.0),
        ["soft", "22 per unit"],
    ),
}


KINDS = [(kind, of) for kind in SPECTRA for of in ("control", "state", "output") if (kind[-8:], of) != NO_OUTPUT]


@pytest.mark.parametrize(("kind", "of"), KINDS)
def test_every_frequency_constraint_is_described(kind: str, of: str):
    make, words = SPECTRA[kind]
    one = make(T + 1 if of == "state" else T)
    if of == "output":
        given: Any = lfo.spectrum.OutputSpectrum(
            C=[[1, 0], [0, 2]], D=np.eye(2), constraints=[one], output_names=["a", "b"]
        )
    else:
        given = [one]
    facts = said(problem(**{f"{of}_spectrum": given}))
    for word in words:
        assert word in facts[f"{of} spectrum"]
    if isinstance(one, Band) and one.component == 1:
        assert {"control": "of I", "state": "of V", "output": "of b"}[of] in facts[f"{of} spectrum"]
    if of == "output":
        assert ("a = position + force" if one.component == 0 else "b = 2 V + I") in facts["outputs"]


ROWS: dict[str, tuple[lfo.StageRows, list[str]]] = {
    "one row": (lfo.StageRows([[1, 0]], [[0, 2]], [3], "pull"), ["position + 2 I ≤ 3"]),
    "many rows": (lfo.StageRows(np.ones((30, 2)), None, np.ones(30), "pull"), ["30 rows C x + D u ≤ e"]),
    "soft": (lfo.StageRows([[1, 0]], None, [3], "pull", penalty=23.0), ["soft", "23 per unit"]),
    "varying": (lfo.StageRows([[1, 0]], None, VARYING[:, None], "pull"), ["depend on time"]),
}


@pytest.mark.parametrize("kind", ROWS)
def test_every_row_is_described(kind: str):
    rows, words = ROWS[kind]
    facts = said(problem(stage_rows=rows))
    for word in words:
        assert word in facts["rows: pull"]


def test_offsets_are_described():
    A, B = [[1, 0.1], [0, 1]], [[0.005], [0.1]]
    constant = lfo.LinearDynamics(A, B, offset=[0.0, -0.98])
    assert "d = (0, -0.98)" in said(problem(dynamics=constant))["dynamics"]
    moving = lfo.LinearDynamics(A, B, offset=np.outer(VARYING, [1, 0]))
    assert "d depends on time, from 0 to 3" in said(problem(dynamics=moving))["dynamics"]
    assert "d" not in said(problem(dynamics=lfo.LinearDynamics(A, B)))["dynamics"].replace("depend", "").split()
    varying = lfo.LinearDynamics(np.broadcast_to(A, (T, 2, 2)) * VARYING[:, None, None], B)
    assert "A depends on time" in said(problem(dynamics=varying))["dynamics"]


def test_bounds_that_depend_on_time_have_their_range():
    upper = np.full((T + 1, 2), 5.0)
    upper[-1] = 1e20
    facts = said(problem(state_set=lfo.Box(np.full((T + 1, 2), -2.5), upper)))
    assert facts["state: V [m/s]"].startswith("bounds that depend on time: lower -2.5, upper 5, none at some times")


def test_soft_and_hard_parts_of_one_set_are_told_apart():
    facts = said(problem(state_set=lfo.Box(-3, 3) & lfo.sets.Soft(lfo.Box(-1, 1), 5.0)))
    assert facts["state: V [m/s]"].startswith("within ±3")
    assert "soft, 5 per unit of excess" in facts["state set"]


def everything_at_once() -> lfo.OptimalControlProblem:
    """Thirty states with long names, and one of everything."""
    n, rng = 30, np.random.default_rng(3)
    names = [f"a rather long name of the state number {i} of all [m/s]" for i in range(n)]
    dynamics = lfo.LinearDynamics(0.9 * np.eye(n), np.ones((n, 1)), rng.normal(size=(60, n)), 0.1, names, ["u"])
    return lfo.OptimalControlProblem(
        dynamics,
        60,
        lfo.QuadraticCost(
            rng.normal(size=(60, 1, 1)) ** 2 * np.eye(n),
            [[1 / 3]],
            x_ref=rng.normal(size=(61, n)),
            q=np.pi * np.ones(n),
        )
        + lfo.costs.L1Cost(x=rng.uniform(size=n), terminal=rng.uniform(size=n), x_ref=rng.normal(size=n)),
        state_set=[lfo.sets.Ball(float(i + 5), rng.normal(size=n)) & lfo.Box(-100, 100 + i) for i in range(61)],
        terminal_state=lfo.sets.Ellipsoid(rng.normal(size=(n, n)), 7.0, rng.normal(size=n)),
        control_spectrum=[
            lfo.stop_band(bins=list(range(1, 30, 2))),
            lfo.MagnitudeBound(rng.uniform(1, 9, size=15).tolist(), bins=list(range(0, 30, 2))),
            lfo.spectrum.LinearConstraint(rng.normal(size=(60, 1, 1))),
        ],
        stage_rows=lfo.StageRows(rng.normal(size=(2, n)), rng.normal(size=(2, 1)), [99.0, 98.0], "mixed"),
        output_spectrum=lfo.spectrum.OutputSpectrum(
            C=rng.normal(size=(9, n)), constraints=lfo.low_pass(cutoff_hz=2, component=3)
        ),
    )


def test_no_sentence_is_long():
    problems = [everything_at_once(), problem(cost=lfo.QuadraticCost(*[np.pi / 3 + 0 * W] * 2))]
    for one, _ in SETS.values():
        problems.append(problem(state_set=one & lfo.Box(-9, 9), terminal_state=one))
    for one in problems:
        for term, value in problem_facts(one):
            assert value
            assert len(value) <= LONGEST_FACT, term
    assert LONGEST_FACT <= 300


def test_a_library_problem_is_described_shortly():
    for name in ("pendulum", "buck_affine", "ball_and_paddle", "elliptic_rendezvous", "max_min_network"):
        for _, value in problem_facts(getattr(lfo.library, name)()):
            assert len(value) <= LONGEST_FACT


def test_errors_name_dynamics_as_they_were_stated():
    """Levels and formulas make other classes of them, which no user states."""
    plant = lfo.LinearDynamics([[1.0]], [[1.0]])
    levels = lfo.OptimalControlProblem(plant, 2, lfo.QuadraticCost(R=1.0), lfo.FiniteSet([0, 1]), lfo.Box(-9, 9), [0.0])
    with pytest.raises(lfo.errors.UnsupportedError, match="got LinearDynamics with levels; expected LinearDynamics"):
        _ = levels.linear
    formulas = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage="cosh(x_0)")
    problem = lfo.OptimalControlProblem(plant, 2, formulas, initial_state=[0.0])
    with pytest.raises(lfo.errors.UnsupportedError, match="these are dynamics with a cost or path constraints by form"):
        problem.form.disturbed(np.zeros(1))
