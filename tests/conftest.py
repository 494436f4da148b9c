import gc
import os
import signal
import sys

import pytest
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.sparse_arrays import spmatrix_refused
from helpers.stage_rows import two_families as two_families
from helpers.sweeps import file as file
from helpers.sweeps import serial as serial
from lin_freq_ocp.base.clock import use_clock
from lin_freq_ocp.testing import PENDULUM, reference_problem

COMPILED = ("test_paths.py",)
"""The tests that wait longest for numba."""


def pytest_configure():
    """Give each process one BLAS thread, children included: with several, workers wait for threads of one another.

    Bytecode is written even where the environment forbids it: without it, every command and every worker compiles the
    package anew, and every run rewrites the assertions of all tests.

    A suite that a script starts in the background ignores Ctrl-C, as do the commands that it starts; the tests of
    Ctrl-C need the handler of Python.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    threadpool_limits(1, user_api="blas")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("any machine")


@pytest.fixture(scope="session", autouse=True)
def clock():
    """Give all tests a clock by which a look takes two milliseconds: limits are over after as many on any machine."""
    with use_clock(Clock(2e-3)):
        yield


@pytest.fixture(scope="session", autouse=True)
def _sparse_arrays():
    """Refuse the older type of sparse matrices on every version of SciPy."""
    with spmatrix_refused():
        yield


def pytest_collection_modifyitems(items):
    """Begin with what compiles: one worker does it while the others test, and these find the code in the cache."""
    items.sort(key=lambda item: item.path.name not in COMPILED)


def pytest_collection_finish():
    """Collect garbage less often, and never what was imported: it lives until the end."""
    gc.freeze()
    gc.set_threshold(50_000, 50, 100)


@pytest.fixture(autouse=True, scope="session")
def _coarse_images():
    """Draw pages with few pixels: no test counts them, and most of the pixels of a page are drawn for nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lin_freq_ocp.pages.report.page.PIXELS_PER_INCH", 60)
        yield


def judged_problem(name):
    """The three problems on which every condition of the theorem is made to fail."""
    if name == "velocity bound":
        return reference_problem("pendulum_variant_velocity_bound", ulo=[-3.4], uhi=[3.4])
    return lfo.library.pendulum(**PENDULUM[name][0])


@pytest.fixture(scope="session")
def solved():
    """Solve each named problem once."""
    results = {}

    def solve(name):
        if name not in results:
            results[name] = lfo.solve(judged_problem(name))
        return results[name]

    return solve
