"""The command as a contract: keys and types of the JSON, arrays of the .npz, exit statuses, and what goes where."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from lin_freq_ocp.api.solve import ERRORS
from lin_freq_ocp.backends import clarabel_
from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.cli import app as cli
from lin_freq_ocp.methods.convex import sparse_program as convex
from lin_freq_ocp.methods.spectral import solver
from lin_freq_ocp.methods.spectral.algorithm.exchange import deadline

COMMAND = shutil.which("lin-freq-ocp", path=str(Path(sys.executable).parent)) or "lin-freq-ocp"
HARMLESS = ("--set", f"cutoff={np.pi!r}")
"""A low pass at the Nyquist frequency: it removes nothing, and says so in a warning."""


once = cache(run)
"""The same for runs that change nothing: each is made once."""


# --- the JSON -------------------------------------------------------------------------------------------------------

HEAD = {
    "schema": int,
    "version": str,
    "problem": {"name": str, "horizon": int, "state_dim": int, "control_dim": int, "sampling_time": (float, None)},
}
DIRECTION = {"slope": float, "residual": float, "time": int}
CERTIFICATE = {
    "descent": (DIRECTION, None),
    "borders": (dict, None),
    "pmp": str,
    "normal": (bool, None),
    "global": bool,
    "conditions": [
        {
            "label": str,
            "name": str,
            "residual": (float, None),
            "scale": (float, None),
            "tolerance": float,
            "passed": bool,
            "time": (int, None),
            "component": (int, None),
        }
    ],
}
VALUES = {"cost": (float, None), "lower_bound": (float, None), "gap": (float, None), "bound": (str, None)}
CERTIFY = {**HEAD, **VALUES, "certificate": CERTIFICATE}
TOO_WEAK = ("--set", "horizon=60", "--set", "control_bound=1")
"""An infeasible pendulum that is explained in less than the time there is for it."""

SOLVE = {
    **HEAD,
    **VALUES,
    "status": str,
    "primal": bool,
    "dual": bool,
    "method": str,
    "backend": (str, None),
    "seconds": {"setup": float, "solve": float, "certify": float},
    "certificate": (CERTIFICATE, None),
    "conflict": ([{"block": str, "share": float, "times": [int]}], None),
    "explanation": (
        {"family": [str], "irreducible": bool, "cures": [{"block": str, "amount": float, "words": str}]},
        None,
    ),
    "direction": (DIRECTION, None),
    "modes": ([int], None),
    "tree": ({"nodes": int, "leaves": int, "covers": bool}, None),
    "message": (str, None),
}
MEASURES = {
    "cost": (float, None),
    "max_control": float,
    "control_violation": float,
    "state_violation": (float, None),
    "stage_violation": (float, None),
    "terminal_error": (float, None),
    "terminal_errors": ([float], None),
    "stopband_energy": (float, None),
    "stopband_peak": (float, None),
    "state_stopband_energy": (float, None),
    "state_stopband_peak": (float, None),
    "amplification": float,
}
FILTERED = {**MEASURES, "description": str, "replay_meaningful": bool, "one_step_residual": [float]}
FILTERS = ("brickwall", "butterworth", "zero_phase", "moving_average", "clipped")


def compared(*filters: str):
    return {
        **SOLVE,
        "classical": (MEASURES, None),
        "constrained": (MEASURES, None),
        "filtered": dict.fromkeys(filters, FILTERED),
    }


def require(value, kind, place="$"):
    """Assert that a value is of a kind: a type, a list of one kind, a table of kinds, or a kind or None."""
    if isinstance(kind, tuple):
        if value is not None:
            require(value, kind[0], place)
    elif isinstance(kind, dict):
        assert isinstance(value, dict), place
        assert set(value) == set(kind), place
        for key, of_key in kind.items():
            require(value[key], of_key, f"{place}.{key}")
    elif isinstance(kind, list):
        assert isinstance(value, list), place
        for i, entry in enumerate(value):
            require(entry, kind[0], f"{place}[{i}]")
    else:
        assert type(value) is kind, f"{place}: {value!r}"


def require_words(summary):
    """Assert what the words and numbers of a summary may be, beyond their types."""
    assert summary["schema"] == 1
    assert summary["version"] == lfo.__version__
    assert summary.get("status", "optimal") in ("optimal", "locally_optimal", *ERRORS)
    if "method" in summary:
        assert summary["method"] in ("spectral", "convex")
        assert (summary["backend"] is None) == (summary["method"] == "spectral")
    assert summary["bound"] in ("rigorous", "numerical", None)
    assert (summary["bound"] is None) == (summary["lower_bound"] is None) == (summary["gap"] is None)
    if summary["gap"] is not None:
        cost = summary["cost"]
        assert summary["gap"] * abs(cost) == pytest.approx(cost - summary["lower_bound"], abs=1e-12 * abs(cost))
    certificate = summary["certificate"]
    if certificate is not None:
        assert certificate["pmp"] in ("satisfied", "violated", "not_applicable")
        for condition in certificate["conditions"]:
            assert condition["label"] in "C-i C-ii C-iii C-iv C-v C-vi C-vii S-x S-u N-x N-u".split()


UNCLOCKED = """
schema = 1
horizon = 6
initial_state = [1.0]
[dynamics]
A = [[1.0]]
B = [[1.0]]
[cost]
R = 1.0
P = 1.0
"""
UNBOUNDED = UNCLOCKED.replace("R = 1.0\nP = 1.0", "r = [1.0]")
ADRIFT = UNBOUNDED.replace("horizon = 6", "horizon = 60")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    (folder / "unclocked.toml").write_text(UNCLOCKED)
    (folder / "unbounded.toml").write_text(UNBOUNDED)
    (folder / "adrift.toml").write_text(ADRIFT)
    return folder


@pytest.mark.parametrize(
    ("arguments", "status", "word", "used"),
    [
        (("pendulum",), 0, "optimal", ("spectral", None)),
        (("pendulum", "--method", "spectral"), 0, "optimal", ("spectral", None)),
        (("pendulum", "--method", "convex"), 0, "optimal", ("convex", "clarabel")),
        (("pendulum", "--backend", "clarabel"), 0, "optimal", ("convex", "clarabel")),
        (("two_mass_spring",), 0, "optimal", ("spectral", None)),
        (("elliptic_rendezvous",), 0, "optimal", ("convex", "clarabel")),
        (
            ("pendulum", "--backend", "osqp", "--method", "convex", "--tolerance", "1e-8"),
            0,
            "optimal",
            ("convex", "osqp"),
        ),
        (("unclocked.toml",), 0, "optimal", ("spectral", None)),
        (("unclocked.toml", "--method", "convex"), 0, "optimal", ("convex", "clarabel")),
        (("pendulum", "--set", "control_bound=1"), 1, "infeasible", ("spectral", None)),
        (("pendulum", "--set", "control_bound=1", "--method", "convex"), 1, "infeasible", ("convex", "clarabel")),
        (("unbounded.toml",), 1, "unbounded", ("convex", "clarabel")),
        (("adrift.toml",), 1, "unbounded", ("convex", "clarabel")),
        (("pendulum", "--time-limit", "1e-3"), 3, "limit", ("spectral", None)),
        (("pendulum", "--time-limit", "1e-3", "--method", "convex"), 3, "limit", ("convex", "clarabel")),
        (("pendulum", "--time-limit", "1e-3", "--backend", "osqp"), 3, "limit", ("convex", "osqp")),
        (("pendulum", "--tolerance", "10", "--method", "spectral"), 3, "numerical_error", ("spectral", None)),
        (("pendulum", *HARMLESS), 0, "optimal", ("spectral", None)),
    ],
)
def test_json_of_solve(arguments, status, word, used, files, monkeypatch):
    monkeypatch.chdir(files)
    ended, out, err = once("solve", *arguments, "--json")
    summary = parsed(out)
    require(summary, SOLVE)
    require_words(summary)
    assert (ended, summary["status"]) == (status, word)
    assert (summary["method"], summary["backend"]) == used
    assert (summary["conflict"] is None) == (word != "infeasible")
    assert (summary["message"] is None) == (word == "optimal")
    assert summary["primal"] == (word == "optimal") or word == "numerical_error"
    assert (summary["certificate"] is None) == (word in ("infeasible", "unbounded")) == (summary["cost"] is None)
    if word == "optimal":
        assert summary["certificate"]["pmp"] == "satisfied"
        assert summary["certificate"]["normal"] is True
    assert err.startswith("warning: control_spectrum: low_pass") if HARMLESS[1] in arguments else err == ""


def test_a_method_that_cannot_take_the_problem_says_why(files, monkeypatch):
    """It is bad input: nothing was solved, so nothing is on stdout."""
    monkeypatch.chdir(files)
    status, out, err = run("solve", "unbounded.toml", "--method", "spectral", "--json")
    assert (status, out) == (2, "")
    assert "method 'spectral': neither Q nor R is above zero" in err
    assert "Use method 'convex'" in err


def test_an_answer_that_the_judge_rejects_is_not_proven(monkeypatch):
    """The default goes on to the sparse program; who asks for this method alone is told."""
    honest = solver.SpectralSolver.solve

    def spoiled(self, *given, **named):
        answer = honest(self, *given, **named)
        x, u = answer.trajectory.x, answer.trajectory.u
        return replace(answer, trajectory=lfo.Trajectory(x * (1 + 1e-3), u))

    monkeypatch.setattr(solver.SpectralSolver, "solve", spoiled)
    for method, expected in (("auto", (0, "convex", "satisfied")), ("spectral", (3, "spectral", "violated"))):
        status, out, _ = run("solve", "pendulum", "--method", method, "--json")
        summary = parsed(out)
        require(summary, SOLVE)
        require_words(summary)
        assert (status, summary["method"], summary["certificate"]["pmp"]) == expected


@pytest.mark.parametrize(("method", "backend"), [("spectral", None), ("convex", "clarabel")])
def test_json_of_solve_says_what_the_library_says(method, backend):
    summary = parsed(once("solve", "pendulum", "--method", method, "--json")[1])
    result = lfo.solve(lfo.library.pendulum(), method=method)
    certificate = result.certificate
    assert summary["problem"] == {
        "name": "pendulum",
        "horizon": 240,
        "state_dim": 4,
        "control_dim": 1,
        "sampling_time": 0.01,
    }
    assert summary["cost"] == pytest.approx(result.cost, rel=1e-12)
    assert summary["cost"] == pytest.approx(3199.18631986, rel=1e-8)
    assert summary["lower_bound"] == pytest.approx(result.lower_bound, rel=1e-12)
    assert (summary["bound"], summary["method"], summary["backend"]) == ("rigorous", method, backend)
    assert (summary["primal"], summary["dual"], summary["certificate"]["global"]) == (True, True, True)
    assert [(one["label"], one["name"], one["passed"]) for one in summary["certificate"]["conditions"]] == [
        (one.label, one.name, one.passed) for one in certificate.conditions
    ]
    assert [one["scale"] for one in summary["certificate"]["conditions"]] == pytest.approx(
        [one.scale for one in certificate.conditions]
    )


@pytest.mark.parametrize("method", ["auto", "convex"])
def test_json_of_an_infeasible_problem_names_the_conflict(method):
    summary = parsed(once("solve", "pendulum", *TOO_WEAK, "--method", method, "--json")[1])
    with pytest.raises(lfo.errors.InfeasibleError) as caught:
        lfo.solve(lfo.library.pendulum(horizon=60, control_bound=1), method=method)
    assert [one["block"] for one in summary["conflict"]] == [one.block for one in caught.value.result.conflict]
    assert [one["times"] for one in summary["conflict"]] == [list(one.times) for one in caught.value.result.conflict]
    said = caught.value.result.explanation
    assert summary["explanation"]["family"] == list(said.family)
    assert [one["words"] for one in summary["explanation"]["cures"]] == [one.words for one in said.cures]
    assert (summary["primal"], summary["dual"]) == (False, True)


@pytest.mark.parametrize(
    ("arguments", "filters", "status"),
    [
        (("pendulum",), FILTERS, 0),
        (("two_mass_spring", "--filters", " clipped , brickwall"), ("clipped", "brickwall"), 0),
        (("pendulum", "--filters", "brickwall", "--set", "sampling_time=0.1"), ("brickwall",), 0),
        (("unclocked.toml", "--filters", "zero_phase"), ("zero_phase",), 0),
        (("pendulum", "--filters", "brickwall", "--set", "control_bound=4.5"), ("brickwall",), 1),
        (("pendulum", "--filters", "brickwall", *HARMLESS), ("brickwall",), 0),
    ],
)
def test_json_of_compare(arguments, filters, status, files, monkeypatch):
    monkeypatch.chdir(files)
    ended, out, err = once("compare", *arguments, "--json")
    summary = parsed(out)
    require(summary, compared(*filters))
    require_words(summary)
    assert ended == status
    assert list(summary["filtered"]) == list(filters)
    assert (summary["constrained"] is None) == (summary["status"] == "infeasible") == (status == 1)
    assert err.startswith("warning: control_spectrum: low_pass") if HARMLESS[1] in arguments else err == ""


def test_json_of_compare_says_what_the_library_says():
    summary = parsed(once("compare", "pendulum", "--json")[1])
    comparison = lfo.compare(lfo.library.pendulum())
    assert summary["cost"] == pytest.approx(comparison.constrained.cost, rel=1e-12)
    for name in ("classical", "constrained"):
        measures = getattr(comparison, f"{name}_measures")
        for key in ("cost", "max_control", "stopband_peak", "amplification"):
            assert summary[name][key] == pytest.approx(getattr(measures, key), rel=1e-9)
    for one in comparison.filtered:
        found = summary["filtered"][one.name]
        assert found["description"] == one.description
        for key in ("cost", "max_control", "control_violation", "state_violation", "terminal_error", "stopband_peak"):
            assert found[key] == pytest.approx(getattr(one.replay.measures, key), rel=1e-6, abs=1e-9)


def test_json_of_a_replay_without_meaning_is_null():
    arguments = ("compare", "pendulum", "--filters", "brickwall", "--set", "sampling_time=0.1", "--json")
    brickwall = parsed(once(*arguments)[1])["filtered"]["brickwall"]
    assert brickwall["replay_meaningful"] is False
    for key in ("cost", "state_violation", "terminal_error", "terminal_errors"):
        assert brickwall[key] is None
    assert brickwall["amplification"] > 1e46


def test_json_of_compare_where_nothing_can_be_compared():
    """Even without its band the problem has no solution: that is an answer, and as JSON it is one object as ever."""
    ended, out, _ = run("compare", "pendulum", "--set", "control_bound=1", "--filters", "brickwall", "--json")
    summary = parsed(out)
    assert (ended, summary["status"]) == (1, "infeasible")
    assert set(summary) == set(compared())
    assert summary["conflict"]


# --- solutions: saved, certified, tampered with ---------------------------------------------------------------------

MULTIPLIERS = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Solve the pendulum on the command line; return the path of the solution."""
    path = tmp_path_factory.mktemp("saved") / "run.npz"
    status, _, err = run("solve", "pendulum", "--json", "--save", str(path))
    assert (status, err) == (0, "")
    return path


