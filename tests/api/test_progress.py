"""Progress in a Jupyter notebook and on a terminal, and nowhere else.

IPython and the terminal are stand-ins that record what they are told to show.
"""

import multiprocessing
import sys
from io import BytesIO, TextIOWrapper
from types import ModuleType, SimpleNamespace

import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import seeds
from lin_freq_ocp.api import progress_line, report_progress

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
        substitute(monkeypatch, f"api.{name}", 0.0)
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


@pytest.mark.parametrize("name", CALLS)
def test_a_notebook_shows_a_line_that_is_gone_in_the_end(displayed, name, capsys):
    call, words = CALLS[name]
    call()
    *shown, last = displayed.bundles
    assert words in shown[0]["text/plain"]
    assert all(one["text/html"].startswith("<progress></progress> ") for one in shown)
    assert last == {}
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["solve_many", "loop"])
def test_a_terminal_shows_a_line_that_is_gone_in_the_end(displayed, name, monkeypatch):
    stream, (call, words) = open_terminal(monkeypatch), CALLS[name]
    call()
    before, *shown, last, after = stream.buffer.getvalue().decode().split("\r")
    assert (before, last, after) == ("", " " * 39, "")
    assert shown[0] == f"{words:39}"
    assert shown[-1] == f"{words.replace('0', '2'):39}"


def test_a_line_is_not_longer_than_the_terminal(displayed, monkeypatch):
    stream = open_terminal(monkeypatch)
    with report_progress(None, str) as report:
        report("a" * 50)
        assert stream.buffer.getvalue().decode() == "\r" + "a" * 39


def test_quick_calls_show_nothing_on_a_terminal(displayed, monkeypatch):
    stream = open_terminal(monkeypatch)
    substitute(monkeypatch, "api.TERMINAL_SECONDS", 1e3)
    CALLS["solve_many"][0]()
    assert stream.buffer.getvalue() == b""


def test_a_stream_that_another_library_has_put_for_a_terminal_is_left_alone(displayed, monkeypatch):
    open_terminal(monkeypatch)
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True))
    assert progress_line() is None


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
    assert progress_line() is None
    CALLS["sweep"][0]()
    assert "IPython" not in sys.modules


def test_a_worker_of_a_pool_shows_nothing(displayed, monkeypatch):
    assert progress_line() is not None
    monkeypatch.setattr(multiprocessing.process, "_parent_process", "the kernel")
    assert progress_line() is None


def test_quick_calls_show_nothing(displayed, monkeypatch):
    substitute(monkeypatch, "api.FIRST_SECONDS", 1e3)
    CALLS["sweep"][0]()
    assert displayed.bundles == []


def test_changes_in_quick_succession_are_left_out(displayed, monkeypatch):
    substitute(monkeypatch, "api.BETWEEN_SECONDS", 1e3)
    CALLS["sweep"][0]()
    assert [one.get("text/plain") for one in displayed.bundles] == ["0 of 2 solved", None]


def test_an_error_leaves_nothing_of_the_line(displayed):
    def failing():
        with report_progress(None, lambda reached: f"<b>{reached}</b>") as report:
            report(3)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        failing()
    assert displayed.bundles == [
        {"text/plain": "<b>3</b>", "text/html": "<progress></progress> &lt;b&gt;3&lt;/b&gt;"},
        {},
    ]
