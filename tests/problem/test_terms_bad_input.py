"""Bad nonsmooth costs, masks, energies, equations, outputs and sets are refused by the field, with what would be right.

A case is what is made, the field, and words of what was got and of what was expected.
"""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo

DYNAMICS = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]], control_names=["force [N]"])


def problem(**fields) -> lfo.OptimalControlProblem:
    """Return a cart, n = 2, m = 1, T = 8."""
    return lfo.OptimalControlProblem(
        **({"dynamics": DYNAMICS, "horizon": 8, "cost": lfo.QuadraticCost(R=1.0), "initial_state": [1, 0]} | fields)
    )


def controls(*given) -> lfo.OptimalControlProblem:
    return problem(control_spectrum=list(given))


def states(given) -> lfo.OptimalControlProblem:
    return problem(state_spectrum=given)


def mask(*limit, **fields) -> lfo.MagnitudeBound:
    return lfo.MagnitudeBound(*limit, **({"bins": [1]} | fields))


def outputs(C=None, D=None, constraints=None, names=None) -> lfo.spectrum.OutputSpectrum:
    return lfo.spectrum.OutputSpectrum(C, D, lfo.low_pass(1) if constraints is None else constraints, names)


Windows = lfo.spectrum.Spectrogram
L1, LInf, Quadratic = lfo.costs.L1Cost, lfo.costs.LInfCost, lfo.QuadraticCost
Mask, Energy, Equation, Rows = (
    lfo.MagnitudeBound,
    lfo.spectrum.EnergyBound,
    lfo.spectrum.LinearConstraint,
    lfo.StageRows,
)
Ball, Box, Soft = lfo.sets.Ball, lfo.Box, lfo.sets.Soft
BALL_3, BOX_3 = Ball(1, [0, 0, 0]), Box([0, 0, 0], 1)
NO_COST = "QuadraticCost, L1Cost, LInfCost, SmoothCost, or a sum of them"

COSTS = {
    "negative": (lambda: L1(u=-1), "L1Cost.u", "-1", "zero or above"),
    "one negative": (lambda: LInf(x=[1, -2]), "LInfCost.x", "[1, -2]", "zero or above"),
    "negative at the end": (lambda: LInf(terminal=-0.5), "LInfCost.terminal", "-0.5", "zero or above"),
    "text": (lambda: L1(u="a"), "L1Cost.u", "'a'", "numbers"),
    "nan": (lambda: L1(x=[0, np.nan]), "L1Cost.x[1]", "nan", "a finite number"),
    "infinite": (lambda: LInf(u=np.inf), "LInfCost.u", "inf", "a finite number"),
    "controls": (lambda: problem(cost=L1(u=[1, 2])), "cost.norms[0].u", "(2,)", "shape (1,), or (8, 1)"),
    "states": (lambda: problem(cost=LInf(x=[1, 2, 3])), "cost.norms[0].x", "(3,)", "shape (2,), or (8, 2)"),
    "times": (lambda: problem(cost=L1(x=np.ones((9, 2)))), "cost.norms[0].x", "(9, 2)", "shape (2,), or (8, 2)"),
    "end": (lambda: problem(cost=L1(terminal=np.ones((9, 2)))), "cost.norms[0].terminal", "(9, 2)", "shape (2,)"),
    "x_ref": (lambda: problem(cost=L1(x=1, x_ref=np.ones((8, 2)))), "cost.norms[0].x_ref", "(8, 2)", "(9, 2)"),
    "u_ref": (lambda: problem(cost=L1(u=1, u_ref=np.ones((9, 1)))), "cost.norms[0].u_ref", "(9, 1)", "(8, 1)"),
    "in a sum": (lambda: problem(cost=Quadratic(R=1) + L1(x=[1])), "cost.norms[0].x", "(1,)", "shape (2,)"),
    "no cost in a sum": (lambda: Quadratic(R=1) + 3, "cost", "3", NO_COST),
    "no cost in a norm's sum": (lambda: L1(u=1) + "a", "cost", "'a'", NO_COST),
    "no cost": (lambda: lfo.costs.CostSum([L1(u=1), None]), "cost", "None", NO_COST),
    "number plus cost": (lambda: 1 + L1(u=1), "cost", "1", NO_COST),
    "false plus cost": (lambda: False + Quadratic(), "cost", "False", NO_COST),
    "no list": (lambda: lfo.costs.CostSum(L1(u=1)), "cost", "L1Cost(", "a list of costs"),
    "nothing": (lambda: lfo.costs.CostSum(None), "cost", "None", "a list of costs"),
    "two quadratic": (lambda: Quadratic(R=1) + L1(u=1) + Quadratic(Q=1), "cost", "two quadratic", "Add their matrices"),
    "a list as cost": (lambda: problem(cost=[L1(u=1)]), "cost", "[L1Cost(", NO_COST),
}

