"""Bounds, weights, references, ends and signals by the names of their components."""

from __future__ import annotations

import re

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive

H = 0.1
STEPS = 6


def cart(**fields):
    """Return a cart that goes one metre; its signals have names and units."""
    plant = lfo.LinearDynamics(
        [[1, H], [0, 1]], [[H**2 / 2], [H]], sampling_time=H, state_names="position [m], speed [m/s]",
        control_names=["force [N]"],
    )  # fmt: skip
    return lfo.OptimalControlProblem(plant, STEPS, **({"cost": lfo.QuadraticCost(R=1.0)} | fields))


PAIRS = {
    "bounds of one state": (
        {"state_set": lfo.Box({"speed [m/s]": (-1, 1)})},
        {"state_set": lfo.Box([None, -1], [None, 1])},
    ),
    "one bound": ({"state_set": lfo.Box({"speed": (None, 1)})}, {"state_set": lfo.Box(None, [None, 1])}),
    "sides": (
        {"state_set": lfo.Box({"speed": -1}, {"position": 3.0})},
        {"state_set": lfo.Box([None, -1], [3.0, None])},
    ),
    "a lower bound": ({"state_set": lfo.Box(lower={"speed": -1})}, {"state_set": lfo.Box([None, -1])}),
    "an upper bound": ({"state_set": lfo.Box(upper={"speed": 1})}, {"state_set": lfo.Box(None, [None, 1])}),
    "a bound over time and a number": (
        {"state_set": lfo.Box({"speed": (np.arange(7.0) - 9, 4.0)})},
        {"state_set": lfo.Box([[None, t - 9] for t in range(7)], [None, 4.0])},
    ),
    "the same lower bound": ({"state_set": lfo.Box(-2, {"speed": 1})}, {"state_set": lfo.Box([None, -2], [None, 1])}),
    "bounds over time": (
        {"state_set": lfo.Box({"speed": (np.arange(7.0) - 9, None)})},
        {"state_set": lfo.Box(np.column_stack([np.full(7, -np.inf), np.arange(7.0) - 9]))},
    ),
    "one box a time": (
        {"control_set": [lfo.Box({"force": (-t, t)}) for t in range(1, 7)]},
        {"control_set": [lfo.Box(-t, t) for t in range(1, 7)]},
    ),
    "soft bounds": (
        {"state_set": lfo.sets.Soft(lfo.Box({"speed": (-1, 1)}), 9.0)},
        {"state_set": lfo.sets.Soft(lfo.Box([None, -1], [None, 1]), 9.0)},
    ),
    "an intersection": (
        {"state_set": lfo.Box({"speed": (-1, 1)}) & lfo.sets.Ball(3.0)},
        {"state_set": lfo.Box([None, -1], [None, 1]) & lfo.sets.Ball(3.0)},
    ),
    "bounds that meet others": (
        {"state_set": lfo.Box({"speed": (5, 6)}) & lfo.Box(0, [1, 9])},
        {"state_set": lfo.Box([None, 5], [None, 6]) & lfo.Box(0, [1, 9])},
    ),
    "ends": (
        {"initial_state": {"speed": 0.5, "position": 0}, "terminal_state": lfo.Box({"position": (1, 1)})},
        {"initial_state": [0, 0.5], "terminal_state": lfo.Box([1, None], [1, None])},
    ),
    "weights and references": (
        {"cost": lfo.QuadraticCost(Q={"position": 10.0}, R={"force": 2}, P={"speed": 3}, x_ref={"position": 1.0})},
        {"cost": lfo.QuadraticCost(Q=np.diag([10.0, 0]), R=2, P=np.diag([0, 3.0]), x_ref=[1.0, 0])},
    ),
    "linear weights": (
        {"cost": lfo.QuadraticCost(R=1, q={"speed": 1.0}, r={"force [N]": 2}, p={"position": -1}, u_ref={"force": 1})},
        {"cost": lfo.QuadraticCost(R=1, q=[0, 1.0], r=[2], p=[-1, 0], u_ref=[1])},
    ),
    "weights and references over time": (
        {"cost": lfo.QuadraticCost(R=1, Q={"speed": np.arange(6)}, x_ref={"position": 3, "speed": np.arange(7)})},
        {
            "cost": lfo.QuadraticCost(
                R=1, Q=[np.diag([0, t]) for t in range(6)], x_ref=np.column_stack([np.full(7, 3), np.arange(7)])
            )
        },
    ),
    "norms": (
        {"cost": lfo.QuadraticCost(R={"force": 1}) + lfo.costs.L1Cost(x={"speed": 2}, x_ref={"speed": 1})},
        {"cost": lfo.QuadraticCost(R=1) + lfo.costs.L1Cost(x=[0, 2], x_ref=[0, 1])},
    ),
}  # fmt: skip


