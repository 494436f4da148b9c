"""A comparison shows what is found in its time: a plan that is not proven is filtered, too."""

from __future__ import annotations

from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.command_line import run
from helpers.seeds import expensive
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.comparison import SEARCH_SECONDS, compare_methods
from lin_freq_ocp.files import comparison_summary
from lin_freq_ocp.pages import finding_of
from lin_freq_ocp.results import Status


def wall():
    return lfo.library.pendulum_with_wall(horizon=6, control_spectrum=[3])


@pytest.fixture(scope="module")
def plan():
    return lfo.solve(lfo.library.pendulum_with_wall(horizon=6)).trajectory


def solving(found, asked=None, plan=None):
    """Return solve as far as it gets in time: ``found`` says of which problems it finds a point that is not proven."""

    def solve(problem, throw=True, **options):
        kind = "constrained" if problem.control_stop.any() else "classical"
        if asked is not None:
            asked.append((kind, options.get("time_limit"), options.get("start")))
        result = lfo.solve(problem, node_limit=1, throw=False)
        start = options.get("start")
        trajectory = plan if kind in found else start if isinstance(start, lfo.Trajectory) else None
        result = replace(result, status=Status.LIMIT, trajectory=trajectory, certificate=None, message="time limit")
        if throw:
            raise lfo.errors.LimitError("stopped in time", result)
        return result

    return solve


def test_filters_are_shown_beside_no_point(plan):
    comparison = compare_methods(wall(), solving(["classical"], plan=plan), ["brickwall", "clipped"], "auto", None)
    assert [one.name for one in comparison.filtered] == ["brickwall", "clipped"]
    assert comparison.constrained_solution is None
    assert str(comparison).splitlines()[-1] == "constrained  limit, no point found"
    assert "With the constraint in the problem: no point found (time limit)" in str(finding_of(comparison))
    summary = comparison_summary(comparison)
    assert summary["constrained"] is None
    assert set(summary["filtered"]) == {"brickwall", "clipped"}


def test_a_constrained_point_is_where_the_classical_search_begins(plan):
    asked = []
    comparison = compare_methods(wall(), solving(["constrained"], asked, plan), ["brickwall"], "auto", None)
    assert [kind for kind, *_ in asked] == ["classical", "constrained", "classical"]
    assert asked[-1][2] is plan
    assert comparison.classical_solution.trajectory is plan


def test_without_any_point_the_error_says_how_one_is_given():
    with pytest.raises(lfo.errors.LimitError, match="Nothing can be filtered: begin with a traj"):
        compare_methods(wall(), solving([]), ["brickwall"], "auto", None)


@expensive
@pytest.mark.parametrize(("given", "total"), [(None, SEARCH_SECONDS), (8.0, 8.0), (120.0, 120.0)])
def test_the_limit_is_one_for_both_solves(given, total, plan):
    asked = []
    with use_clock(Clock(0.5)):
        compare_methods(wall(), solving(["classical"], asked, plan), ["brickwall"], "auto", given)
    (_, first, _), (_, second, _) = asked
    assert first == pytest.approx((total - 0.5) / 2)
    assert second < total - 0.5


def test_linear_problems_have_no_limit_by_themselves():
    asked = []

    def solve(problem, **options):
        asked.append(options["time_limit"])
        return lfo.solve(problem, **options)

    compare_methods(lfo.library.double_integrator(cutoff_hz=3.0), solve, ["brickwall"], "auto", None)
    assert asked == [None, None]


def test_the_command_begins_with_a_trajectory(tmp_path):
    words = ("pendulum_with_wall", "--set", "horizon=6", "--set", "control_spectrum=[3]", "--filters", "brickwall")
    file = tmp_path / "start.npz"
    lfo.solve(lfo.library.pendulum_with_wall(horizon=6)).save(file)
    status, out, _ = run("compare", *words, "--start", str(file))
    assert status == 0
    assert "brickwall" in out
    status, _, err = run("compare", *words, "--start", str(tmp_path / "none.npz"))
    assert status == 2
    assert "none.npz" in err
