"""The move of a printer's axis: its least horizon, its parameters, and the command line."""

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.seeds import expensive
from lin_freq_ocp.library import printer_move


@expensive
def test_the_default_is_the_shortest_calm_move():
    result = lfo.solve(printer_move())
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert abs(result.gap) < 1e-7
    shorter = lfo.solve(printer_move(21), throw=False)
    assert (shorter.status, shorter.message) == ("infeasible", "proven by a rigorous ray")
    assert lfo.solve(printer_move(18, vibration_bound=None)).status == "optimal"


def test_the_box_is_that_of_the_parameters():
    problem = printer_move(resonance_hz=30.0, uncertainty=0.2, damping=(0.0, 0.05), vibration_bound=0.3)
    (box,) = (term.semi_infinite for term in problem.terms)
    assert (box.low, box.high) == (pytest.approx([24.0, 0.0]), pytest.approx([36.0, 0.05]))
    assert box.limit == 0.3
    assert printer_move(vibration_bound=None).control_spectrum is None


@expensive
def test_minimum_time_from_the_command_line():
    status, out, _ = run("minimum-time", "printer_move", "--horizons", "20", "24", "--json")
    found = parsed(out)
    assert status == 0
    assert (found["horizon"], found["proven"], found["monotone"]) == (22, True, True)


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("resonance_hz", {"resonance_hz": 0.0}),
        ("uncertainty", {"uncertainty": 1.0}),
        ("uncertainty", {"uncertainty": [0.1, 0.2]}),
        ("distance", {"distance": -1.0}),
        ("speed_bound", {"speed_bound": -1.0}),
        ("ResidualVibration.damping", {"damping": (0.5, 1.0)}),
        ("ResidualVibration.limit", {"vibration_bound": 0.0}),
    ],
)
def test_bad_parameters_are_named(field, given):
    with pytest.raises(lfo.errors.ProblemError, match=f"^{field}"):
        printer_move(**given)


def test_it_is_known_by_its_name():
    assert lfo.library.by_name("printer_move") is lfo.library.WAVEFORMS["printer_move"] is printer_move
    assert printer_move().name == "printer_move"
