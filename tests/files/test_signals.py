"""Signals from elsewhere, in CSV, MATLAB's .mat and python-control's responses: read back exactly, or refused."""

from __future__ import annotations

from dataclasses import replace

import control
import matplotlib as mpl
import numpy as np
import pytest
from scipy import sparse
from scipy.io import loadmat, savemat

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from lin_freq_ocp.files import save_csv, save_mat

T = 20
PROBLEM = lfo.OptimalControlProblem(
    dynamics=lfo.LinearDynamics(
        [[1, 0.1], [0, 1]],
        [[0.005], [0.1]],
        sampling_time=0.1,
        state_names=["position [m]", "speed [m/s]"],
        control_names=["force [N]"],
    ),
    horizon=T,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-5, 5),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=3),
)
UNCLOCKED = replace(PROBLEM, dynamics=lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]]), control_spectrum=None)


@pytest.fixture(scope="module")
def result():
    return lfo.solve(PROBLEM)


@pytest.fixture(scope="module")
def some():
    """A trajectory that no dynamics connects: what is read is not made up from a part of it."""
    rng = np.random.default_rng(6)
    return lfo.Trajectory(rng.normal(size=(T + 1, 2)), rng.normal(size=(T, 1)))


def assert_same(one, other):
    assert (one.x == other.x).all()
    assert (one.u == other.u).all()


# --- what is written is read back -----------------------------------------------------------------------------------


def test_every_way_out_is_a_way_in(tmp_path, result):
    """To the last bit, and the judge says of each what it says of the solution."""
    result.to_csv(tmp_path / "run.csv")
    result.to_mat(tmp_path / "run.mat")
    for trajectory in (
        lfo.read_csv(tmp_path / "run.csv", PROBLEM),
        lfo.read_mat(tmp_path / "run.mat", PROBLEM),
        lfo.from_time_response(result.to_time_response(), PROBLEM),
    ):
        assert_same(trajectory, result.trajectory)
        assert lfo.certify(PROBLEM, trajectory).pmp == "satisfied"


@pytest.mark.parametrize("problem", [PROBLEM, UNCLOCKED], ids=["clocked", "unclocked"])
def test_nothing_depends_on_the_dynamics(tmp_path, some, problem):
    save_csv(tmp_path / "some.csv", problem, some)
    save_mat(tmp_path / "some.mat", problem, some)
    assert_same(lfo.read_csv(tmp_path / "some.csv", problem), some)
    assert_same(lfo.read_mat(tmp_path / "some.mat", problem), some)
    assert_same(lfo.from_time_response(lfo.io.to_time_response(problem, some), problem), some)


def test_there_is_nothing_to_write_without_a_trajectory(tmp_path):
    result = lfo.solve(replace(PROBLEM, control_set=lfo.Box(-0.1, 0.1)), throw=False)
    for write in (lambda: result.to_mat(tmp_path / "run.mat"), result.to_time_response):
        with pytest.raises(lfo.errors.SolveError, match="without a trajectory"):
            write()
    assert list(tmp_path.iterdir()) == []


# --- the command line -----------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch, result):
    monkeypatch.chdir(tmp_path)
    lfo.write_problem(PROBLEM, "cart.toml")
    return tmp_path


@pytest.mark.parametrize("name", ["run.csv", "run.CSV", "run.mat", "run.npz"])
def test_certify_takes_every_kind_of_file(folder, result, name):
    {"csv": result.to_csv, "mat": result.to_mat, "npz": result.save}[name[-3:].lower()](name)
    status, out, err = run("certify", "cart.toml", name, "--json")
    summary = parsed(out)
    assert (status, err, summary["certificate"]["pmp"]) == (0, "", "satisfied")
    assert summary["cost"] == result.cost


