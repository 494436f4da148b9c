"""The JSON Schemas: what the package writes and prints is valid, and they know the keys that it knows."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

import lin_freq_ocp as lfo
from helpers.compared_pages import moved
from helpers.every_table import GOOD, PIECEWISE, changed
from helpers.random.mixed import problem_of, random_model
from helpers.schemas import MINIMUM_TIME, PROBLEM, RESULT, SHOW, SWEEP, faults, is_valid, printed
from helpers.seeds import expensive, seeds
from lin_freq_ocp.api import ERRORS
from lin_freq_ocp.certificate import Condition, Conflict
from lin_freq_ocp.cli import cli
from lin_freq_ocp.files import (
    SETS,
    TableRecord,
    comparison_summary,
    failed_comparison_summary,
    result_summary,
    template,
)
from lin_freq_ocp.files import problem_tables as dynamics
from lin_freq_ocp.files import problem_tables as tables
from lin_freq_ocp.problem import Measures

PARTS = PROBLEM["$defs"]
PAGE = Path(__file__).parents[2] / "docs" / "problem_file.md"


def assert_valid_file(path: Path) -> None:
    assert faults(PROBLEM, tomllib.loads(path.read_text(encoding="utf-8"))) == []


def properties(schema: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return all properties of a schema and of its parts."""
    tables = [schema, *schema.get("$defs", {}).values()]
    nested = [inner for table in tables for inner in table.get("properties", {}).values() if "properties" in inner]
    return [one for table in [*tables, *nested] for one in table.get("properties", {}).items()]


@pytest.mark.parametrize("schema", [PROBLEM, RESULT, SWEEP, SHOW, MINIMUM_TIME])
def test_a_schema_is_one_and_describes_every_key_in_one_line(schema):
    Draft202012Validator.check_schema(schema)
    for key, entry in properties(schema):
        described = entry.get("description") or schema["$defs"][entry["$ref"].rsplit("/")[-1]]["description"]
        assert described.endswith((".", "...")), key
        assert "\n" not in described


def test_every_part_of_a_schema_is_used():
    for schema in (PROBLEM, RESULT, SWEEP, SHOW):
        text = json.dumps(schema)
        assert {part for part in schema["$defs"] if f'"#/$defs/{part}"' not in text} == set()


# --- what the package writes is valid -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", lfo.library.PROBLEMS)
def test_the_problems_of_the_library_are_valid(tmp_path, name):
    lfo.write_problem(lfo.library.by_name(name)(), tmp_path / "problem.toml")
    assert_valid_file(tmp_path / "problem.toml")


def test_the_template_is_valid():
    assert faults(PROBLEM, tomllib.loads(template())) == []


def test_the_example_of_the_page_is_valid_and_has_an_optimum(tmp_path):
    page = PAGE.read_text(encoding="utf-8")
    (tmp_path / "example.toml").write_text(page.split("```toml")[1].split("```")[0])
    assert_valid_file(tmp_path / "example.toml")
    assert lfo.solve(lfo.read_problem(tmp_path / "example.toml")).certificate.globally_optimal


def test_the_page_names_every_key():
    page = PAGE.read_text(encoding="utf-8")
    told = set(re.findall(r"\w+", page)) | {f"{edge}_hz" for edge in ("lower", "upper", "centre", "width")}
    assert {key for key, _ in properties(PROBLEM)} - told == set()


@pytest.mark.parametrize("seed", seeds(range(24)))
def test_problems_of_mixed_features_are_valid(tmp_path, seed):
    lfo.write_problem(problem_of(random_model(seed)), tmp_path / "problem.toml")
    assert_valid_file(tmp_path / "problem.toml")


# --- what the reader refuses for its structure is invalid -----------------------------------------------------------