def with_fields(saved, path, **changes):
    with np.load(saved, allow_pickle=False) as file:
        fields = dict(file) | changes
    np.savez(path, **{name: value for name, value in fields.items() if value is not None})
    return str(path)


def test_arrays_of_a_saved_solution(saved):
    with np.load(saved, allow_pickle=False) as file:
        shapes = {name: file[name].shape for name in file.files}
        assert {file[name].dtype.kind for name in ("x", "u", "eta", "mu", "nu")} == {"f"}
        assert {file[name].dtype.kind for name in ("rho_u", "rho_x")} == {"c"}
        assert (int(file["schema"]), float(file["eta_C"])) == (1, 1.0)
        summary = parsed(str(file["summary"]))
    assert shapes == {
        "x": (241, 4),
        "u": (240, 1),
        "eta_C": (),
        "eta": (240, 4),
        "mu": (241, 4),
        "nu": (240, 1),
        "rho_u": (121, 1),
        "rho_x": (121, 4),
        "schema": (),
        "summary": (),
    }
    require(summary, SOLVE)
    solution = lfo.load(saved)
    assert lfo.library.pendulum().cost.value(solution.trajectory.x, solution.trajectory.u) == summary["cost"]


def test_a_saved_solution_is_certified(saved):
    status, out, err = run("certify", "pendulum", str(saved), "--json")
    summary = parsed(out)
    require(summary, CERTIFY)
    require_words(summary)
    assert (status, err) == (0, "")
    assert (summary["certificate"]["pmp"], summary["certificate"]["global"]) == ("satisfied", True)
    solution = lfo.load(saved)
    certificate = lfo.certify(lfo.library.pendulum(), solution.trajectory, solution.multipliers)
    assert (summary["cost"], summary["lower_bound"]) == (certificate.cost, certificate.lower_bound)
    status, out, err = run("certify", "pendulum", str(saved))
    assert (status, err) == (0, "")
    assert "maximum principle satisfied" in " ".join(out.split())


