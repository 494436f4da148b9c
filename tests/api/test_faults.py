"""Faults: errors on their way between processes, solvers shared by threads, what nobody foresaw, failures to write."""

import errno
import os
import pickle
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.batch import process_pool
from lin_freq_ocp.methods.spectral import Violations

SHORT = partial(lfo.library.double_integrator, horizon=60, sampling_time=0.1, cutoff_hz=1.0)

WORDS = ("double_integrator", "--set", "horizon=60", "--set", "sampling_time=0.1", "--set", "cutoff_hz=1.0")
"""The same on the command line."""

ERRORS = [
    one for one in vars(lfo.errors).values() if isinstance(one, type) and issubclass(one, lfo.errors.LinFreqOCPError)
]


def failing(error):
    """Return a function that raises an error, or an OSError of this number."""

    def fails(*given):
        raise OSError(error, os.strerror(error)) if isinstance(error, int) else error

    return fails


# --- between processes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ERRORS)
def test_every_error_survives_pickling_with_all_it_holds(kind):
    arguments = (
        ("cost.R", "-1", "a number above 0", "Square it.") if kind is lfo.errors.ProblemError else ("what happened",)
    )
    error = kind(*arguments)
    error.noted = "on the way"
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        again = pickle.loads(pickle.dumps(error, protocol))
        assert (type(again), str(again), vars(again)) == (kind, str(error), vars(error))


@expensive
def test_the_result_of_an_error_survives_pickling():
    with pytest.raises(lfo.errors.InfeasibleError) as caught:
        lfo.solve(SHORT(control_bound=1e-3))
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    assert again.result.status == "infeasible"
    assert again.result.conflict == caught.value.result.conflict
    np.testing.assert_array_equal(again.result.ray.eta, caught.value.result.ray.eta)


def test_a_bad_problem_kills_no_pool():
    """What a worker raises is unpickled by the pool's own thread, whose death takes the whole pool with it."""
    with process_pool(1) as pool:
        error = pool.submit(SHORT, control_bound=-1.0).exception(60)
        assert isinstance(error, lfo.errors.ProblemError)
        assert error.field == "control_bound"
        rows = lfo.sweep(SHORT, {"control_bound": [-1.0, 1.0]}, pool).rows
    assert [row["status"] for row in rows] == ["error", "optimal"]
    assert rows[0]["message"] == str(error)


# --- between threads ------------------------------------------------------------------------------------------------


def test_threads_that_share_a_solver_get_the_answers_of_its_own(monkeypatch):
    """The pause lets another thread in between measuring a point and using what was measured."""
    problem = lfo.library.double_integrator(horizon=150, speed_bound=0.2, control_bound=0.6)
    ends = [[distance, 0.0] for distance in np.linspace(0.0, 0.46, 16)]
    alone = [lfo.SpectralSolver(problem).solve(terminal_state=end) for end in ends]
    honest = Violations.measure_values

    def pausing(*given):
        worst = honest(*given)
        time.sleep(0.001)
        return worst

    monkeypatch.setattr(Violations, "measure_values", pausing)
    solver = lfo.SpectralSolver(problem)
    with ThreadPoolExecutor(4) as threads:
        shared = list(threads.map(lambda end: solver.solve(terminal_state=end), ends))
    for one, other in zip(alone, shared, strict=True):
        assert one.status == other.status == "optimal"
        np.testing.assert_allclose(one.trajectory.u, other.trajectory.u, rtol=0, atol=1e-9)


def test_a_solver_can_be_sent_to_another_process():
    solver = lfo.SpectralSolver(SHORT())
    again = pickle.loads(pickle.dumps(solver))
    np.testing.assert_array_equal(again.solve().trajectory.u, solver.solve().trajectory.u)


# --- what nobody foresaw --------------------------------------------------------------------------------------------


@expensive
@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (IndexError("index 3 is out of bounds"), 70, ("a fault of lin-freq-ocp", "index 3 is out of bounds", "--dump")),
        (RecursionError("maximum recursion depth exceeded"), 70, ("a fault of lin-freq-ocp", "nested too deeply")),
        (AssertionError(), 70, ("a fault of lin-freq-ocp", "AssertionError", "broken")),
        (MemoryError("Unable to allocate 7.45 GiB"), 3, ("not enough memory", "7.45 GiB")),
    ],
)
@pytest.mark.parametrize("arguments", [("solve", "pendulum", "--json"), ("solve", "pendulum"), ("compare", "pendulum")])
def test_what_nobody_foresaw_is_called_a_fault_of_ours(monkeypatch, error, status, words, arguments):
    def broken(*given, **named):
        raise error

    for name in ("solve", "compare"):
        substitute(monkeypatch, name, broken)
    got, out, err = run(*arguments)
    assert (got, out) == (status, "")
    assert all(word in err for word in words)
    assert err.count("\n") == 1
    assert "Traceback" not in err


def test_a_fault_that_ctrl_c_caused_is_ctrl_c(monkeypatch):
    """Compiled code turns KeyboardInterrupt into errors of its own, as imports of numpy do."""

    def broken(*given, **named):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise ImportError("cannot load the library") from error

    substitute(monkeypatch, "solve", broken)
    assert run("solve", "pendulum") == (130, "", "")


