"""Progress in a Jupyter notebook and on a terminal, and nowhere else.

IPython and the terminal are stand-ins that record what they are told to show.
"""

import multiprocessing
import sys
import threading
from io import BytesIO, TextIOWrapper
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.patience import PATIENCE
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import activity_line, report_progress

SHORT = {"horizon": [60, 80]}
STARTS = [[0.0, 0.0], [0.1, 0.0]]
CALLS = {
    "sweep": (lambda **report: lfo.sweep(lfo.library.double_integrator, SHORT, **report), "0 of 2 solved"),
    "solve_many": (lambda **report: lfo.solve_many(lfo.library.double_integrator(), STARTS, **report), "0 of 2 solved"),
    "minimum_time": (
        lambda **report: lfo.minimum_time(lfo.library.double_integrator, horizons=(180, 190), **report),
        "horizon 180: infeasible",
    ),
    "solve": (lambda **report: lfo.solve(lfo.library.max_min_network(), **report), "nodes"),
    "compare": (lambda **report: lfo.compare(lfo.library.switched_rotation(), [], **report), "nodes"),
    "loop": (
        lambda **report: lfo.RecedingHorizon(lfo.library.double_integrator(cutoff_hz=None)).run(
            [0.0, 0.0], 2, **report
        ),
        "0 of 2 steps",
    ),
}


class Displayed:
    """What a notebook was told to display, in order."""

    def __init__(self):
        self.bundles = []

    def display(self, bundle, *, raw, display_id=False):
        assert (raw, display_id) == (True, True)
        self.bundles.append(bundle)
        return self

    def update(self, bundle, *, raw):
        assert raw
        self.bundles.append(bundle)


@pytest.fixture
def displayed(monkeypatch):
    """A kernel that displays at once."""
    found, ipython, display = Displayed(), ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(kernel="a kernel")
    display.display = found.display
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    for name in ("FIRST_SECONDS", "TERMINAL_SECONDS", "BETWEEN_SECONDS"):
        substitute(monkeypatch, f"base.{name}", 0.0)
    substitute(monkeypatch, "base.TICK_SECONDS", None)  # seconds are not counted: the line changes with its levels only
    return found


class Terminal(TextIOWrapper):
    """A terminal that keeps what is written."""

    def isatty(self):
        return True


def open_terminal(monkeypatch):
    """Return what becomes sys.stderr: a terminal, and no kernel."""
    stream = Terminal(BytesIO(), encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.delitem(sys.modules, "IPython")
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


@expensive
@pytest.mark.parametrize("name", CALLS)
def test_a_notebook_shows_a_line_that_is_gone_in_the_end(displayed, name, capsys):
    call, words = CALLS[name]
    call()
    *shown, last = displayed.bundles
    assert any(words in one["text/plain"] for one in shown)
    assert all(one["text/html"].startswith("<progress></progress> ") for one in shown)
    assert last == {}
    assert capsys.readouterr() == ("", "")


@expensive
@pytest.mark.parametrize("name", ["solve_many", "loop"])
def test_a_terminal_shows_a_line_that_is_gone_in_the_end(displayed, name, monkeypatch):
    stream, (call, words) = open_terminal(monkeypatch), CALLS[name]
    call()
    before, *shown, last, after = stream.buffer.getvalue().decode().split("\r")
    assert (before, last, after) == ("", " " * 39, "")
    assert f"{words} (0 s)".ljust(39) in shown
    assert shown[-1] == f"{words.replace('0', '2')} (0 s)".ljust(39)


def test_a_line_is_not_longer_than_the_terminal(displayed, monkeypatch):
    stream = open_terminal(monkeypatch)
    with report_progress(None, "b", str) as report:
        report("a" * 50)
        assert stream.buffer.getvalue().decode() == "\rb (0 s)".ljust(40) + "\r" + "a" * 39


@expensive
def test_quick_calls_show_nothing_on_a_terminal(displayed, monkeypatch):
    stream = open_terminal(monkeypatch)
    substitute(monkeypatch, "base.TERMINAL_SECONDS", 1e3)
    CALLS["solve_many"][0]()
    assert stream.buffer.getvalue() == b""


@expensive
def test_a_stream_that_another_library_has_put_for_a_terminal_is_left_alone(displayed, monkeypatch):
    open_terminal(monkeypatch)
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True))
    assert activity_line() is None


