"""Files that were spoiled at random: each is read, or refused by one of our errors."""

import csv
import datetime
import io
import json
import random
import warnings
import zipfile
from copy import deepcopy
from functools import partial

import numpy as np
import pytest
import tomli_w
from scipy.io import savemat

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.every_table import GOOD, PIECEWISE
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.api import Rerun, outcome_fields, rerun_summary
from lin_freq_ocp.base import LARGE, MOST_ENTRIES
from lin_freq_ocp.files import sweep_summary, to_json
from lin_freq_ocp.pages import sweep_table

SMOOTH = {
    **{"schema": 1, "horizon": 4, "cost": {"R": 1.0}, "initial_state": [0.0, 0.0], "control_set": {"upper": 1.0}},
    "dynamics": {
        **{"control_dim": 1, "sampling_time": 0.1, "state_names": ["a", "b"], "control_names": ["c"]},
        **{"f": ["x_0 + max(0, x_1) * u_0 / 2", "norm(x_0, x_1)**2 - sin(x_0)"], "domain": ["1 + x_0"]},
    },
}
MODES = SMOOTH | {
    "dynamics": {
        "control_dim": 1,
        "modes": [
            {"f": ["x_0 / 2", "x_1"], "region": ["x_0"], "name": "left"},
            {"f": ["u_0", "x_1"], "region": ["-x_0"]},
        ],
    }
}

NUMBERS = [0, -1, 1, 7, 10**30, -(10**400), 0.5, -0.5, 1e-320, 1e308, float("nan"), float("inf"), float("-inf")]
TEXTS = ["", " ", "text", "none", "x_0", "0**-1", "1" * 5000, "(" * 300, "a\nb", "=1+1", "\x00", "é" * 90, "low_pass"]
OTHERS = [True, False, [], {}, [[]], [{}], [[1.0], [2.0, 3.0]], [[[[1.0]]]], ["a"], [None]]
DATE = datetime.date(2024, 2, 29)
NESTED = json.loads("[" * 40 + "]" * 40)


def containers(value):
    """Return all tables and lists within a value that are not empty."""
    found, stack = [], [value]
    while stack:
        one = stack.pop()
        if isinstance(one, (dict, list)) and one:
            found.append(one)
            stack += list(one.values() if isinstance(one, dict) else one)
    return found


def spoiled(value, rng, others=(*OTHERS, NESTED, DATE)):
    """Return a copy with another value, key, type or length in one place, or in two."""
    value = deepcopy(value)
    for _ in range(rng.choice([1, 1, 2])):
        places = containers(value)
        if not places:
            return value
        place = rng.choice(places)
        key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
        change = rng.randrange(7)
        if change == 0:
            del place[key]
        elif change == 1 and isinstance(place, dict):
            place[rng.choice([*TEXTS[2:4], "kind", "npz", "name"])] = place.pop(key)
        elif change == 2:
            place[key] = [place[key]] * rng.choice([1, 2])
        elif change == 3:
            place[key] = {rng.choice(["npz", "kind", "a"]): place[key]}
        else:
            place[key] = rng.choice([rng.choice(NUMBERS), rng.choice(TEXTS), rng.choice(others)])
    return value


