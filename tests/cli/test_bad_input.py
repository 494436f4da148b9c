"""What is wrong is refused: the exit status says what kind of wrong, one line names the field and what was got.

Nothing else appears: no traceback, and not a byte on stdout, so that a pipe never takes a complaint for an answer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.cli import BAD_INPUT, NO_SOLUTION, NOT_PROVEN

CART = """
schema = 1
name = "cart"
horizon = 20
initial_state = [0.0, 0.0]
terminal_state = [1.0, 0.0]
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
[state_set]
lower = -2.0
upper = 2.0
[[control_spectrum]]
kind = "low_pass"
cutoff_hz = 3.0
"""

UNCLOCKED = CART.replace("sampling_time = 0.1\n", "")
UNBOUNDED = """
schema = 1
horizon = 10
initial_state = [0.0]
[dynamics]
A = [[1.0]]
B = [[1.0]]
[cost]
r = [1.0]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with good and bad files of every kind."""
    folder = tmp_path_factory.mktemp("files")
    for name, text in {
        "cart.toml": CART,
        "unclocked.toml": UNCLOCKED,
        "unbounded.toml": UNBOUNDED,
        "precious.toml": "precious",
        "empty.toml": "",
        "syntax.toml": CART.replace("horizon = 20", "horizon 20"),
        "typo.toml": CART.replace("[control_set]\nlower", "[control_set]\nlowr"),
        "headless.toml": CART.replace("schema = 1\n", ""),
        "future.toml": CART.replace("schema = 1", "schema = 3"),
        "nan.toml": CART.replace("[1.0, 0.1]", "[1.0, nan]"),
        "escape.toml": CART.replace("[[1.0, 0.1], [0.0, 1.0]]", '{npz = "../outside.npz", key = "A"}'),
    }.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "folder").mkdir()
    (folder / "folder.toml").mkdir()
    (folder / "binary.toml").write_bytes(bytes(range(256)))
    result = lfo.solve(lfo.read_problem(folder / "cart.toml"))
    longer = lfo.solve(replace(result.problem, horizon=30))
    result.save(folder / "run.npz")
    for suffix in (".npz", ".csv", ".mat"):
        longer.save(folder / f"longer{suffix}")
    with np.load(folder / "run.npz") as saved:
        good = dict(saved)
    busy = good["rho_u"].copy()
    busy[1] = 1.0
    for name, change in {
        "no_u": {"u": None},
        "no_mu": {"mu": None},
        "nan": {"u": good["u"] * np.nan},
        "flat": {"u": good["u"][:, 0]},
        "short": {"u": good["u"][:-1]},
        "narrow": {"eta": good["eta"][:, :1]},
        "busy": {"rho_u": busy},
        "future": {"schema": np.array(3)},
        "objects": {"u": np.array([[{}]], dtype=object)},
    }.items():
        changed = {key: value for key, value in (good | change).items() if value is not None}
        np.savez(folder / f"{name}.npz", **changed)
    np.save(folder / "single.npy", good["x"])
    (folder / "empty.npz").write_bytes(b"")
    return folder


def settings(*given: str) -> tuple[str, ...]:
    return tuple(word for one in given for word in ("--set", one))


def solve_pendulum(*given: str) -> tuple[str, ...]:
    return ("solve", "pendulum", *settings(*given))


def solve_cart(*given: str) -> tuple[str, ...]:
    return ("solve", "cart.toml", *settings(*given))


def with_band(band: str, file: str = "cart.toml") -> tuple[str, ...]:
    return ("solve", file, "--set", f"control_spectrum=[{{{band}}}]")


# --- exit status 2: bad input ---------------------------------------------------------------------------------------


BAD_PARAMETERS = {
    "unknown problem": (("solve", "pendulm"), "name: got 'pendulm'", "Did you mean 'pendulum'?"),
    "nameless problem": (("solve", ""), "name: got ''", "expected one of pendulum"),
    "horizon in words": (solve_pendulum('horizon="abc"'), "horizon: got 'abc'; expected a whole number"),
    "horizon zero": (solve_pendulum("horizon=0"), "horizon: got 0;"),
    "horizon negative": (solve_pendulum("horizon=-3"), "horizon: got -3;"),
    "horizon with a fraction": (solve_pendulum("horizon=1.5"), "horizon: got 1.5;"),
    "horizon a float": (solve_pendulum("horizon=240.0"), "horizon: got 240.0;"),
    "horizon true": (solve_pendulum("horizon=true"), "horizon: got True;"),
    "horizon huge": (solve_pendulum("horizon=1_000_000_000_000"), "horizon: got 1000000000000;"),
    "horizon beyond 64 bits": (solve_pendulum(f"horizon=1{'0' * 30}"), "horizon: got 1000"),
    "horizon a list": (solve_pendulum("horizon=[240]"), "horizon: got [240];"),
    "horizon a table": (solve_pendulum("horizon.steps=240"), "horizon: got {'steps': 240};"),
    "horizon a date": (solve_pendulum("horizon=2026-01-01"), "horizon: got datetime.date(2026, 1, 1);"),
    "cut-off negative": (solve_pendulum("cutoff=-1"), "low_pass.cutoff: got -1;"),
    "cut-off beyond Nyquist": (solve_pendulum("cutoff=4"), "low_pass.cutoff: got 4 rad/sample; expected at most pi"),
    "cut-off in hertz beyond Nyquist": (
        ("solve", "double_integrator", "--set", "cutoff_hz=26"),
        "control_spectrum.low_pass: got 26 Hz; expected at most the Nyquist frequency 25 Hz",
    ),
    "cut-off nan": (solve_pendulum("cutoff=nan"), "low_pass.cutoff: got nan;"),
    "cut-off inf": (solve_pendulum("cutoff=inf"), "low_pass.cutoff: got inf;"),
    "cut-off true": (solve_pendulum("cutoff=true"), "low_pass.cutoff: got True;"),
    "cut-off in words": (solve_pendulum('cutoff="fast"'), "low_pass.cutoff: got 'fast';"),
    "cut-off a list": (solve_pendulum("cutoff=[1, 2]"), "low_pass.cutoff: got [1, 2];"),
    "notch without width": (("solve", "scanner", "--set", "notch_width_hz=0"), "notch.width: got 0;"),
    "band the wrong way round": (("solve", "quarter_car", "--set", "stop_band_hz=[8, 4]"), "notch.width_hz: got -4"),
    "initial state nan": (solve_pendulum("initial_state=[nan, 0, 0, 0]"), "initial_state[0]: got nan;"),
    "initial state inf": (solve_pendulum("initial_state=[0, inf, 0, 0]"), "initial_state[1]: got inf;"),
    "initial state too short": (solve_pendulum("initial_state=[0, 0, 0]"), "initial_state: got shape (3,);"),
    "initial state with text": (solve_pendulum('initial_state=[0, 0, "a", 0]'), "initial_state: got [0, 0, 'a', 0];"),
    "initial state a matrix": (solve_pendulum("initial_state=[[0, 0, 0, 0]]"), "initial_state: got shape (1, 4);"),
    "sampling time zero": (solve_pendulum("sampling_time=0"), "dynamics.sampling_time: got 0;"),
    "sampling time nan": (solve_pendulum("sampling_time=nan"), "dynamics.sampling_time: got nan;"),
    "sampling time none": (solve_pendulum('sampling_time="none"'), "dynamics.sampling_time: got None;"),
    "state bounds too few": (
        solve_pendulum("state_bounds=[1, 2]"),
        "got bounds for 2 components; expected bounds for 4",
    ),
    "orbit without size": (
        ("solve", "elliptic_rendezvous", "--set", "perigee_radius=1e-308"),
        "perigee_radius: got 1e-308",
    ),
    "orbit beyond all size": (
        ("solve", "elliptic_rendezvous", "--set", "perigee_radius=1e308"),
        "perigee_radius: got 1e+308",
    ),
    "unknown variant": (solve_pendulum('parameters="mine"'), "parameters: got 'mine'; expected 'paper' or 'physical'"),
    "unknown parameter": (solve_pendulum("cutof=1"), "--set cutof: got no parameter of that name", "horizon,"),
    "key of a file": (solve_pendulum("cost.R=1"), "--set cost: got no parameter of that name"),
    "setting without value": (solve_pendulum("horizon"), "--set: got 'horizon'; expected KEY=VALUE"),
    "setting with an empty value": (solve_pendulum("horizon="), "--set: got 'horizon='; expected KEY=VALUE"),
    "setting without key": (solve_pendulum("=3"), "--set: got '=3'; expected KEY=VALUE"),
    "setting without quotes": (solve_pendulum("parameters=paper"), "--set: got 'parameters=paper'", "quotes"),
    "setting with two values": (
        solve_pendulum("horizon=3 4"),
        "--set: got 'horizon=3 4'; expected KEY=VALUE",
        "quotes",
    ),
    "setting with a list": (("sweep", "pendulum", *settings("horizon = 60, 80")), "sweep --grid 'horizon=[60, 80]'"),
    "setting with a range": (solve_pendulum("horizon=60:80:3"), "sweep --grid 'horizon=60:80:3'."),
    "setting with a range without count": (solve_pendulum("horizon=60:80"), "quotes"),
    "bound below zero": (solve_pendulum("control_bound=-1"), "control_bound: got -1"),
    "bound nan": (solve_pendulum("control_bound=nan"), "control_bound: got nan"),
    "bound with text": (solve_pendulum('state_bounds=[0.2, "a", 15, 30]'), "state_bounds", "'a'"),
}
BAD_OPTIONS = {
    "unknown method": (
        ("solve", "pendulum", "--method", "magic"),
        "method: got 'magic'; expected 'auto', 'spectral', 'structured', 'convex', 'branch_and_bound', 'enumerate', "
        "'miqp', 'angles' or 'nonsmooth'.",
    ),
    "backend of a method without": (
        ("solve", "pendulum", "--method", "spectral", "--backend", "osqp"),
        "backend: got 'osqp' for the method 'spectral'",
    ),
    "problem that the method cannot take": (
        ("solve", "elliptic_rendezvous", "--method", "spectral"),
        "method 'spectral': A or B depends on time",
    ),
    "unknown backend": (("solve", "pendulum", "--backend", "magic"), "backend: got 'magic'; expected 'clarabel'"),
    "backend without member": (("solve", "pendulum", "--backend", "qpsolvers"), "backend: got 'qpsolvers';"),
    "backend not installed": (
        ("solve", "pendulum", "--backend", "qpsolvers:nonesuch"),
        "backend: got 'qpsolvers:nonesuch', which is no solver",
    ),
    "time limit zero": (("solve", "pendulum", "--time-limit", "0"), "time_limit: got 0.0; expected a number above"),
    "time limit negative": (("solve", "pendulum", "--time-limit", "-1"), "time_limit: got -1.0;"),
    "time limit nan": (("compare", "pendulum", "--time-limit", "nan"), "time_limit: got nan;"),
    "tolerance zero": (("solve", "pendulum", "--tolerance", "0"), "tolerance: got 0.0;"),
    "tolerance nan": (("solve", "pendulum", "--tolerance", "nan"), "tolerance: got nan;"),
    "unknown filter": (
        ("compare", "pendulum", "--filters", "brickwall,magic"),
        "filters: got 'magic'; expected some of brickwall",
    ),
    "no filter": (("compare", "pendulum", "--filters", ""), "filters: got '';"),
    "unknown backend to compare": (("compare", "pendulum", "--backend", "magic"), "backend: got 'magic';"),
}
BAD_FILES = {
    "no such file": (("solve", "missing.toml"), "missing.toml: got no such file"),
    "no such file without suffix": (("solve", "folder/missing"), "folder/missing: got no such file"),
    "directory": (("solve", "folder.toml"), "folder.toml: got a directory"),
    "binary": (("solve", "binary.toml"), "binary.toml: got byte 128 that is not UTF-8"),
    "empty file": (("solve", "empty.toml"), "empty.toml: schema: got nothing"),
    "no TOML": (("solve", "syntax.toml"), "syntax.toml: TOML syntax: got", "(at line 4, column 9)"),
    "wrong key": (("solve", "typo.toml"), "control_set.lowr: got an unknown key", "Did you mean 'lower'?"),
    "missing key": (("solve", "headless.toml"), "headless.toml: schema: got nothing; expected this key"),
    "schema of the future": (("solve", "future.toml"), "schema: got 3; expected a whole number from 1 to 2"),
    "nan in a matrix": (("solve", "nan.toml"), "nan.toml: dynamics.A[0][1]: got nan; expected a finite number"),
    "path that escapes": (("solve", "escape.toml"), "escape.toml: dynamics.A.npz: got '../outside.npz'"),
    "no such file to compare": (("compare", "missing.toml"), "missing.toml: got no such file"),
    "no such file to certify": (("certify", "missing.toml", "run.npz"), "missing.toml: got no such file"),
    "overridden horizon": (solve_cart('horizon="abc"'), "cart.toml: horizon: got 'abc';"),
    "overridden key unknown": (solve_cart("bogus=1"), "cart.toml: bogus: got an unknown key; expected one of schema"),
    "overridden table": (solve_cart("dynamics=3"), "cart.toml: dynamics: got 3; expected a table"),
    "unit in a number": (
        solve_cart('dynamics.sampling_time="10 ms"'),
        "sampling_time: got '10 ms'; expected one number above zero. Numbers have no quotes and no units.",
    ),
    "linear cost a number": (solve_cart("cost.q=1.0"), "cart.toml: cost.q: got a single number;"),
    "other suffix, no file": (("solve", "cart.tml"), "cart.tml: got no such file"),
    "A of wrong shape": (solve_cart("dynamics.A=[[1, 0]]"), "cart.toml: dynamics.A: got shape (1, 2);"),
    "A a number": (solve_cart("dynamics.A=3"), "cart.toml: dynamics.A: got shape ();"),
    "B of wrong shape": (solve_cart("dynamics.B=[1, 2]"), "cart.toml: dynamics.B: got shape (2,);"),
    "A ragged": (
        solve_cart("dynamics.A=[[1, 0], [1]]"),
        "cart.toml: dynamics.A: got [[1, 0], [1]];",
        "All rows have the same length.",
    ),
    "Q asymmetric": (
        solve_cart("cost.Q=[[1, 2], [0, 1]]"),
        "cart.toml: cost.Q: got a matrix that differs from its transpose by 2; expected a symmetric matrix",
    ),
    "Q of wrong shape": (solve_cart("cost.Q=[[1]]"), "cart.toml: cost.Q: got shape (1, 1);"),
    "cost not convex": (solve_cart("cost.R=-1"), "cost: [[Q, S], [S', R]] at t = 0 has the eigenvalue -1"),
    "terminal cost not convex": (solve_cart("cost.P=-2.0"), "cost: P has the eigenvalue -2"),
    "lower above upper": (solve_cart("control_set.lower=6"), "cart.toml: control_set.lower: got 6 above upper = 5"),
    "bound is nan": (solve_cart("control_set.lower=nan"), "cart.toml: control_set.lower: got nan"),
    "lower bound inf": (solve_cart("control_set.lower=inf"), "cart.toml: control_set.lower: got inf"),
    "bounds too many": (solve_cart("control_set.upper=[5, 5]"), "cart.toml: control_set: got bounds for 2 components"),
    "start inf": (solve_cart("initial_state=[0, -inf]"), "cart.toml: initial_state[1]: got -inf"),
    "band no table": (solve_cart("control_spectrum=3"), "cart.toml: control_spectrum: got 3;"),
    "band of unknown kind": (with_band('kind="lowpass"'), "control_spectrum[0].kind: got 'lowpass'", "'low_pass'?"),
    "band with both units": (
        with_band('kind="low_pass", cutoff=3, cutoff_hz=3'),
        "control_spectrum[0].cutoff: got both",
    ),
    "band with no edge": (with_band('kind="low_pass"'), "control_spectrum[0].cutoff: got neither"),
    "band in hertz beyond Nyquist": (with_band('kind="low_pass", cutoff_hz=6'), "got 6 Hz; expected at most", "5 Hz"),
    "band in hertz without a clock": (
        ("solve", "unclocked.toml"),
        "unclocked.toml: control_spectrum[0]: got low_pass(0 .. 3 Hz); expected a sampling time",
    ),
    "band upside down": (with_band('kind="band_pass", lower=2, upper=1'), "got lower 2 above upper 1 rad/sample"),
    "band in mixed units": (with_band('kind="band_pass", lower=1, upper_hz=2'), "got lower in rad/sample, upper in Hz"),
    "notch of no width": (with_band('kind="notch", centre=1, width=0'), "control_spectrum[0].width: got 0;"),
    "bins empty": (with_band('kind="stop_band", bins=[]'), "control_spectrum[0].bins: got [];"),
    "bins out of range": (with_band('kind="stop_band", bins=[21]'), "got bin 21; expected bins 0 .. 19"),
    "bins beyond 64 bits": (
        with_band(f'kind="stop_band", bins=[1{"0" * 30}]'),
        "control_spectrum[0].bins: got bin 1000",
    ),
    "bins fractional": (with_band('kind="stop_band", bins=[1.5]'), "control_spectrum[0].bins: got [1.5];"),
    "component unknown": (
        with_band('kind="low_pass", cutoff=1, component="thrust"'),
        "control_spectrum[0].component: got 'thrust'; expected an index 0 or one of 'force [N]'",
    ),
    "component out of range": (
        with_band('kind="low_pass", cutoff=1, component=1'),
        "control_spectrum[0].component: got 1",
    ),
}
BAD_SOLUTIONS = {
    "missing": ("missing.npz", "missing.npz: got no such file"),
    "a directory": ("folder", "folder: got a directory"),
    "text": ("cart.toml", "cart.toml: got cart.toml, unreadable"),
    "empty": ("empty.npz", "empty.npz: got empty.npz, unreadable"),
    "a single array": ("single.npy", "single.npy: got a single array"),
    "objects": ("objects.npz", "objects.npz: got objects.npz, unreadable"),
    "no control": ("no_u.npz", "no_u.npz: u: got nothing"),
    "a multiplier missing": ("no_mu.npz", "no_mu.npz: mu: got nothing"),
    "nan": ("nan.npz", "nan.npz: trajectory.u[0][0]: got nan"),
    "control of one dimension": ("flat.npz", "flat.npz: u: got float64 of shape (20,)"),
    "control too short": ("short.npz", "short.npz: trajectory: got x (21, 2) and u (19, 1)"),
    "multiplier of wrong shape": ("narrow.npz", "narrow.npz: multipliers.mu: got shape (21, 2)"),
    "multiplier on a free bin": ("busy.npz", "multipliers.rho_u[1, 0]: got 1+0j; expected 0"),
    "schema of the future": ("future.npz", "future.npz: schema: got"),
}
UNWRITABLE = {
    "save into a missing folder": (("solve", "cart.toml", "--save", "nowhere/run.npz"), "nowhere/run.npz: got"),
    "save over a folder": (("solve", "cart.toml", "--save", "folder"), "folder: got"),
    "report over a file": (("compare", "cart.toml", "--out", "precious.toml"), "got precious.toml"),
}
ALL_BAD = {
    **BAD_PARAMETERS,
    **BAD_OPTIONS,
    **BAD_FILES,
    **{f"solution: {case}": (("certify", "cart.toml", file), words) for case, (file, words) in BAD_SOLUTIONS.items()},
    **{
        f"solution of another horizon, {suffix}": (("certify", "cart.toml", f"longer.{suffix}"), "--set horizon=30.")
        for suffix in ("npz", "csv", "mat")
    },
    "solution of another problem": (
        ("certify", "pendulum", "run.npz"),
        "trajectory: got x (21, 2), u (20, 1); expected x (241, 4), u (240, 1). Time is axis 0.",
    ),
    **{case: UNWRITABLE[case] for case in UNWRITABLE if case.startswith("save")},
}


@pytest.mark.parametrize("case", ALL_BAD)
def test_bad_input(case, files, monkeypatch):
    arguments, *words = ALL_BAD[case]
    monkeypatch.chdir(files)
    for more in ((), ("--json",)):
        status, out, err = run(*arguments, *more)
        assert (status, out) == (BAD_INPUT, "")
        assert err.startswith("error: ")
        assert err.count("\n") == 1
        for word in words:
            assert word in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("frobnicate",), "No such command 'frobnicate'"),
        (("solve",), "Missing argument 'NAME|FILE.toml'"),
        (("solve", "pendulum", "more"), "unexpected extra argument (more)"),
        (("solve", "pendulum", "--bogus"), "No such option"),
        (("solve", "pendulum", "--time-limit", "soon"), "'soon' is not a valid float"),
        (("solve", "pendulum", "--set"), "'--set' requires an argument"),
        (("certify", "pendulum"), "Missing argument 'SOLUTION.npz|.csv|.mat'"),
        (("init",), "Missing argument 'FILE.toml'"),
        (("list", "more"), "unexpected extra argument"),
    ],
)
def test_wrong_usage(arguments, words):
    status, out, err = run(*arguments)
    assert (status, out) == (BAD_INPUT, "")
    assert "Error: " in err
    assert words in err


def test_init_replaces_nothing(files, monkeypatch):
    monkeypatch.chdir(files)
    for name, words in {
        "precious.toml": "precious.toml: got a file that exists already; expected a new name",
        "folder": "folder: got",
        "nowhere/new.toml": "nowhere/new.toml: got No such file or directory",
    }.items():
        status, out, err = run("init", name)
        assert (status, out) == (BAD_INPUT, "")
        assert words in err
    assert (files / "precious.toml").read_text() == "precious"


@expensive
@pytest.mark.parametrize("case", UNWRITABLE)
def test_where_nothing_can_be_written_nothing_is_solved(case, files, monkeypatch):
    """A solve may take an hour; its answer must not be lost to a slip in a path."""
    monkeypatch.chdir(files)

    def solved(*given, **named):
        pytest.fail("solved before the path was looked at")

    for name in ("solve", "compare"):
        substitute(monkeypatch, name, solved)
    status, out, err = run(*UNWRITABLE[case][0])
    assert (status, out) == (BAD_INPUT, "")
    assert UNWRITABLE[case][1] in err


def test_a_problem_file_is_not_replaced_by_its_solution(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(CART)
    status, out, err = run("solve", "cart.toml", "--save", "./cart.toml")
    assert (tmp_path / "cart.toml").read_bytes() == CART.encode()
    assert (status, out) == (BAD_INPUT, "")
    assert "cart.toml" in err


def test_nobody_is_advised_to_read_pickles(files, monkeypatch):
    monkeypatch.chdir(files)
    for name in ("cart.toml", "binary.toml"):
        assert "unsafely" not in run("certify", "cart.toml", name)[2]


def test_what_no_memory_can_hold_is_not_called_infeasible(monkeypatch):
    def exhausted(*given, **named):
        raise MemoryError("Unable to allocate 7.45 GiB")

    substitute(monkeypatch, "solve", exhausted)
    status, out, err = run("solve", "pendulum")
    assert status in (BAD_INPUT, NOT_PROVEN)
    assert out == ""
    assert "7.45 GiB" in err


# --- exit status 1: no solution; 3: no proof ------------------------------------------------------------------------


@expensive
@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (solve_pendulum("horizon=60", "control_bound=1"), NO_SOLUTION, "control bound on force [N]"),
        (solve_cart("control_set.upper=0.1"), NO_SOLUTION, "control bound on force [N]"),
        (("solve", "unbounded.toml"), NO_SOLUTION, "unbounded"),
        (("compare", "unbounded.toml"), NO_SOLUTION, "no lower bound"),
        (
            ("compare", "pendulum", *settings("horizon=60", "control_bound=1")),
            NO_SOLUTION,
            "control bound on force [N]",
        ),
        (
            ("compare", "pendulum", "--filters", "clipped", *settings("horizon=100", "control_bound=5.5")),
            NO_SOLUTION,
            "control bound on force [N]",
        ),
        (("solve", "pendulum", "--time-limit", "1e-9"), NOT_PROVEN, "limit"),
        (("solve", "pendulum", "--time-limit", "1e-9", "--backend", "osqp"), NOT_PROVEN, "limit"),
        (("compare", "pendulum", "--time-limit", "1e-9"), NOT_PROVEN, "limit"),
        (solve_cart("initial_state=[3, 0]"), NO_SOLUTION, "state bound on"),
        (("certify", "cart.toml", "run.npz", *settings("cost.Q=1.0")), NOT_PROVEN, "violated"),
    ],
)
def test_no_solution_and_no_proof(arguments, status, words, files, monkeypatch):
    monkeypatch.chdir(files)
    ended, out, err = run(*arguments)
    assert ended == status
    assert words in " ".join((out + err).split())  # lines break where the terminal ends


@expensive
def test_a_band_without_which_there_is_a_solution_is_part_of_the_conflict():
    """With 5.5 N the pendulum arrives without its low pass and not with it, so the low pass is to be named."""
    assert lfo.solve(lfo.library.pendulum(100, control_bound=5.5, cutoff=None)).status == "optimal"
    out = run("solve", "pendulum", *settings("horizon=100", "control_bound=5.5"))[1]
    assert "control stop band on force [N]" in " ".join(out.split())


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e300])
@pytest.mark.parametrize("with_multipliers", [True, False])
def test_a_trajectory_of_any_size_can_be_judged(size, with_multipliers, files, tmp_path, monkeypatch):
    """Zeros and numbers near the end of the range are no proof, and no traceback either."""
    monkeypatch.chdir(files)
    with np.load("run.npz") as saved:
        fields = dict(saved) if with_multipliers else {"x": saved["x"], "u": saved["u"]}
    np.savez(tmp_path / "sized.npz", **fields | {name: size * fields[name] for name in ("x", "u")})
    status, out, _ = run("certify", "cart.toml", str(tmp_path / "sized.npz"))
    assert status == NOT_PROVEN
    assert "violated" in out