MASKS = {
    "no limit": (lambda: mask(), "MagnitudeBound.limit", "no limit", "exactly one of amplitude, rms, percent"),
    "two limits": (
        lambda: mask(1, limit_db=0, reference=1),
        "MagnitudeBound.limit",
        "limit and limit_db",
        "exactly one",
    ),
    "no reference": (lambda: mask(limit_db=0), "MagnitudeBound.reference", "None", "a value with db or limit_db"),
    "idle reference": (lambda: mask(1, reference=1), "MagnitudeBound.reference", "1", "only with it"),
    "reference 0": (lambda: mask(limit_db=0, reference=0), "MagnitudeBound.reference", "0", "above zero"),
    "references": (lambda: mask(limit_db=0, reference=[1, 2]), "MagnitudeBound.reference", "[1, 2]", "one number"),
    "negative": (lambda: mask(-1), "MagnitudeBound.limit", "-1", "zero or above"),
    "one negative": (lambda: mask([1, -1]), "MagnitudeBound.limit", "[1, -1]", "zero or above"),
    "a matrix": (lambda: mask([[1]]), "MagnitudeBound.limit", "[[1]]", "one for each bin"),
    "a matrix in dB": (lambda: mask(limit_db=[[1]], reference=1), "MagnitudeBound.limit_db", "[[1]]", "each bin"),
    "text": (lambda: mask("a"), "MagnitudeBound.limit", "'a'", "numbers"),
    "-inf dB": (lambda: mask(limit_db=-np.inf, reference=1), "MagnitudeBound.limit_db", "-inf", "finite"),
    "limits": (lambda: controls(mask([1, 2, 3])), "control_spectrum[0].limit", "(3,)", "one number, or 1"),
    "limits of a pair": (lambda: controls(mask([1, 2], bins=[1, 7])), "control_spectrum[0].bins", "[1, 7]", "0 .. 4"),
    "limits out of order": (lambda: states(mask([1, 2], bins=[3, 1])), "state_spectrum.bins", "[3, 1]", "increasing"),
    "window": (lambda: mask(1, window="magic"), "MagnitudeBound.window", "'magic'", "a window of scipy.signal"),
    "window's length": (lambda: states(mask(1, window=np.ones(8))), "state_spectrum.window", "(8,)", "shape (9,)"),
    "window's shape": (
        lambda: controls(lfo.low_pass(2), mask(1, window=np.ones((8, 1)))),
        "control_spectrum[1].window",
        "(8, 1)",
        "shape (8,), one per sample",
    ),
    "two places": (lambda: mask(1, band=lfo.low_pass(1)), "MagnitudeBound", "both", "exactly one of them"),
    "no place": (lambda: Mask(1), "MagnitudeBound", "neither of bins and band", "exactly one of them"),
    "no band": (lambda: Mask(1, band=[3, 4]), "MagnitudeBound.band", "[3, 4]", "a band"),
    "no bins": (lambda: Mask(1, bins=[]), "stop_band.bins", "[]", "at least one whole number"),
    "fractional bins": (lambda: Mask(1, bins=[1.5]), "stop_band.bins", "[1.5]", "whole number"),
    "bins out of range": (lambda: controls(mask(1, bins=[9])), "control_spectrum[0].bins", "bin 9", "bins 0 .. 7"),
    "component twice": (
        lambda: Mask(1, band=lfo.low_pass(1, component=0), component="force"),
        "MagnitudeBound.component",
        "'force', and 0 from the band",
        "one component",
    ),
    "component": (lambda: controls(mask(1, component=1)), "control_spectrum[0].component", "1", "an index 0 or"),
    "component's name": (
        lambda: controls(mask(1, component="pull")),
        "control_spectrum[0].component",
        "'pull'",
        "'force",
    ),
    "hertz without a clock": (
        lambda: controls(Mask(1, band=lfo.low_pass(cutoff_hz=1))),
        "control_spectrum[0].band",
        "low_pass(0 .. 1 Hz)",
        "a sampling time",
    ),
    "penalty": (lambda: mask(1, penalty=0), "MagnitudeBound.penalty", "0", "above zero"),
    "oversampling": (lambda: mask(1, oversampling=1.5), "MagnitudeBound.oversampling", "1.5", "a whole number"),
}