@pytest.mark.parametrize("pair", PAIRS)
def test_a_problem_by_name_is_the_problem_by_components(pair, tmp_path):
    texts = []
    for name, fields in zip(("named", "plain"), PAIRS[pair], strict=True):
        lfo.write_problem(cart(**fields), tmp_path / f"{name}.toml")
        texts.append((tmp_path / f"{name}.toml").read_text())
    assert texts[0] == texts[1]


NAMES = "expected one of 'position [m]', 'speed [m/s]'"
WRONG = {
    "a name that is no state": ({"state_set": lfo.Box({"sped": (-1, 1)})}, f"{NAMES}. Did you mean 'speed'?"),
    "another unit": ({"state_set": lfo.Box({"speed [km/h]": (-1, 1)})}, f"{NAMES}. Did you mean 'speed [m/s]'?"),
    "a state twice": ({"state_set": lfo.Box({"speed": (-1, 1), "speed [m/s]": (0, 1)})}, "got 'speed [m/s]' twice"),
    "a state as a control": ({"control_set": lfo.Box({"speed": (-1, 1)})}, "expected one of 'force [N]'"),
    "too few times": ({"state_set": lfo.Box({"speed": ([0, 1], None)})}, "expected bounds for 7 times"),
    "too few references": (
        {"cost": lfo.QuadraticCost(Q=1.0, x_ref={"speed": 1.0, "position": range(6)})},
        "cost.x_ref['position']: got 6 numbers; expected a number, or 7, one per time.",
    ),
    "soft bounds over time": (
        {"state_set": lfo.sets.Soft(lfo.Box({"speed": (range(7), 9)}), 1.0)},
        "state_set: got a box with one bound per time; expected one box. Give a list of Soft sets.",
    ),
    "a bound of a list": (
        {"control_set": [lfo.Box({"force": (-1, 1)})] * 5 + [lfo.Box({"forse": (-1, 1)})]},
        "control_set[5]: got 'forse'",
    ),
    "several times": ({"cost": lfo.QuadraticCost(x_ref={"speed": range(7), "position": range(6)})}, "(6,) and (7,)"),
    "half a point": ({"initial_state": {"speed": 1}}, "initial_state: got no value of 'position [m]'"),
    "no number": ({"cost": lfo.QuadraticCost(Q={"speed": "fast"})}, "cost.Q['speed']: got 'fast'"),
    "a matrix": ({"cost": lfo.QuadraticCost(Q={"speed": [[1.0]]})}, "cost.Q: got values of shape (1, 1)"),
    "mixed weights": ({"cost": lfo.QuadraticCost(S={"speed": 1})}, "cost.S: got a mapping; expected a matrix (n, m)"),
    "a negative weight": ({"cost": lfo.costs.L1Cost(u={"force": -1})}, "L1Cost.u"),
    "a component": ({"control_spectrum": lfo.low_pass(1.0, component="forc")}, "Did you mean 'force'?"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_fits_no_name_is_refused(case):
    fields, text = WRONG[case]
    with pytest.raises(lfo.errors.ProblemError, match=re.escape(text)):
        cart(**fields)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (({"speed": 1},), "Box['speed']: got 1; expected a pair (lower, upper). For one bound, the other is None."),
        (({"speed": (1, -1)},), "Box.lower['speed']: got 1 above upper['speed'] = -1"),
        (({},), "got a mapping without names"),
        (({"speed": (range(7), 9), "position": (range(6), 9)},), "Box.lower: got values of shape (6,) and (7,)"),
    ],
)
def test_bounds_by_name_are_checked_before_there_is_a_problem(given, text):
    with pytest.raises(lfo.errors.ProblemError, match=re.escape(text)):
        lfo.Box(*given)


def test_a_mapping_given_as_one_side_is_that_side():
    """Two numbers there are those of two times, and no pair."""
    box = lfo.Box(lower={"speed": [-1, 2]})
    assert box.lower.tolist() == [[-1], [2]]
    assert np.isinf(box.upper).all()
    with pytest.raises(lfo.errors.ProblemError, match=r"Box.lower: got two values; expected one"):
        lfo.Box(0, lower=1)


def test_bounds_by_name_bound_nothing_without_a_problem():
    """A box without names would have no bounds: nobody may take the named one for it."""
    named = lfo.Box({"speed": (-1, 1)})
    for use in (
        lambda: named.parts(2),
        lambda: named.at_dimension(1, "set"),
        lambda: lfo.sets.Soft(named, 1.0).parts(2),
    ):
        with pytest.raises(lfo.errors.ProblemError, match=r"got bounds by name on 'speed'; expected a problem"):
            use()


def test_other_ends_and_references_have_names_too():
    problem = cart(cost=lfo.QuadraticCost(Q=1.0, R=1.0), initial_state=[0, 0])
    assert problem.with_ends(initial_state={"speed": 2, "position": 1}).ends[0].lower.tolist() == [1, 2]
    assert problem.with_references({"x_ref": {"speed [m/s]": 2}}).quadratic.x_ref.tolist() == [0, 2]


