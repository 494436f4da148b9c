"""Loads in problem files, and the commands that solve for them and judge plans by them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import lin_freq_ocp as lfo
from helpers.schemas import PROBLEM, RESULT, faults
from helpers.seeds import expensive
from helpers.tubes import A, B, simulate, tube
from lin_freq_ocp.base import number
from lin_freq_ocp.cli import cli

TEXT = """
schema = 2
name = "tube"
horizon = 10
initial_state = [-7.0, -2.0]
[dynamics]
A = [[1.0, 1.0], [0.0, 1.0]]
B = [[0.5], [1.0]]
[cost]
Q = 1.0
R = 0.1
P = 3.0
[control_set]
lower = -1.0
upper = 1.0
[state_set]
lower = [-10.0, -2.0]
upper = [2.0, 2.0]
[disturbance]
"""
BOX = "set = {lower = -0.15, upper = 0.15}"
LOAD = lfo.Disturbance(lfo.Box(-0.15, 0.15))


@pytest.fixture
def file(tmp_path):
    def write(lines: str = BOX):
        (tmp_path / "tube.toml").write_text(TEXT + lines)
        return tmp_path / "tube.toml"

    return write


def call(*arguments: object):
    return CliRunner().invoke(cli, [str(one) for one in arguments], standalone_mode=False)


LOADS = {
    "box": (BOX, LOAD),
    "ball": ('set = {kind = "ball", radius = 0.1}', lfo.Disturbance(lfo.sets.Ball(0.1))),
    "samples": ("set = [[0.1, 0.0], [-0.1, 0.1]]", lfo.Disturbance([[0.1, 0.0], [-0.1, 0.1]])),
    "gaussian": (
        'set = {kind = "gaussian", covariance = [[1e-3, 0.0], [0.0, 1e-3]], probability = 0.9}',
        lfo.Disturbance(lfo.uncertainty.Gaussian(1e-3 * np.eye(2), 0.9)),
    ),
    "records": (
        f'set = {{kind = "records", loads = {[[[0.1, -0.1]] * 10]}}}',
        lfo.Disturbance(lfo.uncertainty.Records([[[0.1, -0.1]] * 10])),
    ),
    "no feedback": (
        'set = {lower = -0.05, upper = 0.05}\ninput = [[0.0], [1.0]]\ngain = "none"',
        lfo.Disturbance(lfo.Box(-0.05, 0.05), [[0.0], [1.0]], None),
    ),
    "own gain, uncertain start": (
        "set = {lower = -0.05, upper = 0.05}\ngain = [[-0.3, -0.8]]\nstart = {lower = -0.1, upper = 0.1}",
        lfo.Disturbance(lfo.Box(-0.05, 0.05), gain=[[-0.3, -0.8]], start=lfo.Box(-0.1, 0.1)),
    ),
}


@pytest.mark.parametrize("name", LOADS)
def test_a_file_with_loads_is_the_problem_of_robust_and_is_written_back(file, tmp_path, name):
    text, load = LOADS[name]
    read, expected = lfo.read_problem(file(text)), lfo.robust(tube(), load)
    np.testing.assert_array_equal(read.state_boxes.upper, expected.state_boxes.upper)
    np.testing.assert_array_equal(read.control_tube.lower, expected.control_tube.lower)
    lfo.write_problem(read, tmp_path / "again.toml")
    tables = tomllib.loads((tmp_path / "again.toml").read_text())
    assert faults(PROBLEM, tables) == []
    assert "robust" not in tables
    again = lfo.read_problem(tmp_path / "again.toml")
    np.testing.assert_array_equal(again.state_boxes.upper, expected.state_boxes.upper)
    np.testing.assert_array_equal(again.given.state_boxes.upper, tube().state_boxes.upper)


@expensive
def test_an_invariant_end_is_written_back_and_a_problem_with_replaced_fields_with_its_limits(file, tmp_path):
    text = '[robust]\nend = "invariant"\n'
    read = lfo.read_problem(file(f"{BOX}\n{text}"))
    assert read.stage_rows[-1].name == "invariant end"
    lfo.write_problem(read, tmp_path / "again.toml")
    assert text in (tmp_path / "again.toml").read_text()
    moved = replace(read, initial_state=[-5.0, -1.0])
    lfo.write_problem(moved, tmp_path / "moved.toml")
    again = lfo.read_problem(tmp_path / "moved.toml")
    assert again.uncertainty is None
    np.testing.assert_array_equal(again.initial_state.lower, [-5.0, -1.0])
    np.testing.assert_array_equal(again.control_tube.upper, read.control_tube.upper)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("gain = 1", "disturbance.set: got nothing"),
        (f"{BOX}\ngian = 1", "disturbance.gian: .*Did you mean .?gain"),
        ('set = {kind = "bal", radius = 1}', "disturbance.set.kind: got .bal.*Did you mean .?ball"),
        ("set = {lower = -1.0}", "disturbance.set: got .*without bounds"),
        (f'{BOX}\ngain = "lqr"', "disturbance.gain: got .lqr."),
        (f"{BOX}\ninput = [[0.0], [0.0]]", "disturbance.input: got zeros"),
        ("set = {lower = -0.9, upper = 0.9}", "(state|control)_set: got a range of .* of which the loads take"),
        ('set = {kind = "gaussian", covariance = 1.0, probability = 0.1}', "disturbance.set.probability: got 0.1"),
        (
            'set = {kind = "records", loads = [[[0.1, 0.1]]]}',
            "disturbance.set.loads: got loads of 1 steps; expected one",
        ),
        ("set = {lower = 0.1, upper = -0.1}", "disturbance.set.lower: got 0.1 above upper"),
        ("set = {lower = -inf, upper = 0.1}", "disturbance.set: got .*without bounds"),
        ("set = {lower = nan, upper = 0.1}", "disturbance.set.lower: got nan"),
        ("set = []", r"disturbance.set: got shape \(0,\); expected a set such as Box"),
        (f'{BOX}\n[robust]\nend = "set"', "robust.end: got .set.; expected .invariant."),
    ],
)
def test_loads_of_a_file_that_do_not_fit_are_refused_with_their_field(file, lines, message):
    with pytest.raises(lfo.errors.ProblemError, match=f"tube.toml: {message}"):
        lfo.read_problem(file(lines))


def test_a_table_robust_needs_loads(file, tmp_path):
    (tmp_path / "plain.toml").write_text(TEXT.replace("[disturbance]", '[robust]\nend = "invariant"'))
    with pytest.raises(lfo.errors.ProblemError, match=r"plain.toml: robust: got no disturbance; expected .*\[disturb"):
        lfo.read_problem(tmp_path / "plain.toml")


def test_solve_prints_the_worst_loads_and_the_price_of_robustness(file):
    said = call("solve", file())
    assert said.return_value == 0
    assert "position" not in said.output
    assert "No case violates one of these limits: proven" in said.output
    assert "0.15 at t = 0 .. 4" in said.output
    assert "The cost is 212.47; that of the plan without margins 190.02: 11.8 % more." in said.output


def test_the_json_of_solve_and_worst_case_is_valid_and_its_loads_attain_what_it_says(file, tmp_path):
    solved = json.loads(call("solve", file(), "--json", "--save", tmp_path / "plan.npz").output)
    judged = json.loads(call("worst-case", file(), tmp_path / "plan.npz", "--json").output)
    assert faults(RESULT, solved) == faults(RESULT, judged) == []
    assert judged["worst_case"]["limits"] == solved["worst_case"]["limits"]
    assert solved["worst_case"]["nominal"] == pytest.approx(190.02, abs=0.01)
    plan = lfo.load(tmp_path / "plan.npz").trajectory
    for one in judged["worst_case"]["limits"]:
        x, u = simulate(tube(), LOAD.feedback(tube()), plan, np.eye(2), np.array([one["loads"]]))
        signal = x if one["name"].startswith("x") else u
        assert one["attained"] == pytest.approx(signal[0, one["index"], int(one["name"][2])], abs=1e-12)
        assert one["holds"]


def test_the_worst_case_of_a_plan_without_margins_is_a_violation_with_its_own_exit_status(file, tmp_path):
    lfo.solve(tube()).save(tmp_path / "plan.csv")
    said = call("worst-case", file(), tmp_path / "plan.csv")
    assert said.return_value == 3
    assert "Violated: 3 limits" in said.output
    assert call("worst-case", file(), tmp_path / "plan.csv", "--set", "disturbance.set.lower=0.0").return_value == 3
    (tmp_path / "plain.toml").write_text(TEXT.replace("[disturbance]", ""))
    said = call("worst-case", tmp_path / "plain.toml", tmp_path / "plan.csv")
    assert isinstance(said.exception, lfo.errors.ProblemError)
    assert "disturbance: got nothing; expected a table [disturbance], [discs] or [[plants]]" in str(said.exception)


def test_numbers_of_limits_set_the_given_limits(file):
    said = call("solve", file(), "--set", "state_upper.0=1.5", "--json")
    position = next(one for one in json.loads(said.output)["worst_case"]["limits"] if one["name"] == "x_0, upper")
    assert position["limit"] == 1.5
    assert position["planned"] + position["margin"] < 1.5


@pytest.mark.parametrize("of_last_control", ["", ", [0.0, 0.0]"], ids=["input of the plant", "input of all states"])
def test_rate_limits_of_a_file_hold_for_all_loads(file, of_last_control):
    problem = lfo.read_problem(
        file(f"set = {{lower = -0.02, upper = 0.02}}\ninput = [[1.0, 0.0], [0.0, 1.0]{of_last_control}]"),
        {"rate_limit": {"limit": 0.6, "previous": 0.0}, "initial_state": [-5.0, 0.0]},
    )
    plan, K = lfo.solve(problem).trajectory, problem.uncertainty.feedback(problem.given)
    rng, over = np.random.default_rng(0), []
    for _ in range(50):
        x, before = plan.x[0], 0.0
        for t in range(10):
            u = plan.u[t] + K @ (x - plan.x[t])
            over.append(abs(u[0] - before) - 0.6)
            x = np.append(A @ x[:2] + B @ u + rng.choice([-0.02, 0.02], 2), u)
            before = u[0]
    assert max(over) < 1e-8


def test_the_figure_has_the_worst_load_beside_the_plan_and_margins_as_bands(file):
    problem = lfo.read_problem(file())
    found = lfo.solve(problem)
    figure = found.plot()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "margin for loads" in labels
    worst = lfo.worst_case(problem.given, problem.uncertainty, found).closest
    assert f"worst load (for {worst.name})" in labels
    bands = [one.get_paths()[0].vertices[:, 1] for one in figure.axes[0].collections]
    assert {(round(band.min(), 6), round(band.max(), 6)) for band in bands} == {
        (round(float(problem.control_tube.upper.min()), 6), 1.0),
        (-1.0, round(float(problem.control_tube.lower.max()), 6)),
    }
    lines = [line.get_ydata() for line in figure.axes[0].get_lines()]
    _, u = simulate(tube(), LOAD.feedback(tube()), found.trajectory, np.eye(2), worst.loads[None])
    assert any(np.allclose(line[:10], u[0, :, 0], atol=1e-12) for line in lines if len(line) >= 10)
    plain = lfo.solve(tube()).plot()
    assert "margin for loads" not in [text.get_text() for text in plain.legends[0].get_texts()]


def test_the_largest_bins_for_all_loads_are_drawn_and_no_load_exceeds_them(file):
    found = lfo.solve(lfo.read_problem(file()))
    figure = found.plot()
    assert "largest bin for all loads" in [text.get_text() for text in figure.legends[0].get_texts()]
    (drawn,) = [
        line for line in figure.axes[1].get_lines() if line.get_marker() in ("None", "") and len(line.get_ydata()) == 6
    ]
    rng = np.random.default_rng(0)
    w = rng.choice([-0.15, 0.15], (5000, 10, 2))
    _, u = simulate(tube(), LOAD.feedback(tube()), found.trajectory, np.eye(2), w)
    reached = np.abs(np.fft.rfft(u[..., 0], axis=1)).max(axis=0)
    assert (reached <= drawn.get_ydata() * (1 + 1e-12)).all()
    assert (reached > 0.6 * drawn.get_ydata()).all()
    without = lfo.Disturbance(lfo.Box(-0.05, 0.05), gain=None).largest_spectra(tube(), found.trajectory)
    gaussian = lfo.Disturbance(lfo.uncertainty.Gaussian(1e-4 * np.eye(2), 0.9))
    assert without is None is gaussian.largest_spectra(tube(), found.trajectory)


@pytest.mark.parametrize("text", ["tube", "plants", "measured"])
def test_the_page_of_a_robust_plan_has_its_worst_case(file, tmp_path, text):
    if text == "tube":
        path = file()
    else:
        path = tmp_path / f"{text}.toml"
        plants = TEXT.replace("[disturbance]", PLANTS).replace("[-7.0, -2.0]", "[-5.0, 0.0]")
        path.write_text(plants if text == "plants" else f"{RESPONSE}[discs]\nradius = 0.05\n")
    said = call("compare", path, "--out", tmp_path / "report")
    assert said.return_value == 0
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    problem = lfo.read_problem(path)
    worst = lfo.worst_case(problem.given, problem.uncertainty, lfo.solve(problem))
    assert "<h2>The worst case</h2>" in page
    assert worst.verdict in page
    assert all(one.cells[5] in page for one in worst.limits)
    assert (tmp_path / "report" / "worst_case.svg").exists()
    shown = {"tube": "worst load", "plants": "x_0 of plant 1", "measured": "worst plant"}
    assert shown[text] in (tmp_path / "report" / "worst_case.svg").read_text(encoding="utf-8")


def test_the_page_says_by_how_much_a_soft_limit_is_exceeded(file, tmp_path):
    speed = 'kind = "soft"\npenalty = 5.0\nset = {lower = [-inf, -1.0], upper = [inf, 1.0]}'
    path = file(BOX.replace("0.15", "0.05"))
    text = path.read_text().replace("[state_set]\nlower = [-10.0, -2.0]\nupper = [2.0, 2.0]", f"[state_set]\n{speed}")
    path.write_text(text)
    assert call("compare", path, "--out", tmp_path / "report").return_value == 0
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    problem = lfo.read_problem(path)
    worst = lfo.worst_case(problem.given, problem.uncertainty, lfo.solve(problem))
    broken = max(worst.soft, key=lambda one: one.violation)
    assert worst
    assert broken.attained - broken.limit > 0.1
    assert f"soft, exceeded by {number(broken.attained - broken.limit)}" in page
    assert ">soft<" not in page
    assert "violated" not in str(worst)


PLANTS = """
[[plants]]
A = [[1.0, 1.0], [0.0, 1.0]]
B = [[0.5], [1.0]]
[[plants]]
A = [[1.0, 1.0], [0.0, 1.0]]
B = [[0.4], [0.8]]
"""


@pytest.mark.parametrize("shares", [None, [1.0, 2.0]])
def test_plants_of_a_file_share_one_control_and_are_written_back(tmp_path, shares):
    text = TEXT.replace("[disturbance]", PLANTS).replace("[-7.0, -2.0]", "[-5.0, 0.0]")
    text = text if shares is None else text.replace("horizon = 10", f"horizon = 10\nplant_shares = {shares}")
    (tmp_path / "plants.toml").write_text(text)
    read = lfo.read_problem(tmp_path / "plants.toml")
    plants = lfo.Plants([lfo.LinearDynamics(A, B), lfo.LinearDynamics(A, 0.8 * B)], shares)
    expected = lfo.solve(lfo.robust(tube(initial_state=[-5.0, 0.0]), plants))
    found = lfo.solve(read)
    assert found.status == "optimal"
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    lfo.write_problem(read, tmp_path / "again.toml")
    tables = tomllib.loads((tmp_path / "again.toml").read_text())
    assert faults(PROBLEM, tables) == faults(PROBLEM, tomllib.loads(text)) == []
    assert len(tables["plants"]) == 2
    assert ("plant_shares" in tables) == (shares is not None)
    again = lfo.read_problem(tmp_path / "again.toml")
    np.testing.assert_array_equal(again.uncertainty.shares, plants.shares)
    assert lfo.solve(again).cost == found.cost
    found.save(tmp_path / "plan.csv")
    said = call("worst-case", tmp_path / "plants.toml", tmp_path / "plan.csv")
    assert said.return_value == 0
    assert "each of 2 plants; u = v" in said.output
    assert "No case violates one of these limits: proven" in call("solve", tmp_path / "plants.toml").output
    solved = json.loads(call("solve", tmp_path / "plants.toml", "--json").output)
    assert faults(RESULT, solved) == []
    assert {one["plant"] for one in solved["worst_case"]["limits"]} <= {1, 2}


RESPONSE = """
schema = 2
horizon = 8
[dynamics]
G_real = [1.0, 0.5, 0.2, 0.1, 0.0]
G_imag = [0.0, -0.5, -0.3, -0.1, 0.0]
disturbance = [[0.5], [0.2], [0.1], [-0.3], [-0.4], [-0.2], [0.1], [0.4]]
[cost]
Q = 1.0
R = 0.1
[state_set]
lower = -0.4
upper = 0.4
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("horizon = 10", "horizon = 10\nplant_shares = [1.0]", r"plant_shares: got \[1.0\]; expected 2 weights"),
        ("horizon = 10", "horizon = 10\nplant_shares = [1.0, -1.0]", r"plant_shares: got .*; expected 2 weights"),
        ("horizon = 10", "horizon = 10\nplant_shares = ['a', 1.0]", "plant_shares: .*Numbers have no quotes"),
        (PLANTS, "", r"plant_shares: got \[1.0, 1.0\]; expected tables \[\[plants\]\]"),
        ("[0.8]]", "[0.8, 1.0]]", r"plants\[1\].B: .*rectangular"),
        ("[[0.4], [0.8]]", "[[0.4, 0.8]]", r"plants\[1\].B: got shape \(1, 2\); expected a matrix"),
        ("[[0.4], [0.8]]", "[[nan], [0.8]]", r"plants\[1\].B\[0\]\[0\]: got nan"),
        ("[[0.4], [0.8]]", "[[0.4, 1.0], [0.8, 1.0]]", r"plants\[1\]: got 2 states, 2 controls"),
    ],
)
def test_plants_of_a_file_that_do_not_fit_are_refused_with_the_key_of_the_file(tmp_path, old, new, message):
    text = TEXT.replace("[disturbance]", PLANTS).replace("[-7.0, -2.0]", "[-5.0, 0.0]")
    if "shares" not in new:
        text = text.replace("horizon = 10", "horizon = 10\nplant_shares = [1.0, 1.0]")
    (tmp_path / "plants.toml").write_text(text.replace(old, new))
    with pytest.raises(lfo.errors.ProblemError, match=f"plants.toml: {message}"):
        lfo.read_problem(tmp_path / "plants.toml")


