"""Machines without a C compiler, or with one that fails."""

from __future__ import annotations

import shutil
from contextlib import contextmanager

import pytest

from lin_freq_ocp.methods import compiled_library, compiler, library, native_code

needs_kernel = pytest.mark.skipif(compiler() is None and library() is None, reason="no C compiler")
"""For tests of what runs in C alone: the condensed method, paths of modes, and loops that plan by these."""


@pytest.fixture(params=["", "/bin/false"], ids=["no compiler", "one that fails"])
def no_compiler(request, tmp_path):
    """Return a context in which nothing compiles; with a compiler that fails, the warning has these words."""
    compiler = request.param

    @contextmanager
    def let_nothing_compile(words):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_CACHE_HOME", str(tmp_path))
            patch.setenv("CC", compiler)
            patch.setattr(shutil, "which", lambda name: compiler if name == compiler else None)
            forget_libraries()
            with pytest.warns(RuntimeWarning, match=words if compiler else "No C compiler was found"):
                yield

    yield let_nothing_compile
    forget_libraries()


def forget_libraries():
    """Let the next use load the libraries anew."""
    compiled_library.cache_clear()
    native_code.name_extra.cache_clear()