def test_a_result_has_its_signals_by_name():
    head = {"C": [[1.0, 0.0]], "D": [[2.0]], "output_names": ["head [m]"]}
    both = lfo.spectrum.OutputSpectrum(constraints=lfo.low_pass(cutoff_hz=4.0), **head)
    result = lfo.solve(cart(initial_state=[0, 0], terminal_state=[1, 0], output_spectrum=both))
    x, u = result.trajectory.x, result.trajectory.u
    assert np.array_equal(result["position"], x[:, 0])
    assert np.array_equal(result["speed [m/s]"], x[:, 1])
    assert np.array_equal(result["force"], u[:, 0])
    assert np.allclose(result["head"], x[:-1, 0] + 2 * u[:, 0])
    with pytest.raises(lfo.errors.ProblemError, match=r"result: got 'forse'.*Did you mean 'force'"):
        _ = result["forse"]


def test_names_in_a_problem_file(tmp_path):
    (tmp_path / "cart.toml").write_text("""
schema = 2
horizon = 6
initial_state = { speed = 0.5, "position [m]" = 0 }
terminal_state = { lower = { position = 1 }, upper = { position = 1 } }
state_set = { lower = { position = -3 } }
control_set = { upper = { force = 4 } }
[dynamics]
A = [[1, 0.1], [0, 1]]
B = [[0.005], [0.1]]
sampling_time = 0.1
state_names = "position [m], speed [m/s]"
control_names = ["force [N]"]
[cost]
R = { force = 1.0 }
""")
    read = lfo.read_problem(tmp_path / "cart.toml")
    ends = {"initial_state": [0, 0.5], "terminal_state": lfo.Box([1, None], [1, None])}
    plain = cart(**ends, state_set=lfo.Box([-3, None]), control_set=lfo.Box(None, 4))
    assert lfo.solve(read).cost == pytest.approx(lfo.solve(plain).cost, rel=1e-12)


@expensive
def test_rate_limits_by_name():
    named = lfo.rate_limited(cart(), {"force": 0.5}, {"force [N]": 0}, {"force": 1.0}, {"force": 2.0})
    plain = lfo.rate_limited(cart(), 0.5, 0, 1.0, 2.0)
    assert lfo.solve(named).cost == pytest.approx(lfo.solve(plain).cost, rel=1e-12)
    for field, given in (("rate_limit", ({"forse": 1},)), ("previous", (1, {"forse": 1}))):
        with pytest.raises(lfo.errors.ProblemError, match=rf"{field}: got 'forse'.*Did you mean 'force'"):
            lfo.rate_limited(cart(), *given)


def test_a_rate_limit_by_name_in_a_file(tmp_path):
    lfo.write_problem(cart(), tmp_path / "cart.toml")
    table = "\n[rate_limit]\nlimit = {force = 0.5}\nprevious = {force = 0.25}\n"
    with (tmp_path / "cart.toml").open("a") as file:
        file.write(table)
    read, plain = lfo.read_problem(tmp_path / "cart.toml"), lfo.rate_limited(cart(), 0.5, 0.25)
    assert read.stage_rows[0].e.tolist() == plain.stage_rows[0].e.tolist()
    assert read.initial_box.lower.tolist() == plain.initial_box.lower.tolist()


def test_loops_have_states_controls_and_references_by_name():
    """A state that follows from the controls alone may be left out, and then keeps its own reference."""
    problem = lfo.rate_limited(cart(cost=lfo.QuadraticCost(Q=1.0, R=1.0)), 0.5, previous=0.0, price=1.0)
    named, plain = lfo.RecedingHorizon(problem), lfo.RecedingHorizon(problem)
    for k, x in enumerate(([0.1, 0.2], [0.12, 0.1])):
        target, acted = {"speed": np.full(STEPS + 1, 0.3)}, None if k == 0 else {"force": 0.1}
        found = named.step(
            {"speed [m/s]": x[1], "position": x[0]}, {"x_ref": target, "u_ref": {"force": 1}}, applied=acted
        )
        references = {"x_ref": np.tile([0.0, 0.3], (STEPS + 1, 1)), "u_ref": [1.0]}
        assert found == pytest.approx(plain.step(x, references, applied=None if k == 0 else [0.1]), abs=1e-12)
    seen = np.linspace(0, 1, 2 + STEPS)
    loops = [
        lfo.RecedingHorizon(problem).run(start, 2, references={"x_ref": rows})
        for start, rows in (
            ({"position": 0.1, "speed": 0.0}, {"position": seen}),
            ([0.1, 0.0], np.column_stack([seen, 0 * seen])),
        )
    ]
    np.testing.assert_allclose(loops[0].states, loops[1].states, atol=1e-12)
    with pytest.raises(lfo.errors.ProblemError, match=r"state: got 'sped'.*Did you mean 'speed'"):
        named.step({"position": 0, "sped": 0})


def test_too_many_names_are_shown_as_names():
    with pytest.raises(lfo.errors.ProblemError, match=r"got \['a \[g\]', 'b'\]; expected 1 different names"):
        lfo.LinearDynamics([[1]], [[1]], state_names="a [g], b")