def test_a_trajectory_without_multipliers_is_certified(saved, tmp_path):
    path = with_fields(saved, tmp_path / "bare.npz", schema=None, summary=None, **dict.fromkeys(MULTIPLIERS))
    status, out, err = run("certify", "pendulum", path, "--json")
    assert (status, err) == (0, "")
    assert parsed(out)["certificate"]["pmp"] == "satisfied"


@pytest.mark.parametrize(
    ("field", "nudge", "fails"),
    [
        ("u", 0.01, {"C-iii", "C-v", "C-vii"}),
        ("x", 0.01, {"C-iii"}),
        ("eta", 10.0, {"C-iii"}),
        ("eta_C", -1.0, {"C-v"}),
    ],
)
def test_a_tampered_solution_is_not_proven(saved, tmp_path, field, nudge, fails):
    with np.load(saved, allow_pickle=False) as file:
        value = file[field].copy()
    value[(100, 0) if value.ndim else ()] += nudge
    path = with_fields(saved, tmp_path / "tampered.npz", **{field: value})
    status, out, _ = run("certify", "pendulum", path, "--json")
    certificate = parsed(out)["certificate"]
    assert (status, certificate["pmp"], certificate["global"]) == (3, "violated", False)
    failed = [one for one in certificate["conditions"] if not one["passed"]]
    assert fails <= {one["label"] for one in failed}
    if field == "u":
        assert next(one for one in failed if one["name"] == "state equation")["time"] == 100
    status, out, _ = run("certify", "pendulum", path)
    assert (status, "fails" in out) == (3, True)