def test_discs_of_a_file_may_be_those_of_a_coherence(tmp_path):
    c = [0.99, 0.99, 0.98, 0.97, 0.9]
    text = f"{RESPONSE}[discs]\ncoherence = {c}\naverages = 20\nconfidence = 0.9\n"
    (tmp_path / "measured.toml").write_text(text)
    assert faults(PROBLEM, tomllib.loads(text)) == []
    read = lfo.read_problem(tmp_path / "measured.toml")
    G = read.given.dynamics.G
    radius = lfo.uncertainty.radius_of_coherence(G[:, 0, 0], c, averages=20, confidence=0.9, bins=5)
    np.testing.assert_array_equal(read.uncertainty.radii(read.given)[:, 0, 0], radius)
    lfo.write_problem(read, tmp_path / "again.toml")  # with the radii
    again = lfo.read_problem(tmp_path / "again.toml")
    np.testing.assert_array_equal(again.uncertainty.radius, radius)
    assert lfo.solve(again).cost == lfo.solve(read).cost
    solved = json.loads(call("solve", tmp_path / "again.toml", "--json").output)
    assert faults(RESULT, solved) == []
    one = solved["worst_case"]["limits"][0]
    found = lfo.worst_case(read.given, read.uncertainty, lfo.solve(again))
    plant = np.array(one["plant"]["G_real"]) + 1j * np.array(one["plant"]["G_imag"])
    np.testing.assert_array_equal(plant, found.limits[0].plant)
    assert found.cost == solved["worst_case"]["cost"] == pytest.approx(solved["cost"])