def read_or_refused(read, *given):
    """Whether a file was read; any error but ours is the fault that is looked for."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read(*given)
        except lfo.errors.LinFreqOCPError:
            return False
    return True


def without_null(value):
    """Return a value without None, which TOML cannot say."""
    if isinstance(value, dict):
        return {str(key): without_null(one) for key, one in value.items() if one is not None}
    return [without_null(one) for one in value if one is not None] if isinstance(value, list) else value


@expensive
@pytest.mark.parametrize("tables", [GOOD, PIECEWISE, SMOOTH, MODES], ids=["every", "piecewise", "smooth", "modes"])
def test_spoiled_problem_files(tables, tmp_path):
    rng, path, read = random.Random(15), tmp_path / "problem.toml", 0
    for _ in range(40):
        path.write_text(tomli_w.dumps(without_null(spoiled(tables, rng))), encoding="utf-8")
        read += read_or_refused(lfo.read_problem, path)
    assert 0 < read < 80


@pytest.fixture(scope="module")
def cart():
    """A problem, its result, and the bytes of every kind of file that holds them."""
    system = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], sampling_time=0.1, state_names=["p [m]", "v"])
    ends = {"initial_state": [0.0, 0.0], "terminal_state": [0.1, 0.0]}
    rows = lfo.StageRows([[0.0, 1.0]], None, [2.0], name="speed")
    problem = lfo.OptimalControlProblem(system, 8, lfo.QuadraticCost(R=1.0), stage_rows=rows, **ends)
    return lfo.solve(problem)


HEADERS = ["x", "", "schema", "eta", "stage/speed", "stage/", "allow_pickle"]


def spoiled_arrays(arrays, rng):
    arrays = dict(arrays)
    key = rng.choice(list(arrays))
    value = arrays[key]
    change = rng.randrange(8)
    if change == 0:
        del arrays[key]
    elif change == 1:
        arrays[rng.choice(HEADERS)] = arrays.pop(key)
    elif change == 2:
        arrays[key] = np.array(rng.choice([*NUMBERS[:5], *NUMBERS[6:], *TEXTS, True]))
    elif change == 3:
        arrays[key] = np.zeros(value.shape, rng.choice(["U8", "S4", "?", "c16", "m8", "M8[s]", "i1", "f2"]))
    elif change == 4:
        arrays[key] = value.T if value.ndim > 1 else value[None]
    elif change == 5:
        arrays[key] = np.concatenate([value, value]) if value.ndim else np.array([value, value])
    elif change == 6 and value.size and value.dtype.kind == "f":
        arrays[key] = value.copy()
        arrays[key].flat[rng.randrange(value.size)] = rng.choice([*NUMBERS[6:]])
    else:
        arrays[key] = np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f8")])
    return arrays


@pytest.mark.filterwarnings("ignore")
def test_spoiled_solutions(cart, tmp_path):
    """Those that can be read and fit are judged, too: no number in them ends in a traceback."""
    cart.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as archive:
        arrays = dict(archive)
    rng, read = random.Random(15), 0
    for _ in range(40):
        np.savez(tmp_path / "bad.npz", **spoiled_arrays(arrays, rng))
        read += read_or_refused(certified, cart.problem, tmp_path / "bad.npz")
    assert 0 < read < 95


def certified(problem, path):
    saved = lfo.load(path)
    lfo.certify(problem, saved.trajectory, saved.multipliers)


def test_spoiled_archives_of_matlab(cart, tmp_path):
    T, rng, read = cart.problem.horizon, random.Random(15), 0
    arrays = {"x": cart.trajectory.x, "u": cart.trajectory.u, "t": np.arange(T + 1.0)[:, None] * 0.1}
    for number in range(40):
        bad = spoiled_arrays(arrays, rng)
        named = {name: value for name, value in bad.items() if name.isidentifier() and value.dtype.kind not in "mM"}
        savemat(tmp_path / "bad.mat", named, do_compression=number % 2 == 0)
        content = bytearray((tmp_path / "bad.mat").read_bytes())
        if number % 3 == 0:
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        (tmp_path / "bad.mat").write_bytes(content[: rng.choice([len(content)] * 5 + [rng.randrange(len(content))])])
        read += read_or_refused(lfo.read_mat, tmp_path / "bad.mat", cart.problem)
    assert 0 < read < 95


def test_spoiled_tables(cart, tmp_path):
    rng, read, path = random.Random(15), 0, tmp_path / "bad.csv"
    cart.to_csv(path)
    rows = list(csv.reader(io.StringIO(path.read_text())))
    for number in range(40):
        bad = deepcopy(rows)
        row = rng.randrange(rng.choice([1, len(bad)]))
        if number % 5 == 0:
            bad = spoiled(bad, rng)
        else:
            bad[row][rng.randrange(len(bad[row]))] = str(rng.choice([rng.choice(NUMBERS[:5] + NUMBERS[6:]), *TEXTS]))
        lines = [",".join(map(str, row)) if isinstance(row, list) else str(row) for row in bad]
        path.write_text("\n".join(lines)[: rng.choice([None, None, None, 100])], encoding="utf-8")
        read += read_or_refused(lfo.read_csv, path, cart.problem)
    assert 0 < read < 95


def test_spoiled_runs(cart, tmp_path):
    """What is read is shown by the command rerun, whose tables take whatever a stranger wrote."""
    cart.dump(tmp_path / "run.zip")
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    rng, read = random.Random(15), 0
    for _ in range(40):
        bad = dict(contents)
        bad["run.json"] = json.dumps(spoiled(json.loads(bad["run.json"]), rng, [*OTHERS, NESTED, None])).encode()
        with zipfile.ZipFile(tmp_path / "bad.zip", "w") as archive:
            for name, content in bad.items():
                archive.writestr(name, content)
        read += read_or_refused(shown, tmp_path / "bad.zip")
    assert 0 < read < 95


def shown(path):
    saved = lfo.load_run(path)
    then, now = outcome_fields(saved.summary, saved.error), outcome_fields(None, None)
    seen = Rerun(None, None, then, now, saved.environment, {})
    to_json(rerun_summary(seen))
    str(seen)


@expensive
def test_spoiled_sweeps(tmp_path):
    """Rows that can be read can be shown, written as a table and drawn, or drawing says why not."""
    lfo.sweep(partial(lfo.library.double_integrator, horizon=20), {"cutoff_hz": [None, 0.5]}, path=tmp_path / "good")
    lines = [json.loads(line) for line in (tmp_path / "good").read_text().splitlines()]
    rng, read, path = random.Random(15), 0, tmp_path / "bad"
    for _ in range(40):
        bad = deepcopy(lines)
        number = rng.randrange(len(bad))
        bad[number] = spoiled(bad[number], rng, [*OTHERS, NESTED, None])
        path.write_text("".join(json.dumps(line) + "\n" for line in bad))
        read += read_or_refused(tabled, path, tmp_path / "out.csv")
    assert 0 < read < 95


def tabled(path, out):
    found = lfo.load_sweep(path)
    found.to_csv(out)
    str(sweep_table(found))
    to_json(sweep_summary(found))
    found.plot()


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000, "1" * 5000, '{"kind": "lin-freq-ocp sweep", "schema": 1, "a": ' + "[" * 9999],
)
def test_nesting_and_numbers_without_end(text, cart, tmp_path):
    """Of JSON, of TOML, and of both in all files that hold them."""
    assert not read_or_refused(lfo.load_sweep, written(tmp_path / "sweep", text + "\n"))
    assert not read_or_refused(lfo.read_problem, written(tmp_path / "problem.toml", "schema = " + text))
    np.savez(tmp_path / "run.npz", x=cart.trajectory.x, u=cart.trajectory.u, summary=text)
    assert not read_or_refused(lfo.load, tmp_path / "run.npz")
    cart.dump(tmp_path / "run.zip")
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, text if name == "run.json" else content)
    assert not read_or_refused(lfo.load_run, tmp_path / "bad.zip")


@expensive
def test_keys_with_thousands_of_dots(tmp_path):
    """Each dot is a table within a table, which the parser makes without recursion."""
    text = "schema = 1\n" + ".".join(["a"] * 5000) + " = 1\n"
    assert not read_or_refused(lfo.read_problem, written(tmp_path / "problem.toml", text))
    text = "schema = 1\ncost." + ".".join(["a"] * 5000) + " = 1\n"
    assert not read_or_refused(lfo.read_problem, written(tmp_path / "problem.toml", text))


def written(path, text):
    path.write_text(text)
    return path


HUGE = "1" * 5000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--set", f"horizon={HUGE}"), "--set"),
        (("--set", "horizon=1e30"), "horizon: got 1e+30; expected a whole number"),
        (("--set", f"horizon=1{'0' * 30}"), "horizon: got 1000000000000000000000000000000; expected a whole number"),
        (("--set", "horizon=20.5"), "horizon: got 20.5; expected a whole number"),
        (("--set", "horizon=nan"), "horizon: got nan; expected a whole number"),
        (("--set", "horizon=true"), "horizon: got True; expected a whole number"),
        (("--set", "sampling_time=0"), "sampling_time"),
        (("--set", "speed_bound=[]"), "speed_bound"),
        (("--set", ".".join(["a"] * 5000) + "=1"), "--set"),
        (("--set", "a=" + "[" * 5000), "--set"),
    ],
)
def test_settings_that_no_problem_has(arguments, words):
    status, out, err = run("solve", "double_integrator", *arguments)
    assert (status, out) == (2, "")
    assert words in err


@pytest.mark.parametrize(
    "grid",
    [
        f"horizon=[{HUGE}]",
        "horizon=0:inf:3",
        "horizon=0:1:" + "9" * 40,
        "horizon=0:1:99999999999",
        "horizon=" + "[" * 5000,
    ],
)
def test_grids_that_no_sweep_has(grid):
    status, out, err = run("sweep", "double_integrator", "--grid", f"horizon={grid}")
    assert (status, out) == (2, "")
    assert "--grid" in err


# --- archives that unpack to more than they should ------------------------------------------------------------------


def bomb(path, names, size=2**29):
    """Write an archive of zeros, packed a thousand times tighter than they are."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            with archive.open(name, "w", force_zip64=True) as stream:
                np.lib.format.write_array_header_1_0(
                    stream, {"descr": "<f8", "fortran_order": False, "shape": (size // 8,)}
                )
                for _ in range(size // 2**24):
                    stream.write(bytes(2**24))
    return path


@pytest.fixture
def unpacked(monkeypatch):
    """Return the numbers of bytes that were taken out of archives."""
    taken, honest = [], zipfile.ZipExtFile.read

    def counted(*given):
        content = honest(*given)
        taken.append(len(content))
        return content

    monkeypatch.setattr(zipfile.ZipExtFile, "read", counted)
    return taken


@expensive
def test_bombs_are_not_unpacked(tmp_path, unpacked, monkeypatch):
    """The sizes that the archive itself declares are enough: here of a sixteenth of what is large otherwise."""
    substitute(monkeypatch, "base.LARGE", LARGE // 16)
    path = bomb(tmp_path / "bomb.zip", ["x.npy", "u.npy"], LARGE // 16)
    for read in (lfo.load, lfo.load_run):
        with pytest.raises(lfo.errors.ProblemError, match=r"bytes that unpack to 3\d+ or more"):
            read(path)
    assert sum(unpacked) == 0


@expensive
def test_an_archive_of_very_many_entries_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as archive:
        for number in range(MOST_ENTRIES + 1):
            archive.writestr(f"{number}.npy", b"")
    for read in (lfo.load, lfo.load_run):
        with pytest.raises(lfo.errors.ProblemError, match="10001 entries"):
            read(tmp_path / "many.npz")


@pytest.mark.parametrize("shape", [(10**6,), (10**12, 10**12), (-1,), (2**62, 4)])
def test_an_array_is_not_larger_than_its_entry(tmp_path, unpacked, shape):
    """The header of an array says how much memory is asked for, whatever follows."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr("x.npy", header.getvalue() + bytes(800))
    with pytest.raises(lfo.errors.ProblemError, match=r"x\.npy of shape .*as many numbers as it says"):
        lfo.load(tmp_path / "run.npz")
    assert sum(unpacked) < 1000


def test_what_is_no_array_is_not_taken_for_one(tmp_path):
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr("x", b"not an array")
    with pytest.raises(lfo.errors.ProblemError, match="which is no array"):
        lfo.load(tmp_path / "run.npz")


def test_a_bomb_for_matlab_is_not_unpacked(cart, tmp_path, monkeypatch):
    substitute(monkeypatch, "base.LARGE", 2**24)  # an archive above shows the limit itself
    savemat(tmp_path / "bomb.mat", {"x": np.zeros((2**18, 9)), "u": np.zeros((8, 1))}, do_compression=True)
    with pytest.raises(lfo.errors.ProblemError, match="bytes that unpack to"):
        lfo.read_mat(tmp_path / "bomb.mat", cart.problem)


def test_a_large_answer_of_zeros_is_no_bomb(cart, tmp_path, monkeypatch):
    """What is dumped can be read again: it is stored as it is where it would be taken for a bomb."""
    substitute(monkeypatch, "base.LARGE", 10_000)
    substitute(monkeypatch, "base.MOST_COMPRESSED", 2)
    cart.dump(tmp_path / "run.zip")
    assert lfo.load_run(tmp_path / "run.zip").summary["status"] == "optimal"


# --- names ----------------------------------------------------------------------------------------------------------


HOSTILE = [
    "line\nbreak",
    "carriage\rreturn",
    "\x1b[31mred",
    "bell\x07",
    "\x00",
    "right\u202eleft",
    "\ud800",
    "a\u2028b",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_control_characters_in_names_are_refused(name):
    A, one = [[1.0]], {"horizon": 2, "cost": lfo.QuadraticCost(R=1.0)}
    system = lfo.LinearDynamics(A, A)
    mode = {"f": ["x_0"], "name": name}
    for make, field in {
        (lambda: lfo.LinearDynamics(A, A, state_names=[name]), "dynamics.state_names"),
        (lambda: lfo.LinearDynamics(A, A, control_names=[name]), "dynamics.control_names"),
        (lambda: lfo.OptimalControlProblem(system, **one, name=name), "name"),
        (lambda: lfo.StageRows(A, A, [1.0], name=name), "stage_rows.name"),
        (lambda: lfo.spectrum.OutputSpectrum(A, None, [lfo.low_pass(1.0)], [name]), "output_spectrum.output_names"),
        (lambda: lfo.AffineMode(A, A, name=name), "mode.name"),
        (lambda: lfo.PiecewiseSmoothDynamics([lfo.dynamics.SmoothMode(**mode)], 1, 1), "dynamics.modes[0].name"),
    }:
        with pytest.raises(lfo.errors.ProblemError, match="printable characters") as caught:
            make()
        assert caught.value.field == field


def test_names_that_spreadsheets_take_for_formulas_are_quoted_and_read_back(tmp_path):
    names = ["=cmd|' /C calc'!A0 [m]", "'=cmd", "+1", "-v [m/s]", "@SUM(A1)", "'quoted'", " =late", "plain = [1]"]
    system = lfo.LinearDynamics(np.eye(8) / 2, np.ones((8, 1)), state_names=names, control_names=["=u"])
    problem = lfo.OptimalControlProblem(system, 3, lfo.QuadraticCost(R=1.0), initial_state=np.arange(8.0))
    result = lfo.solve(problem)
    result.to_csv(tmp_path / "run.csv")
    head = next(csv.reader((tmp_path / "run.csv").read_text().splitlines()))
    assert not [cell for cell in head if cell.lstrip()[:1] in ("=", "+", "-", "@")]
    again = lfo.read_csv(tmp_path / "run.csv", problem)
    np.testing.assert_array_equal(again.x, result.trajectory.x)
    np.testing.assert_array_equal(again.u, result.trajectory.u)
    text = (tmp_path / "run.csv").read_text().replace("'=cmd|", "=cmd|").replace("'+1", "+1")
    np.testing.assert_array_equal(lfo.read_csv(written(tmp_path / "other.csv", text), problem).x, again.x)


def test_text_in_tables_of_sweeps_is_no_formula(tmp_path):
    lfo.sweep(build, {"name": ["=1+1", "-inf"]}).to_csv(tmp_path / "sweep.csv")
    rows = list(csv.reader((tmp_path / "sweep.csv").read_text().splitlines()))
    assert [row[0] for row in rows] == ["name", "'=1+1", "-inf"]


def build(name):
    system = lfo.LinearDynamics([[0.5]], [[1.0]])
    return lfo.OptimalControlProblem(system, 2, lfo.QuadraticCost(R=1.0), initial_state=[1.0], name=name)