def test_a_dump_that_fails_does_not_hide_the_error(tmp_path, monkeypatch):
    def broken(*given, **named):
        raise IndexError("index 3 is out of bounds")

    def full(*given):
        raise OSError(errno.ENOSPC, "No space left on device")

    substitute(monkeypatch, "solve", broken)
    monkeypatch.setattr(os, "replace", full)
    status, out, err = run("solve", "pendulum", "--dump", str(tmp_path / "run.zip"))
    assert (status, out, os.listdir(tmp_path)) == (70, "", [])
    assert "nothing dumped" in err
    assert "index 3 is out of bounds" in err


# --- failures to write ----------------------------------------------------------------------------------------------


WRITERS = {
    "save": lambda result, path: result.save(path),
    "dump": lambda result, path: result.dump(path),
    "csv": lambda result, path: result.to_csv(path),
    "mat": lambda result, path: result.to_mat(path),
    "json": lambda result, path: result.to_json(path),
    "problem": lambda result, path: lfo.write_problem(result.problem, path),
    "sweep": lambda result, path: lfo.results.Sweep("none", {"a": (1,)}, (), {}).to_csv(path),
}


@pytest.fixture(scope="module")
def result():
    return lfo.solve(SHORT())


@pytest.mark.parametrize("writer", WRITERS)
def test_a_file_is_replaced_as_a_whole_or_not_at_all(writer, result, tmp_path, monkeypatch):
    write, path = WRITERS[writer], tmp_path / "file"
    path.write_bytes(b"precious")
    path.chmod(0o640)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", failing(errno.ENOSPC))
        with pytest.raises(lfo.errors.ProblemError, match="file: got No space left on device"):
            write(result, path)
    assert (path.read_bytes(), os.listdir(tmp_path)) == (b"precious", ["file"])
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", failing(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            write(result, path)
    assert (path.read_bytes(), os.listdir(tmp_path)) == (b"precious", ["file"])
    (tmp_path / "link").symlink_to(path)
    write(result, tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert path.read_bytes() != b"precious"
    assert path.stat().st_mode & 0o777 == 0o640
    with pytest.raises(lfo.errors.ProblemError, match="got No such file or directory"):
        write(result, tmp_path / "nowhere" / "file")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
@pytest.mark.parametrize("writer", WRITERS)
def test_what_is_no_regular_file_is_written_to_as_it_is(writer, result):
    with pytest.raises(lfo.errors.ProblemError, match="/dev/full: got No space left on device"):
        WRITERS[writer](result, "/dev/full")
    WRITERS[writer](result, os.devnull)
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_new_files_have_the_mode_that_the_system_gives(result, tmp_path):
    (tmp_path / "other").write_text("")
    result.save(tmp_path / "file")
    assert (tmp_path / "file").stat().st_mode == (tmp_path / "other").stat().st_mode


@expensive
@pytest.mark.parametrize("writer", ["save_report", "init"])
def test_what_else_is_written_fails_with_words(writer, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", failing(errno.ENOSPC))
    substitute(monkeypatch, "pages.draw_figures", lambda comparison: ())
    substitute(monkeypatch, "pages.render_page", lambda *given: "page")
    if writer == "init":
        substitute(monkeypatch, "files.template", failing(errno.ENOSPC))
        assert run("init", str(tmp_path / "new.toml"))[0] == 2
    else:
        status, out, err = run("compare", *WORDS, "--out", str(tmp_path), "--json")
        assert (status, parsed(out)["status"]) == (2, "optimal")
        assert "No space left on device" in err
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("as_json", [True, False])
def test_the_answer_is_printed_even_if_it_cannot_be_saved(tmp_path, monkeypatch, as_json):
    """One file that fails does not keep the other from being written."""
    honest = os.replace

    def one_fails(source, target):
        if str(target).endswith(".npz"):
            raise OSError(errno.EDQUOT, "Disk quota exceeded")
        honest(source, target)

    monkeypatch.setattr(os, "replace", one_fails)
    files = ("--save", str(tmp_path / "run.npz"), "--dump", str(tmp_path / "run.zip"))
    status, out, err = run("solve", *WORDS, *files, *(["--json"] if as_json else []))
    assert status == 2
    assert parsed(out)["status"] == "optimal" if as_json else "status    optimal" in out
    assert "run.npz: got Disk quota exceeded" in err
    assert os.listdir(tmp_path) == ["run.zip"]
    assert lfo.load_run(tmp_path / "run.zip").summary["status"] == "optimal"


def test_a_sweep_is_printed_even_if_its_table_cannot_be_saved(tmp_path, monkeypatch):
    (tmp_path / "sweep.csv").mkdir()
    status, out, err = run("sweep", *WORDS, "--grid", "horizon=[60]", "--out", str(tmp_path), "--json")
    assert (status, parsed(out)["points"][0]["status"]) == (2, "optimal")
    assert "sweep.csv: got Is a directory" in err


@pytest.mark.skipif(os.name == "nt", reason="no pipes of this kind")
@expensive
def test_a_reader_of_json_who_leaves_changes_no_status():
    command = [sys.executable, "-m", "lin_freq_ocp", "solve", *WORDS, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0