BAD: dict[str, tuple[str, Any]] = {
    "schema missing": ("schema", ...),
    "schema of the future": ("schema", 3),
    "name no text": ("name", 3),
    "horizon missing": ("horizon", ...),
    "horizon in quotes": ("horizon", "8"),
    "horizon zero": ("horizon", 0),
    "horizon a fraction": ("horizon", 8.5),
    "unknown table": ("costs", {}),
    "end in quotes": ("initial_state", "0"),
    "end a list of sets": ("terminal_state", [{"upper": [1.0, 1.0]}]),
    "dynamics no table": ("dynamics", 3),
    "dynamics without B": ("dynamics.B", ...),
    "dynamics with a typo": ("dynamics.sample_time", 0.1),
    "A with text": ("dynamics.A[0]", ["much", 1.0]),
    "A with a truth value": ("dynamics.A", [[True, False], [False, True]]),
    "A a number": ("dynamics.A", 1.0),
    "A a vector": ("dynamics.A", [1.0]),
    "A empty": ("dynamics.A", []),
    "offset a number": ("dynamics.offset", 1.0),
    "sampling time zero": ("dynamics.sampling_time", 0.0),
    "continuous no truth value": ("dynamics.continuous", 1),
    "names no list": ("dynamics.state_names", 1.0),
    "names twice": ("dynamics.state_names", ["x", "x"]),
    "name blank": ("dynamics.control_names", [" "]),
    "cost no table": ("cost", 1.0),
    "cost with a typo": ("cost.QQ", 1.0),
    "q a number": ("cost.q", 1.0),
    "Q text": ("cost.Q", "much"),
    "norm without kind": ("cost.norms[0].kind", ...),
    "norm unknown": ("cost.norms[0].kind", "L2"),
    "norm with a typo": ("cost.norms[0].v", 1.0),
    "norm below zero": ("cost.norms[0].u", -1.0),
    "norms no tables": ("cost.norms", [1.0]),
    "norms a number": ("cost.norms", 1.0),
    "set a number": ("control_set", 5.0),
    "set of no kind": ("control_set.kind", "cube"),
    "set of a kind that is no text": ("control_set.kind", 1),
    "box with a typo": ("control_set.sets[0].lowr", 1.0),
    "box with text": ("control_set.sets[0].upper", "much"),
    "sets empty": ("control_set.sets", []),
    "sets missing": ("control_set.sets", ...),
    "sets no list": ("control_set.sets", {"upper": 1.0}),
    "ball without radius": ("control_set.sets[1].radius", ...),
    "ball with radius zero": ("control_set.sets[1].radius", 0.0),
    "ball with radius in quotes": ("control_set.sets[1].radius", "4"),
    "ball with bounds": ("control_set.sets[1].upper", 1.0),
    "polyhedron without g": ("state_set[0].g", ...),
    "polyhedron with a number": ("state_set[0].g", 1.0),
    "ellipsoid without W": ("state_set[1].W", ...),
    "cone without h": ("state_set[2].h", ...),
    "cone with a list": ("state_set[2].d", [1.0]),
    "soft without penalty": ("state_set[3].penalty", ...),
    "soft without set": ("state_set[3].set", ...),
    "soft with penalty below zero": ("state_set[3].penalty", -1.0),
    "soft cone": ("state_set[3].set", {"kind": "second_order_cone", "F": [[1.0, 0]], "g": [0.0], "h": [0.0, 0.0]}),
    "soft soft": ("state_set[3].set", {"kind": "soft", "set": {"upper": 1.0}, "penalty": 1.0}),
    "sets of no time": ("state_set", []),
    "band without kind": ("control_spectrum[0].kind", ...),
    "band of no kind": ("control_spectrum[0].kind", "lowpass"),
    "band without edge": ("control_spectrum[0].cutoff_hz", ...),
    "band with both edges": ("control_spectrum[0].cutoff", 1.0),
    "band with edge below zero": ("control_spectrum[0].cutoff_hz", -1.0),
    "band of another kind's edge": ("control_spectrum[0].width", 1.0),
    "band above pi": ("control_spectrum[1].centre", 4.0),
    "band with mixed units": ("control_spectrum[1]", {"kind": "notch", "centre": 1.0, "width_hz": 1.0}),
    "component a fraction": ("control_spectrum[0].component", 0.5),
    "component below zero": ("control_spectrum[1].component", -1),
    "bins a number": ("control_spectrum[2].bins", 3),
    "bins fractions": ("control_spectrum[2].bins", [0.5]),
    "bins empty": ("control_spectrum[2].bins", []),
    "bins missing": ("control_spectrum[2].bins", ...),
    "mask without limit": ("control_spectrum[3].limit_db", ...),
    "mask with two limits": ("control_spectrum[3].limit", 1.0),
    "mask without reference": ("control_spectrum[3].reference", ...),
    "mask without band": ("control_spectrum[3].band", ...),
    "mask with bins, too": ("control_spectrum[3].bins", [1]),
    "mask with a mask for a band": ("control_spectrum[3].band.kind", "magnitude_bound"),
    "mask from below": ("control_spectrum[3].at_least", 1.0),
    "coefficients missing": ("control_spectrum[4].coefficients", ...),
    "coefficients a matrix": ("control_spectrum[4].coefficients", [[1.0]] * 8),
    "constant a number": ("control_spectrum[4].constant", 1.0),
    "energy without limit": ("state_spectrum.limit", ...),
    "energy with many limits": ("state_spectrum.limit", [1.0]),
    "energy below zero": ("state_spectrum.limit", -1.0),
    "energy in dB": ("state_spectrum.limit_db", 1.0),
    "window a number": ("state_spectrum.window", 1.0),
    "oversampling a fraction": ("state_spectrum.oversampling", 1.5),
    "oversampling zero": ("state_spectrum.oversampling", 0),
    "penalty text": ("state_spectrum.penalty", "high"),
    "spectrum no tables": ("control_spectrum", "low"),
    "rows without limits": ("stage_rows.e", ...),
    "rows with a typo": ("stage_rows.F", [[1.0]]),
    "rows with a number": ("stage_rows.e", 4.0),
    "rows with a name that is no text": ("stage_rows.name", 3),
    "rows with no price": ("stage_rows.penalty", 0.0),
    "rate limit without a limit": ("rate_limit.limit", ...),
    "rate limit below zero": ("rate_limit.limit", -1.0),
    "price of changes below zero": ("rate_limit.price", -1.0),
    "rate limit with a typo": ("rate_limit.next", 0.0),
    "rate limit from text": ("rate_limit.previous", "rest"),
    "vibration relative to a number": ("control_spectrum[5].relative", 1),
    "outputs without constraints": ("output_spectrum.constraints", ...),
    "outputs with no constraint": ("output_spectrum.constraints", []),
    "outputs with a linear constraint": (
        "output_spectrum.constraints",
        [{"kind": "linear_constraint", "coefficients": [[[1.0]]]}],
    ),
    "outputs with a typo": ("output_spectrum.names", ["y"]),
    "outputs with names that are no list": ("output_spectrum.output_names", 1.0),
    "reference without key": ("dynamics.A", {"npz": "data.npz"}),
    "reference with a typo": ("dynamics.A", {"npz": "data.npz", "key": "A", "row": 1}),
    "reference of no text": ("dynamics.A", {"npz": 3, "key": "A"}),
}