@expensive
@pytest.mark.parametrize("name", CALLS)
def test_a_report_of_the_users_own_takes_its_place(displayed, name):
    told = []
    CALLS[name][0](progress=lambda *reached: told.append(reached))
    assert told
    assert displayed.bundles == []


@pytest.mark.parametrize("name", seeds(CALLS))
@pytest.mark.parametrize("shell", [None, SimpleNamespace()], ids=["no shell", "IPython in a terminal"])
def test_nothing_is_shown_where_there_is_no_kernel(displayed, name, shell, monkeypatch, capsys):
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: shell)
    CALLS[name][0]()
    assert displayed.bundles == []
    assert capsys.readouterr() == ("", "")


def test_without_ipython_nothing_is_imported(monkeypatch):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert activity_line() is None
    CALLS["sweep"][0]()
    assert "IPython" not in sys.modules


def test_a_worker_of_a_pool_shows_nothing(displayed, monkeypatch):
    assert activity_line() is not None
    monkeypatch.setattr(multiprocessing.process, "_parent_process", "the kernel")
    assert activity_line() is None


@expensive
def test_quick_calls_show_nothing(displayed, monkeypatch):
    substitute(monkeypatch, "base.FIRST_SECONDS", 1e3)
    CALLS["sweep"][0]()
    assert displayed.bundles == []


@expensive
def test_changes_in_quick_succession_are_left_out(displayed, monkeypatch):
    substitute(monkeypatch, "base.BETWEEN_SECONDS", 1e3)
    CALLS["sweep"][0]()
    assert [one.get("text/plain") for one in displayed.bundles] == ["sweeping (0 s)", None]


@expensive
def test_an_error_leaves_nothing_of_the_line(displayed):
    def failing():
        with report_progress(None, "waiting", lambda reached: f"<b>{reached}</b>") as report:
            report(3)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        failing()
    waiting, *others = displayed.bundles
    assert waiting["text/plain"] == "waiting (0 s)"
    assert others == [
        {"text/plain": "<b>3</b> (0 s)", "text/html": "<progress></progress> &lt;b&gt;3&lt;/b&gt; (0 s)"},
        {},
    ]


LONG = {
    "linear solve": (lambda: lfo.solve(lfo.library.pendulum()), ["solving", "solving; method spectral; certifying"]),
    "explain": (
        lambda: lfo.explain(lfo.library.double_integrator(horizon=20, cutoff_hz=0.3)),
        ["looking for the constraints in conflict", "smallest change of the initial state"],
    ),
    "certify": (lambda: lfo.certify(lfo.library.pendulum(), np.zeros((240, 1))), ["certifying"]),
    "shaper": (lambda: lfo.shaper((35, 60), damping=0.0), ["looking for the shortest shaper; horizon"]),
    "compare": (
        lambda: lfo.compare(lfo.library.double_integrator(), []),
        ["comparing; without frequency constraints; solving", "comparing; with frequency constraints; solving"],
    ),
}


@expensive
@pytest.mark.parametrize("name", LONG)
def test_calls_that_may_be_long_say_what_they_do(displayed, name):
    call, words = LONG[name]
    call()
    *shown, last = displayed.bundles
    assert last == {}
    for expected in words:
        assert any(one["text/plain"].startswith(expected) for one in shown)


@expensive
def test_the_seconds_of_a_call_that_reports_nothing_are_counted(displayed, monkeypatch):
    counted, update = threading.Event(), displayed.update

    def write(bundle, *, raw):
        update(bundle, raw=raw)
        counted.set()

    displayed.update = write
    substitute(monkeypatch, "base.TICK_SECONDS", 1e-3)
    with report_progress(None, "waiting", str):
        assert counted.wait(PATIENCE)
    assert {one.get("text/plain") for one in displayed.bundles} == {"waiting (0 s)", None}


@expensive
def test_another_thread_changes_no_line(displayed):
    with report_progress(None, "waiting", str):
        thread = threading.Thread(target=CALLS["sweep"][0])
        thread.start()
        thread.join()
    assert [one.get("text/plain") for one in displayed.bundles] == ["waiting (0 s)", None]