def test_a_solution_of_another_cost_is_not_proven(saved):
    status, out, _ = run("certify", "pendulum", str(saved), "--set", "cutoff=2.4", "--json")
    assert status == 3
    assert not next(one for one in parsed(out)["certificate"]["conditions"] if one["label"] == "C-vii")["passed"]


def test_a_point_without_proof_is_saved_and_stays_without(tmp_path):
    path = str(tmp_path / "limit.npz")
    assert run("solve", "pendulum", "--time-limit", "1e-3", "--save", path)[0] == 3
    assert run("certify", "pendulum", path)[0] == 3


def test_without_a_trajectory_nothing_is_saved(tmp_path):
    path = tmp_path / "none.npz"
    assert run("solve", "pendulum", "--set", "control_bound=1", "--save", str(path))[0] == 1
    assert not path.exists()


# --- for people -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ((), ("list", "solve", "compare", "certify", "init", "--version")),
        (("list",), ()),
        (
            ("solve",),
            ("NAME|FILE.toml", "--set", "--method", "--backend", "--time-limit", "--tolerance", "--save", "--json"),
        ),
        (("compare",), ("NAME|FILE.toml", "--set", "--filters", "--out", "--json", *FILTERS)),
        (("certify",), ("NAME|FILE.toml", "SOLUTION.npz", "--json")),
        (("init",), ("FILE.toml",)),
    ],
)
def test_help_names_every_option(arguments, options):
    for flag in ("--help", "-h"):
        status, out, err = once(*arguments, flag)
        assert (status, err) == (0, "")
        for option in options:
            assert option in out


