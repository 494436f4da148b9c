"""Bad sets, costs and frequency constraints in a problem file: the error names the file and the place in it."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.every_table import GOOD, PIECEWISE, changed

START = """
schema = 1
horizon = 2
dynamics = {A = [[1.0]], B = [[1.0]]}
cost = {R = 1.0}
"""

INF, NAN = float("inf"), float("nan")

BAD = {
    "radius a list": ("control_set.sets[1].radius", [1.0], "control_set.sets[1].radius: got [1.0]"),
    "radius not a number": ("control_set.sets[1].radius", NAN, "control_set.sets[1].radius: got nan"),
    "radius infinite": ("control_set.sets[1].radius", INF, "control_set.sets[1].radius: got inf"),
    "centre in quotes": ("control_set.sets[1].centre", "0", "control_set.sets[1].centre: got '0'"),
    "centre of other size": ("control_set.sets[1].centre", [0.0, 0.0], "control_set: got sets in [1, 2] dimensions"),
    "box upside down": ("control_set.sets[0].lower", 6.0, "control_set.sets[0].lower[0]: got 6 above upper[0] = 5"),
    "boxes apart": ("control_set.sets[2].upper", -9.0, "control_set: got bounds -5 <= v <= -9"),
    "boxes of other times": (
        "control_set.sets",
        [{"lower": [[0.0]] * 3}, {"lower": [[0.0]] * 4}],
        "control_set: got bounds for 3 and 4 times",
    ),
    "member no table": ("control_set.sets", [3], "control_set.sets[0]: got 3; expected a table"),
    "kind misspelt": ("control_set.sets[1].kind", "bal", "control_set.sets[1].kind: got 'bal'"),
    "F ragged": ("state_set[0].F", [[1.0, 0.0], [0.0]], "state_set[0].F: got [[1.0, 0.0], [0.0]]"),
    "F of other size": ("state_set[0].F", [[1.0]], "state_set[0]: got a set in 1 dimensions; expected a set in 2"),
    "g of other size": ("state_set[0].g", [1.0, 2.0], "state_set[0].g: got shape (2,)"),
    "g without a number": ("state_set[0].g", [-INF], "state_set[0].g[0]: got -inf"),
    "W of other size": ("state_set[1].W", [[1.0]], "state_set[1]: got a set in 1 dimensions"),
    "W a vector": ("state_set[1].W", [1.0, 0.0], "state_set[1].W: got shape (2,)"),
    "radius of an ellipsoid": ("state_set[1].radius", -1.0, "state_set[1].radius: got -1.0"),
    "centre of an ellipsoid": ("state_set[1].centre", [1.0], "state_set[1].centre: got shape (1,)"),
    "h of other size": ("state_set[2].h", [1.0], "state_set[2].h: got shape (1,)"),
    "g of a cone": ("state_set[2].g", [1.0, 2.0], "state_set[2].g: got shape (2,)"),
    "d in quotes": ("state_set[2].d", "5", "state_set[2].d: got '5'"),
    "soft box of other size": ("state_set[3].set.upper", [1.0], "state_set[3]: got a set in 1 dimensions"),
    "soft box per time": (
        "state_set[3].set.upper",
        [[1.0, 1.0]] * 9,
        "state_set[3]: got a box with one bound per time",
    ),
    "soft set no table": ("state_set[3].set", 3, "state_set[3].set: got 3; expected a table"),
    "soft set with a typo": ("state_set[3].set.uper", 1.0, "state_set[3].set.uper: got an unknown key"),
    "penalty in quotes": ("state_set[3].penalty", "2", "state_set[3].penalty: got '2'"),
    "sets for other times": ("state_set", [{"upper": 9.0}] * 3, "state_set: got a sequence of 3"),
    "set of another time no table": ("state_set[8]", 3, "state_set[8]: got 3; expected a table"),
    "end of no radius": ("terminal_state.radius", 0.0, "terminal_state.radius: got 0.0"),
    "end of other size": ("terminal_state.centre", [1.0], "terminal_state: got a set in 1 dimensions"),
    "norm misspelt": ("cost.norms[0].kind", "Linff", "cost.norms[0].kind: got 'Linff'"),
    "norm of other size": ("cost.norms[0].u", [1.0, 2.0], "cost.norms[0].u: got shape (2,)"),
    "norm's reference of other size": ("cost.norms[1].x_ref", [[1.0]], "cost.norms[1].x_ref: got shape (1, 1)"),
    "norm below zero": ("cost.norms[1].x", [-0.1, 0.2], "cost.norms[1].x: got [-0.1, 0.2]"),
    "norms no tables": ("cost.norms", 3, "cost.norms: got 3; expected tables that begin with [[cost.norms]]"),
    "limit in quotes": ("control_spectrum[3].limit_db", "-3", "control_spectrum[3].limit_db: got '-3'"),
    "limit a matrix": ("control_spectrum[3].limit_db", [[1.0]], "control_spectrum[3].limit_db: got [[1.0]]"),
    "limits of other size": ("control_spectrum[3].limit_db", [1.0] * 4, "control_spectrum[3].limit_db: got shape (4,)"),
    "reference zero": ("control_spectrum[3].reference", 0.0, "control_spectrum[3].reference: got 0.0"),
    "band no table": ("control_spectrum[3].band", "low", "control_spectrum[3].band: got 'low'; expected a table"),
    "band without edge": ("control_spectrum[3].band.cutoff", ..., "control_spectrum[3].band.cutoff: got neither"),
    "band above pi": ("control_spectrum[3].band.cutoff", 4.0, "control_spectrum[3].band.cutoff: got 4 rad/sample"),
    "band with a typo": ("control_spectrum[3].band.cutof", 1.0, "control_spectrum[3].band.cutof: got an unknown key"),
    "band above Nyquist": (
        "control_spectrum[3].band",
        {"kind": "low_pass", "cutoff_hz": 40.0},
        "control_spectrum[3].band.low_pass: got 40 Hz",
    ),
    "component unknown": ("control_spectrum[3].component", "thrust", "control_spectrum[3].component: got 'thrust'"),
    "window unknown": ("control_spectrum[3].window", "hannn", "control_spectrum[3].window: got 'hannn'"),
    "window of other size": ("control_spectrum[3].window", [1.0], "control_spectrum[3].window: got shape (1,)"),
    "oversampling true": ("control_spectrum[3].oversampling", True, "control_spectrum[3].oversampling: got True"),
    "coefficients of other times": (
        "control_spectrum[4].coefficients",
        [[[1.0]]] * 7,
        "control_spectrum[4].coefficients: got shape (7, 1, 1)",
    ),
    "constant of other size": ("control_spectrum[4].constant", [1, 2], "control_spectrum[4].constant: got shape (2,)"),
    "bins fractions": ("state_spectrum.bins", [0.5], "state_spectrum.bins: got [0.5]"),
    "bins in quotes": ("state_spectrum.bins", ["1"], "state_spectrum.bins: got ['1']"),
    "bins beyond": ("state_spectrum.bins", [99], "state_spectrum.bins: got bin 99"),
    "component a list": ("state_spectrum.component", [0], "state_spectrum.component: got [0]"),
    "kind cut short": ("state_spectrum.kind", "energy", "Did you mean 'energy_bound'?"),
    "price of rows": ("stage_rows.penalty", -1.0, "stage_rows.penalty: got -1.0"),
    "outputs of other size": ("output_spectrum.C", [[1.0]], "output_spectrum.C: got shape (1, 1); expected 2 columns"),
    "outputs of two sizes": ("output_spectrum.D", [[1.0], [1.0]], "output_spectrum: got (1, 2), (2, 1)"),
    "output unknown": (
        "output_spectrum.constraints[0].component",
        "z",
        "output_spectrum.constraints[0].component: got 'z'",
    ),
    "second outputs": (
        "output_spectrum",
        [{"D": [[1.0]], "constraints": {"kind": "stop_band", "bins": [k]}} for k in (1, 99)],
        "output_spectrum[1].constraints[0].bins: got bin 99",
    ),
    "second outputs of other size": (
        "output_spectrum",
        [{"C": [[1.0] * n], "constraints": {"kind": "stop_band", "bins": [1]}} for n in (2, 3)],
        "output_spectrum[1].C: got shape (1, 3)",
    ),
}

WIDE = [[1.0, 0.0, 0.0]]

BAD_MODES = {
    "modes of two sizes": (
        "modes[1]",
        {"A": [[1.0]], "B": [[1.0]]},
        "modes[1]: got 1 state and 1 control; expected 2 and 1, as in the first",
    ),
    "A not square": ("modes[1].A", WIDE, "modes[1].A: got shape (1, 3)"),
    "A without a number": ("modes[0].A[1]", [NAN, 1.0], "modes[0].A[1][0]: got nan"),
    "A ragged": ("modes[0].A[1]", [1.0], "modes[0].A: got [[1.0, 0.1], [1.0]]"),
    "B of other size": ("modes[1].B", [[1.0]], "modes[1].B: got shape (1, 1); expected a matrix (2, m)"),
    "B of other times": ("modes[1].B", [[[0.0], [1.0]]] * 7, "modes[1].B: got 7 times; expected one for each of the 8"),
    "offset of other size": ("modes[0].offset", [1.0], "modes[0].offset: got shape (1,)"),
    "offset infinite": ("modes[0].offset", [1.0, INF], "modes[0].offset[1]: got inf"),
    "offset of other times": ("modes[0].offset", [[1.0, 1.0]] * 9, "modes[0].offset: got 9 times"),
    "G of other size": ("modes[1].G", WIDE * 2, "modes[1].G: got shape (2, 3); expected shape (2, 2)"),
    "G of other rows": ("modes[1].G", [[1.0, 0.0]], "modes[1].G: got shape (1, 2); expected shape (2, 2)"),
    "G infinite": ("modes[1].G[1]", [0.0, INF], "modes[1].G[1][1]: got inf"),
    "G of other times": (
        "modes[0].G",
        [[[1.0, 0.0]]] * 7,
        "modes[0].G: got shape (7, 1, 2); expected shape (1, 2), or (8, 1, 2) with one per time",
    ),
    "H of other size": ("modes[1].H", [[1.0, 0.0]] * 2, "modes[1].H: got shape (2, 2); expected shape (2, 1)"),
    "h of other rows": ("modes[0].h", [1.0, 1.0], "modes[0].G: got shape (1, 2); expected shape (2, 2)"),
    "h of other times": ("modes[0].h", [[1.0]] * 7, "modes[0].h: got limits for 7 times"),
    "h without a number": ("modes[0].h", [NAN], "modes[0].h[0]: got nan"),
    "h below all": ("modes[0].h", [-INF], "modes[0].h[0]: got -inf; expected a number, or inf for no bound"),
    "h without rows": ("modes[0].h", [], "modes[0].h: got shape (0,)"),
    "row that cannot hold": (
        "modes[0]",
        {"A": [[1.0, 0.0], [0.0, 1.0]], "B": [[1.0], [1.0]], "G": [[0.0, 0.0]], "h": [-1.0]},
        "modes[0].h: got -1 for row 0, which has no coefficients",
    ),
    "name twice": ("modes[1].name", "free", "modes[1].name: got 'free' a second time; expected a different name"),
    "name of two lines": ("modes[1].name", "a\nb", "modes[1].name: got 'a\\nb'"),
    "region too large": ("modes[0].h", [0.6], "modes[1]: got a region that overlaps that of 'free'"),
    "two controls' names": ("control_names", ["a", "b"], "dynamics.control_names: got ['a', 'b']; expected 1"),
}


def fault(tmp_path, tables) -> lfo.errors.ProblemError | None:
    """Return what the reader says of the tables; nothing, if it reads them."""
    (tmp_path / "cart.toml").write_text("schema = 1\n")
    try:
        lfo.read_problem(tmp_path / "cart.toml", tables)
    except lfo.errors.ProblemError as error:
        return error
    return None


@pytest.mark.parametrize("case", BAD)
def test_a_bad_table_is_refused_with_file_and_place(tmp_path, case):
    place, value, expected = BAD[case]
    found = str(fault(tmp_path, changed(GOOD, place, value)))
    assert found.startswith("cart.toml: ")
    assert expected in found


@pytest.mark.parametrize("case", BAD_MODES)
def test_a_bad_mode_is_refused_with_file_and_place(tmp_path, case):
    place, value, expected = BAD_MODES[case]
    found = str(fault(tmp_path, changed(PIECEWISE, f"dynamics.{place}", value)))
    assert found.startswith("cart.toml: dynamics.")
    assert expected in found


def test_a_component_is_given_once(tmp_path):
    tables = changed(GOOD, "control_spectrum[3].band.component", "force")
    tables = changed(tables, "control_spectrum[3].component", 0)
    assert "control_spectrum[3].component: got 0, and 'force' from the band; expected one" in str(
        fault(tmp_path, tables)
    )


@pytest.mark.parametrize("field", ["state_set", "terminal_state", "control_spectrum", "stage_rows", "cost.norms"])
@pytest.mark.parametrize("value", [3, "text", True, [3], [[3]], {"kind": 3}, {"npz": "none.npz", "key": "A"}, [{}]])
def test_nothing_that_a_field_may_hold_raises_anything_else(tmp_path, field, value):
    found = fault(tmp_path, changed(GOOD, field, value))
    assert found is None or found.field.startswith(f"cart.toml: {field}")


@pytest.mark.parametrize("depth", [20, 100, 150, 170, 190, 400])
def test_sets_within_sets_are_read_or_refused(tmp_path, depth):
    nested = '{kind = "intersection", sets = [' * depth + "{upper = 1.0}" + "]}" * depth
    (tmp_path / "deep.toml").write_text(f"{START}control_set = {nested}\n")
    words = ""
    try:
        assert (lfo.read_problem(tmp_path / "deep.toml").control_tube.upper == 1).all()
    except lfo.errors.ProblemError as error:
        words = error.got
    assert not words or (depth > 20 and ("recursion" in words or words == "nested too deeply"))


def test_a_limit_beyond_all_numbers_is_no_limit(tmp_path):
    (tmp_path / "cart.toml").write_text("schema = 1\n")
    problem = lfo.read_problem(tmp_path / "cart.toml", changed(GOOD, "control_spectrum[3].limit_db", 1e9))
    assert np.isinf(problem.control_spectrum[3].levels)
