"""When loops are compiled, and what is said of it."""

import runpy
import sys
from threading import Event, Thread

import pytest

from helpers.patience import PATIENCE
from lin_freq_ocp.methods.structured import can_compile

if not can_compile():
    pytest.skip("numba does not compile", allow_module_level=True)

import numba

from lin_freq_ocp.methods.structured import Kernels, jit
from lin_freq_ocp.methods.structured.kkt import kernels


class Kernel:
    """Stands in for what numba makes of a function."""

    def __init__(self, folder, fails=False):
        self.signatures, self.cache_path, self._fails = [], None if folder is None else str(folder), fails
        self.stats = self

    def compile(self, signature):
        self.signatures.append(signature)
        if self._fails:
            raise PermissionError("the cache was full")

    def disable_compile(self):
        assert self.signatures


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "loops.py"
    path.write_text("sum")
    return path


def test_code_is_ready_once_it_was_compiled_and_until_the_source_changes(tmp_path, source):
    first = Kernels((str(source),), (Kernel(tmp_path), ()))
    assert not first.ready
    first.prepare()
    assert first.ready
    assert Kernels((str(source),), (Kernel(tmp_path), ())).ready
    source.write_text("another sum")
    assert first.ready  # what this process has compiled stays
    assert not Kernels((str(source),), (Kernel(tmp_path), ())).ready


def test_changes_of_inlined_functions_are_seen(tmp_path, source):
    inlined = tmp_path / "inlined.py"
    inlined.write_text("product")
    Kernels((str(source), str(inlined)), (Kernel(tmp_path), ())).prepare()
    stale, foreign = tmp_path / "loops.sum-1.py311.nbi", tmp_path / "others.sum-1.py311.nbi"
    stale.touch()
    foreign.touch()
    inlined.write_text("another product")
    again = Kernels((str(source), str(inlined)), (Kernel(tmp_path), ()))
    assert not again.ready
    again.prepare()
    assert not stale.exists()
    assert foreign.exists()
    assert len(list(tmp_path.glob("*.complete"))) == 1


def test_who_comes_second_waits_and_takes_what_the_first_compiled(tmp_path, source):
    """Threads stand in for processes: each opens the locked file by itself."""
    pytest.importorskip("fcntl", reason="files are locked on POSIX only")
    started, goes_on, code = Event(), Event(), tmp_path / "loops.sum-1.py311.nbi"

    class Slow(Kernel):
        def compile(self, signature):
            code.touch()
            started.set()
            assert goes_on.wait(PATIENCE)
            super().compile(signature)

    later = Kernel(tmp_path)
    first = Thread(target=Kernels((str(source),), (Slow(tmp_path), ())).prepare)
    second = Thread(target=Kernels((str(source),), (later, ())).prepare)
    first.start()
    assert started.wait(PATIENCE)
    second.start()
    second.join(0.2)
    assert second.is_alive()
    assert not later.signatures
    goes_on.set()
    for thread in (first, second):
        thread.join(60)
    assert later.signatures
    assert code.exists()  # the second has not forgotten it


def test_a_terminal_is_told_once(tmp_path, source, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    kernels = Kernels((str(source),), (Kernel(tmp_path), ()))
    kernels.prepare()
    assert "compiling" in capsys.readouterr().err
    kernels.prepare()
    Kernels((str(source),), (Kernel(tmp_path), ())).prepare()
    assert not capsys.readouterr().err


def test_others_are_told_nothing(tmp_path, source, capsys):
    Kernels((str(source),), (Kernel(tmp_path), ())).prepare()
    assert not capsys.readouterr().err


def test_a_full_cache_does_no_harm(tmp_path, source):
    kernels = Kernels((str(source),), (Kernel(tmp_path, fails=True), ()))
    kernels.prepare()
    assert kernels.ready


def test_without_a_folder_every_process_compiles(source):
    kernels = Kernels((str(source),), (Kernel(None), ()))
    assert not kernels.ready
    kernels.prepare()
    assert kernels.ready


def test_functions_are_compiled_where_nothing_can_be_cached(monkeypatch):
    def njit(cache, **_):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(numba, "njit", njit)
    assert jit(len)([1, 2]) == 2


def test_the_command_compiles_all_kernels_ahead(monkeypatch):
    prepared = []
    monkeypatch.setattr(Kernels, "prepare", lambda own: prepared.append(own))
    monkeypatch.delitem(sys.modules, "lin_freq_ocp.methods.structured.__main__", raising=False)  # others import all
    runpy.run_module("lin_freq_ocp.methods.structured", run_name="__main__")
    assert kernels.KERNELS in prepared
