"""Controllers as C: they compile without a warning, agree with Python, and judge their class, states and memory."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.generated import SANITIZERS, CompiledController, compile_command
from helpers.loops import LOOPS, pendulum, states
from helpers.seeds import expensive, seeds
from lin_freq_ocp.methods import compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")

FAR = np.array([1e5, 0.0, 0.0, 0.0])
# A distribution's compiler adds calls of its own (__memcpy_chk, __stack_chk_fail) and a table of addresses
PLAIN = ("-U_FORTIFY_SOURCE", "-fno-stack-protector", "-fno-pic")
APART = {"double": 1e-7, "float": 5e-3}  # of a control, relative to its bound


def controller(problem: lfo.OptimalControlProblem, **options) -> lfo.RecedingHorizon:
    return lfo.RecedingHorizon(problem, **options)


def compiled(folder: Path, given: lfo.RecedingHorizon, real: str = "double", **options) -> CompiledController:
    lfo.generate(given, folder, real, **options)
    problem = given.problem
    sizes = problem.state_dim, problem.control_dim, problem.horizon
    return CompiledController(folder, real, *sizes, references=options.get("references", False))


PLANTS = {
    "rate limit": lambda: (controller(LOOPS["rate limit"]()), {}),
    "two controls": lambda: (controller(LOOPS["two controls"]()), {"changes": 6}),
    "soft bounds": lambda: (controller(pendulum(30), soft={"state_set": 1e3}, delay=1), {"references": True}),
}


RECORDED = seeds(
    [("rate limit", "float"), ("two controls", "double"), ("soft bounds", "double"), ("soft bounds", "float")]
)


@pytest.fixture(scope="module")
def generated(tmp_path_factory) -> dict[tuple[str, str], tuple[lfo.RecedingHorizon, Path]]:
    """Return the controller and the folder of each plant and type of numbers, compiled with sanitizers."""
    found, running = {}, []
    for name, real in RECORDED:
        (given, options), folder = PLANTS[name](), tmp_path_factory.mktemp("generated")
        lfo.generate(given, folder, real, **options)
        command = compile_command("-O0", *SANITIZERS, "test_controller.c", "-o", "test_controller")
        running.append(subprocess.Popen([*command, "-lm"], cwd=folder))
        found[name, real] = given, folder
    assert [process.wait() for process in running] == [0] * len(running)
    return found


@expensive
@needs_compiler
@pytest.mark.parametrize(("name", "real"), RECORDED)
def test_recorded_steps_run_clean_and_their_log_is_proven(generated, name, real):
    given, folder = generated[name, real]
    done = subprocess.run(["./test_controller", "log.csv"], cwd=folder, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "0 failed" in done.stdout
    certified = lfo.certify_log(given, folder / "log.csv")
    assert set(certified.findings) <= {"proven", "plan before"}
    assert certified.proven.sum() >= 60
    assert np.nanmax(certified.gaps) <= 1e-8
    assert certified.differences[certified.proven].max() <= APART[real]


@expensive
@needs_compiler
def test_the_code_calls_nothing_but_square_root_and_copies(tmp_path):
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    lfo.generate(controller(LOOPS["low pass"]()), tmp_path)
    subprocess.run(compile_command("-Os", "-c", *PLAIN), cwd=tmp_path, check=True)
    listed = subprocess.run(
        ["nm", "-u", "controller.o", "lfo_kernel.o"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    undefined = {line.split()[-1] for line in listed.stdout.splitlines() if line.split()[:1] == ["U"]}
    own = {"lfo_begin", "lfo_step"}
    assert undefined - own <= {"sqrt", "memcpy", "memset", "memmove"}


@expensive
@needs_compiler
@pytest.mark.parametrize("real", APART)
def test_plans_cost_what_the_sparse_program_costs(tmp_path, real):
    problem = LOOPS["low pass"]()
    step = compiled(tmp_path, controller(problem), real)
    for start in states(problem, 4):
        status, control = step.step(start)
        x, u = step.plan()
        best = lfo.solve(problem.with_ends(start), "convex")
        assert status == 0
        np.testing.assert_allclose(u[0], control, rtol=1e-6)
        assert problem.value(x, u) == pytest.approx(best.cost, rel=1e-8 if real == "double" else 1e-4)
        assert np.abs(control - best.control[0]).max() <= 1e-3


@expensive
@needs_compiler
def test_states_that_are_none_change_nothing(tmp_path):
    step = compiled(tmp_path, controller(LOOPS["low pass"]()), "float")
    start = states(LOOPS["low pass"](), 1)[0]
    assert step.step(start)[0] == 0
    before, control = step.bytes, step.u.copy()
    for value in (np.nan, np.inf, -np.inf, 1e30):
        assert step.step(np.array([0.0, value, 0.0, 0.0]))[0] == 4
    assert (step.bytes == before, (step.u == control).all()) == (True, True)
    assert step.step(np.array([0.0, 1e9, 0.0, 0.0]))[0] == 3  # a number, and no plan


@expensive
@needs_compiler
def test_a_step_without_a_plan_keeps_box_and_rate_and_hinders_no_later_one(tmp_path):
    given = controller(LOOPS["rate limit"]())
    step, cold = (compiled(tmp_path, given) for _ in range(2))
    start = states(given.problem, 1)[0, :4]
    assert step.step(start)[0] == 0
    step.applied(np.array([1.2]))
    status, control = step.step(np.array([0.0, 20.0, 0.0, 0.0]))
    assert status == 3
    assert abs(control[0]) <= given.problem.control_tube.upper[0, 0]
    assert abs(control[0] - 1.2) <= 1.0
    step.applied(np.array([0.0]))
    statuses = [one.step(start) for one in (step, cold)]
    assert [status for status, _ in statuses] == [0, 0]
    np.testing.assert_allclose(statuses[0][1], statuses[1][1], atol=1e-9)


@pytest.fixture(scope="module")
def free(tmp_path_factory) -> CompiledController:
    """A controller with soft bounds that may change its working set as often as it needs to."""
    return compiled(tmp_path_factory.mktemp("free"), controller(LOOPS["soft bounds"]()))


@needs_compiler
@pytest.mark.parametrize("real", APART)
@pytest.mark.parametrize("name", seeds(["rate limit", "soft bounds"]))
def test_controls_keep_hard_limits_exactly_at_every_state_and_status(tmp_path, name, real):
    """States jump up to 1e30; bounds and rate limit are no numbers of float, and no power of two."""
    problem, rng = LOOPS["soft bounds"](), np.random.default_rng(0)
    problem = replace(problem, control_set=lfo.Box(-1.672, 1.299))
    if name == "rate limit":
        problem = lfo.rate_limited(problem, 0.7, previous=0.0)
    step, statuses, before = compiled(tmp_path, controller(problem), real, changes=5), set(), 0.0
    for _ in range(60):
        x = 10.0 ** rng.uniform(-3, 30) * rng.standard_normal(4)
        status, (control,) = step.step(x)
        statuses.add(status)
        if status == 4:
            continue
        assert -1.672 <= control <= 1.299
        if name == "rate limit":
            assert abs(Fraction(control) - Fraction(before)) <= Fraction(0.7)
        before = control
    assert {0, 2, 4} <= statuses


@expensive
@needs_compiler
@pytest.mark.parametrize("real", APART)
def test_far_from_its_set_the_control_drives_the_plant_back(tmp_path, real):
    plant, cost = lfo.LinearDynamics([[0.9]], [[1.0]]), lfo.QuadraticCost(Q=0.3, R=0.3)
    problem = lfo.OptimalControlProblem(plant, 25, cost, lfo.Box(-1.672, 1.299), initial_state=[0])
    step = compiled(tmp_path, controller(problem), real)
    near = step.step([0.1])
    for far in (4.1e5, -3.7e6, 4.1e7, -2.77e9, 4e11):
        status, (control,) = step.step([far])
        assert control == pytest.approx(-1.672 if far > 0 else 1.299, rel=1e-6)
        assert status == (2 if abs(far) > (1e9 if real == "double" else 1e4) else 0)
        assert step.step([0.1]) == near


@expensive
@needs_compiler
def test_the_generated_test_passes_where_recorded_steps_have_retreated_or_none_is_planned(tmp_path):
    turning = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[-0.86, -0.61], [0.61, -0.86]], [[-1.57], [-2.92]]),
        10,
        lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.01),
        lfo.Box(-0.5, 0.5),
        lfo.Box(-0.6, 0.6),
        initial_state=[0, 0],
    )
    pushed = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5]], [[1.0]], [1.0]),
        5,
        lfo.QuadraticCost(Q=1.0, R=0.1),
        lfo.Box(-0.1, 0.1),
        initial_state=[0],
    )
    for name, given, options in (
        ("delay", controller(turning, delay=1), {}),
        ("none", controller(pushed), {"changes": 0}),
    ):
        folder = tmp_path / name
        lfo.generate(given, folder, **options)
        subprocess.run(
            [*compile_command("-O0", "test_controller.c", "-o", "test_controller"), "-lm"], cwd=folder, check=True
        )
        done = subprocess.run(["./test_controller", "log.csv"], cwd=folder, capture_output=True, text=True)
        assert (done.returncode, name) == (0, name)
        if name == "delay":
            assert "100 of 100 steps planned" in done.stdout
            assert lfo.certify_log(given, folder / "log.csv").proven.all()


@expensive
@needs_compiler
@pytest.mark.parametrize("changes", [0, 5])
def test_a_cap_is_met_and_its_controls_stay_in_their_box(free, tmp_path, changes):
    problem, rng = LOOPS["soft bounds"](), np.random.default_rng(0)
    step = compiled(tmp_path / "capped", controller(problem), changes=changes)
    statuses = set()
    for start in states(problem, 20) * 2:
        status, control = step.step(start)
        possible, best = free.step(start)
        statuses.add(status)
        assert np.abs(control).max() <= problem.control_tube.upper[0, 0] + 1e-9
        if status == 0:
            assert possible == 0
            np.testing.assert_allclose(control, best, atol=1e-7)
    assert 2 in statuses
    assert step.step(1e-4 * rng.uniform(-1, 1, 4))[0] == 0


@expensive
@needs_compiler
@pytest.mark.parametrize("real", APART)
def test_a_plant_far_from_zero_that_grows_beyond_all_numbers(tmp_path, real):
    """States are counted from where they move; the open loop grows by 3e46, the stable one does not."""
    far, period = np.array([1e3, 0.0]), 0.4466
    plant = lfo.LinearDynamics.from_continuous([[0, 1], [1.0, 0]], [[0], [1]], period)
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(plant.A, plant.B, offset=far - plant.A @ far, sampling_time=period),
        240,
        lfo.QuadraticCost(Q=np.eye(2), R=0.1, P=10 * np.eye(2), x_ref=far),
        control_set=lfo.Box(-1, 1),
        initial_state=far,
        control_spectrum=lfo.low_pass(0.5 * np.pi),
    )
    step = compiled(tmp_path / "far", controller(problem), real)
    for start in 0.2 * np.random.default_rng(0).uniform(-1, 1, (4, 2)):
        measured = (far + start).astype(step.dtype).astype(float)
        status, control = step.step(measured)
        assert status == 0
        best = lfo.solve(problem.with_ends(measured)).control[0]
        assert np.abs(control - best).max() <= APART[real] / 10
    if real == "float":
        longer = controller(replace(problem, horizon=260, cost=replace(problem.quadratic, x_ref=far)))
        with pytest.raises(lfo.errors.UnsupportedError, match=r"generate: real: the open loop grows by 3e\+50"):
            lfo.generate(longer, tmp_path / "longer", real)


REFUSED = {
    "dynamics": lambda: controller(lfo.library.cart_pole_with_walls()),
    "dynamics: A or B": lambda: controller(pendulum(20, dynamics=replace(pendulum(20).linear, A=[np.eye(4)] * 20))),
    "control_spectrum: mask": lambda: controller(
        pendulum(20, control_spectrum=lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0)))
    ),
    "control_spectrum: soft": lambda: controller(pendulum(20), soft={"control_spectrum": 1e2}),
    "state_spectrum": lambda: controller(pendulum(20, state_spectrum=lfo.stop_band(bins=[3], component=0))),
    "control_set": lambda: controller(pendulum(20, control_set=lfo.sets.Ball(1.0))),
    "cost: L1": lambda: controller(
        pendulum(20, cost=lfo.costs.CostSum([lfo.QuadraticCost(R=1.0), lfo.costs.L1Cost(u=1.0)]))
    ),
    "cost: Q, R or S": lambda: controller(pendulum(20, cost=lfo.QuadraticCost(Q=[np.eye(4)] * 20, R=1.0))),
    "cost: it is not strictly": lambda: controller(
        pendulum(20, None, cost=lfo.QuadraticCost(Q=np.diag([0.0, 0, 0, 1]), R=0.0))
    ),
    "cost: ": lambda: controller(pendulum(20, cost=lfo.QuadraticCost(R=-1.0))),
    "terminal_state": lambda: controller(pendulum(20, terminal_state=lfo.Periodic(), initial_state=None)),
    "horizon: 700 steps": lambda: controller(pendulum(700)),
}


@pytest.mark.parametrize("field", REFUSED)
def test_problems_of_another_class_are_refused_by_field(tmp_path, field):
    with pytest.raises(lfo.errors.UnsupportedError, match=f"generate: {field}"):
        lfo.generate(REFUSED[field](), tmp_path / "folder")
    assert not (tmp_path / "folder").exists()


@needs_kernel
@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"real": "half"}, "real"),
        ({"changes": -1}, "changes"),
        ({"changes": True}, "changes"),
        ({"memory": "64q"}, "memory: got '64q'"),
        ({"memory": 0}, "memory"),
        ({"memory": "1k"}, "memory: got 1024 bytes; expected at least"),
        ({"references": 1}, "references"),
        ({"folder": 3}, "folder"),
        ({"folder": "/dev/null/folder"}, "/dev/null/folder: got .*a folder that can be written"),
    ],
)
def test_bad_options_are_named(tmp_path, options, field):
    with pytest.raises(lfo.errors.ProblemError, match=field):
        lfo.generate(controller(LOOPS["low pass"]()), **({"folder": tmp_path} | options))


def test_a_problem_is_no_controller(tmp_path):
    with pytest.raises(lfo.errors.ProblemError, match=r"controller: .*lfo.RecedingHorizon\(problem\)"):
        lfo.generate(pendulum(20), tmp_path)


@needs_kernel
def test_a_horizon_that_fits_the_memory(tmp_path):
    given = controller(LOOPS["low pass"]())
    written = lfo.generate(given, tmp_path, "float", memory="64k")
    assert written.ram + written.stack <= 64 * 1024
    assert f"RAM {written.ram} bytes" in str(written)
    assert str(written.flash) in (tmp_path / "README.md").read_text()
    with pytest.raises(lfo.errors.ProblemError, match="memory"):
        lfo.generate(given, tmp_path, "double", memory=written.ram + written.stack)


@needs_kernel
def test_states_that_no_sensor_measures_are_named(tmp_path):
    lfo.generate(controller(LOOPS["rate limit"]()), tmp_path / "limited")
    lfo.generate(controller(LOOPS["two controls"]()), tmp_path / "plain")
    for name, words in (("controller.h", "are kept inside: 1 more"), ("README.md", "the controller keeps them")):
        assert words in (tmp_path / "limited" / name).read_text()
        assert words not in (tmp_path / "plain" / name).read_text()


NAMES = ["end */ of\\ a ☃ comment", "x*\\/ int y;", "a /* b ??/", "*/#error", "long " * 100]


@needs_kernel
@pytest.mark.parametrize("name", NAMES)
def test_names_of_a_problem_reach_c_by_letters_of_a_list_alone(tmp_path, name):
    lfo.generate(controller(replace(pendulum(20), name=name)), tmp_path)
    title = (tmp_path / "controller.h").read_text().split("\n")[0]
    assert re.fullmatch(r"/\* [A-Za-z0-9 _.-]{1,60}", title)


def dead_time(steps: int) -> lfo.OptimalControlProblem:
    """Return an oscillator on which a control acts so many steps later; the states in between follow from controls."""
    A, B = np.zeros((2 + steps, 2 + steps)), np.zeros((2 + steps, 1))
    A[np.ix_([0, -1], [0, -1])], A[0, 1], B[steps] = [[0.7, 0.4], [-0.4, 0.7]], 1.0, 1.0
    A[range(1, steps), range(2, steps + 1)] = 1.0
    inner = np.ones(steps)
    cost = lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=np.concatenate([[0.0], 0.1 * inner, [0.0]]))
    start = np.concatenate([[0.0], 0.2 * inner, [0.0]])
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), 12, cost, lfo.Box(-0.7, 0.4), initial_state=start)


@expensive
@needs_compiler
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(("name", "real"), [("rate limit", "float"), ("dead time", "double")])
def test_x_is_what_is_measured_and_the_rest_is_kept_inside(tmp_path, name, real, delay):
    """Controls are those of Python, which has other arguments of the same size, also where another control acts."""
    problem = dead_time(3) if name == "dead time" else LOOPS[name]()
    given = controller(problem, delay=delay)
    step, rng = compiled(tmp_path, given, real, references=True), np.random.default_rng(0)
    assert step.measured == problem.state_dim - (3 if name == "dead time" else 1)
    for k in range(6):
        x, reference = 0.03 * rng.standard_normal(step.measured), 0.02 * rng.standard_normal(step.measured)
        acted = np.array([0.1]) if k == 3 and not delay else None
        if acted is not None:
            step.applied(acted)
        u = given.step(x, references={"x_ref": reference}, applied=acted)
        status, control = step.step(x, reference)
        assert status == 0
        np.testing.assert_allclose(control, u, atol=APART[real])


def compiles(folder: Path, text: str, *options: str) -> bool:
    """Whether a text that includes the header of a folder compiles without a warning."""
    (folder / "test.c").write_text(f'#include "controller.h"\n{text}\n')
    found = compiler()
    assert found is not None
    command = [found, "-O1", "-Wall", "-Werror", "-fsyntax-only", *(options or ["-std=c99"]), "test.c"]
    return not subprocess.run(command, cwd=folder, capture_output=True).returncode


def windows() -> lfo.OptimalControlProblem:
    """Return the drive of two masses with limits on windows of its torque."""
    limit = lfo.spectrum.closed_loop(lfo.spectrum.notch(centre_hz=12, width_hz=8), 0.03, 0.005, length=40, past=0)
    return replace(lfo.library.two_mass_drive(horizon=20), control_spectrum=limit)


COMPILERS = {
    "gcc": ["gcc", "-std=c99"],
    "clang": ["clang", "-std=c99"],
    "gcc, 32 bits": ["gcc", "-std=c99", "-m32"],
    "clang, 32 bits": ["clang", "-std=c99", "-m32"],
}


@expensive
@needs_kernel
@pytest.mark.parametrize("real", APART)
@pytest.mark.parametrize("name", COMPILERS)
def test_every_compiler_takes_the_sources_without_a_warning_and_the_test_passes(tmp_path, name, real):
    command = [*COMPILERS[name], *compile_command()[2:], "test_controller.c", "-o", "test_controller", "-lm"]
    (tmp_path / "empty.c").write_text("#include <stdio.h>\nint main(void) { return 0; }\n")
    if (
        shutil.which(command[0]) is None
        or subprocess.run([*COMPILERS[name], "empty.c", "-o", "empty"], cwd=tmp_path, capture_output=True).returncode
    ):
        pytest.skip(f"no {name}")
    lfo.generate(controller(lfo.rate_limited(windows(), 0.9, previous=0.0)), tmp_path / "out", real)
    done = subprocess.run(command, cwd=tmp_path / "out", capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    ran = subprocess.run(["./test_controller"], cwd=tmp_path / "out", capture_output=True, text=True)
    assert (ran.returncode, "100 of 100 steps planned" in ran.stdout) == (0, True)


@expensive
@needs_compiler
@pytest.mark.parametrize(
    ("name", "real"), [("rate limit", "float"), ("two controls", "double"), ("windows", "float"), ("windows", "double")]
)
def test_sizes_are_those_of_the_compiler(tmp_path, name, real):
    """The struct has the size that is stated; more than the allowed memory does not compile."""
    problem = windows() if name == "windows" else LOOPS[name]()
    written = lfo.generate(controller(problem), tmp_path, real, memory="64k")
    arrays = len(re.findall(r"\bX\(\w+, ", (tmp_path / "lfo_kernel.h").read_text())) + 1
    excess = f"(int)sizeof(controller) - {written.ram} - (sizeof(void *) > 4 ? {4 * arrays} : 0)"  # pointers of 8 bytes
    near = f"{excess} <= 12 && {excess} >= -12"  # at most 12 bytes to align
    assert compiles(tmp_path, f"typedef char sizes[{near} ? 1 : -1];")
    if compiles(tmp_path, "", "-m32"):
        assert compiles(tmp_path, f"typedef char sizes[{excess} == 0 ? 1 : -1];", "-m32", "-malign-double")
    header = (tmp_path / "controller.h").read_text()
    (tmp_path / "controller.h").write_text(header.replace("<= 65536", f"<= {written.ram - 1}"))
    assert not compiles(tmp_path, "")


@needs_compiler
def test_an_array_that_is_too_short_for_x_is_a_warning(tmp_path):
    lfo.generate(controller(LOOPS["rate limit"]()), tmp_path)
    use = (
        "static controller c; int f(lfo_real *u) {{ lfo_real x[{}] = {{0}}; return controller_step(&c, x, u); }}".format
    )
    assert compiles(tmp_path, use(4))
    assert compiles(tmp_path, "static controller c; int f(lfo_real *u) { return controller_step(&c, u, u); }", "-xc++")
    assert not compiles(tmp_path, use(3), "-O2", "-fno-syntax-only")


@expensive
@needs_kernel
def test_only_a_folder_of_its_own_gets_other_files(tmp_path):
    """There, logs and what the compiler made stay; files of another project are not replaced."""
    (tmp_path / "Makefile").write_text("all: mine")
    with pytest.raises(lfo.errors.ProblemError, match="got a folder with other files; expected a new or empty folder"):
        lfo.generate(controller(LOOPS["low pass"]()), tmp_path)
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("Makefile", "all: mine")]
    (tmp_path / "Makefile").unlink()
    for real in ("double", "float"):
        lfo.generate(controller(LOOPS["low pass"]()), tmp_path, real)
        (tmp_path / "log.csv").write_text("a log")
        assert f"{real}." in (tmp_path / "controller.h").read_text()
    assert (tmp_path / "log.csv").read_text() == "a log"
