"""A run in a file: it comes back as it was, is repeated, and what differs is said."""

from __future__ import annotations

import getpass
import json
import platform
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.command_line import parsed, run
from helpers.problem_files import assert_same, everything_at_once
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import cli
from lin_freq_ocp.api import SAME_COST, Rerun
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.files import dump_run, result_summary

CART = lfo.OptimalControlProblem(
    dynamics=lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], sampling_time=0.1),
    horizon=20,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-5, 5),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=3),
    name="cart",
)
WEAK = replace(CART, control_set=lfo.Box(-0.1, 0.1))
DRIFTING = replace(CART, cost=lfo.QuadraticCost(r=[1.0]), control_set=None, terminal_state=None, control_spectrum=None)


def rewritten(path, name, change):
    """Replace what stands in a file of the archive by what ``change`` makes of it; None takes the file away."""
    with zipfile.ZipFile(path) as archive:
        files = {one: archive.read(one) for one in archive.namelist()}
    files[name] = change(files.get(name))
    with zipfile.ZipFile(path, "w") as archive:
        for one, content in files.items():
            if content is not None:
                archive.writestr(one, content)


def changed(path, **keys):
    """Replace keys of run.json, dotted ones as ``summary__cost``."""

    def change(text):
        table = json.loads(text)
        for key, value in keys.items():
            *above, last = key.split("__")
            inner = table
            for one in above:
                inner = inner[one]
            inner[last] = value
        return json.dumps(table)

    rewritten(path, "run.json", change)


# --- there and back -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"method": "convex", "backend": "osqp", "time_limit": 60, "tolerance": 1e-7},
        {"method": "spectral", "time_limit": np.int64(60), "tolerance": np.float32(1e-9)},
    ],
)
def test_a_run_comes_back_and_is_repeated(tmp_path, options):
    result = lfo.solve(CART, **options)
    result.dump(tmp_path / "run.zip")
    loaded = lfo.load_run(tmp_path / "run.zip")
    assert_same(CART, loaded.problem)
    assert loaded.options == {"method": "auto", "backend": "auto", "time_limit": None, "tolerance": None} | options
    assert loaded.options == result.options
    assert loaded.summary == result_summary(result)
    assert (loaded.solution.trajectory.x == result.trajectory.x).all()
    assert (loaded.solution.multipliers.rho_u == result.multipliers.rho_u).all()
    assert loaded.error is None
    assert loaded.environment["packages"]["numpy"] == np.__version__
    again = loaded.solve()
    assert (again.status, again.method, again.backend) == ("optimal", result.method, result.backend)
    assert again.cost == pytest.approx(result.cost, rel=1e-12)


@pytest.fixture
def ticking():
    """Give a clock by which two looks take two seconds."""
    with use_clock(Clock(1.0)):
        yield


@expensive
@pytest.mark.parametrize(
    ("problem", "options", "error", "status"),
    [
        (WEAK, {}, lfo.errors.InfeasibleError, "infeasible"),
        (DRIFTING, {}, lfo.errors.UnboundedError, "unbounded"),
        (lfo.library.pendulum(), {"time_limit": 2.0}, lfo.errors.LimitError, "limit"),
        (
            lfo.library.pendulum(),
            {"tolerance": 10.0, "method": "convex", "backend": "osqp"},
            lfo.errors.NumericalError,
            "numerical_error",
        ),
    ],
)
def test_the_result_of_an_error_can_be_dumped(tmp_path, ticking, monkeypatch, problem, options, error, status):
    substitute(monkeypatch, "methods.repair_trajectory", lambda *given: None)
    substitute(monkeypatch, "methods.corrections", lambda *given: ())
    with pytest.raises(error) as caught:
        lfo.solve(problem, **options)
    caught.value.result.dump(tmp_path / "run.zip")
    loaded = lfo.load_run(tmp_path / "run.zip")
    assert loaded.summary["status"] == status
    assert (loaded.solution is None) == (caught.value.result.trajectory is None)
    assert loaded.solve().status == status
    with pytest.raises(error):
        loaded.solve(throw=True)


def test_large_arrays_are_in_the_archive(tmp_path):
    problem = everything_at_once(60)
    dump_run(tmp_path / "run.zip", problem, {}, error=lfo.errors.UnsupportedError("not yet"))
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        assert sorted(archive.namelist()) == ["problem.problem.npz", "problem.toml", "run.json"]
    loaded = lfo.load_run(tmp_path / "run.zip")
    assert_same(problem, loaded.problem)
    assert (loaded.summary, loaded.solution) == (None, None)
    assert loaded.error == {"type": "UnsupportedError", "message": "not yet", "places": []}


