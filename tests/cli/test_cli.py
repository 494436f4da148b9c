"""The command for people: its words and files, its reports, and the command as a real process."""

from __future__ import annotations

import io
import logging
import os
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import click
import pytest
from scipy.io import savemat

import lin_freq_ocp as lfo
from helpers.command_json import FILTERS, SOLVE, TOO_WEAK, UNCLOCKED, compared, require
from helpers.command_line import COMMAND, once, parsed, run
from helpers.compared_pages import blanks
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp import cli
from lin_freq_ocp.cli import BAD_INPUT, COMMANDS

# --- for people -----------------------------------------------------------------------------------------------------


def test_matplotlib_says_nothing_of_its_font_cache(caplog):
    run("--version")
    logging.getLogger("matplotlib.font_manager").warning("Matplotlib is building the font cache")
    assert not caplog.records


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


def test_an_unknown_command_names_the_nearest():
    status, out, err = run("slove", "pendulum")
    assert (status, out) == (BAD_INPUT, "")
    assert "No such command 'slove'. Did you mean 'solve'?" in err


def test_list_shows_every_problem():
    status, out, err = once("list")
    assert (status, err) == (0, "")
    for name in lfo.library.PROBLEMS:
        assert name in out


SLOW = ("cart_pole_with_walls", "ball_and_paddle")
"""Problems of the library whose search takes minutes, or more than that."""


@pytest.mark.parametrize("name", seeds(lfo.library.LINEAR))
def test_every_linear_problem_of_the_library_is_proven(name):
    status, out, err = once("solve", name)
    assert (status, err) == (0, "")
    for words in ("status optimal", "theorem satisfied, normal", "global optimum", "maximum principle satisfied"):
        assert words in " ".join(out.split())


@pytest.mark.parametrize("name", seeds([name for name in lfo.library.PIECEWISE_AFFINE if name not in SLOW]))
def test_every_small_problem_with_modes_is_proven(name):
    status, out, err = once("solve", name)
    assert (status, err) == (0, "")
    for words in ("status optimal", "global optimum", "method branch_and_bound"):
        assert words in " ".join(out.split())


def test_a_conflict_is_shown():
    status, out, err = once("solve", "pendulum", *TOO_WEAK)
    assert (status, err) == (1, "")
    assert "ray initial state, t = 0" in " ".join(out.split())
    assert "conflict initial state, terminal state" in " ".join(out.split())
    assert "repair control bound on" in " ".join(out.split())
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
    assert "2 of 404 state bins removed\n" in out


def test_a_fresh_file_is_solved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run("init", "my.toml")
    assert (status, out, err) == (0, "wrote my.toml; next: lin-freq-ocp solve my.toml\n", "")
    status, out, err = run("solve", "my.toml", "--save", "run.npz")
    assert (status, err) == (0, "")
    assert "cart: horizon 200" in out
    assert run("certify", "my.toml", "run.npz")[0] == 0
    assert sorted(os.listdir()) == ["my.toml", "run.npz"]


def test_a_file_with_a_plant_of_yours_is_solved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    savemat(
        "plant.mat", {"A": [[0.0, 1.0], [-4.0, -0.1]], "B": [[0.0], [1.0]], "Ts": 0.0, "StateName": ["angle", "speed"]}
    )
    (tmp_path / "frf.csv").write_text("frequency [Hz];magnitude [dB];phase [deg]\n0;0;0\n2,5;-3;-45\n5;-20;0\n")
    assert run("init", "a.toml", "--plant", "plant.mat", "--sampling-time", "0.05")[0] == 0
    assert run("init", "b.toml", "--response", "frf.csv")[0] == 0
    assert run("init", "c.toml", "--response", "frf.csv", "--sampling-time", "0.05")[0] == 0
    for name, horizon, state in (("a", 100, "angle"), ("b", 4, "x_0"), ("c", 8, "x_0")):
        problem = lfo.read_problem(f"{name}.toml")
        assert (problem.horizon, problem.state_names[0]) == (horizon, state)
        assert run("solve", f"{name}.toml")[0] == 0
    outside = "# The response is 0 outside the frequencies of the table, 0 .. 5 Hz.\n"
    assert [outside in (tmp_path / f"{name}.toml").read_text() for name in "abc"] == [False, False, True]
    assert abs(lfo.read_problem("c.toml").dynamics.G[:, 0, 0]).round(3).tolist() == [1, 0.708, 0.1, 0, 0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--plant", "none.mat"), "none.mat: got no such file"),
        (("--response", "none.csv"), "none.csv: got no such file"),
        (("--plant", "a.mat", "--response", "b.csv"), "plant, response: got both; expected one of them"),
        (("--sampling-time", "0.1"), "sampling_time: got 0.1; expected none without a plant or a response"),
        (
            ("--response", "../frf.csv"),
            "got a file in another folder; expected a file in the folder of the problem file",
        ),
        (("--response", "one.csv"), "expected at least two that increase"),
    ],
)
def test_plants_that_cannot_be_taken_are_named(tmp_path, monkeypatch, given, message):
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path / "sub")
    (tmp_path / "frf.csv").write_text("f,re,im\n0,1,0\n1,0,0\n")
    (tmp_path / "sub" / "one.csv").write_text("f,re,im\n1,1,0\n")
    status, out, err = run("init", "my.toml", *given)
    assert (status, out) == (2, "")
    assert message in " ".join(err.split())
    assert not (tmp_path / "sub" / "my.toml").exists()


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
    substitute(monkeypatch, "pages.draw_figures", lambda _: blanks())
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


@expensive
def test_a_reader_that_goes_away_is_no_obstacle():
    with subprocess.Popen([COMMAND, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert "Traceback" not in process.stderr.read()


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
    status, _, err = run("solve", "pendulum", *TOO_WEAK, "--save", "run.npz")
    assert status == 1
    assert "nothing saved to run.npz" in err
    assert not Path("run.npz").exists()


def test_a_nearby_parameter_is_suggested():
    assert "Did you mean 'cutoff'?" in run("solve", "pendulum", "--set", "cutof=1")[2]
    assert run("solve", "pendulum", "--set", "")[0] == 2


def test_the_help_imports_no_command():
    """It would take a second. The first line of each command is read from its source."""
    text = "import sys\nfrom lin_freq_ocp.cli import main\ntry: main(['-h'])\nexcept SystemExit: print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True).stdout
    help_text, _, modules = shown.rpartition("\n  schema")
    assert not {"numpy", "lin_freq_ocp.cli.solve", "lin_freq_ocp.cli.show"} & set(modules.split())
    words = " ".join(help_text.split())
    for name in list(COMMANDS)[:-1]:
        command = cli.cli.get_command(click.Context(cli.cli), name)
        assert f"{name} {command.help.partition(chr(10))[0]}" in words


def test_the_library_is_listed_by_field():
    names = [name for field in lfo.library.FIELDS.values() for name in field.split()]
    assert sorted(names) == sorted(set(names) & set(lfo.library.PROBLEMS))
    lines = once("list")[1].splitlines()
    assert [line.rstrip() for line in lines if not line.startswith(" ")][: len(lfo.library.FIELDS)] == [
        *lfo.library.FIELDS
    ]
    assert len(lines) >= len(lfo.library.PROBLEMS) + len(lfo.library.FIELDS)
    assert next(line for line in lines if "quarter_car" in line).split(maxsplit=1)[1].startswith("Cross a bump")