def test_certify_tells_a_disturbed_control_from_the_optimum(folder, result):
    """A larger control at one time, replayed: it misses the end, and the file's kind does not hide it."""
    u = result.trajectory.u.copy()
    u[3] += 0.1
    savemat("u.mat", {"u": u})
    with open("u.csv", "w") as file:
        file.write("force\n" + "".join(f"{force!r}\n" for force in u[:, 0].tolist()))
    for name in ("u.mat", "u.csv"):
        status, out, _ = run("certify", "cart.toml", name, "--json")
        failed = {one["label"] for one in parsed(out)["certificate"]["conditions"] if not one["passed"]}
        assert (status, parsed(out)["certificate"]["pmp"]) == (3, "violated")
        assert {"S-x", "C-vii"} <= failed


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.csv", None, "none.csv: got no such file"),
        ("none.mat", None, "none.mat: got no such file"),
        ("bad.csv", b"force [N]\n1\nx\n", "error: bad.csv: rows: got 2; expected 21, or 20"),
        ("bad.csv", b"force [N]\n" + 20 * b"1\n" + b"\xff\n", "bad.csv: got byte 50 that is not UTF-8"),
        ("bad.mat", b"no file of MATLAB's" * 20, "expected a .mat file of version 5 or 7"),
        ("bad.mat", b"", "expected a .mat file of version 5 or 7"),
    ],
)
def test_files_that_cannot_be_read_are_named(folder, name, content, words):
    if content is not None:
        (folder / name).write_bytes(content)
    status, out, err = run("certify", "cart.toml", name)
    assert (status, out) == (2, "")
    assert words in err


# --- CSV ------------------------------------------------------------------------------------------------------------


def table(head, *columns):
    """Return a CSV text."""
    return "\n".join([head, *(",".join(map(str, row)) for row in zip(*columns, strict=True))]) + "\n"


def csv_file(folder, text):
    path = folder / "run.csv"
    path.write_text(text, encoding="utf-8")
    return path


def csv_message(folder, text, problem=PROBLEM):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.read_csv(csv_file(folder, text), problem)
    assert caught.value.field.startswith("run.csv: ")
    return str(caught.value)


STEPS = range(T + 1)
GOOD = table("position,speed,force", *(range(k, k + T + 1) for k in (0, 100, 200)))


def test_columns_are_found_by_name(tmp_path):
    """In any order, with or without units, between others; the control at time T is not read."""
    ahead, behind = ["a"] * (T + 1), [""] * (T + 1)
    force = [*range(T), "broken"]
    text = table("comment,speed,force [N],position [m],", ahead, range(100, 121), force, range(200, 221), behind)
    trajectory = lfo.read_csv(csv_file(tmp_path, text), PROBLEM)
    assert trajectory.x.T.tolist() == [list(range(200, 221)), list(range(100, 121))]
    assert trajectory.u[:, 0].tolist() == list(range(T))


def test_spreadsheets_have_their_ways(tmp_path):
    """A byte-order mark, Windows line ends, blanks, quotes, empty lines at the end."""
    text = GOOD.replace("speed", '"speed [m/s] "').replace("\n", "\r\n").replace(",", ", ")
    path = tmp_path / "run.csv"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode() + b"\r\n,,\r\n")
    assert_same(lfo.read_csv(path, PROBLEM), lfo.read_csv(csv_file(tmp_path, GOOD), PROBLEM))


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_semicolons_tabs_and_decimal_commas_are_read(tmp_path, separator, decimal):
    u = np.sin(STEPS)
    text = table("position,speed,force", STEPS, STEPS, u).replace(",", separator).replace(".", decimal)
    trajectory = lfo.read_csv(csv_file(tmp_path, text), PROBLEM)
    assert (trajectory.u[:, 0] == u[:T]).all()
    assert trajectory.x.T.tolist() == [list(STEPS)] * 2


@pytest.mark.parametrize("rows", [T, T + 1])
def test_controls_alone_are_replayed(tmp_path, rows):
    u = np.sin(np.arange(rows))
    text = table("time [s],t,force", 5 + 0.1 * np.arange(rows), range(rows), u)
    trajectory = lfo.read_csv(csv_file(tmp_path, text), PROBLEM)
    assert_same(trajectory, lfo.simulate(PROBLEM, u[:T, None]))


