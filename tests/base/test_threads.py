import sys
from collections import defaultdict
from dis import get_instructions
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import lin_freq_ocp as lfo
from lin_freq_ocp.methods.structured import loops

FLOORS = "program", "methods", "certificate", "solving", "batch", "loop", "comparison", "explanation"
ALGORITHMS = tuple(
    str(Path(lfo.__file__).parent / floor) for floor in FLOORS
)  # problem: the data, and steps of a plant
LINEAR_ALGEBRA = {"linalg", "la", "lapack", "blas", "dot", "vdot", "tensordot", "einsum", "solve_triangular", "schur"}

problem = lfo.library.double_integrator(horizon=20, cutoff_hz=None, terminal_state=None)
infeasible = lfo.library.double_integrator(horizon=5, cutoff_hz=None)


def most_threads():
    blas = ThreadpoolController().select(user_api="blas").lib_controllers
    return lambda: max(library.get_num_threads() for library in blas)


@pytest.fixture
def two_threads():
    loops()  # what is compiled while calls are counted takes a multiple of the time
    with threadpool_limits(2, user_api="blas"):
        if most_threads()() == 1:
            pytest.skip("this BLAS has one thread only")
        yield


@cache
def calls_blas(code):
    """Whether a function multiplies matrices or calls a function of linear algebra itself."""
    return any(step.argrepr == "@" or step.argval in LINEAR_ALGEBRA for step in get_instructions(code))


def calls_of_blas(call):
    """Return the functions that called BLAS during a call, each with the numbers of threads that it ran with."""
    threads, found = most_threads(), defaultdict(set)

    def note(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(ALGORITHMS) and calls_blas(code):
            found[f"{Path(code.co_filename).name}: {code.co_qualname}"].add(threads())

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(before)
    return found


def loop(certify, **options):
    controller = lfo.RecedingHorizon(problem, certify=certify, **options)
    controller.run([0.0, 0.0], steps=3)
    controller.certify()


DOORS = {
    "solve": lambda: lfo.solve(problem),
    "solve, structured": lambda: lfo.solve(problem, method="structured"),
    "solve, convex": lambda: lfo.solve(problem, method="convex"),
    "solve, infeasible": lambda: lfo.solve(infeasible, throw=False),
    "certify": lambda: lfo.certify(problem, np.zeros((20, 1))),
    "compare": lambda: lfo.compare(lfo.library.double_integrator(horizon=20, terminal_state=None), ["clipped"]),
    "minimum_time": lambda: lfo.minimum_time(lfo.library.double_integrator(cutoff_hz=None), (180, 184)),
    "Solver": lambda: lfo.Solver(problem).solve(initial_state=[0.01, 0.0]),
    "solve_many": lambda: lfo.solve_many(problem, [[0.0, 0.0], [0.01, 0.0]]),
    "loop": partial(loop, "each"),
    "loop, certified later": partial(loop, "later"),
    "loop, of few changes": partial(loop, "later", max_changes=1),
}


@pytest.mark.parametrize("door", DOORS)
def test_linear_algebra_runs_on_one_thread(two_threads, door):
    found = calls_of_blas(DOORS[door])
    assert found
    assert {function: threads for function, threads in found.items() if threads != {1}} == {}