BAD_MODES: dict[str, tuple[str, Any]] = {
    "modes no tables": ("dynamics.modes", 3),
    "modes a table": ("dynamics.modes", {"A": [[1.0]], "B": [[1.0]]}),
    "no modes": ("dynamics.modes", []),
    "mode no table": ("dynamics.modes[1]", 3),
    "mode without A": ("dynamics.modes[0].A", ...),
    "mode without B": ("dynamics.modes[0].B", ...),
    "mode with a typo": ("dynamics.modes[1].offsets", [0.0, 0.0]),
    "mode of continuous time": ("dynamics.modes[0].continuous", True),
    "mode with its own names": ("dynamics.modes[0].state_names", ["x", "v"]),
    "A beside modes": ("dynamics.A", [[1.0, 0.1], [0.0, 1.0]]),
    "offset beside modes": ("dynamics.offset", [0.0, 0.0]),
    "continuous beside modes": ("dynamics.continuous", False),
    "sampling time of modes zero": ("dynamics.sampling_time", 0.0),
    "names of modes' states no list": ("dynamics.state_names", 1.0),
    "A of a mode a vector": ("dynamics.modes[0].A", [1.0]),
    "offset of a mode a number": ("dynamics.modes[0].offset", 1.0),
    "region without limits": ("dynamics.modes[0].h", ...),
    "limits without a region": ("dynamics.modes[0].G", ...),
    "limits a number": ("dynamics.modes[0].h", 0.5),
    "limits with text": ("dynamics.modes[0].h", ["much"]),
    "G a vector": ("dynamics.modes[0].G", [1.0, 0.0]),
    "H a number": ("dynamics.modes[1].H", 1.0),
    "name of a mode no text": ("dynamics.modes[0].name", 3),
    "name of a mode blank": ("dynamics.modes[0].name", " "),
}