SPECTROGRAMS = {
    "a band": (lambda: Windows(lfo.low_pass(1)), "Spectrogram.bound", "Band(", "a MagnitudeBound or an EnergyBound"),
    "hop alone": (lambda: Windows(mask(1), hop=2), "Spectrogram.hop", "2", "a length"),
    "hop": (lambda: Windows(mask(1), 4, 0), "Spectrogram.hop", "0", "a whole number"),
    "length": (lambda: Windows(mask(1), 2.5), "Spectrogram.length", "2.5", "a whole number"),
    "long hop": (lambda: Windows(mask(1), 4, 5), "Spectrogram.hop", "5", "at most the length of a window, 4"),
    "offset": (lambda: Windows(mask(1), 4, offset=-1), "Spectrogram.offset", "-1", "a whole number"),
    "past": (lambda: Windows(mask(1), past=[[[1.0]]]), "Spectrogram.past", "(1, 1, 1)", "(P, components)"),
    "empty past": (lambda: Windows(mask(1), past=[]), "Spectrogram.past", "(0,)", "(P, components)"),
    "unknown past": (lambda: Windows(mask(1), past=[np.nan]), "Spectrogram.past[0]", "nan", "finite"),
    "components": (
        lambda: states(Windows(mask(1), past=[1, 2])),
        "state_spectrum.past",
        "shape (2, 1)",
        "shape (2, 2)",
    ),
    "too long": (
        lambda: controls(Windows(mask(1), 9)),
        "control_spectrum[0].length",
        "9 samples",
        "at least one window",
    ),
    "bins": (lambda: controls(Windows(mask(1, bins=[5]), 4)), "control_spectrum[0].bound.bins", "bin 5", "0 .. 3"),
    "limits": (lambda: controls(Windows(mask([1, 2]), 4)), "control_spectrum[0].bound.limit", "(2,)", "or 1"),
}