def test_version():
    assert once("--version") == (0, f"lin-freq-ocp, version {lfo.__version__}\n", "")


def test_list_shows_every_problem():
    status, out, err = once("list")
    assert (status, err) == (0, "")
    for name in lfo.library.PROBLEMS:
        assert name in out


SLOW = ("cart_pole_with_walls", "ball_and_paddle")
"""Problems of the library whose search takes minutes, or more than that."""


@pytest.mark.parametrize("name", lfo.library.LINEAR)
def test_every_linear_problem_of_the_library_is_proven(name):
    status, out, err = once("solve", name)
    assert (status, err) == (0, "")
    for words in ("status optimal", "theorem satisfied, normal", "global optimum", "maximum principle satisfied"):
        assert words in " ".join(out.split())


@pytest.mark.parametrize("name", [name for name in lfo.library.PIECEWISE_AFFINE if name not in SLOW])
def test_every_small_problem_with_modes_is_proven(name):
    status, out, err = once("solve", name)
    assert (status, err) == (0, "")
    for words in ("status optimal", "global optimum", "method branch_and_bound"):
        assert words in " ".join(out.split())


def test_a_conflict_is_shown():
    status, out, err = once("solve", "pendulum", *TOO_WEAK)
    assert (status, err) == (1, "")
    assert "conflict initial state, t = 0" in " ".join(out.split())
    assert "together initial state, terminal state" in " ".join(out.split())
    assert "cure control bound on" in " ".join(out.split())
    assert "control bound on force [N]" in " ".join(out.split())


