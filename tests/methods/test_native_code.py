"""Compiled sources: cached for one processor, compiled anew where the cached file is damaged, and never an error."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from ctypes import CDLL
from pathlib import Path

import pytest

from lin_freq_ocp.methods import native_code
from lin_freq_ocp.methods.native_code import compiled_library, compiler

PURPOSE = "the mode search in C could not be compiled"


@pytest.fixture
def load(monkeypatch, tmp_path) -> Callable[[], CDLL | None]:
    """Return a function that loads the mode search as a new process does, with a cache of its own."""
    if compiler() is None:
        pytest.skip("no C compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return lambda: compiled_library.__wrapped__("lin_freq_ocp.methods.hybrid.search", ("path.c",), PURPOSE)


def cached_files(folder: Path) -> list[Path]:
    return sorted((folder / "lin_freq_ocp").iterdir())


def test_a_processor_with_other_instructions_gets_its_own_library(load, monkeypatch, tmp_path):
    """Homes are shared by machines, and containers keep their name where they move."""
    assert native_code.processor()
    load()
    first = cached_files(tmp_path)
    load()
    assert cached_files(tmp_path) == first
    assert len(first) == 1
    monkeypatch.setattr(native_code, "processor", lambda: "another one")
    assert load() is not None
    assert len(cached_files(tmp_path)) == 2


@pytest.mark.parametrize("content", [b"", b"no library"])
def test_a_damaged_file_is_compiled_anew(content, load, tmp_path, monkeypatch):
    monkeypatch.setattr(native_code, "_compile_library", lambda found, texts, stem, target: write(target, content))
    with pytest.warns(RuntimeWarning, match=PURPOSE):
        assert load() is None
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load().lfo_path_run
    assert [len(path.read_bytes()) > len(content) for path in cached_files(tmp_path)] == [True]


def write(target: Path, content: bytes) -> None:
    target.parent.mkdir(exist_ok=True)
    target.write_bytes(content)


def test_without_a_home_folder_there_is_one_warning(load, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as without HOME and an entry of the user
    with pytest.warns(RuntimeWarning, match=PURPOSE) as seen:
        assert load() is None
    assert len(seen) == 1


def test_a_cache_that_is_a_file_gives_one_warning(load, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.warns(RuntimeWarning, match=PURPOSE) as seen:
        assert load() is None
    assert len(seen) == 1


def test_an_interrupted_compilation_leaves_nothing(load, monkeypatch, tmp_path):
    def interrupt(command, cwd, **others):
        (Path(cwd) / "path.so").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(native_code.subprocess, "run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        load()
    assert cached_files(tmp_path) == []


def test_libraries_compiled_at_once_are_one_file(load, tmp_path):
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(lambda _: load(), range(3)))
    assert all(found)
    assert len(cached_files(tmp_path)) == 1