def test_times_may_be_rounded_but_not_wrong(tmp_path):
    rounded = table("time [s],force", [f"{3 + 0.1 * t + 0.004 * (-1) ** t:.3f}" for t in STEPS], STEPS)
    assert_same(lfo.read_csv(csv_file(tmp_path, rounded), PROBLEM), lfo.simulate(PROBLEM, np.arange(T)[:, None]))
    slow = table("time [s],force", [f"{3 + 0.1008 * t:.4f}" for t in STEPS], STEPS)
    expected = "run.csv: line 15, column 'time [s]': got 4.3104; expected 4.3, 13 periods of 0.1 after 3"
    assert expected in csv_message(tmp_path, slow)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("", "", "header: got an empty file"),
        ("force", "thrust", "column 'force [N]': got none (there is 'position', 'speed', 'thrust')"),
        ("speed", "speed [km/h]", "column 'speed [m/s]': got none (there is 'position', 'speed [km/h]', 'force')"),
        (
            "position,speed",
            "Position,speed [km/h]",
            "columns: got 'Position', 'speed [km/h]'; expected columns for the",
        ),
        ("force", "speed", "column 'speed': got 2 of them"),
        (",", "|", "column 'force [N]': got none (there is 'position|speed|force')"),
        ("position,speed", "position;speed", "line 2: got 3 cells; expected 2, as many as the header has"),
        ("\n7,107,207", "\n7,107", "line 9: got 2 cells; expected 3"),
        ("\n7,107,207", "\n7,,207", "line 9, column 'speed': got an empty cell; expected a finite number"),
        ("\n7,107,207", "\n7,much,207", "line 9, column 'speed': got 'much'"),
        ("\n7,107,207", "\n7,107,nan", "line 9, column 'force': got 'nan'"),
        ("\n7,107,207", "\ninf,107,207", "line 9, column 'position': got 'inf'"),
        ("\n7,107,207", "", "rows: got 20; expected 21: one per time"),
        ("\n7,107,207", '\n7,107,"207', "got unexpected end of data; expected comma-separated values"),
        ("\n7,107,207", "\n\n7,x,207", "line 10, column 'speed'"),
    ],
)
def test_a_bad_table_is_refused_with_line_and_column(tmp_path, old, new, words):
    assert words in csv_message(tmp_path, GOOD.replace(old, new) if old else "\n")


def test_a_missing_step_is_found(tmp_path):
    """A row is missing and another stands twice, so that their number is right."""
    steps = [*range(9), 8, *range(10, T + 1)]
    found = csv_message(tmp_path, table("t,position,speed,force", steps, STEPS, STEPS, STEPS))
    assert "line 11, column 't': got 8; expected 9" in found


def test_controls_need_an_initial_state_to_start_from(tmp_path):
    problem = replace(PROBLEM, initial_state=lfo.Box(-1, 1))
    assert "initial_state: got None" in csv_message(tmp_path, table("force", range(T)), problem)


def test_a_name_without_its_unit_must_be_the_only_one(tmp_path):
    names = ["position [m]", "position [rad]"]
    problem = replace(PROBLEM, dynamics=lfo.LinearDynamics(np.eye(2), [[0], [1]], None, 0.1, names, ["force"]))
    text = table("position,position [rad],force", STEPS, STEPS, STEPS)
    assert "column 'position [m]': got none" in csv_message(tmp_path, text, problem)
    exact = text.replace("position,", "position [m],")
    assert lfo.read_csv(csv_file(tmp_path, exact), problem).x.shape == (T + 1, 2)


# --- MATLAB ---------------------------------------------------------------------------------------------------------


def test_matlab_sees_one_row_per_time_and_the_names(tmp_path, result):
    result.to_mat(tmp_path / "run.mat")
    seen = loadmat(tmp_path / "run.mat", spmatrix=False)
    assert (seen["x"] == result.trajectory.x).all()
    assert (seen["u"] == result.trajectory.u).all()
    np.testing.assert_allclose(seen["t"], 0.1 * np.arange(T + 1)[:, None], rtol=1e-15)
    assert [str(cell[0][0]) for cell in seen["state_names"]] == list(PROBLEM.state_names)
    assert [str(cell[0][0]) for cell in seen["control_names"]] == list(PROBLEM.control_names)


