"""The shortest moves of input shapers beside that of the problem: lengths, vibrations, and where they do not apply."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.compared_pages import blanks, moved
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.comparison import boxes_of, remember_zero, shortest_moves, vibration, why_not_shaped
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.pages import draw_figures, moves_rows, moves_sentence, render_page, ringing_of
from lin_freq_ocp.results import Status
from lin_freq_ocp.solving import solve_judged

CALM = lfo.ResidualVibration(frequency=(18.0, 22.0), damping=(0.02, 0.1), limit=0.5)


@pytest.fixture
def comparison():
    return moved()


@expensive
def test_no_shaper_is_shorter_and_every_move_is_calm(comparison):
    moves = comparison.moves
    assert [(move.name, move.samples) for move in moves.all] == [
        ("unshaped", 18), ("ZV", 45), ("ZVD", 28), ("EI", 28), ("optimal", 22)
    ]  # fmt: skip
    assert moves.proof
    assert moves.unshaped.ratio > 10
    assert not moves.unshaped.keeps_everything
    for move, shown in zip((*moves.shaped, moves.ours), ringing_of(moves, 0)[1:], strict=True):
        assert move.keeps_everything
        frequencies = np.linspace(18.0, 22.0, 101)
        largest = vibration(shown.box, shown.trajectory, frequencies).max()
        assert 0.99 * 0.5 * move.ratio <= largest <= 0.5 * move.ratio
        x = lfo.simulate(move.measured.problem, move.measured.trajectory.u).x
        assert x[-1] == pytest.approx([0.02, 0.0], abs=1e-9)
        assert np.abs(x[:, 1]).max() <= 0.5 + 1e-9
        assert np.abs(move.measured.trajectory.u).max() <= 10 + 1e-9


@expensive
def test_a_move_that_breaks_a_bound_is_none_of_a_shaper(comparison):
    move = comparison.moves.shaped[1]
    at = move.measured.problem
    slower = replace(at, state_set=lfo.Box([-1, -0.1], [1, 0.1]))
    assert not replace(move, measured=replace(move.measured, problem=slower)).keeps_everything
    loud = replace(move, peaks=(replace(move.peaks[0], ratio=1 + 1e-6),))
    assert not loud.keeps_everything


@expensive
def test_words_table_and_page(comparison):
    words = moves_sentence(comparison.moves)
    assert "ZV 45, ZVD 28 and EI 28" in words
    assert "22 samples are enough, and 21 are proven not to be" in words
    rows = moves_rows(comparison.moves)
    assert rows.columns == ("unshaped", "ZV", "ZVD", "EI", "optimal")
    (group,) = rows.groups
    assert [cell.text for cell in group.rows[0].cells] == ["18", "45", "28", "28", "22"]
    assert [cell.passed for cell in group.rows[3].cells] == [False, True, True, True, True]
    drawings = tuple(draw_figures(comparison))
    (drawing,) = (one for one in drawings if one.name == "vibration")
    assert 'aria-label="Residual vibration over the natural frequency: ZV, ZVD, EI and optimal' in drawing.inline
    page = render_page(comparison, drawings)
    assert "Shortest moves at the same residual vibration" in page
    assert "0.5471 at t = 0, 0.4529 at t = 5" in page
    assert "ZV " in str(comparison)


@expensive
def test_a_shaper_without_a_move_is_said_to_have_none(monkeypatch):
    substitute(monkeypatch, "comparison.LONGEST_PROFILE", 2)
    problem = lfo.library.printer_move(30, vibration_bound=0.002)
    moves = lfo.compare(problem, ["ZV"]).moves
    (move,) = moves.shaped
    assert (move.measured, move.ratio, move.samples) == (None, None, 2 * 18 + 4)
    assert "ZV more than 40" in moves_sentence(moves)
    assert "> 40" in [cell.text for cell in moves_rows(moves).groups[0].rows[0].cells]


@expensive
def test_of_long_moves_not_every_length_is_tried(monkeypatch, comparison):
    substitute(monkeypatch, "comparison.TRIED", 6)
    (move,) = lfo.compare(lfo.library.printer_move(24, vibration_bound=0.3), ["EI"]).moves.shaped
    assert (move.samples - 28) % 9 == 0
    assert move.description.endswith("; profiles tried are 9 samples apart")
    assert "tried" not in comparison.moves.shaped[0].description


@expensive
def test_a_numerical_ray_is_no_proof():
    """Rounding may decide whether a ray is rigorous: here all rays of the solver are numerical."""

    def solve(problem, any_point):
        outcome = solve_judged(problem, any_point=any_point)
        return replace(outcome, status=Status.INFEASIBLE_CLAIMED) if outcome.status == Status.INFEASIBLE else outcome

    moves = shortest_moves(lfo.library.printer_move(14, distance=2e-3, vibration_bound=2.0), solve, ["ZV"])
    assert 1 < moves.unshaped.samples < moves.ours.samples
    assert moves.ours.measured is not None
    assert not moves.proof
    assert "proven" not in moves_sentence(moves)


def test_where_shapers_do_not_apply():
    free = lfo.library.double_integrator(horizon=40, sampling_time=0.04, cutoff_hz=None)
    assert "no control" in why_not_shaped(free)
    swing = lfo.library.two_mass_spring(horizon=40, notch_width_hz=None, initial_state=(0.0, 0.5, 0.0, 0.0))
    ringing = replace(swing, control_spectrum=CALM, terminal_state=None)
    assert "does not stay" in why_not_shaped(ringing)
    with pytest.raises(ProblemError, match="'ZV'; expected a problem that input shapers apply to"):
        lfo.compare(ringing, ["ZV"])
    varying = replace(free, control_set=[lfo.Box(-1.0, 1.0)] * 40, control_spectrum=CALM)
    assert "control_set" in why_not_shaped(varying)
    with pytest.raises(ProblemError, match=r"some of brickwall.*ZV, ZVD, EI"):
        lfo.compare(free, ["ZVDD"])


@expensive
def test_shapers_for_two_modes_of_a_rate_limited_move():
    """They are convolved, and shape profiles that start after a control of zero and end with one."""
    fast = lfo.ResidualVibration(frequency=(33.0, 35.0), damping=(0.02, 0.05), limit=0.5)
    printer = replace(lfo.library.printer_move(40), control_spectrum=[CALM, fast])
    problem = lfo.rate_limited(printer, 3.0, previous=[0.0])
    assert why_not_shaped(problem) == ""
    moves = lfo.compare(problem, ["ZVD"]).moves
    (move,) = moves.shaped
    assert move.keeps_everything
    assert move.description.count("at t =") == 9
    assert moves.unshaped.samples < moves.ours.samples < move.samples
    assert moves.proof
    u = move.measured.trajectory.u
    assert np.abs(np.diff(u, axis=0, prepend=0.0)).max() <= 3.0 + 1e-9
    assert u[-1] == pytest.approx(0.0, abs=1e-9)
    boxes = boxes_of(move.measured.problem)
    assert [tuple(box.low) for box in boxes] == [(18.0, 0.02), (33.0, 0.02)]
    for box in boxes:
        largest = vibration(box, move.measured.trajectory, np.linspace(box.low[0], box.high[0], 101)).max()
        assert largest <= 0.5 * move.ratio * (1 + 1e-9)


def test_only_states_that_remember_controls_are_zero_at_the_ends():
    printer = lfo.library.printer_move()
    assert remember_zero(printer) is printer
    limited = lfo.rate_limited(printer, 3.0, previous=[1.0])
    zeroed = remember_zero(limited)
    assert (zeroed.initial_box.lower[2], zeroed.initial_box.upper[2]) == (1.0, 1.0)  # where zero is not admissible
    assert (zeroed.terminal_box.lower[2], zeroed.terminal_box.upper[2]) == (0.0, 0.0)
    assert np.array_equal(zeroed.terminal_box.lower[:2], limited.terminal_box.lower[:2])


@expensive
def test_one_line_says_why_no_shaper_applies():
    swing = lfo.library.two_mass_spring(horizon=40, notch_width_hz=None, initial_state=(0.0, 0.5, 0.0, 0.0))
    ringing = lfo.compare(replace(swing, control_spectrum=CALM, terminal_state=None))
    assert ringing.moves is None
    assert "input shapers do not apply: with a control of zero the state does not stay" in " ".join(
        str(ringing).split()
    )
    assert "input shapers do not apply: with a control of zero" in render_page(ringing, blanks())
    of_states = replace(lfo.library.printer_move(40), control_spectrum=None, state_spectrum=replace(CALM, component=1))
    assert lfo.compare(of_states).shaper_obstacle == "no control has a bound on its residual vibration"
    for problem in (lfo.library.double_integrator(), lfo.library.printer_move(horizon=24)):
        assert lfo.compare(problem, ["clipped"]).shaper_obstacle == ""


def test_the_command_says_why_no_shaper_applies(tmp_path):
    swing = lfo.library.two_mass_spring(horizon=40, notch_width_hz=None, initial_state=(0.0, 0.5, 0.0, 0.0))
    lfo.write_problem(replace(swing, control_spectrum=CALM, terminal_state=None), tmp_path / "move.toml")
    status, out, _ = run("compare", str(tmp_path / "move.toml"))
    assert status == 0
    assert "Input shapers do not apply: with a control of zero" in " ".join(out.split())


@expensive
def test_the_command_prints_both_tables(monkeypatch):
    made = lfo.compare(lfo.library.printer_move(uncertainty=0.05), ["ZVD"])
    substitute(monkeypatch, "compare", lambda *given: made)
    given = ["compare", "printer_move", "--set", "uncertainty=0.05", "--filters", "ZVD"]
    status, out, _ = run(*given)
    assert status == 0
    assert "Shortest moves at the same residual vibration" in out
    status, out, _ = run(*given, "--json")
    moves = parsed(out)["moves"]
    assert (status, list(moves)) == (0, ["unshaped", "ZVD", "optimal"])
    assert (moves["ZVD"]["samples"], moves["optimal"]["samples"]) == (28, 21)
