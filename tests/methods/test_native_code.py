"""Compiled sources: compiled once for compiler, source and processor; a failure is one warning a day, never an error.

The compiler is a script that runs the text in BEHAVIOUR, and the source has one function.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from ctypes import CDLL
from pathlib import Path

import pytest

from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.methods import DAY, compiled_library, compiler, native_code

FAILURE = "answer.c could not be compiled, slower code computes the same"
COMPILER = compiler()
COMPILE = f'exec {COMPILER} "$@"'
SOURCES = ("kernel.c", "path.c", "loops.c", "lattice.c")
STRICT = "-std=c99 -O1 -Wall -Wextra -Wpedantic -Wno-unknown-pragmas -Werror".split()
SINGLE = ("-DLFO_REAL=float", "-DLFO_SQRT=sqrt")  # numbers of single precision, for generated controllers
WRITE_NO_LIBRARY = 'for last; do case "$last" in *.so) echo no library > "$last";; esac; done'

pytestmark = [
    pytest.mark.skipif(COMPILER is None, reason="no C compiler"),
    pytest.mark.skipif(os.name != "posix", reason="a shell script as a compiler"),
]


@pytest.fixture
def sources(tmp_path) -> Path:
    """Return the folder of the source, with the script that stands in for the compiler."""
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "answer.h").write_text("#define ANSWER 42\n")
    (folder / "answer.c").write_text('#include "answer.h"\nint answer(void) { return ANSWER; }\n')
    script = folder / "compiler"
    script.write_text(f'#!/bin/sh\necho run >> {folder / "runs"}\neval "$BEHAVIOUR"\n')
    script.chmod(0o755)
    return folder


@pytest.fixture
def cache(tmp_path) -> Path:
    return tmp_path / "cache" / "lin_freq_ocp"


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """Return the folder of the package for libraries, which is empty."""
    monkeypatch.setattr(native_code, "__file__", str(tmp_path / "package" / "native_code.py"))
    return tmp_path / "package" / "__pycache__"


@pytest.fixture
def load(monkeypatch, sources, cache) -> Callable[[str], CDLL | None]:
    """Return a function that loads the library as a new process does, with a cache of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache.parent))
    monkeypatch.setenv("CC", str(sources / "compiler"))

    def load_library(behaviour: str = COMPILE) -> CDLL | None:
        monkeypatch.setenv("BEHAVIOUR", behaviour)
        return compiled_library.__wrapped__(str(sources / "module.py"), "answer.c", "answer.h")

    return load_library


@pytest.fixture
def fail(load, cache) -> Callable[[str], tuple[str, Path]]:
    """Return a function that fails to compile, and returns the only warning and the record of the failure."""

    def fail_to_compile(behaviour: str = "exit 3") -> tuple[str, Path]:
        with pytest.warns(RuntimeWarning, match=FAILURE) as seen:
            assert load(behaviour) is None
        (warning,), (record,) = seen, cache.glob("*.failed")
        return str(warning.message), record

    return fail_to_compile


def count_runs(sources: Path) -> int:
    path = sources / "runs"
    return len(path.read_text().splitlines()) if path.exists() else 0


def test_a_library_is_compiled_once(load, sources, cache):
    assert [load().answer() for _ in range(2)] == [42, 42]
    assert count_runs(sources) == 1
    assert len(list(cache.glob("*.so"))) == 1


def touch_compiler(sources, _record, _monkeypatch):
    os.utime(sources / "compiler", (0, 0))


def change_header(sources, _record, _monkeypatch):
    (sources / "answer.h").write_text("#define ANSWER (42)\n")


def change_processor(_sources, _record, monkeypatch):
    """Homes are shared by machines, and containers keep their name where they move."""
    assert native_code.processor()
    monkeypatch.setattr(native_code, "processor", lambda: "another one")


def remove_record(_sources, record, _monkeypatch):
    record.unlink()


def let_a_day_pass(_sources, record, _monkeypatch):
    then = record.stat().st_mtime - DAY - 60
    os.utime(record, (then, then))


@expensive
@pytest.mark.parametrize("change", [touch_compiler, change_header, change_processor])
def test_another_compiler_source_or_processor_gets_its_own_library(change, load, sources, cache, monkeypatch):
    load()
    change(sources, None, monkeypatch)
    assert load().answer() == 42
    assert len(list(cache.glob("*.so"))) == 2


@pytest.mark.parametrize("change", [touch_compiler, remove_record, let_a_day_pass])
def test_a_failure_is_remembered_until(change, load, fail, sources, monkeypatch):
    _, record = fail()
    assert load() is None  # without a warning, which would be an error
    assert count_runs(sources) == 1
    change(sources, record, monkeypatch)
    assert load().answer() == 42


@pytest.mark.parametrize(
    ("behaviour", "reason"),
    [
        ("exit 3", "exit status 3"),
        ("kill -9 $$", "SIGKILL"),
        ("exec sleep 600", "timed out"),
        (WRITE_NO_LIBRARY, "no library|too short|invalid"),
        ("true", "No such file"),
        ("echo $(ulimit -S -t) seconds >&2; exit 1", "\n60 seconds\n"),
        ("kill -0 -$$ && echo its own group; exit 1", "its own group"),
    ],
)
def test_a_failure_is_one_line_that_says_what_to_do(behaviour, reason, fail, cache, monkeypatch):
    if "sleep" in behaviour:
        monkeypatch.setattr(native_code, "SECONDS_TO_WAIT", 0.05)
    notice, record = fail(behaviour)
    assert notice == f"{FAILURE}: {record} says why. To try again before tomorrow, remove this file"
    assert re.search(reason, record.read_text())
    assert {path.suffix for path in cache.iterdir()} <= {".lock", ".failed", ".so"}