MEASURED = """
schema = 2
horizon = 20
[dynamics]
table = {csv = "buoy.csv"}
samples = 20
sampling_time = 0.1
disturbance = [[0.5], [0.2], [0.1], [-0.3], [-0.4], [-0.2], [0.1], [0.4], [0.3], [0.1],
               [0.5], [0.2], [0.1], [-0.3], [-0.4], [-0.2], [0.1], [0.4], [0.3], [0.1]]
[cost]
Q = 1.0
R = 5.0
[state_set]
lower = -0.4
upper = 0.4
[discs]
coherence = {csv = "buoy.csv"}
averages = 20
"""
FREQUENCIES = np.array([0.0, 0.7, 1.9, 3.0, 5.0])  # but the first and the last, no bins, which are 0, 0.5 .. 5 Hz
OF_BUOY, COHERENCE = 1 / (1 + 1j * FREQUENCIES * (FREQUENCIES < 5)), np.array([0.99, 0.98, 0.97, 0.99, 0.9])


@pytest.fixture
def measured(tmp_path):
    """Return what writes a problem file beside its table, and returns its path."""

    def write(text: str = MEASURED, header: str = "frequency [Hz],re,im,coherence", last: float = 5.0):
        rows = np.column_stack([FREQUENCIES, OF_BUOY.real, OF_BUOY.imag, COHERENCE])[:, : len(header.split(","))]
        rows = rows[FREQUENCIES <= last]
        np.savetxt(tmp_path / "buoy.csv", rows, "%.17g", ",", header=header, comments="")
        np.savetxt(tmp_path / "other.csv", rows * [1, 1000, 1000, 1][: rows.shape[1]], "%.17g", ",", header=header)
        (tmp_path / "buoy.toml").write_text(text)
        return tmp_path / "buoy.toml"

    return write