def test_a_comparison_is_shown():
    status, out, err = once("compare", "pendulum", "--filters", "brickwall")
    assert (status, err) == (0, "")
    for words in ("status optimal", "brickwall", "classical", "5.858", "16.72"):
        assert words in " ".join(out.split())


@pytest.mark.parametrize("command", ["solve", "compare"])
def test_in_a_file_nothing_is_cut_off(command):
    """Where there is no terminal there is no edge: 3.6e-… would be no number, and a broken line no line."""
    out = once(command, "two_mass_spring")[1]
    assert "\N{HORIZONTAL ELLIPSIS}" not in out
    assert "0 control and 2 state bins removed (0 .. Nyquist)\n" in out


def test_a_fresh_file_is_solved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run("init", "my.toml")
    assert (status, out, err) == (0, "wrote my.toml; next: lin-freq-ocp solve my.toml\n", "")
    status, out, err = run("solve", "my.toml", "--save", "run.npz")
    assert (status, err) == (0, "")
    assert "cart: horizon 200" in out
    assert run("certify", "my.toml", "run.npz")[0] == 0
    assert sorted(os.listdir()) == ["my.toml", "run.npz"]


def test_settings_of_a_file_are_merged(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("init", "my.toml")
    given = ("horizon=150", "cost.R=3.0", "state_set={lower = [-inf, -2.0], upper = [inf, 2.0]}", "control_spectrum=[]")
    status, out, _ = run("solve", "my.toml", "--json", *(word for one in given for word in ("--set", one)))
    summary = parsed(out)
    assert (status, summary["problem"]["horizon"]) == (0, 150)
    assert summary["cost"] == pytest.approx(3 / 2 * 12 / 0.01**4 / (149 * 150 * 151), rel=1e-6)  # rest to rest


def test_settings_of_the_library():
    given = ("--set", "horizon=60", "--set", "cutoff_hz=4", "--set", "horizon=120", "--set", 'speed_bound="none"')
    summary = parsed(run("solve", "double_integrator", "--json", *given)[1])
    expected = lfo.solve(lfo.library.double_integrator(horizon=120, cutoff_hz=4, speed_bound=None))
    assert summary["problem"]["horizon"] == 120
    assert summary["cost"] == pytest.approx(expected.cost, rel=1e-12)


def test_a_problem_of_the_library_is_not_hidden_by_a_file_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("solve", "double_integrator", "--save", "double_integrator")[0] == 0
    assert run("certify", "double_integrator", "double_integrator")[0] == 0


def test_file_names_are_shown_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("[red]my.toml", ":smile:.toml"):
        assert run("init", name) == (0, f"wrote {name}; next: lin-freq-ocp solve {name}\n", "")


def test_names_within_a_problem_are_shown_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = UNCLOCKED.replace("schema = 1", 'schema = 1\nname = "[red]a[/blue]"')
    Path("p.toml").write_text(text.replace("[cost]", 'control_names = ["[/] [N]"]\n[cost]'))
    for command in ("solve", "compare"):
        status, out, err = run(command, "p.toml")
        assert (status, err) == (0, "")
        assert "[red]a[/blue]: horizon 6" in out
    assert "[/] [N]" in out


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
@pytest.mark.parametrize("arguments", [("list",), ("solve", "pendulum"), ("compare", "pendulum")])
def test_a_stream_that_cannot_show_every_character_is_no_obstacle(arguments, encoding):
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    with redirect_stdout(stream), pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert not ended.value.code
    assert b"pendulum" in stream.buffer.getvalue()


def test_an_optimum_of_zero_satisfies_the_principle(tmp_path, monkeypatch):
    """The cart may start where it is to end: nothing moves, nothing costs, and no multiplier is large."""
    monkeypatch.chdir(tmp_path)
    run("init", "my.toml")
    status, out, _ = run("solve", "my.toml", "--json", "--set", "initial_state={lower = [0, 0]}")
    summary = parsed(out)
    assert status == 0
    assert summary["cost"] == pytest.approx(0, abs=1e-12)
    assert summary["certificate"]["pmp"] == "satisfied"


# --- the report -----------------------------------------------------------------------------------------------------


def test_a_report_is_written_and_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run("compare", "pendulum", "--out", "some/report")
    page = Path("some/report/index.html")
    assert (status, err) == (0, "")
    assert f"report: {page}" in out
    assert "pendulum" in page.read_text(encoding="utf-8")


def test_a_report_does_not_disturb_the_json(tmp_path, monkeypatch):
    folders = []
    monkeypatch.setattr(lfo.results.Comparison, "save", lambda comparison, folder: folders.append(folder))
    status, out, _ = run(
        "compare", "pendulum", "--filters", "brickwall", "--out", str(tmp_path / "[red]report"), "--json"
    )
    require(parsed(out), compared("brickwall"))
    assert (status, folders) == (0, [tmp_path / "[red]report"])


# --- interrupted ----------------------------------------------------------------------------------------------------


def test_ctrl_c_while_nothing_is_known_yet(monkeypatch):
    def interrupted(*given, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr("lin_freq_ocp.cli.solve.solve", interrupted)
    status, out, err = run("solve", "pendulum", "--json")
    assert (status, out, err.strip()) == (130, "", "")


@pytest.mark.parametrize("passes", [0, 1])
def test_ctrl_c_keeps_the_best_point(monkeypatch, passes):
    """A program may be solved twice, in natural and then in revised units: the interrupt may come in either."""
    finished = []
    monkeypatch.setattr(convex, "ACCURATE", -1.0)
    monkeypatch.setattr(convex, "revised_scaling", lambda transcription, scaling, z: scaling)

    def impatient(program, tolerance, time_limit):
        answer = clarabel_.solve(program, tolerance, time_limit)
        finished.append(answer)
        return answer if len(finished) <= passes else Solution(Claim.INTERRUPTED, answer.z, answer.y, "interrupted")

    monkeypatch.setattr(convex, "backend", lambda name: impatient)
    status, out, _ = run("solve", "pendulum", "--method", "convex", "--json")
    summary = parsed(out)
    require(summary, SOLVE)
    require_words(summary)
    assert len(finished) == passes + 1
    assert summary["cost"] == pytest.approx(3199.186, rel=1e-3)
    assert status == 130


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
@pytest.mark.parametrize("method", ["auto", "spectral"])
def test_ctrl_c_acts_between_the_rounds_of_the_spectral_method(monkeypatch, method):
    """Each round's point is kept, with the bound that it proves; no other method begins after it."""
    optimum, last, bounds = 3199.18631986, solver.SpectralSolver(lfo.library.pendulum()).solve().rounds, []
    for rounds in range(1, last):
        asked = press_ctrl_c(monkeypatch, rounds)
        status, out, err = run("solve", "pendulum", "--method", method, "--json")
        summary = parsed(out)
        require(summary, SOLVE)
        require_words(summary)
        assert (status, err, len(asked)) == (130, "", rounds + 1)  # the round that stops, and who says why
        assert (summary["status"], summary["message"], summary["method"]) == ("limit", "interrupted", "spectral")
        assert summary["cost"] is not None
        if rounds == 1:  # its point is the first one, which knows of no bound yet
            assert summary["cost"] < optimum
            assert (summary["primal"], summary["certificate"]["global"]) == (False, False)
        bounds.append(summary["lower_bound"])
    assert 0 < min(bounds) <= max(bounds) < optimum


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
@pytest.mark.parametrize("method", ["auto", "spectral"])
def test_ctrl_c_after_the_last_round_is_not_lost(monkeypatch, method):
    """The answer is complete, and said to be; who waits for the exit status is told of Ctrl-C all the same."""
    recover = solver.recover

    def pressing(*found):
        signal.raise_signal(signal.SIGINT)
        return recover(*found)

    monkeypatch.setattr(solver, "recover", pressing)
    status, out, _ = run("solve", "pendulum", "--method", method, "--json")
    assert (status, parsed(out)["status"]) == (130, "optimal")


def press_ctrl_c(monkeypatch, rounds):
    """Send SIGINT in that round of the next spectral solve; return a list that grows with the rounds."""
    asked = []

    def pressing(seconds, interrupted):
        stop = deadline(seconds, interrupted)

        def pressed():
            asked.append(stop())
            if len(asked) == rounds:
                signal.raise_signal(signal.SIGINT)
            return stop()

        return pressed

    monkeypatch.setattr(solver, "deadline", pressing)
    return asked


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
def test_after_a_spectral_solve_ctrl_c_is_itself_again(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    press_ctrl_c(monkeypatch, 1)
    assert run("solve", "pendulum", "--json")[0] == 130
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
def test_an_interrupted_point_is_saved(monkeypatch, tmp_path):
    press_ctrl_c(monkeypatch, 1)
    path = str(tmp_path / "early.npz")
    status, out, err = run("solve", "pendulum", "--save", path, "--json")
    assert (status, err) == (130, "")
    monkeypatch.undo()
    solution, summary = lfo.load(path), parsed(out)
    assert lfo.library.pendulum().cost.value(solution.trajectory.x, solution.trajectory.u) == summary["cost"]
    status, out, err = run("certify", "pendulum", path, "--json")
    assert (status, parsed(out)["lower_bound"]) == (3, summary["lower_bound"])


# --- as real processes ----------------------------------------------------------------------------------------------


def test_the_whole_process(tmp_path):
    environment = os.environ | {"FORCE_COLOR": "1", "COLUMNS": "30"}
    done = subprocess.run(
        [COMMAND, "solve", "pendulum", "--json"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    summary = parsed(done.stdout)
    require(summary, SOLVE)
    assert summary["cost"] == pytest.approx(3199.18631986, rel=1e-8)
    assert os.listdir(tmp_path) == []


def test_a_reader_that_goes_away_is_no_obstacle():
    with subprocess.Popen([COMMAND, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert "Traceback" not in process.stderr.read()


@pytest.mark.skipif(os.name == "nt", reason="no SIGINT for one process")
@pytest.mark.parametrize(("backend", "horizon"), [("clarabel", 2000), ("osqp", 1000)])
def test_ctrl_c_in_the_middle_of_a_long_solve(backend, horizon, tmp_path):
    """The high pass removes nothing and so makes a warning, which tells us that the solve is about to begin."""
    slow = lfo.library.pendulum(horizon=horizon, terminal_state=(0.0, 0.0, 0.0, 0.0), cutoff=None)
    lfo.write_problem(slow, tmp_path / "slow.toml")
    with (tmp_path / "slow.toml").open("a") as file:
        for kind, cutoff in (("low_pass", 2.5), ("high_pass", 0.0)):
            file.write(f'\n[[control_spectrum]]\nkind = "{kind}"\ncutoff = {cutoff}\n')
    arguments = [COMMAND, "solve", "slow.toml", "--json", "--backend", backend]
    with subprocess.Popen(
        arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert "removes no bin" in process.stderr.readline()
            time.sleep(1.5)
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            clock = time.monotonic()
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert time.monotonic() - clock < 15
    assert (process.returncode, err.strip()) == (130, "")
    if out:  # nothing, if the solver had not yet begun
        summary = parsed(out)
        require(summary, SOLVE)
        assert summary["status"] == "limit"


def test_none_takes_a_value_away(tmp_path, monkeypatch):
    """In the library it is Python's None; in a file the key is gone."""
    monkeypatch.chdir(tmp_path)
    run("init", "my.toml")
    free = parsed(run("solve", "my.toml", "--json", "--set", 'terminal_state="none"')[1])
    assert free["cost"] == pytest.approx(0, abs=1e-9)
    limited = ("solve", "my.toml", "--json", "--set", "horizon=130")  # in so short a time the speed meets its limit
    unlimited = parsed(run(*limited, "--set", 'state_set="none"')[1])
    assert unlimited["cost"] < 0.99 * parsed(run(*limited)[1])["cost"]
    classical = parsed(run("solve", "pendulum", "--json", "--set", 'cutoff="none"')[1])
    assert classical["cost"] == pytest.approx(2852.70530277)


def test_it_is_said_that_nothing_was_saved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, err = run("solve", "pendulum", "--set", "control_bound=1", "--save", "run.npz")
    assert status == 1
    assert "nothing saved to run.npz" in err
    assert not Path("run.npz").exists()


def test_a_nearby_parameter_is_suggested():
    assert "Did you mean 'cutoff'?" in run("solve", "pendulum", "--set", "cutof=1")[2]
    assert run("solve", "pendulum", "--set", "")[0] == 2


def test_certify_says_whether_multipliers_are_unique_or_shows_a_descent(tmp_path):
    problem = ("double_integrator", "--set", "horizon=40", "--set", "sampling_time=0.1")
    status, _, _ = run("solve", *problem, "--save", str(tmp_path / "run.npz"))
    assert status == 0
    _, said, _ = run("certify", *problem, str(tmp_path / "run.npz"))
    assert "multipliers unique: the " in said
    (tmp_path / "constant.csv").write_text("acceleration [m/s^2]\n" + "0.1\n" * 40)
    status, said, _ = run("certify", *problem, str(tmp_path / "constant.csv"))
    assert "descent     no normal multipliers exist" in said
    assert status == 3
