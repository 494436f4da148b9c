import gc
import os
import signal
import sys
from importlib.util import find_spec

import pytest
from hypothesis import HealthCheck, settings
from matplotlib.layout_engine import ConstrainedLayoutEngine
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from helpers.browsers import browser as browser
from helpers.browsers import chromium as chromium
from helpers.clocks import Clock
from helpers.compilers import no_compiler as no_compiler
from helpers.drawings import BLANK
from helpers.drawings import blank as blank
from helpers.drawings import images as images
from helpers.explanations import explain_once
from helpers.replacing import substitute
from helpers.seeds import ALL, PARTS, VARIABLE, choose_seeds, has_its_turn
from helpers.sparse_arrays import spmatrix_refused
from helpers.stage_rows import two_families as two_families
from helpers.sweeps import file as file
from helpers.sweeps import serial as serial
from helpers.verdicts import CLOSEST, FAR, REFUSED, Record, list_close_verdicts
from helpers.without_flint import SkippedModule
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.explanation import explanation
from lin_freq_ocp.pages import Drawing
from lin_freq_ocp.testing import PENDULUM, reference_problem


def pytest_pycollect_makemodule(module_path, parent):
    """Return a module that is skipped if it needs python-flint, where that is missing; None is the default."""
    return None if find_spec("flint") else SkippedModule.from_parent(parent, path=module_path)


def pytest_configure(config):
    """Choose the random seeds, and give each process one BLAS thread, children included.

    With several threads, workers wait for threads of one another. OPENBLAS_NUM_THREADS and OMP_NUM_THREADS in the
    environment say otherwise.

    Bytecode is written even where the environment forbids it: without it, every command and every worker compiles the
    package anew, and every run rewrites the assertions of all tests.

    A suite that a script starts in the background ignores Ctrl-C, as do the commands that it starts; the tests of
    Ctrl-C need the handler of Python.
    """
    choose_seeds(named=any(".py" in one for one in config.args))
    gc.disable()
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    threads = os.environ.setdefault("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    threadpool_limits(int(threads), user_api="blas")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    config.addinivalue_line("markers", "at_tolerance(reason): verdicts of the test may be close to their tolerance")
    config.addinivalue_line("markers", "expensive: one run of twelve takes the test")
    settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("any machine")


def pytest_sessionstart(session):
    """Print the choice of seeds; workers have no reporter."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None:
        share = "all" if os.environ[VARIABLE] == ALL else f"one of {PARTS} parts of the"
        reporter.write_line(f"{VARIABLE}={os.environ[VARIABLE]}: {share} expensive tests, random seeds and long tables")


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


def pytest_collection_modifyitems(config, items):
    """Leave expensive tests to the run that takes them."""
    later = [item for item in items if item.get_closest_marker("expensive") and not has_its_turn(item.nodeid)]
    if later:
        config.hook.pytest_deselected(items=later)
        items[:] = [item for item in items if item not in set(later)]


def pytest_collection_finish():
    """Collect garbage from now on, less often, and never what was imported: it lives until the end."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(50_000, 50, 100)


@pytest.fixture(autouse=True, scope="session")
def _plain_drawings():
    """Draw figures with few pixels and where panels are by default: no test counts pixels, and one has the layout.

    Pages are saved with blank images, but by tests with the fixture ``images``.
    """
    with pytest.MonkeyPatch.context() as patch:
        substitute(patch, "pages.PIXELS_PER_INCH", 60)
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda layout, figure: None)
        patch.setattr(Drawing, "png", lambda drawing: BLANK)
        yield


_verdicts, _closest = Record(), {}
_verdicts.watch()


@pytest.fixture(autouse=True, scope="session")
def _explanations():
    """Let solve search once for the explanation of a problem that several tests solve; ``lfo.explain`` always does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explanation, "explain", explain_once(lfo.explain))
        yield


@pytest.fixture(autouse=True)
def _verdicts_far_from_tolerances(request):
    """Fail a test whose verdict is about to flip; the report of a test says how close its verdicts are."""
    yield
    (closeness, subject), _verdicts.closest = _verdicts.closest, FAR
    request.node.user_properties.append((CLOSEST, (closeness, subject)))
    if closeness > REFUSED and not request.node.get_closest_marker("at_tolerance"):
        pytest.fail(f"a verdict is at {closeness:.2f} of its tolerance: {subject}")


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


def pytest_runtest_logreport(report):
    """Collect the closest verdicts of tests, also of those in workers."""
    if report.when == "teardown":
        _closest[report.nodeid] = dict(report.user_properties).get(CLOSEST, (0.0, ""))


def pytest_terminal_summary(terminalreporter):
    """List the verdicts that are close to their tolerance."""
    for line in list_close_verdicts(_closest):
        terminalreporter.write_line(line)