def test_discs_of_a_file_are_those_of_the_coherence_in_a_csv_file_between_measured_frequencies(measured, tmp_path):
    path = measured()
    assert faults(PROBLEM, tomllib.loads(MEASURED)) == []
    read = lfo.read_problem(path)
    at_measured = lfo.uncertainty.radius_of_coherence(OF_BUOY, COHERENCE, averages=20, confidence=0.95, bins=5)
    expected = np.interp(np.arange(11) / 2, FREQUENCIES, at_measured)
    np.testing.assert_allclose(read.uncertainty.radius, expected, rtol=1e-15)
    discs = lfo.Discs.from_csv(tmp_path / "buoy.csv", 20, 0.1, averages=20)
    np.testing.assert_array_equal(discs.radius, read.uncertainty.radius)
    found = lfo.solve(read)
    assert found.status == "optimal"
    assert found.cost > lfo.solve(read.given).cost * (1 + 1e-6)
    assert lfo.worst_case(read.given, discs, found)["x_0, upper"].attained == pytest.approx(0.4)
    lfo.write_problem(read, tmp_path / "again.toml")  # with the radii
    assert lfo.solve(lfo.read_problem(tmp_path / "again.toml")).cost == pytest.approx(found.cost, rel=1e-12)
    assert call("solve", path).return_value == 0
    assert "proven, to 1e-08 of their terms" in call("solve", path).output