def test_a_dump_says_nothing_of_who_and_where(tmp_path, monkeypatch):
    """Neither does an error that was raised in a folder with somebody's name."""
    monkeypatch.chdir(tmp_path)

    def failing(*given):
        open("/home/somebody/data.npz")

    substitute(monkeypatch, "program.backend", failing)
    with pytest.raises(FileNotFoundError):
        cli.cli.main(["solve", "pendulum", "--method", "convex", "--dump", "run.zip"], standalone_mode=False)
    with zipfile.ZipFile("run.zip") as archive:
        text = "".join(archive.read(name).decode() for name in archive.namelist())
    assert lfo.load_run("run.zip").error["places"][-1].startswith(f"{__name__}:")
    assert "No such file" in text
    names = {getpass.getuser(), platform.node(), "somebody", str(Path.home()), sys.prefix, str(tmp_path), "/"}
    for name in names:
        assert name not in text.replace("[m/s]", "").replace("[rad/s]", ""), name


# --- the command line -----------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for problem, name in ((CART, "cart"), (WEAK, "weak"), (DRIFTING, "drifting")):
        lfo.write_problem(problem, f"{name}.toml")
    return tmp_path


@expensive
@pytest.mark.parametrize(
    ("arguments", "status", "word"),
    [
        (("cart.toml",), 0, "optimal"),
        (("weak.toml",), 1, "infeasible"),
        (("drifting.toml",), 1, "unbounded"),
        (("pendulum", "--time-limit", "2"), 3, "limit"),
        (("cart.toml", "--backend", "osqp", "--tolerance", "1e-7"), 0, "optimal"),
    ],
)
def test_what_is_dumped_is_repeated(folder, ticking, arguments, status, word):
    ended, out, err = run("solve", *arguments, "--dump", "run.zip", "--json")
    assert (ended, err) == (status, "")
    assert lfo.load_run("run.zip").summary == parsed(out)
    ended, out, err = run("rerun", "run.zip")
    assert (ended, err) == (status, "")
    assert f"status {word} {word}" in " ".join(out.split())
    assert out.endswith("the same\n")
    ended, out, _ = run("rerun", "run.zip", "--json")
    summary = parsed(out)
    assert ended == status
    assert summary["then"]["status"] == summary["now"]["status"] == word
    assert (summary["differences"], summary["environment"]) == ([], {})


def test_costs_are_compared_unless_both_stopped_at_a_limit():
    """How far a run came before its limit is a matter of the machine."""
    then = {"status": "limit", "cost": 1.0, "theorem": False, "method": "spectral", "backend": None, "error": None}
    assert Rerun(None, None, then, then | {"cost": 2.0}, {}, {}).differences == ()
    assert Rerun(None, None, then, then | {"method": "convex"}, {}, {}).differences == ("method",)
    solved = then | {"status": "optimal"}
    assert Rerun(None, None, then, solved, {}, {}).differences == ("status",)
    assert Rerun(None, None, solved, solved | {"cost": 2.0}, {}, {}).differences == ("cost",)


def test_a_run_that_is_refused_is_dumped(folder):
    status, _, err = run("solve", "drifting.toml", "--method", "spectral", "--dump", "run.zip")
    assert (status, lfo.load_run("run.zip").summary) == (2, None)
    assert lfo.load_run("run.zip").error["message"] in err
    status, out, err = run("rerun", "run.zip")
    assert (status, err) == (2, "")
    assert "UnsupportedError: method 'spectral'" in out
    assert out.endswith("the same\n")


def test_an_option_that_is_refused_is_kept(folder):
    assert run("solve", "cart.toml", "--tolerance", "0", "--dump", "run.zip")[0] == 2
    assert lfo.load_run("run.zip").options["tolerance"] == 0
    assert run("rerun", "run.zip")[1].endswith("the same\n")


def test_a_run_that_breaks_down_is_dumped(folder, monkeypatch):
    """It breaks down again, until the fault is mended."""

    def broken(*given):
        raise IndexError("index 3 is out of bounds")

    substitute(monkeypatch, "program.backend", broken)
    assert run("solve", "cart.toml", "--method", "convex", "--dump", "run.zip")[0] == 70
    assert lfo.load_run("run.zip").error["places"][-1].endswith("broken")
    status, out, _ = run("rerun", "run.zip")
    assert (status, out.splitlines()[-1]) == (70, "the same")
    assert out.count("IndexError: index 3 is out of bounds") == 2
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    status, out, _ = run("rerun", "run.zip")
    assert (status, out.splitlines()[-1]) == (0, "differs: status, cost, theorem, method, backend, error")


def test_what_differs_is_said(folder):
    run("solve", "cart.toml", "--dump", "run.zip")
    cost = lfo.load_run("run.zip").summary["cost"]
    changed("run.zip", summary__cost=cost * (1 + 0.5 * SAME_COST))
    assert run("rerun", "run.zip")[1].endswith("the same\n")
    changed("run.zip", summary__cost=cost * (1 + 2 * SAME_COST), environment__packages={"numpy": "1.0"})
    changed("run.zip", summary__method="convex", environment__system="Plan 9")
    _, out, _ = run("rerun", "run.zip")
    assert out.endswith("differs: cost, method\n")
    assert f"numpy 1.0 {np.__version__}" in " ".join(out.split())
    assert f"system Plan 9 {platform.system()}" in " ".join(out.split())
    summary = parsed(run("rerun", "run.zip", "--json")[1])
    assert summary["differences"] == ["cost", "method"]
    assert summary["environment"]["numpy"] == ["1.0", np.__version__]
    assert summary["now"]["cost"] == pytest.approx(cost, rel=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--dump", "nowhere/run.zip"), "--dump nowhere/run.zip: got a file in a folder that does not exist"),
        (("--dump", "."), "--dump .: got a folder"),
        (("--dump", "cart.toml"), "--dump cart.toml: got the problem's own file"),
        (("--dump", "a", "--save", "./a"), "--dump a: got the file of --save"),
    ],
)
def test_a_dump_that_cannot_be_written_is_refused_at_once(folder, options, words):
    before = Path("cart.toml").read_bytes()
    status, out, err = run("solve", "cart.toml", *options)
    assert (status, out) == (2, "")
    assert words in err
    assert Path("cart.toml").read_bytes() == before


