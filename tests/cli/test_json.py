"""The JSON of solve and compare as a contract: keys, types, and the numbers of the library."""

from __future__ import annotations

from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.command_json import FILTERS, HARMLESS, SOLVE, TOO_WEAK, UNCLOCKED, compared, require, require_words
from helpers.command_line import once, parsed, run
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.methods.structured import can_compile

UNBOUNDED = UNCLOCKED.replace("R = 1.0\nP = 1.0", "r = [1.0]")
ADRIFT = UNBOUNDED.replace("horizon = 6", "horizon = 60")

LAST = ("structured", None) if can_compile() else ("convex", "clarabel")  # of the methods that auto tries


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    (folder / "unclocked.toml").write_text(UNCLOCKED)
    (folder / "unbounded.toml").write_text(UNBOUNDED)
    (folder / "adrift.toml").write_text(ADRIFT)
    return folder


@expensive
@pytest.mark.parametrize(
    ("arguments", "status", "word", "used"),
    [
        (("pendulum",), 0, "optimal", ("spectral", None)),
        (("pendulum", "--method", "spectral"), 0, "optimal", ("spectral", None)),
        (("pendulum", "--method", "convex"), 0, "optimal", ("convex", "clarabel")),
        (("pendulum", "--backend", "clarabel"), 0, "optimal", ("convex", "clarabel")),
        (("two_mass_spring",), 0, "optimal", ("spectral", None)),
        (("elliptic_rendezvous",), 0, "optimal", LAST),
        (
            ("pendulum", "--backend", "osqp", "--method", "convex", "--tolerance", "1e-8"),
            0,
            "optimal",
            ("convex", "osqp"),
        ),
        (("unclocked.toml",), 0, "optimal", ("spectral", None)),
        (("unclocked.toml", "--method", "convex"), 0, "optimal", ("convex", "clarabel")),
        (("pendulum", *TOO_WEAK, "--method", "auto"), 1, "infeasible", ("spectral", None)),
        (("pendulum", *TOO_WEAK, "--method", "convex"), 1, "infeasible", ("convex", "clarabel")),
        (("unbounded.toml",), 1, "unbounded", ("convex", "clarabel")),
        (("adrift.toml",), 1, "unbounded", ("convex", "clarabel")),
        (("pendulum", "--time-limit", "1e-9"), 3, "limit", ("spectral", None)),
        (("pendulum", "--time-limit", "1e-9", "--method", "convex"), 3, "limit", ("convex", "clarabel")),
        (("pendulum", "--time-limit", "1e-9", "--backend", "osqp"), 3, "limit", ("convex", "osqp")),
        (("pendulum", "--tolerance", "10", "--method", "spectral"), 0, "optimal", ("spectral", None)),
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


@expensive
def test_an_answer_that_the_judge_rejects_is_not_proven(monkeypatch):
    """The default goes on to other methods; who asks for this method alone is told."""
    honest = lfo.SpectralSolver.solve

    def spoiled(self, *given, **named):
        answer = honest(self, *given, **named)
        x, u = answer.trajectory.x, answer.trajectory.u
        return replace(answer, trajectory=lfo.Trajectory(x * (1 + 1e-3), u))

    monkeypatch.setattr(lfo.SpectralSolver, "solve", spoiled)
    substitute(monkeypatch, "methods.repair_trajectory", lambda *given: None)
    substitute(monkeypatch, "methods.corrections", lambda *given: ())
    for method, expected in (("auto", (0, LAST[0], "satisfied")), ("spectral", (3, "spectral", "violated"))):
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
    ended, out, _ = run("compare", "pendulum", *TOO_WEAK, "--filters", "brickwall", "--json")
    summary = parsed(out)
    assert (ended, summary["status"]) == (1, "infeasible")
    assert set(summary) == set(compared())
    assert summary["conflict"]