@pytest.mark.parametrize("key", ["coherence = {csv", "radius = 0.05", "coherence = 0.97"])
def test_the_last_controls_that_a_rate_limit_adds_are_known(measured, key):
    text = MEASURED + "[rate_limit]\nlimit = 0.4\n"
    if key != "coherence = {csv":
        array = "[0.97" + 10 * ", 0.97" + "]\naverages = 20" if "coherence" in key else "0.05"
        text = text.replace('coherence = {csv = "buoy.csv"}\naverages = 20', f"{key.split()[0]} = {array}")
    read = lfo.read_problem(measured(text))
    radii = read.uncertainty.radii(read.given)[..., 0]
    assert (radii[:, 0] > 0).all()
    assert not radii[:, 1:].any()
    found = lfo.solve(read)
    assert np.abs(np.diff(found.trajectory.u[:, 0])).max() <= 0.4 * (1 + 1e-9)
    worst = lfo.worst_case(read.given, read.uncertainty, found)
    assert worst
    assert {one.margin for one in worst.limits if "rate limit" in one.name} == {0.0}


@pytest.mark.parametrize(
    ("change", "written", "message"),
    [
        (
            ("", ""),
            {"header": "frequency [Hz],re,im"},
            r"discs.coherence: got shape \(5, 3\); expected \(k, 4\): frequency .*The header of a CSV file names them",
        ),
        (
            ('coherence = {csv = "buoy.csv"}', 'coherence = {csv = "other.csv"}'),
            {},
            r"discs.coherence: got another response than that of the dynamics, at bins 0 \(0 Hz\), 1 \(0.5 Hz\), .*"
            " and 5 more; expected the same. The dynamics and the discs take the same file",
        ),
        (
            ('table = {csv = "buoy.csv"}', "table = [[0, 1, 0], [5, 0, 0]]"),
            {"last": 3.0},
            "discs.coherence: got another response .* at bins 1",
        ),
        (('coherence = {csv = "buoy.csv"}', 'coherence = {csv = "none.csv"}'), {}, "discs.coherence.csv: .*none.csv"),
        (("averages = 20", "averages = 1"), {}, "discs.averages: got 1; expected a whole number of independent"),
        (("averages = 20", "averages = 20\nconfidence = 95"), {}, "discs.confidence: got 95; .*State 95 % as 0.95"),
        (
            ('coherence = {csv = "buoy.csv"}', "coherence = [[0.0, 1.0, 0.0, 0.9], [5.0, 1.0, 0.0, 1.9]]"),
            {},
            "discs.coherence: got another response than",
        ),
    ],
)
def test_coherences_in_files_that_do_not_fit_are_refused_with_their_field(measured, change, written, message):
    with pytest.raises(lfo.errors.ProblemError, match=f"buoy.toml: {message}"):
        lfo.read_problem(measured(MEASURED.replace(*change), **written))