ENERGIES_AND_EQUATIONS = {
    "negative": (lambda: Energy(-1, bins=[1]), "EnergyBound.limit", "-1", "zero or above"),
    "energies": (lambda: Energy([1, 2], bins=[1]), "EnergyBound.limit", "[1, 2]", "one number"),
    "no energy": (lambda: Energy(None, bins=[1]), "EnergyBound.limit", "no limit", "exactly one of rms, amplitude"),
    "infinite": (lambda: Energy(np.inf, bins=[1]), "EnergyBound.limit", "inf", "finite"),
    "no place": (lambda: Energy(1), "EnergyBound", "neither of bins and band", "exactly one of them"),
    "window": (lambda: Energy(1, bins=[1], window="magic"), "EnergyBound.window", "'magic'", "scipy.signal"),
    "window's length": (lambda: states(Energy(1, bins=[1], window=[1, 2])), "state_spectrum.window", "(2,)", "(9,)"),
    "component twice": (
        lambda: Energy(1, band=lfo.spectrum.notch(1, 0.5, component="x_0"), component=0),
        "EnergyBound.component",
        "0, and 'x_0' from the band",
        "one component",
    ),
    "one matrix": (lambda: Equation(np.ones((8, 1))), "LinearConstraint.coefficients", "(8, 1)", "per time"),
    "no rows": (lambda: Equation(np.ones((8, 0, 1))), "LinearConstraint.coefficients", "(8, 0, 1)", "per time"),
    "constants": (lambda: Equation(np.ones((8, 2, 1)), [1]), "LinearConstraint.constant", "(1,)", "(2,)"),
    "infinite coefficient": (
        lambda: Equation(np.full((8, 1, 1), np.inf)),
        "LinearConstraint.coefficients[0][0][0]",
        "inf",
        "a finite number",
    ),
    "0 = 1": (lambda: Equation(np.zeros((8, 1, 1)), [1]), "LinearConstraint.constant", "1 for row 0", "can hold"),
    "price": (lambda: Equation(np.ones((8, 1, 1)), penalty=-1), "LinearConstraint.penalty", "-1", "above zero"),
    "times": (
        lambda: controls(Equation(np.ones((9, 1, 1)))),
        "control_spectrum[0].coefficients",
        "(9, 1, 1)",
        "(8, 1, 1)",
    ),
    "components": (
        lambda: states(Equation(np.ones((9, 2, 1)))),
        "state_spectrum.coefficients",
        "(9, 2, 1)",
        "(9, 2, 2)",
    ),
    "soft rows without a price": (
        lambda: Rows([[1, 0]], None, [1], penalty=0),
        "stage_rows.penalty",
        "0",
        "above zero",
    ),
    "a price per row": (lambda: Rows([[1, 0]], None, [1], penalty=[1]), "stage_rows.penalty", "[1]", "one number"),
    "price in words": (
        lambda: Rows([[1, 0]], None, [1], penalty="hard"),
        "stage_rows.penalty",
        "'hard'",
        "one number above zero",
    ),
}

OUTPUTS = {
    "no matrix": (lambda: outputs(), "output_spectrum", "neither C nor D", "a matrix C or D, or both"),
    "a vector": (lambda: outputs([1, 0]), "output_spectrum", "(2,)", "one row per output"),
    "no rows": (lambda: outputs(np.zeros((0, 2))), "output_spectrum", "(0, 2)", "one row per output"),
    "rows differ": (lambda: outputs([[1, 0]], [[1], [1]]), "output_spectrum", "(1, 2), (2, 1)", "one row per output"),
    "nan": (lambda: outputs([[0, np.nan]]), "output_spectrum.C[0][1]", "nan", "a finite number"),
    "no constraint": (lambda: lfo.spectrum.OutputSpectrum([[1, 0]]), "output_spectrum.constraints", "nothing", "bands"),
    "a number": (lambda: outputs([[1, 0]], None, 3), "output_spectrum.constraints", "3", "bands, MagnitudeBound"),
    "an equation": (
        lambda: outputs([[1, 0]], None, [Equation(np.ones((8, 1, 1)))]),
        "output_spectrum.constraints",
        "LinearConstraint",
        "bands, MagnitudeBound or EnergyBound",
    ),
    "names": (lambda: outputs([[1, 0]], names=["a", "b"]), "output_spectrum.output_names", "['a', 'b']", "1 different"),
    "columns of C": (lambda: problem(output_spectrum=outputs([[1, 0, 0]])), "output_spectrum.C", "(1, 3)", "2 columns"),
    "columns of D": (lambda: problem(output_spectrum=outputs(None, [[1, 0]])), "output_spectrum.D", "(1, 2)", "1 col"),
    "a band alone": (
        lambda: problem(output_spectrum=lfo.low_pass(1)),
        "output_spectrum",
        "Band(",
        "OutputSpectrum, a list",
    ),
    "component": (
        lambda: problem(output_spectrum=outputs([[1, 0]], None, lfo.low_pass(1, component="tip"), ["hip [m]"])),
        "output_spectrum.constraints[0].component",
        "'tip'",
        "an index 0 or one of 'hip [m]'",
    ),
    "among controls": (
        lambda: controls(outputs([[1, 0]])),
        "control_spectrum[0]",
        "OutputSpectrum(",
        "a band, Magnitude",
    ),
    "a set among controls": (
        lambda: controls(Ball(1)),
        "control_spectrum[0]",
        "Ball(",
        "EnergyBound or LinearConstraint",
    ),
}