# --- what is no run -------------------------------------------------------------------------------------------------


@pytest.fixture
def dumped(folder):
    lfo.solve(CART).dump("run.zip")
    return Path("run.zip")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (
            "run.json",
            lambda text: None,
            "run.zip: got an archive without run.json; expected a file that lin-freq-ocp solve --dump wrote",
        ),
        ("problem.toml", lambda text: None, "run.zip: got an archive without problem.toml"),
        ("run.json", lambda text: text[:-3], "run.zip: run.json: JSON syntax: got"),
        ("run.json", lambda text: b"[" * 10**6, "run.zip: run.json: JSON syntax: got"),
        ("run.json", lambda text: b"\xff", "run.zip: run.json: JSON syntax: got"),
        ("run.json", lambda text: b"[]", "run.zip: run.json: run: got []; expected a table"),
        ("run.json", lambda text: b"{}", "run.zip: run.json: run.schema: got nothing"),
        ("problem.toml", lambda text: text.replace(b"horizon = 20", b"horizon = -1"), "run.zip: problem.toml: horizon"),
        ("problem.toml", lambda text: text.replace(b"horizon = 20", b"horizon = 21"), "solution.npz: trajectory: got"),
        ("solution.npz", lambda text: b"no archive", "solution.npz, unreadable"),
    ],
)
def test_a_bad_archive_is_refused_with_file_and_place(dumped, name, change, words):
    rewritten(dumped, name, change)
    status, out, err = run("rerun", "run.zip")
    assert (status, out) == (2, "")
    assert words in err


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"schema": 2}, "schema: got 2; expected 1"),
        ({"options__method": 3}, "options.method: got 3"),
        ({"options__tolerance": "small"}, "options.tolerance: got 'small'"),
        ({"options__speed": 3}, "options.speed: got an unknown key"),
        ({"options": None}, "options: got None; expected a table"),
        ({"environment": None}, "environment: got None; expected a table"),
        ({"summary": []}, "summary: got []; expected a table"),
        ({"error": "text"}, "error: got 'text'; expected a table"),
    ],
)
def test_a_bad_run_is_refused_with_its_key(dumped, keys, words):
    changed(dumped, **keys)
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.load_run(dumped)
    assert str(caught.value).startswith(f"run.zip: run.json: {words}")


@expensive
@pytest.mark.parametrize(
    "keys",
    [
        {"summary": {}, "environment": {}},
        {"summary__certificate": [], "summary__seconds": {"solve": "long"}, "summary__cost": "much"},
        {"environment__packages": 3, "environment__blas": {"a": 1}, "error": {}},
    ],
)
def test_what_a_stranger_wrote_there_is_shown_as_it_is(dumped, keys):
    changed(dumped, **keys)
    status, out, err = run("rerun", "run.zip")
    assert (status, err) == (0, "")
    assert "cost" in out


def test_what_is_no_archive_is_refused(folder):
    Path("text.zip").write_text("no archive")
    for name, words in (("none.zip", "got no such file"), (".", "got a directory"), ("text.zip", "got unreadable")):
        status, out, err = run("rerun", name)
        assert (status, out) == (2, "")
        assert f"error: {name}: {words}" in err


def test_only_the_files_of_a_run_are_taken_out(dumped):
    before = sorted(Path().absolute().parent.rglob("*"))
    with zipfile.ZipFile(dumped, "a") as archive:
        for name in ("../evil.txt", "/tmp/evil.txt", "evil.txt"):
            archive.writestr(name, "evil")
    assert lfo.load_run(dumped).solve().status == "optimal"
    assert sorted(Path().absolute().parent.rglob("*")) == before
    rewritten(dumped, "problem.toml", lambda text: text + b'\n[state_set]\nlower = {npz = "../evil.npz", key = "A"}\n')
    with pytest.raises(lfo.errors.ProblemError, match="expected the name of a file in the folder"):
        lfo.load_run(dumped)


def test_a_damaged_archive_is_refused_or_read(dumped):
    whole, rng = dumped.read_bytes(), np.random.default_rng(8)
    for _ in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=3):
            damaged[place] = rng.integers(256)
        dumped.write_bytes(damaged[: rng.integers(len(whole) // 2, 2 * len(whole))])
        try:
            lfo.load_run(dumped)
        except lfo.errors.ProblemError:
            continue