def test_controls_of_lsim_have_one_row_more(tmp_path, some):
    """Its value acts on nothing, and may be NaN; t may be a row."""
    variables = {"x": some.x, "u": np.vstack([some.u, [[np.nan]]]), "t": 7 + 0.1 * np.arange(T + 1)[None], "y": "text"}
    savemat(tmp_path / "run.mat", variables)
    assert_same(lfo.read_mat(tmp_path / "run.mat", PROBLEM), some)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"u": None}, "run.mat: u: got nothing (there is x)"),
        ({"x": np.zeros((2, T + 1))}, "run.mat: x: got shape (2, 21); expected shape (21, 2), one row per time. Tran"),
        ({"u": np.zeros((1, T))}, "run.mat: u: got shape (1, 20); expected shape (20, 1) or (21, 1)"),
        ({"u": np.zeros((T - 1, 1))}, "run.mat: u: got shape (19, 1)"),
        ({"x": np.zeros((T, 2))}, "run.mat: x: got shape (20, 2)"),
        ({"x": np.full((T + 1, 2), np.inf)}, "run.mat: x[0][0]: got inf"),
        ({"x": np.full((T + 1, 2), 1j)}, "run.mat: x: got a complex matrix"),
        (
            {"x": sparse.csc_array(np.eye(T + 1, 2))},
            "run.mat: x: got a sparse matrix or a structure; expected a matrix of real numbers, full",
        ),
        ({"u": "text"}, "run.mat: u: got text"),
        ({"t": 0.2 * np.arange(T + 1)}, "run.mat: t[1]: got 0.2; expected 0.1, 1 periods of 0.1 after 0"),
        ({"t": np.zeros(T)}, "run.mat: t: got shape (1, 20); expected shape (21, 1)"),
    ],
)
def test_a_bad_mat_file_is_refused_with_its_variable(tmp_path, some, change, words):
    variables = {"x": some.x, "u": some.u} | change
    savemat(tmp_path / "run.mat", {name: value for name, value in variables.items() if value is not None})
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.read_mat(tmp_path / "run.mat", PROBLEM)
    assert words in str(caught.value)


def test_version_7_3_is_refused_with_the_cure(tmp_path):
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "run.mat").write_bytes(head + b"\x89HDF\r\n\x1a\n" * 20)
    with pytest.raises(lfo.errors.ProblemError, match=r"version 7\.3.*'-v7'"):
        lfo.read_mat(tmp_path / "run.mat", PROBLEM)


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int8, np.uint16, np.int64, np.bool_])
@pytest.mark.parametrize("compressed", [False, True])
def test_what_scipy_writes_is_read(tmp_path, dtype, compressed):
    """Numbers of every type, in small elements too, between variables of every other kind."""
    given = (3 * np.random.default_rng(2).normal(size=(T + 1, 2))).astype(dtype)
    others = {"a_longer_name": "höhe", "c": np.array(["a", 2], dtype=object), "s": {"f": 1.0}, "e": np.zeros((0, 3))}
    variables = {**others, "u": np.ones((T, 1), dtype=np.int8), "x": given}
    savemat(tmp_path / "run.mat", variables, do_compression=compressed, long_field_names=True)
    trajectory = lfo.read_mat(tmp_path / "run.mat", PROBLEM)
    assert (trajectory.x == given).all()
    assert (trajectory.u == 1).all()


# --- python-control -------------------------------------------------------------------------------------------------