SETS = {
    "states": (
        lambda: problem(state_set=lfo.sets.Polyhedron(np.eye(3), [1, 1, 1])),
        "state_set",
        "3 dim",
        "a set in 2",
    ),
    "controls": (lambda: problem(control_set=Ball(1, [0, 0])), "control_set", "2 dimensions", "a set in 1"),
    "start": (lambda: problem(initial_state=BALL_3), "initial_state", "3 dimensions", "a set in 2"),
    "end": (
        lambda: problem(terminal_state=lfo.sets.Ellipsoid(np.eye(3))),
        "terminal_state",
        "3 dimensions",
        "a set in 2",
    ),
    "a new end": (lambda: problem().with_ends(terminal_state=BALL_3), "terminal_state", "3 dimensions", "a set in 2"),
    "cone": (
        lambda: problem(terminal_state=lfo.sets.SecondOrderCone(np.eye(3), [0, 0, 0], [0, 0, 0], 1)),
        "terminal_state",
        "3 dimensions",
        "a set in 2",
    ),
    "soft": (lambda: problem(state_set=Soft(BOX_3, 1.0)), "state_set", "3 dimensions", "a set in 2"),
    "intersection": (lambda: problem(state_set=Ball(1) & BOX_3), "state_set", "3 components", "bounds for 2"),
    "one of many": (lambda: problem(control_set=[Ball(1)] * 7 + [BALL_3]), "control_set[7]", "3 dim", "a set in 1"),
    "too many": (lambda: problem(control_set=[Ball(1)] * 9), "control_set", "a sequence of 9", "8 sets, one per time"),
    "too few": (lambda: problem(state_set=[Ball(1)] * 8), "state_set", "a sequence of 8", "9 sets, one per time"),
    "one is none": (lambda: problem(control_set=[Ball(1)] * 7 + [3]), "control_set", "3 at place 7", "8 sets, one"),
    "a number": (lambda: problem(control_set=3), "control_set", "3", "a set such as Box or Polyhedron"),
    "a class": (lambda: problem(control_set=Ball), "control_set", "<class", "a set such as Box or Polyhedron"),
    "starts": (lambda: problem(initial_state=[Ball(1), Ball(2)]), "initial_state", "[Ball(", "a set, or None"),
    "start per time": (
        lambda: problem(initial_state=Box(np.zeros((9, 2)), 1) & Ball(1)),
        "initial_state",
        "per time",
        "a point",
    ),
    "a band": (lambda: problem(terminal_state=lfo.low_pass(1)), "terminal_state", "Band(", "a set, or None"),
    "a ball for bounds": (lambda: Box(Ball(1), 1), "Box.lower", "Ball(", "numbers"),
    "a box for rows": (lambda: lfo.sets.Polyhedron(Box(0, 1), [1]), "Polyhedron.F", "Box(", "numbers"),
    "a set for rows": (
        lambda: problem(stage_rows=Ball(1)),
        "stage_rows",
        "Ball(",
        "StageRows, PathConstraint, a sequence of them",
    ),
    "boxes apart": (
        lambda: Box(0, 1) & Box(2, 3),
        "Intersection",
        "2 <= v <= 1",
        "a point within the bounds of all sets",
    ),
    "boxes of other times": (
        lambda: Box(np.zeros((8, 1)), 1) & Box(np.zeros((9, 1)), 1),
        "Intersection",
        "bounds for 8 and 9 times",
        "the same times for all",
    ),
    "and a number": (lambda: Box(0, 1) & 3, "Intersection", "3", "sets such as Box"),
    "soft and soft": (lambda: Soft(Soft(Ball(1), 1.0), 1.0), "Soft", "Soft(", "a Box, Polyhedron, Ball or Ellipsoid"),
    "no price": (lambda: Soft(Ball(1), None), "Soft.penalty", "None", "one number above zero"),
}