def refused(tables: dict[str, Any], folder: Path) -> str:
    """Return the place in the file that the reader finds fault with; nothing, if it reads the tables."""
    (folder / "cart.toml").write_text("schema = 1\n")
    place = ""
    try:
        lfo.read_problem(folder / "cart.toml", {"schema": None, **tables})
    except lfo.errors.ProblemError as error:
        place = error.field
    return place


@pytest.mark.parametrize("tables", [GOOD, PIECEWISE], ids=["linear", "piecewise"])
def test_a_problem_with_every_table_is_read_and_valid(tmp_path, tables):
    assert not refused(tables, tmp_path)
    assert faults(PROBLEM, tables) == []
    lfo.write_problem(lfo.read_problem(tmp_path / "cart.toml", tables), tmp_path / "again.toml")
    assert_valid_file(tmp_path / "again.toml")


ALL_BAD = BAD | BAD_MODES


@pytest.mark.parametrize("case", seeds(ALL_BAD))
def test_what_the_reader_refuses_for_its_structure_is_invalid(tmp_path, case):
    place, value = ALL_BAD[case]
    tables = changed(PIECEWISE if case in BAD_MODES else GOOD, place, value)
    found = refused(tables, tmp_path).removeprefix("cart.toml: ")
    assert found.startswith(place.rpartition(".")[0]) if "." in place else found.startswith(place)
    assert not is_valid(PROBLEM, tables)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("schema", 1),
        ("initial_state", {"npz": "data.npz", "key": "x"}),
        ("control_set.sets[1].centre", {"npz": "data.npz", "key": "one"}),
        ("control_spectrum[2].bins", {"npz": "data.npz", "key": "bins"}),
        ("control_spectrum[4].coefficients", {"npz": "data.npz", "key": "coefficients"}),
        ("state_set", {"lower": -np.inf, "upper": {"npz": "data.npz", "key": "per time"}}),
        ("state_spectrum.window", {"npz": "data.npz", "key": "window"}),
        ("cost.S", 0),
        ("cost.norms", {"kind": "L1", "x": [[1, 2]] * 8, "u": [1.0], "terminal": [1, 0], "u_ref": [[0.5]] * 8}),
        ("stage_rows", []),
        ("control_spectrum", []),
        ("output_spectrum.constraints", {"kind": "stop_band", "bins": [2]}),
    ],
)
def test_other_forms_are_read_and_valid(tmp_path, place, value):
    per_time = {"per time": np.full((9, 2), 9.0), "coefficients": np.ones((8, 1, 1)), "window": np.hanning(9)}
    np.savez(tmp_path / "data.npz", x=np.zeros(2), one=np.zeros(1), bins=np.array([1, 2]), **per_time)
    tables = changed(GOOD, place, value)
    assert not refused(tables, tmp_path)
    assert faults(PROBLEM, tables) == []


def test_a_continuous_model_needs_its_period_and_is_constant(tmp_path):
    for place, value in (("sampling_time", ...), ("A", [[[0.0, 1.0], [0.0, 0.0]]] * 8), ("offset", [[0.0, 0.0]] * 8)):
        tables = changed(changed(GOOD, "dynamics.continuous", True), f"dynamics.{place}", value)
        assert refused(tables, tmp_path)
        assert not is_valid(PROBLEM, tables)
    assert faults(PROBLEM, changed(GOOD, "dynamics.continuous", True)) == []


# --- the schema knows the same keys as reader and writer ------------------------------------------------------------


def keys(part: str) -> set[str]:
    return set(PARTS[part]["properties"])


def keys_of(record: TableRecord) -> tuple[set[str], set[str]]:
    """Return all keys of a record but those that it always refuses, and the required ones."""
    return {*record.required, *record.optional} - {"at_least"}, set(record.required)