def test_bins_outside_of_a_measured_table_are_known_only_where_the_response_is_zero(measured):
    zero = MEASURED.replace("sampling_time = 0.1", 'sampling_time = 0.1\noutside = "zero"')
    read = lfo.read_problem(measured(zero, last=3.0))
    assert (read.uncertainty.radius[:7] > 0).all()
    assert not read.uncertainty.radius[7:].any()
    table = np.column_stack([FREQUENCIES, OF_BUOY.real, OF_BUOY.imag, COHERENCE])[:4]
    with pytest.raises(lfo.errors.ProblemError, match=r"discs.coherence: got frequencies from 0 to 3 Hz; expected all"):
        lfo.Discs.from_table(table, 20, 0.1, averages=20)
    np.testing.assert_array_equal(
        lfo.Discs.from_table(table, 20, 0.1, averages=20, outside="zero").radius, read.uncertainty.radius
    )


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('[discs]\ncost = "worst"', "discs: got nothing; expected radius, or coherence with averages"),
        ("[discs]\nradius = 0.1\ncoherence = 0.9\naverages = 9", "discs: got radius, coherence and averages"),
        ("[discs]\ncoherence = 0.9", "discs: got coherence; expected radius, or coherence with averages"),
        (
            "[discs]\ncoherence = [0.9, 0.9, 0.9, 0.9, 1.2]\naverages = 9",
            "discs.coherence: got .*; expected .* at most 1",
        ),
        ("[discs]\nradius = [0.1, 0.1]", r"discs.radius: got shape \(2,\); expected shape \(5, 1, 1\)"),
        ("[discs]\ncoherence = [0.9, 0.9]\naverages = 9", r"discs.coherence: got shape \(2,\); expected shape \(5,\)"),
        (
            "[discs]\ncoherence = [0.9, 0.9, 0.9, 0.9, 0.9]\naverages = 1",
            "discs.averages: got 1; expected a whole number of independent",
        ),
        (
            "[discs]\nradius = 0.1\n[[plants]]\nA = [[1.0]]\nB = [[1.0]]",
            "plants: got discs, too; expected one of .disturbance.",
        ),
        ("[[plants]]\nA = [[1.0]]\nB = [[1.0]]", r"plants\[0\]: got .*; expected a FrequencyResponse"),
        ("plants = 3", "plants: got 3; expected tables that begin with"),
    ],
)
def test_uncertainties_of_a_file_that_do_not_fit_are_refused_with_their_field(tmp_path, lines, message):
    text = f"{lines}\n{RESPONSE}" if lines.startswith("plants") else RESPONSE + lines
    (tmp_path / "measured.toml").write_text(text)
    with pytest.raises(lfo.errors.ProblemError, match=f"measured.toml: {message}"):
        lfo.read_problem(tmp_path / "measured.toml")