def test_a_damaged_file_is_compiled_anew(load, fail):
    _, record = fail()
    record.with_suffix(".so").write_bytes(b"")
    record.unlink()
    assert load().answer() == 42


@pytest.mark.parametrize("readable", [True, False])
def test_a_library_is_loaded_from_a_folder_that_cannot_be_written(
    readable, load, sources, cache, own_cache, monkeypatch
):
    """If it cannot be read either, as another user's, the package has its own."""
    load()
    (library,) = cache.glob("*.so")
    forbidden = {(cache, os.W_OK), *([] if readable else [(library, os.R_OK)])}
    monkeypatch.setattr(os, "access", lambda path, mode: (path, mode) not in forbidden)
    assert load().answer() == 42
    assert count_runs(sources) == (1 if readable else 2)
    assert readable != any(own_cache.glob("*.so"))


@pytest.fixture
def without_compiler(monkeypatch):
    monkeypatch.setattr(native_code, "compiler", lambda: None)


@pytest.mark.usefixtures("without_compiler")
def test_without_a_compiler_the_extra_is_named_once_a_day(load, cache, monkeypatch):
    monkeypatch.setitem(sys.modules, "ziglang", None)  # it is not installed
    for named in (True, False, True):
        native_code.name_extra.cache_clear()  # as in a new process
        with pytest.warns(RuntimeWarning, match=r"'\.\[compiler\]'") if named else nullcontext():
            assert [load(), load()] == [None, None]
        if not named:
            let_a_day_pass(None, cache / "no-compiler.failed", None)
    native_code.name_extra.cache_clear()


@pytest.mark.usefixtures("without_compiler")
def test_the_compiler_of_the_extra_compiles(load, sources, monkeypatch):
    package = sources / "ziglang"
    package.mkdir()
    (package / "__init__.py").write_text("")
    script = '#!/bin/sh\nmkdir "$ZIG_GLOBAL_CACHE_DIR" && [ "$1" = cc ] && shift && exec ' + f'{COMPILER} "$@"\n'
    (package / "zig").write_text(script)
    (package / "zig").chmod(0o755)
    monkeypatch.syspath_prepend(sources)
    assert [load().answer() for _ in range(2)] == [42, 42]


@pytest.mark.parametrize("behaviour", [None, "exit 3"], ids=["no compiler", "one that fails"])
def test_the_library_of_the_wheel_is_loaded_where_nothing_compiles(behaviour, load, sources, monkeypatch):
    source = sources / "answer.c"
    target = sources / f"answer-{native_code.SYSTEM}.so"
    subprocess.run([COMPILER, *native_code.PORTABLE, str(source), "-o", str(target)], check=True)
    if behaviour is None:
        monkeypatch.setattr(shutil, "which", lambda name: None)
    assert [load(behaviour or "").answer() for _ in range(2)] == [42, 42]  # without a warning, which would be an error


def test_a_terminal_is_told_once(load, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    substitute(monkeypatch, "base.TERMINAL_SECONDS", 0.0)
    load()
    assert capsys.readouterr().err.startswith("\rcompiling answer.c, once (0 s) ")
    load()
    assert not capsys.readouterr().err


@pytest.fixture(params=["file", "home", "relative"])
def no_cache(request, load, monkeypatch, tmp_path):
    """Take the user's cache away: its folder is a file, there is no home folder, or its path is relative."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", {"file": str(tmp_path / "file"), "home": "", "relative": "a"}[request.param])
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as without HOME and an entry of the user


@pytest.mark.usefixtures("no_cache")
def test_without_a_cache_of_the_user_the_package_has_one(load, own_cache, tmp_path):
    assert load().answer() == 42
    assert {path.parent for path in tmp_path.rglob("answer-*.so")} == {own_cache}


@pytest.mark.usefixtures("no_cache")
def test_without_any_folder_there_is_one_warning(load, monkeypatch, tmp_path):
    monkeypatch.setattr(native_code, "__file__", str(tmp_path / "file" / "native_code.py"))
    with pytest.warns(RuntimeWarning, match="Set XDG_CACHE_HOME to a folder that can be written") as seen:
        assert load() is None
    assert len(seen) == 1


@expensive
@pytest.mark.parametrize(("source", "flags"), [*((source, ()) for source in SOURCES), ("kernel.c", SINGLE)])
def test_every_source_is_strict_c99(source, flags, tmp_path):
    (path,) = Path(native_code.__file__).parent.rglob(source)
    command = [COMPILER, *STRICT, *flags, "-c", str(path), "-o", str(tmp_path / "object")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_interrupted_compilation_leaves_nothing(load, cache, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(native_code.subprocess, "run", interrupt)
        with pytest.raises(KeyboardInterrupt):
            load()
    assert {path.suffix for path in cache.iterdir()} == {".lock"}
    assert load().answer() == 42


def test_several_at_once_compile_once(load, sources):
    """Threads stand in for processes: each opens the locked file by itself."""
    pytest.importorskip("fcntl", reason="files are locked on POSIX only")
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(load, [f"sleep 0.2; {COMPILE}"] * 3))
    assert [library.answer() for library in found] == [42] * 3
    assert count_runs(sources) == 1