def test_the_keys_of_tables_are_those_of_the_reader():
    assert keys_of(tables.PROBLEM) == (set(PROBLEM["properties"]), set(PROBLEM["required"]))
    assert PROBLEM["properties"]["schema"]["maximum"] == tables.SCHEMA
    for part, record in (
        ("dynamics", dynamics.LINEAR),
        ("piecewise_affine_dynamics", dynamics.PIECEWISE_AFFINE),
        ("mode", dynamics.AFFINE_MODE),
        ("cost", tables.COST),
        ("output_spectrum", tables.OUTPUTS),
    ):
        assert keys_of(record) == (keys(part), set(PARTS[part].get("required", ()))), part
    for part, (kind, record) in zip(("stage_rows", "path_constraint"), tables.STAGE_ROWS.records.items(), strict=True):
        needed = {*record.required, *({"kind"} if kind == "formula" else ())}
        assert (keys_of(record)[0], needed) == (keys(part) - {"kind"}, set(PARTS[part]["required"]))
        assert PARTS[part]["properties"]["kind"]["const"] == kind
    norms = PARTS["norm_cost"]["properties"]["kind"]["enum"]
    assert [*norms, PARTS["formula_cost"]["properties"]["kind"]["const"]] == list(tables.NORM_COSTS.records)
    for kind, record in tables.NORM_COSTS.records.items():
        part = "norm_cost" if kind in norms else "formula_cost"
        assert (keys_of(record)[0], {"kind"}) == (keys(part) - {"kind"}, set(PARTS[part]["required"]))


def kinds(part: str) -> list[str]:
    return [one["$ref"].rsplit("/")[-1] for one in PARTS[part]["oneOf"]]


def test_the_kinds_are_those_of_the_reader():
    assert kinds("set") == list(SETS.records)
    assert kinds("band") == list(tables.BANDS.records)
    assert kinds("frequency_constraint") == list(tables.SPECTRUM.records)
    assert kinds("output_constraint") == [kind for kind in kinds("frequency_constraint") if kind != "linear_constraint"]
    for kind, record in (SETS.records | tables.SPECTRUM.records).items():
        assert PARTS[kind]["properties"]["kind"]["const"] == kind
        found, required = keys_of(record)
        needed = required if kind == "box" else {"kind", *required}
        assert (found | {"kind"}, needed) == (keys(kind), set(PARTS[kind].get("required", ())))


class Slab(lfo.sets.Polyhedron):
    """A set of a user's own, with the arguments of its constructor as attributes."""

    def __init__(self, normal: Any, width: float = 1.0):
        super().__init__(np.array([normal, np.negative(normal)]), np.full(2, width))
        self.__dict__.update(normal=np.asarray(normal), width=width)


def test_a_set_of_a_new_class_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setitem(SETS.records, "slab", TableRecord(Slab))
    path = tmp_path / "cart.toml"
    slab = {"kind": "slab", "normal": [1.0, 0.0], "lower": None, "upper": None}
    lfo.write_problem(lfo.read_problem(written(path), {"state_set": slab}), path)
    assert tomllib.loads(path.read_text())["state_set"] == {"kind": "slab", "normal": [1.0, 0.0], "width": 1.0}
    with pytest.raises(
        lfo.errors.ProblemError, match=r"cart.toml: state_set.norml: got an unknown key.*Did you mean 'normal'"
    ):
        lfo.read_problem(path, {"state_set": {"norml": 1.0, "normal": None}})


def written(path: Path) -> Path:
    lfo.write_problem(lfo.library.double_integrator(horizon=4, cutoff_hz=None, speed_bound=None), path)
    return path


# --- results --------------------------------------------------------------------------------------------------------


SHORT = {"horizon": 20, "sampling_time": 0.25, "cutoff_hz": 1.0}


@pytest.fixture(scope="module")
def solved() -> lfo.results.Result:
    return lfo.solve(lfo.library.double_integrator(**SHORT))


def test_the_result_of_a_solve_is_valid(solved, tmp_path):
    assert faults(RESULT, printed(result_summary(solved))) == []
    assert faults(RESULT, printed(result_summary(solved, with_trajectory=True))) == []
    solved.save(tmp_path / "run.npz")
    settings = [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]
    answer = CliRunner().invoke(cli, ["certify", "double_integrator", str(tmp_path / "run.npz"), "--json", *settings])
    assert faults(RESULT, json.loads(answer.stdout)) == []


