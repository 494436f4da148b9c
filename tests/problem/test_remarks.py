"""The status of a result says what limits nothing, and which references lie outside bounds; a warning names its line.

A case is fields of a problem, and the words of the status; no words stand for no remark.
"""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.files import result_summary

NYQUIST = lfo.low_pass(np.pi)
MASK_OF_16 = lfo.MagnitudeBound(16.1, bins=[1])  # 8 samples of at most 2 add up to 16
WITHOUT_LIMIT = lfo.MagnitudeBound(np.inf, bins=[1])
CART = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]], state_names=["position", "speed"]),
    8,
    lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=1.0),
    state_set=lfo.Box(-1, 1),
    initial_state=[0, 0],
)


def tracking(**references):
    return {"cost": replace(CART.cost, **references)}


CASES = {
    "control band": (
        {"control_spectrum": NYQUIST},
        "control_spectrum: low_pass(0 .. 3.14159 rad/sample) removes no bin",
    ),
    "state band": ({"state_spectrum": [NYQUIST]}, "removes no bin of a signal of 9 samples"),
    "all bins": ({"control_spectrum": lfo.stop_band(bins=range(5))}, "removes every bin of a signal of 8 samples"),
    "mask": ({"control_spectrum": lfo.MagnitudeBound(1.0, band=NYQUIST)}, "control_spectrum.band: low_pass"),
    "infinite": (
        {"control_spectrum": [lfo.low_pass(2.0), WITHOUT_LIMIT]},
        "control_spectrum[1]: its limit is infinite",
    ),
    "above what bounds allow": (
        {"control_set": lfo.Box(-2, 1), "control_spectrum": MASK_OF_16},
        "mask on u_0 limits nothing: the bounds of its signal keep the spectrum below it",
    ),
    "above what bounds allow, of a band": (
        {"control_set": lfo.Box(-2, 2), "control_spectrum": lfo.spectrum.EnergyBound(3 * 16.1**2, bins=[1, 2, 4])},
        "energy bound on u_0 limits nothing",
    ),
    "within what bounds allow": (
        {"control_set": lfo.Box(-2.01, 1), "control_spectrum": lfo.MagnitudeBound(16.0, bins=[0])},
        "",
    ),
    "soft bounds": ({"control_set": lfo.sets.Soft(lfo.Box(-2, 1), penalty=1.0), "control_spectrum": MASK_OF_16}, ""),
    "no bounds": ({"control_spectrum": MASK_OF_16}, ""),
    "no bounds on the other": (
        {"output_spectrum": lfo.spectrum.OutputSpectrum([[1, 0]], [[0]], lfo.MagnitudeBound(9.0, bins=[1]))},
        "mask on y_0 limits nothing",
    ),
    "no bounds on a part": (
        {"output_spectrum": lfo.spectrum.OutputSpectrum([[1, 0]], [[0.1]], lfo.MagnitudeBound(9.0, bins=[1]))},
        "",
    ),
    "windows": (
        {"control_spectrum": lfo.spectrum.Spectrogram(WITHOUT_LIMIT, 8)},
        "control_spectrum: its limit is infinite",
    ),
    "output": (
        {"output_spectrum": lfo.spectrum.OutputSpectrum([[1, 0]], None, [lfo.low_pass(2.0), NYQUIST])},
        "output_spectrum.constraints[1]: low_pass(0 .. 3.14159 rad/sample) removes no bin of a signal of 9 samples",
    ),
    "output of controls": (
        {"output_spectrum": lfo.spectrum.OutputSpectrum(None, [[1]], NYQUIST)},
        "output_spectrum.constraints[0]: low_pass(0 .. 3.14159 rad/sample) removes no bin of a signal of 8 samples",
    ),
    "state reference": (tracking(x_ref=[2, 0]), "cost.x_ref lies outside the bounds: position at 9 times"),
    "reference for some time": (tracking(x_ref=np.outer(np.arange(9) / 7, [1, 0])), "position at 1 time"),
    "reference without a weight": (tracking(x_ref=[0, 2]), ""),
    "control reference": (
        {"control_set": lfo.Box(-1, 1), **tracking(u_ref=[-3])},
        "cost.u_ref lies outside the bounds: u_0 at 8 times",
    ),
    "no reference": ({"control_set": lfo.Box(0.01, 1)}, ""),
    "in bounds": ({"control_spectrum": lfo.low_pass(2.0), **tracking(x_ref=[1, 0])}, ""),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.filterwarnings("ignore::lin_freq_ocp.base.errors.BandWarning")
def test_the_status_says_what_limits_nothing_and_which_references_lie_outside(case):
    fields, words = CASES[case]
    result = lfo.solve(replace(CART, **fields))
    (line,) = [line for line in str(result).splitlines() if line.startswith("status")]
    assert words in line
    assert (line == "status    optimal") == (not words)
    remarks = "; ".join(result_summary(result)["remarks"])
    assert (words in remarks, bool(words)) == (True, bool(remarks))


WITHOUT_BINS = lfo.spectrum.notch(0.3, 0.01)
BANDS = {
    "control band": {"control_spectrum": [WITHOUT_BINS]},
    "state band": {"state_spectrum": [WITHOUT_BINS]},
    "output band": {"output_spectrum": [lfo.spectrum.OutputSpectrum([[1.0, 0.5]], None, WITHOUT_BINS)]},
    "mask": {"control_spectrum": [lfo.MagnitudeBound(1.0, band=WITHOUT_BINS)]},
    "every bin, with the band before": {"control_spectrum": [lfo.low_pass(1.0), lfo.spectrum.high_pass(2.0)]},
}
ON_THE_WAY = {
    "rounds of frequencies": {
        "control_spectrum": [lfo.MagnitudeBound(9.0, band=lfo.low_pass(2.2), every_frequency=True)]
    },
    "modes": {"control_set": lfo.FiniteSet([-1, 0, 1])},
    "a state that counts the cost": {"cost": lfo.costs.SmoothCost(stage="x_0**2 + u_0**2 + 0.01*u_0**4")},
    "norms of a cost by formulas": {"cost": lfo.costs.SmoothCost(stage="x_0**2 + u_0**2 + abs(x_0 - 0.3)")},
    "tangents": {"stage_rows": [lfo.sets.PathConstraint("x_1**2 + u_0**2", "path", 2.0)]},
    "joint rows": {"control_set": lfo.sets.Polyhedron([[-2.0]], [0.7])},
    "another origin": {"initial_state": [1e7, 0.0], "terminal_state": [1e7, 0.0], "state_set": None},
    "rate limits": {"rates": 0.4},
}


def stated(band, way):
    """Return the problem with a band, by the way of the user: of rate limits by ``rate_limited``."""
    fields = dict(ON_THE_WAY[way])
    rates = fields.pop("rates", None)
    fields |= {field: [*fields.get(field, []), *given] for field, given in BANDS[band].items()}
    problem = replace(CART, **fields)
    return problem if rates is None else lfo.rate_limited(problem, rates)


@pytest.mark.parametrize("way", ON_THE_WAY)
@pytest.mark.parametrize("band", BANDS)
def test_a_band_warns_once_where_the_problem_is_stated(band, way):
    with pytest.warns(lfo.errors.BandWarning) as caught:
        problem = stated(band, way)
    assert len(caught) == 1
    method = "nonsmooth" if way.startswith("a state") else "auto"
    result = lfo.solve(problem, method, throw=False)  # warnings are errors
    lfo.certify(problem, result.trajectory)


def test_neither_explanations_nor_loops_repeat_the_warning_of_a_band():
    with pytest.warns(lfo.errors.BandWarning):
        problem = replace(CART, control_set=lfo.Box(-1, 1), control_spectrum=NYQUIST)
    lfo.RecedingHorizon(problem).step([0.1, 0.0])
    assert lfo.explain(problem.with_ends([0, 0], [1, 0])).family


def test_a_warning_names_the_line_of_the_user_whatever_lies_between():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        _ = replace(CART, control_spectrum=NYQUIST), warnings.warn("the same line", stacklevel=1)
        lfo.RecedingHorizon(replace(CART, control_spectrum=lfo.low_pass(2.0)))
    band, line, loop = caught
    assert band.category is lfo.errors.BandWarning
    assert loop.category is lfo.errors.ClosedLoopWarning
    assert (band.filename, band.lineno) == (line.filename, line.lineno)
    assert (loop.filename, loop.lineno) == (line.filename, line.lineno + 1)
