"""What a user writes first: bounds on one side, rows of controls only, numbers for single components, results."""

from __future__ import annotations

import pydoc
import re
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

import lin_freq_ocp as lfo


def scalar(**changes):
    """Return x_{t+1} = x_t + u_t with one state and one control."""
    given = {"dynamics": lfo.LinearDynamics([[1.0]], [[1.0]]), "horizon": 5, "cost": lfo.QuadraticCost(R=1.0)} | changes
    return lfo.OptimalControlProblem(**given)


def test_a_box_may_be_given_by_one_side():
    upper, lower = lfo.Box(upper=5), lfo.Box(lower=[0.0, 1.0])
    assert (float(upper.lower), float(upper.upper)) == (-np.inf, 5.0)
    assert lower.upper.tolist() == [np.inf, np.inf]
    assert lfo.Box().contains(np.array([1e12, -1e12]))


def test_rows_may_have_controls_only_or_states_only():
    result = lfo.solve(
        scalar(initial_state=[0.0], terminal_state=[1.0], stage_rows=lfo.StageRows(D=[[-1.0]], e=[-0.2]))
    )
    np.testing.assert_allclose(result.control, 0.2, atol=1e-7)
    assert lfo.StageRows(C=[[1.0]], e=[1.0]).rows == 1
    with pytest.raises(lfo.errors.ProblemError, match=r"stage_rows\.e: got nothing"):
        lfo.StageRows(D=[[1.0]])
    with pytest.raises(lfo.errors.ProblemError, match="neither C nor D"):
        lfo.StageRows(e=[1.0])


def test_a_number_stands_for_an_end_of_one_component():
    written, listed = scalar(initial_state=0.5, terminal_state=2), scalar(initial_state=[0.5], terminal_state=[2.0])
    assert lfo.solve(written).cost == lfo.solve(listed).cost == pytest.approx(1.5**2 / 10, rel=1e-8)
    assert written.with_ends(terminal_state=1.0).terminal_state.value.tolist() == [1.0]
    assert lfo.sets.Point(0.5).value.tolist() == [0.5]
    np.testing.assert_allclose(lfo.simulate(scalar(), np.ones((5, 1)), 0.5).x[:, 0], 0.5 + np.arange(6))


def test_a_number_stands_for_a_reference_of_one_component():
    written = scalar(initial_state=0.0, cost=lfo.QuadraticCost(R=1.0, P=1.0, x_ref=3.0, u_ref=0.1))
    listed = replace(written, cost=lfo.QuadraticCost(R=1.0, P=1.0, x_ref=[3.0], u_ref=[0.1]))
    assert lfo.solve(written).cost == lfo.solve(listed).cost > 0


def test_a_number_stands_for_the_control_before_a_single_one():
    limited = lfo.rate_limited(scalar(initial_state=0.0), 0.5, previous=0.25)
    assert (
        limited.initial_box.lower.tolist()
        == lfo.rate_limited(scalar(initial_state=0.0), 0.5, [0.25]).initial_box.lower.tolist()
    )


@pytest.mark.parametrize("field", ["initial_state", "terminal_state"])
def test_a_number_is_no_end_of_several_components(field):
    with pytest.raises(
        lfo.errors.ProblemError, match=rf"{field}: got shape \(\); expected numbers, one for each of the 4"
    ):
        replace(lfo.library.pendulum(), **{field: 0.5})
    with pytest.raises(lfo.errors.ProblemError, match=r"cost\.x_ref"):
        replace(lfo.library.pendulum(), cost=lfo.QuadraticCost(R=1.0, x_ref=0.5))


def test_a_file_may_have_a_number_for_an_end_of_one_component(tmp_path):
    text = "schema = 1\nhorizon = 5\ninitial_state = 0.5\nterminal_state = 2\n"
    (tmp_path / "p.toml").write_text(text + "[dynamics]\nA = [[1.0]]\nB = [[1.0]]\n[cost]\nR = 1.0\n")
    assert lfo.solve(lfo.read_problem(tmp_path / "p.toml")).cost == pytest.approx(1.5**2 / 10, rel=1e-8)


def test_certify_takes_what_solve_and_load_return(tmp_path):
    problem = lfo.library.double_integrator()
    result = lfo.solve(problem)
    result.save(tmp_path / "run.npz")
    expected = lfo.certify(problem, result.trajectory, result.multipliers)
    for given in (result, lfo.load(tmp_path / "run.npz")):
        certificate = lfo.certify(problem, given)
        assert (certificate.cost, certificate.lower_bound) == (expected.cost, expected.lower_bound)
        assert certificate.pmp == "satisfied"
    zeros = lfo.results.Multipliers(
        *(0 * getattr(result.multipliers, name) for name in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x"))
    )
    assert lfo.certify(problem, result, zeros).pmp == "violated"  # those that are given count


def test_certify_refuses_a_result_without_a_trajectory():
    infeasible = lfo.solve(lfo.library.pendulum(horizon=60, control_bound=1.0), throw=False)
    with pytest.raises(
        lfo.errors.ProblemError, match=r"trajectory: got a result without one, which ended as 'infeasible'"
    ):
        lfo.certify(infeasible.problem, infeasible)


LISTED = {
    "OptimalControlProblem": ("with_ends", "with_modes", "value"),
    "results.Result": ("plot", "save", "to_csv", "to_mat", "to_json", "to_time_response", "dump"),
    "LinearDynamics": ("from_continuous", "from_statespace", "linearised"),
    "Box": ("contains", "project", "violation", "support"),
    "StageRows": ("values", "slack", "violation"),
    "QuadraticCost": ("value", "gradient"),
    "PiecewiseAffineDynamics": ("from_guards", "from_formulas"),
    "PiecewiseSmoothDynamics": ("from_formulas",),
    "results.Sweep": ("column", "table", "plot", "to_csv"),
    "results.Comparison": ("plot", "save"),
}


@pytest.mark.parametrize("name", LISTED)
def test_help_begins_with_the_methods_that_users_call(name):
    """What pydoc lists by itself is in alphabetical order, with everything that other modules ask of the class."""
    shown = pydoc.plain(pydoc.render_doc(attrgetter(name)(lfo)))
    ours, rule, _ = shown.partition("Methods defined here:")
    section = re.split(r"\n [| ]*Methods\n [| ]*-------\n", ours)
    assert (len(section), rule != "") == (2, True)
    methods = re.split(r"\n [| ]*\w+\n [| ]*-------+\n", section[1])[0]  # what comes before the next section
    listed = set(re.findall(r"(\w+)\([^)]*\)", "".join(re.findall(r"\n \|  (\S.*)", "\n" + methods))))
    assert listed >= set(LISTED[name])
    assert all(callable(getattr(attrgetter(name)(lfo), one)) for one in listed)