@pytest.mark.parametrize("seed", [0, 3])
def test_the_result_of_mixed_features_is_valid(seed):
    assert faults(RESULT, printed(result_summary(lfo.solve(problem_of(random_model(seed)))))) == []


@expensive
def test_the_result_of_a_solve_without_solution_is_valid():
    with pytest.raises(lfo.errors.InfeasibleError) as caught:
        lfo.solve(lfo.library.double_integrator(horizon=20, sampling_time=0.25, cutoff_hz=0.3))
    summary = printed(result_summary(caught.value.result))
    assert summary["conflict"]
    assert summary["explanation"]["cures"]
    assert faults(RESULT, summary) == []
    assert faults(RESULT, printed(failed_comparison_summary(caught.value.result))) == []
    dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    unbounded = lfo.OptimalControlProblem(dynamics, 10, lfo.QuadraticCost(r=[1.0]), initial_state=[0.0])
    summary = printed(result_summary(lfo.solve(unbounded, throw=False)))
    assert summary["status"] == "unbounded"
    assert faults(RESULT, summary) == []


def test_the_result_of_a_comparison_is_valid():
    problem = lfo.library.double_integrator(**SHORT)
    summary = printed(comparison_summary(lfo.compare(problem)))
    assert summary["filtered"]
    assert faults(RESULT, summary) == []


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("schema", 1),
        ("status", "solved"),
        ("status", ...),
        ("cost", ...),
        ("cost", "high"),
        ("extra", 1),
        ("certificate.conditions[0].passed", None),
        ("certificate.pmp", "yes"),
        ("seconds.solve", None),
        ("problem.horizon", 0),
        ("classical", None),
        ("bound", "good"),
    ],
)
def test_a_result_of_other_keys_is_invalid(solved, place, value):
    assert not is_valid(RESULT, changed(printed(result_summary(solved)), place, value))


def test_levels_are_valid():
    found = printed(result_summary(lfo.solve(lfo.library.pulse_pattern(samples=32))))
    assert faults(RESULT, found) == []
    assert np.shape(found["levels"]["duty_cycles"]) == (1, 32, 5)


def test_the_keys_of_a_result_are_those_of_the_package(solved):
    parts = RESULT["$defs"]
    compared = {"classical", "constrained", "filtered", "moves"}
    assert set(RESULT["properties"]) - compared == {
        *("atoms", "levels", "spectra", "worst_case"),
        *result_summary(solved, with_trajectory=True),
    }
    assert {*RESULT["dependentRequired"]} - compared == set(RESULT["properties"]) - {*RESULT["required"]} - compared
    assert RESULT["properties"]["status"]["enum"] == ["optimal", "locally_optimal", "extremal", *ERRORS]
    for part, kind in (
        ("measures", Measures),
        ("conflict", Conflict),
        ("explanation", lfo.results.Explanation),
        ("cure", lfo.results.Cure),
    ):
        names = {field.name for field in fields(kind)}
        assert (set(parts[part]["properties"]), set(parts[part]["required"])) == (names, names)
    condition = {*asdict(Condition("C-i", "", 0.0, 1.0, 1.0)), "passed"} - {"rounding"}  # which is of the judge alone
    assert set(parts["condition"]["properties"]) == {"peak", *parts["condition"]["required"]} == condition


def test_the_moves_of_a_comparison_are_valid():
    summary = printed(comparison_summary(moved()))
    assert list(summary["moves"]) == ["unshaped", "ZV", "ZVD", "EI", "optimal"]
    assert faults(RESULT, summary) == []
    assert not is_valid(RESULT, changed(summary, "moves.EI.samples", 0))


def test_the_result_of_a_mask_at_every_frequency_is_valid():
    mask = lfo.MagnitudeBound(2.0, band=lfo.low_pass(0.6), every_frequency=True)
    problem = replace(lfo.library.double_integrator(horizon=100, sampling_time=0.04), control_spectrum=mask)
    summary = printed(result_summary(lfo.solve(problem)))
    assert faults(RESULT, summary) == []
    assert [len(atom) for atoms in summary["atoms"].values() for atom in atoms] == [3] * len(*summary["atoms"].values())
    assert sum("peak" in condition for condition in summary["certificate"]["conditions"]) == 1