def test_a_response_has_labels_times_and_no_last_input(result):
    response = result.to_time_response()
    np.testing.assert_allclose(response.time, 0.1 * np.arange(T + 1), rtol=1e-15)
    assert (response.states["speed [m/s]"] == result.trajectory.x[:, 1]).all()
    assert (response.outputs["position [m]"] == result.trajectory.x[:, 0]).all()
    assert (response.inputs[0, :T] == result.trajectory.u[:, 0]).all()
    assert np.isnan(response.inputs[0, T])
    with mpl.rc_context({"figure.max_open_warning": 0}):
        mpl.use("Agg")
        response.plot()
        mpl.pyplot.close("all")


def discrete_plant(**names):
    return control.ss(PROBLEM.dynamics.A, PROBLEM.dynamics.B, np.eye(2), np.zeros((2, 1)), 0.1, **names)


def test_a_simulation_of_python_control_is_judged(result):
    """Its states are ours: the same dynamics, from the same controls, so the judge is content."""
    u = np.append(result.trajectory.u[:, 0], 0.0)
    response = control.forced_response(discrete_plant(), 0.1 * np.arange(T + 1), u, return_x=True)
    trajectory = lfo.from_time_response(response, PROBLEM)
    np.testing.assert_allclose(trajectory.x, result.trajectory.x, atol=1e-12)
    assert lfo.certify(PROBLEM, trajectory).pmp == "satisfied"


@pytest.mark.parametrize("with_states", [True, False])
def test_signals_are_found_by_their_labels(some, with_states):
    """The response has the states in another order, among further outputs."""
    outputs = np.vstack([some.x[:, 1], np.zeros(T + 1), some.x[:, 0]])
    response = control.TimeResponseData(
        0.1 * np.arange(T + 1),
        outputs,
        states=np.zeros((3, T + 1)) if with_states else None,
        inputs=np.append(some.u[:, 0], 9.0),
        output_labels=["speed [m/s]", "other", "position [m]"],
    )
    assert_same(lfo.from_time_response(response, PROBLEM), some)


def test_states_come_before_outputs(some):
    response = response_of(some, outputs=2 * some.x.T, states=some.x.T)
    assert_same(lfo.from_time_response(response, PROBLEM), some)


def response_of(some, **change):
    given = {"outputs": some.x.T, "inputs": np.append(some.u[:, 0], 0.0), "time": 0.1 * np.arange(T + 1)} | change
    return control.TimeResponseData(issiso=False, **given)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"time": 0.2 * np.arange(T + 1)}, "response.time[1]", "Sample the signals with the problem's sampling time"),
        ({"inputs": None}, "response.inputs", "got no inputs; expected 1: force [N]"),
        ({"inputs": np.zeros((2, T + 1))}, "response.inputs", "got 2 inputs"),
        (
            {"outputs": np.zeros(T + 1)},
            "response.states, outputs",
            "got no states; 1 outputs; expected 2: position [m]",
        ),
        ({"outputs": np.full((2, T + 1), np.nan)}, "response.x[0][0]", "got nan"),
        ({"inputs": np.full(T + 1, np.inf)}, "response.u[0][0]", "got inf"),
    ],
)
def test_a_response_that_does_not_fit_is_refused(some, change, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.from_time_response(response_of(some, **change), PROBLEM)
    assert caught.value.field == field
    assert words in str(caught.value)


def test_only_one_response_is_taken(some):
    plant = control.ss(PROBLEM.dynamics.A, np.eye(2), np.eye(2), np.zeros((2, 2)), 0.1)
    both = control.step_response(plant, 0.1 * np.arange(T + 1))
    for response, words in ((both, "2 traces"), (some, "a control.TimeResponseData")):
        with pytest.raises(lfo.errors.ProblemError, match=words):
            lfo.from_time_response(response, PROBLEM)
    one = control.step_response(discrete_plant(), 0.1 * np.arange(T + 1))
    assert_same(lfo.from_time_response(one, PROBLEM), lfo.simulate(PROBLEM, np.ones((T, 1))))
    short = lfo.io.to_time_response(replace(PROBLEM, horizon=5), lfo.Trajectory(some.x[:6], some.u[:5]))
    with pytest.raises(lfo.errors.ProblemError, match="got 6 times; expected 21"):
        lfo.from_time_response(short, PROBLEM)