ALL = {
    f"{group}: {case}": given
    for group, cases in {
        "cost": COSTS,
        "mask": MASKS,
        "energy and equation": ENERGIES_AND_EQUATIONS,
        "spectrogram": SPECTROGRAMS,
        "output": OUTPUTS,
        "set": SETS,
    }.items()
    for case, given in cases.items()
}


@pytest.mark.parametrize("case", ALL)
def test_what_is_wrong_is_refused_by_the_field(case):
    make, field, got, expected = ALL[case]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        make()
    assert caught.value.field == field
    assert got in caught.value.got
    assert expected in f"{caught.value.expected}. {caught.value.advice}"
    assert str(caught.value).startswith(f"{field}: got ")


def test_a_bound_from_below_is_refused_with_the_reason_and_an_alternative():
    for limit in ((), (2.0,)):
        with pytest.raises(lfo.errors.UnsupportedError, match=r"mean.*can be zero.*Use a reference instead"):
            lfo.MagnitudeBound(*limit, at_least=1.0, bins=[1])


def test_a_limit_in_decibels_beyond_all_numbers_is_none():
    bound = mask(limit_db=[1e5, -20.0], reference=2.0, bins=[1, 2])
    assert problem(control_spectrum=bound).terms[0].penalty.radius.tolist() == [np.inf, 0.2]


def test_an_output_band_that_removes_nothing_warns_and_is_no_constraint():
    with pytest.warns(lfo.errors.BandWarning, match=r"output_spectrum.constraints\[0\]: .* removes no bin"):
        given = problem(output_spectrum=outputs([[1, 0]], None, lfo.low_pass(np.pi)))
    assert given.terms == ()
    assert lfo.solve(given).cost == 0


@pytest.mark.parametrize("band", [lfo.low_pass(np.pi), lfo.spectrum.notch(1.1, 0.1)])
@pytest.mark.parametrize("of", [Mask, Energy, lambda limit, band: Windows(Mask(limit, band=band), 8)])
def test_a_bound_without_bins_warns_and_is_no_constraint(of, band):
    with pytest.warns(lfo.errors.BandWarning, match=r"spectrum.*band: .* bounds no bin of a signal of 8 samples"):
        given = problem(control_spectrum=of(1.0, band=band))
    assert given.terms == ()
    assert lfo.solve(given).cost == 0


def test_a_new_end_that_is_a_set_is_a_constraint():
    assert [term.name for term in problem().with_ends(terminal_state=Ball(1)).terms] == ["terminal state"]
    assert problem(terminal_state=Ball(1)).with_ends(terminal_state=[0, 0]).terms == ()
    soft = problem(terminal_state=lfo.sets.Soft(Ball(1), 2.0))
    assert soft.with_ends(terminal_state=[0, 0]).terms == ()
    assert soft.with_ends(initial_state=[1, 0]).terms
    last = problem(state_set=[lfo.sets.Everything()] * 8 + [Ball(1)], terminal_state=[0, 0])
    assert not last.terms  # the end lies in the ball
    assert [term.name for term in last.with_ends(terminal_state=[2, 0]).terms] == ["state set"]


def test_a_band_without_bins_bounds_nothing_and_a_warning_says_so():
    for bound in (Mask(1, band=lfo.low_pass(np.pi)), Energy(1, band=lfo.low_pass(np.pi))):
        with pytest.warns(lfo.errors.BandWarning, match=r"control_spectrum(\[0\])?.band: low_pass.* bounds no bin"):
            assert not controls(bound).terms
