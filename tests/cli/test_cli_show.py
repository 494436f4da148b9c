"""The command show: what a problem is, and the parameters that --set changes."""

from __future__ import annotations

import inspect
import json
import tomllib

import pytest
from jsonschema import Draft202012Validator

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.schemas import SHOW, faults
from helpers.seeds import expensive, seeds
from lin_freq_ocp.cli import SCHEMAS, as_toml
from lin_freq_ocp.files import problem_text


def shown(*arguments):
    status, out, err = run("show", *arguments, "--json")
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert faults(SHOW, summary) == []
    return summary


@pytest.mark.parametrize("name", seeds(lfo.library.PROBLEMS))
def test_every_problem_of_the_library_is_shown_with_all_its_parameters(name):
    summary = shown(name)
    function, problem = lfo.library.by_name(name), lfo.library.by_name(name)()
    assert summary["about"].startswith(inspect.getdoc(function).splitlines()[0])
    defaults = {key: one.default for key, one in inspect.signature(function).parameters.items()}
    assert [one["name"] for one in summary["parameters"]] == list(defaults)
    for one in summary["parameters"]:
        default = defaults[one["name"]]
        assert one["default"] == one["value"] == (list(default) if isinstance(default, tuple) else default)
        assert one["about"]
    assert summary["problem"]["horizon"] == problem.horizon
    assert [f"{one['name']} [{one['unit']}]" if one["unit"] else one["name"] for one in summary["states"]] == list(
        problem.state_names
    )
    status, out, _ = run("show", name)
    assert status == 0
    for word in (*defaults, *problem.state_names, *problem.control_names):
        assert word in " ".join(out.split())


def test_bounds_and_ends_are_those_of_the_problem():
    summary = shown("pendulum", "--set", 'terminal_state="none"', "--set", "control_bound=4", "--set", "horizon=100")
    position, force = summary["states"][0], summary["controls"][0]
    assert (position["lower"], position["upper"]) == (-0.2, 0.2)
    assert (position["initial"], position["terminal"]) == ([-0.15, -0.15], [None, None])
    assert force == {"name": "force", "unit": "N", "lower": -4.0, "upper": 4.0}
    changed = {one["name"]: (one["default"], one["value"]) for one in summary["parameters"]}
    assert changed["control_bound"] == (5.0, 4)
    assert changed["terminal_state"] == ([0.15, -0.1, 0.0, 0.0], None)
    out = run("show", "pendulum", "--set", "control_bound=4")[1]
    assert "control_bound = 5.0 (set: 4)" in out


def test_words_say_horizon_cost_bounds_ends_and_bands():
    words = " ".join(run("show", "double_integrator")[1].split())
    for part in ("200 steps of 0.02 s (4 s)", "u' R u", "at 0", "at 1", "0.3", "low pass", "5 Hz", "[m/s^2]"):
        assert part in words


@expensive
def test_keys_of_a_file_are_those_that_can_be_set(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("init", "cart.toml")[0] == 0
    summary = shown("cart.toml", "--set", "control_set.upper=4.0", "--set", "cost.Q=1.0")
    parameters = {one["name"]: (one["default"], one["value"]) for one in summary["parameters"]}
    assert parameters["horizon"] == (200, 200)
    assert parameters["control_set.upper"] == (5.0, 4.0)
    assert parameters["cost.Q"] == (None, 1.0)
    assert parameters["cutoff_hz"] == parameters["stage_rows"] == (None, None)
    assert parameters["state_set.lower"][0] == [None, -1.0]
    assert summary["about"] is None
    for name, (default, _) in parameters.items():  # each of them, given as it is shown, changes nothing
        if default is not None and name != "control_spectrum":
            raw = as_toml([float("-inf"), -1.0] if name == "state_set.lower" else default)
            raw = raw.replace('["none"', "[inf") if name == "state_set.upper" else raw
            assert shown("cart.toml", "--set", f"{name}={raw}")["states"] == shown("cart.toml")["states"]


def test_a_name_with_a_space_has_quotes_in_its_key(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("init", "cart.toml")[0] == 0
    words = ("cart.toml", "--set", 'dynamics.state_names=["load position [m]", "speed [m/s]"]')
    summary = shown(*words, "--set", 'initial_state={"load position" = 0.5, speed = 0.0}')
    parameters = {one["name"]: one["value"] for one in summary["parameters"]}
    key = 'initial_state."load position"'
    assert parameters[key] == 0.5
    low = shown(*words, "--set", "initial_state.speed=0.0", "--set", f"{key}=0.25")["states"][0]["initial"]
    assert low == [0.25, 0.25]


@pytest.mark.parametrize(
    "value",
    [1, 2.5, True, "text", None, [0.0, float("inf")], [[1.0, 2.0], [3.0, 4.0]], [{"kind": "low_pass", "bins": [1, 2]}]],
)
def test_a_value_is_shown_as_it_is_set(value):
    text = as_toml(value)
    assert "\n" not in text
    assert tomllib.loads(f"value = {text}")["value"] == ("none" if value is None else value)


def test_what_is_no_problem_is_not_shown():
    for arguments, word in ((("pendulun",), "Did you mean 'pendulum'?"), (("pendulum", "--set", "mass=1"), "mass")):
        status, out, err = run("show", *arguments)
        assert (status, out) == (2, "")
        assert word in err


@expensive
@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_printed(name):
    status, out, err = run("schema", name)
    assert (status, err) == (0, "")
    Draft202012Validator.check_schema(parsed(out))


def test_an_unknown_schema_is_answered_with_the_known_ones():
    status, _, err = run("schema", "problems")
    assert (status, all(name in err for name in SCHEMAS)) == (2, True)


def test_the_problem_file_of_a_library_problem_is_printed(tmp_path):
    status, out, err = run("show", "elliptic_rendezvous", "--toml", "--set", "horizon=30")
    assert (status, err) == (0, "")
    (tmp_path / "orbit.toml").write_text(out, encoding="utf-8")
    read = lfo.read_problem(tmp_path / "orbit.toml")
    assert read.linear.A.shape == (30, 4, 4)  # in the text itself
    assert problem_text(read) == problem_text(lfo.library.elliptic_rendezvous(horizon=30))


def test_only_one_form_is_printed():
    status, out, err = run("show", "pendulum", "--toml", "--json")
    assert (status, out) == (2, "")
    assert "--json, --toml and --out exclude each other" in err


def test_a_page_has_the_sketch_of_the_library(tmp_path):
    status, out, err = run("show", "pendulum", "--out", str(tmp_path / "page"), "--set", "horizon=100")
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert (status, err, out.strip()) == (0, "", f"page: {tmp_path / 'page' / 'index.html'}")
    assert 'aria-label="A cart on rails, pushed by a force, carries an inverted pendulum"' in page
    assert "horizon = 240 (set: 100)" in page
    assert "within ±0.34907; starts at 0.1; ends at -0.1" in page


def test_every_problem_of_the_library_has_a_sketch():
    assert set(lfo.library.SKETCHES) <= set(lfo.library.PROBLEMS)
    assert all(lfo.library.sketch_of(name).startswith("<svg") for name in lfo.library.PROBLEMS)
    assert lfo.library.sketch_of("cart") == ""  # the name of a sketch, and of no problem
