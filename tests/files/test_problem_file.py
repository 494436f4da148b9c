"""Problem files: what is written is read back, what is wrong is named, and the template can be used line by line."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import lin_freq_ocp as lfo
from helpers.problem_files import assert_same, bands, everything_at_once
from helpers.seeds import examples, expensive
from lin_freq_ocp import (
    Box,
    LinearDynamics,
    OptimalControlProblem,
    QuadraticCost,
    StageRows,
    Trajectory,
    low_pass,
    read_problem,
    stop_band,
    write_problem,
)
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.files import INLINE_LIMIT, NORM_COSTS, SETS, SPECTRUM, init_problem_file, save_solution, template
from lin_freq_ocp.library import pendulum
from lin_freq_ocp.sets import Everything, Point
from lin_freq_ocp.spectrum import band_pass, high_pass, notch

GOOD = """
schema = 1
name = "cart"
horizon = 8
initial_state = [0.0, 0.0]
[dynamics]
A = [[1.0, 0.1], [0.0, 1.0]]
B = [[0.005], [0.1]]
sampling_time = 0.1
state_names = ["position [m]", "speed [m/s]"]
control_names = ["force [N]"]
[cost]
R = 1.0
[control_set]
lower = -5.0
upper = 5.0
[[control_spectrum]]
kind = "low_pass"
cutoff_hz = 3.0
component = "force"
"""


def file_with(folder: Path, text: str) -> Path:
    path = folder / "cart.toml"
    path.write_text(text, encoding="utf-8")
    return path


def message(path: Path, overrides=None) -> str:
    with pytest.raises(ProblemError) as caught:
        read_problem(path, overrides)
    return str(caught.value)


def round_trip(problem: OptimalControlProblem, folder: Path) -> OptimalControlProblem:
    write_problem(problem, folder / "problem.toml")
    again = read_problem(folder / "problem.toml")
    assert_same(problem, again)
    return again


# --- what is written is read back -----------------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [9, 60])
def test_every_feature_survives_the_round_trip(tmp_path, horizon):
    round_trip(everything_at_once(horizon), tmp_path)
    assert (tmp_path / "problem.problem.npz").exists() == (horizon == 60)


def test_the_pendulum_survives_the_round_trip(tmp_path):
    round_trip(pendulum(), tmp_path)
    assert os.listdir(tmp_path) == ["problem.toml"]


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"control_set": Everything(), "state_set": Box(None, [1.0, 2.0])},
        {"state_set": [Box([None, -1], [None, 1])] * 9, "control_set": Point([0.5])},
        {"initial_state": Everything(), "terminal_state": Box([0, None], [None, None])},
        {"initial_state": Point([1e-300, -0.0]), "control_spectrum": []},
    ],
)
def test_sets_and_absent_sets_survive_the_round_trip(tmp_path, given):
    dynamics = LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]])
    round_trip(OptimalControlProblem(dynamics=dynamics, horizon=8, cost=QuadraticCost(), **given), tmp_path)


@pytest.mark.parametrize("unit", ["", "_hz"])
def test_a_notch_survives_the_round_trip_bitwise(tmp_path, unit):
    centres, widths = np.random.default_rng(11).uniform(0.5, 1.5, size=(2, 100)).tolist()
    made = [notch(**{f"centre{unit}": c, f"width{unit}": w}) for c, w in zip(centres, widths, strict=True)]
    dynamics = LinearDynamics([[1.0]], [[1.0]], sampling_time=0.1)
    round_trip(
        OptimalControlProblem(dynamics=dynamics, horizon=300, cost=QuadraticCost(R=1), state_spectrum=made), tmp_path
    )


@st.composite
def problems(draw) -> OptimalControlProblem:
    T, n, m = draw(st.integers(1, 5)), draw(st.integers(1, 3)), draw(st.integers(1, 2))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    bound = st.one_of(st.just(np.inf), st.floats(0, allow_nan=False))

    def matrix(*shape: int) -> np.ndarray:
        return draw(arrays(np.float64, (T, *shape) if draw(st.booleans()) else shape, elements=finite))

    def diagonal(size: int) -> np.ndarray:
        return np.diag(draw(arrays(np.float64, size, elements=finite)))

    def box(times: int, size: int) -> Box:
        shape = draw(st.sampled_from([(), (size,), (times, size)]))
        return Box(*(sign * draw(arrays(np.float64, shape, elements=bound)) for sign in (-1, 1)))

    limits = arrays(np.float64, st.sampled_from([(2,), (T, 2)]), elements=bound)
    frequency = st.floats(0, np.pi)
    band = st.one_of(
        st.builds(low_pass, frequency),
        st.builds(high_pass, cutoff_hz=st.floats(0, 2)),
        st.builds(lambda edges: band_pass(*sorted(edges)), st.tuples(frequency, frequency)),
        st.builds(lambda k: stop_band(bins=k, component=m - 1), st.lists(st.integers(-T, T), min_size=1)),
    )
    return OptimalControlProblem(
        dynamics=LinearDynamics(matrix(n, n), matrix(n, m), matrix(n), sampling_time=draw(st.floats(1e-3, 0.25))),
        horizon=T,
        cost=QuadraticCost(diagonal(n), diagonal(m), matrix(n, m), matrix(n), matrix(m), P=diagonal(n)),
        control_set=box(T, m),
        state_set=box(T + 1, n),
        initial_state=draw(st.sampled_from([None, np.zeros(n)])),
        control_spectrum=draw(st.lists(band, max_size=3)),
        stage_rows=draw(st.sampled_from([None, StageRows(matrix(2, n), matrix(2, m), draw(limits))])),
        name=draw(st.text().filter(str.isprintable)),
    )


@expensive
@pytest.mark.filterwarnings("ignore::lin_freq_ocp.base.errors.BandWarning")
@given(problem=problems())
@settings(
    derandomize=True,
    max_examples=examples(15),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_random_problems_survive_the_round_trip(tmp_path, problem):
    round_trip(problem, tmp_path)


def test_rows_of_a_matrix_stand_on_one_line(tmp_path):
    write_problem(pendulum(), tmp_path / "p.toml")
    lines = (tmp_path / "p.toml").read_text(encoding="utf-8").splitlines()
    assert "lower = [-0.2, -0.3490658503988659, -15.0, -30.0]" in lines


def test_only_large_arrays_leave_the_text(tmp_path):
    n = 1 + int(np.sqrt(INLINE_LIMIT))
    dynamics = LinearDynamics(np.eye(n), np.ones((n, 1)))
    round_trip(OptimalControlProblem(dynamics=dynamics, horizon=2, cost=QuadraticCost()), tmp_path)
    with np.load(tmp_path / "problem.problem.npz", allow_pickle=False) as beside:
        assert beside.files == ["dynamics.A"]


def test_a_solution_of_the_same_stem_leaves_the_problem_intact(tmp_path):
    problem = everything_at_once(60)
    write_problem(problem, tmp_path / "run.toml")
    save_solution(tmp_path / "run.npz", Trajectory(np.zeros((61, 3)), np.zeros((60, 2))), None, {})
    assert_same(problem, read_problem(tmp_path / "run.toml"))


# --- what the reader understands ------------------------------------------------------------------------------------


def test_a_continuous_model_is_sampled_with_a_zero_order_hold(tmp_path):
    text = GOOD.replace("[[1.0, 0.1], [0.0, 1.0]]", "[[0, 1], [0, 0]]").replace("[[0.005], [0.1]]", "[[0], [1]]")
    problem = read_problem(file_with(tmp_path, text.replace("[dynamics]", "[dynamics]\ncontinuous = true")))
    np.testing.assert_allclose(problem.dynamics.A, [[1, 0.1], [0, 1]], rtol=1e-14)
    np.testing.assert_allclose(problem.dynamics.B, [[0.005], [0.1]], rtol=1e-14)
    assert problem.dynamics.plant is not None


def test_a_rate_limit_of_a_file_is_that_of_rate_limited(tmp_path):
    plain = lfo.library.double_integrator()
    lfo.write_problem(plain, tmp_path / "move.toml")
    table = {"limit": 0.5, "previous": 0.0, "following": 0.0}
    read = lfo.read_problem(tmp_path / "move.toml", {"rate_limit": table})
    assert lfo.solve(read).cost == lfo.solve(lfo.rate_limited(plain, 0.5, 0.0, 0.0)).cost
    read = lfo.read_problem(tmp_path / "move.toml", {"rate_limit": {"price": 2.0, "previous": 0.0}})
    assert lfo.solve(read).cost == lfo.solve(lfo.rate_limited(plain, None, 0.0, price=2.0)).cost
    with pytest.raises(lfo.errors.ProblemError, match=re.escape("move.toml: rate_limit.following: got shape (2,)")):
        lfo.read_problem(tmp_path / "move.toml", {"rate_limit": table | {"following": [0.0, 0.0]}})


def test_arrays_come_from_an_npz_beside_the_file(tmp_path):
    (tmp_path / "data").mkdir()
    np.savez(tmp_path / "data" / "model.npz", A=np.array([[1.0, 0.5], [0.0, 1.0]]), bins=np.array([1, 2]), x=[1, 2])
    text = (
        GOOD.replace("[[1.0, 0.1], [0.0, 1.0]]", '{npz = "data/model.npz", key = "A"}')
        .replace("[0.0, 0.0]", '{npz = "data/model.npz", key = "x"}')
        .replace('"low_pass"\ncutoff_hz = 3.0', '"stop_band"\nbins = {npz = "data/model.npz", key = "bins"}')
    )
    problem = read_problem(file_with(tmp_path, text))
    assert problem.dynamics.A[0, 1] == 0.5
    assert problem.initial_state.lower.tolist() == [1, 2]
    assert np.flatnonzero(problem.control_stop).tolist() == [1, 2]


def test_one_band_may_be_a_plain_table(tmp_path):
    problem = read_problem(file_with(tmp_path, GOOD.replace("[[control_spectrum]]", "[control_spectrum]")))
    assert problem.control_spectrum == low_pass(cutoff_hz=3.0, component="force")


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path):
    path = tmp_path / "cart.toml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert read_problem(path).name == "cart"


def test_overrides_take_precedence_and_are_merged(tmp_path):
    path = file_with(tmp_path, GOOD)
    overrides = {"horizon": 12, "cost": {"Q": 2.0}, "state_set": {"upper": [9.0, 9.0]}, "initial_state": [1.0, 0.0]}
    problem = read_problem(path, overrides)
    assert problem.horizon == 12
    assert (problem.cost.Q[0, 0], problem.cost.R[0, 0]) == (2.0, 1.0)
    assert problem.state_tube.upper[3].tolist() == [9.0, 9.0]
    assert problem.initial_state.lower.tolist() == [1.0, 0.0]
    assert "cart.toml: cost.RR: got an unknown key" in message(path, {"cost": {"RR": 1}})


# --- what is wrong is named -----------------------------------------------------------------------------------------


BAD = {
    "syntax": ("horizon = 8", "horizon 8", "key/value pair (at line 4, column 9)"),
    "repeated key": ("horizon = 8", "horizon = 8\nhorizon = 9", "(at line 5, column 12)"),
    "endless digits": ("horizon = 8", f"horizon = {'9' * 5000}", "TOML syntax"),
    "deep nesting": ("horizon = 8", f"horizon = {'[' * 5000}", "TOML syntax"),
    "schema missing": ("schema = 1", "", "schema: got nothing"),
    "schema of the future": ("schema = 1", "schema = 3", "schema: got 3; expected a whole number from 1 to 2"),
    "horizon missing": ("horizon = 8", "", "horizon: got nothing"),
    "horizon in quotes": ("horizon = 8", 'horizon = "8"', "horizon: got '8'"),
    "horizon a table": ("horizon = 8", "horizon = {steps = 8}", "horizon: got {'steps': 8}"),
    "horizon beyond memory": ("horizon = 8", f"horizon = 1{'0' * 30}", "horizon: got 1000"),
    "unknown table": ("[cost]", "[costs]", "costs: got an unknown key; expected one of schema, "),
    "did you mean": ("cutoff_hz", "cutof_hz", "Did you mean 'cutoff_hz'?"),
    "unknown key of dynamics": ("sampling_time", "sample_time", "dynamics.sample_time: got an unknown key"),
    "A missing": ("A = ", "offset = [0, 0] # ", "dynamics.A: got nothing"),
    "A ragged": ("[0.0, 1.0]]", "[0.0]]", "dynamics.A: got [[1.0, 0.1], [0.0]]"),
    "A with text": ("0.1]", '"much"]', "dynamics.A: got"),
    "A not finite": ("0.1]", "nan]", "dynamics.A[0][1]: got nan"),
    "A with an integer no float holds": ("0.1]", f"1{'0' * 400}]", "cart.toml: "),
    "B of other size": ("[[0.005], [0.1]]", "[[0.1]]", "dynamics.B: got shape (1, 1)"),
    "dynamics no table": ("initial_state", "cost = 3\ninitial_state", "TOML syntax"),
    "names no list": ('["force [N]"]', "3", "dynamics.control_names: got 3"),
    "names too many": ('["force [N]"]', '["a", "b"]', "dynamics.control_names: got ['a', 'b']"),
    "continuous no truth value": ("sampling_time", "continuous = 1\nsampling_time", "dynamics.continuous: got 1"),
    "continuous without period": ("sampling_time = 0.1", "continuous = true", "dynamics.sampling_time: got nothing"),
    "continuous of other size": ("B = [[0.005]", "continuous = true\nB = [[0.005], [2]", "dynamics.A, B: got shapes"),
    "cost not symmetric": ("R = 1.0", "R = 1.0\nQ = [[1, 1], [0, 1]]", "cost.Q: got a matrix that differs"),
    "cost of other size": ("R = 1.0", "q = [1, 2, 3]", "cost.q: got shape (3,)"),
    "bounds exchanged": ("lower = -5.0", "lower = 6.0", "control_set.lower: got 6 above upper = 5"),
    "bounds of other size": ("upper = 5.0", "upper = [5.0, 5.0]", "control_set: got bounds for 2 components"),
    "bounds with too many dimensions": ("upper = 5.0", "upper = [[[5.0]]]", "cart.toml: "),
    "set no table": ("[control_set]\nlower = -5.0\nupper = 5.0", "[control_set.lower]", "control_set: got a mapping"),
    "initial state of other size": ("[0.0, 0.0]", "[0.0]", "initial_state: got bounds for 1 component;"),
    "initial state a matrix": ("[0.0, 0.0]", "[[0.0, 0.0]]", "initial_state: got shape (1, 2)"),
    "initial state with a typo": ("[0.0, 0.0]", "{lowe = [0, 0]}", "initial_state: got 'lowe'; expected one of"),
    "kind missing": ('kind = "low_pass"', "", "control_spectrum[0].kind: got nothing"),
    "kind unknown": ('"low_pass"', '"lowpass"', "control_spectrum[0].kind: got 'lowpass'"),
    "kind no text": ('"low_pass"', "[1]", "control_spectrum[0].kind: got [1]"),
    "cut-off missing": ("cutoff_hz = 3.0", "", "control_spectrum[0].cutoff: got neither"),
    "cut-off of another kind": ('"low_pass"', '"notch"', "control_spectrum[0].cutoff_hz: got an unknown key"),
    "cut-off above Nyquist": ("3.0", "30.0", "control_spectrum[0].low_pass: got 30 Hz"),
    "component unknown": ('"force"', '"thrust"', "control_spectrum[0].component: got 'thrust'"),
    "bins no list": ('"low_pass"\ncutoff_hz = 3.0', '"stop_band"\nbins = 3', "control_spectrum[0].bins: got 3"),
    "bins not whole": ('"low_pass"\ncutoff_hz = 3.0', '"stop_band"\nbins = [0.5]', "_spectrum[0].bins: got [0.5]"),
    "bands no tables": ("horizon", 'state_spectrum = "low"\nhorizon', "state_spectrum: got 'low'"),
    "name no text": ('"cart"', "3", "name: got 3"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_file_and_field(tmp_path, case):
    old, new, expected = BAD[case]
    assert old in GOOD
    found = message(file_with(tmp_path, GOOD.replace(old, new, 1)))
    assert found.startswith("cart.toml: ")
    assert expected in found


def test_the_field_of_an_error_is_file_and_place(tmp_path):
    with pytest.raises(ProblemError) as caught:
        read_problem(file_with(tmp_path, GOOD.replace("[[0.005], [0.1]]", "[[0.1]]")))
    assert caught.value.field == "cart.toml: dynamics.B"


def test_what_is_no_text_file_is_refused(tmp_path):
    assert "no such file" in message(tmp_path / "missing.toml")
    assert "a directory" in message(tmp_path)
    (tmp_path / "latin.toml").write_bytes('name = "Höhe"'.encode("latin-1"))
    assert "byte 9 that is not UTF-8" in message(tmp_path / "latin.toml")
    (tmp_path / "binary.toml").write_bytes(bytes(range(128)))
    assert "binary.toml: TOML syntax" in message(tmp_path / "binary.toml")
    np.savez(tmp_path / "archive.toml", x=np.ones(3))
    assert "archive.toml" in message(tmp_path / "archive.toml.npz")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.toml")
        assert "not a regular file" in message(tmp_path / "pipe.toml")


@pytest.mark.parametrize(
    "name",
    [
        "/etc/passwd",
        "../data.npz",
        "sub/../../data.npz",
        "..\\\\data.npz",
        "C:\\\\data.npz",
        "link.npz",
        "out/data.npz",
    ],
)
def test_no_reference_leaves_the_folder(tmp_path, name):
    folder, outside = tmp_path / "folder", tmp_path / "data.npz"
    folder.mkdir()
    np.savez(outside, A=np.eye(2))
    (folder / "link.npz").symlink_to(outside)
    (folder / "out").symlink_to(tmp_path)
    text = GOOD.replace("[[1.0, 0.1], [0.0, 1.0]]", f'{{npz = "{name}", key = "A"}}')
    found = message(file_with(folder, text))
    assert found.startswith("cart.toml: dynamics.A.npz: ")
    assert "expected the name of a file in the folder of the problem file" in found


@pytest.mark.parametrize(
    ("reference", "expected"),
    [
        ('{npz = "data.npz", key = "a"}', "dynamics.A.key: got 'a'; expected the name of an array in data.npz: A, c"),
        ('{npz = "data.npz", key = 3}', "dynamics.A.key: got 3"),
        ('{npz = "data.npz"}', "dynamics.A.key: got nothing"),
        ('{npz = "data.npz", key = "A", row = 1}', "dynamics.A.row: got an unknown key"),
        ('{npz = 3, key = "A"}', "dynamics.A.npz: got 3"),
        ('{npz = "none.npz", key = "A"}', "dynamics.A.npz: got no such file"),
        ('{npz = ".", key = "A"}', "dynamics.A.npz: got a directory"),
        ('{npz = "a\\u0000b", key = "A"}', "dynamics.A.npz: got"),
        ('{npz = "loop", key = "A"}', "dynamics.A.npz: got"),
        ('{npz = "text.npz", key = "A"}', "dynamics.A.npz: got text.npz, unreadable"),
        ('{npz = "single.npy", key = "A"}', "dynamics.A.npz: got a single array"),
        ('{npz = "data.npz", key = "c"}', "dynamics.A: got complex128"),
        ('{npz = "data.npz", key = "text"}', "dynamics.A: got <U3"),
        ('{npz = "data.npz", key = "o"}', "dynamics.A.npz: got data.npz, unreadable (Object arrays cannot be loaded"),
    ],
)  # fmt: skip
def test_a_bad_reference_is_refused(tmp_path, reference, expected):
    np.savez(tmp_path / "data.npz", A=np.eye(2), c=1j * np.eye(2), o=np.array([{}], dtype=object), text=np.array("one"))
    np.save(tmp_path / "single.npy", np.eye(2))
    (tmp_path / "text.npz").write_text("not an archive")
    (tmp_path / "loop").symlink_to("loop")
    path = file_with(tmp_path, GOOD.replace("[[1.0, 0.1], [0.0, 1.0]]", reference))
    assert f"cart.toml: {expected}" in message(path)


def test_problems_that_cannot_be_written_say_so(tmp_path):
    with pytest.raises(ProblemError, match="expected a file that can be written"):
        write_problem(pendulum(), tmp_path / "nowhere" / "p.toml")
    with pytest.raises(ProblemError, match="expected a file that can be written"):
        write_problem(pendulum(), tmp_path)


# --- the template ---------------------------------------------------------------------------------------------------


def test_the_template_is_a_problem(tmp_path):
    init_problem_file(tmp_path / "new.toml")
    problem = read_problem(tmp_path / "new.toml")
    assert (problem.name, problem.horizon, problem.state_dim, problem.control_dim) == ("cart", 200, 2, 1)
    assert problem.control_spectrum == [low_pass(cutoff_hz=20.0)]
    assert problem.state_tube.upper[100].tolist() == [np.inf, 1.0]
    np.testing.assert_allclose(problem.dynamics.B, [[0.5e-4], [0.01]], rtol=1e-13)


OPTIONAL = re.compile(r"# (\[\[|[A-Za-z_]+ = |     \[)")
"""What the template calls a line that begins with "# " and a key, a table, or another row of a matrix."""

OTHER_ENDS = [line[2:] for line in template().splitlines() if line.startswith("# terminal_state")]


def test_every_optional_line_of_the_template_can_be_used(tmp_path):
    optional = [OPTIONAL.match(line) and line[2:] not in OTHER_ENDS for line in template().splitlines()]
    lines = [line[2:] if used else line for line, used in zip(template().splitlines(), optional, strict=True)]
    problem = read_problem(file_with(tmp_path, "\n".join(lines)))
    *given, mask, energy, vibration, windows = problem.control_spectrum
    assert [band.kind for band in given] == ["low_pass", "high_pass", "band_pass", "notch", "stop_band"]
    assert (mask.window, mask.oversampling, mask.penalty) == ("hann", 4, 10.0)
    assert (energy.limit, energy.penalty) == (400.0, None)
    assert (vibration.frequency.tolist(), vibration.limit) == ([0.9, 1.1], 0.02)
    assert (windows.length, windows.hop, windows.past.tolist()) == (50, 25, [[0.0], [0.1]])
    assert len(bands(problem.state_spectrum)) == 1
    assert problem.quadratic.x_ref.tolist() == [1.0, 0.0]
    assert problem.cost.norms[0].u == 0.01
    assert [rows.name for rows in problem.stage_rows] == ["speed and force"]
    assert problem.stage_rows[0].e.tolist() == [2.5, np.inf]
    assert problem.stage_rows[0].penalty == 10.0
    assert problem.output_spectrum[0].output_names == ("tip [m]",)
    assert [term.name for term in problem.terms] == [
        *("speed and force", "mask on force [N]", "energy bound on force [N]"),
        *("residual vibration of force [N]", "mask on windows of force [N]"),
        *("energy bound on tip [m]", "L1 cost of states", "L1 cost of controls"),
    ]


@pytest.mark.parametrize("end", OTHER_ENDS)
def test_every_other_end_of_the_template_can_be_used(tmp_path, end):
    lines = [end if line.startswith("terminal_state") else line for line in template().splitlines()]
    problem = read_problem(file_with(tmp_path, "\n".join(lines)))
    kind = tomllib.loads(end)["terminal_state"].get("kind", "box")
    assert type(problem.terminal_state).__name__ == "".join(word.capitalize() for word in kind.split("_"))
    goal = np.tile([1.0, 0.0], (201, 1))
    assert problem.terminal_state.violation(goal[-1]).max() == 0
    assert all(term.violation(goal, np.zeros((200, 1))).max() == 0 for term in problem.terms)


def test_the_template_shows_every_kind_of_set_and_constraint():
    for kind in (*SETS.records, *SPECTRUM.records, *NORM_COSTS.records):
        assert f'kind = "{kind}"' in template() or kind in ("box", "linear_constraint", "Linf")


def test_the_template_never_replaces_a_file(tmp_path):
    (tmp_path / "mine.toml").write_text("precious")
    with pytest.raises(ProblemError, match="exists already"):
        init_problem_file(tmp_path / "mine.toml")
    assert (tmp_path / "mine.toml").read_text() == "precious"
    with pytest.raises(ProblemError, match="expected a file that can be written"):
        init_problem_file(tmp_path / "nowhere" / "p.toml")


def test_written_problems_are_plain_toml(tmp_path):
    write_problem(pendulum(), tmp_path / "p.toml")
    tables = tomllib.loads((tmp_path / "p.toml").read_text(encoding="utf-8"))
    assert tables["control_spectrum"] == [{"kind": "low_pass", "cutoff": 0.8 * np.pi}]
    assert tables["cost"] == {"R": [[2.0]]}
