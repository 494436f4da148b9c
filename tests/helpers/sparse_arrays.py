"""Sparse matrices of our code are sparse arrays: SciPy 1.18 warns of the older type, and earlier versions do not."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import scipy.sparse as sp

ROOT = Path(__file__).parents[2]
OURS = tuple(str(ROOT / name) for name in ("docs", "examples", "lin_freq_ocp", "scripts", "tests"))
CONSTRUCTORS = ("scipy.sparse", "scipy.io", __name__)  # they make what their caller asks for, if only by silence
# those whose solvers ask for that type
INTENDED = ("benchmark.loop", *(f"lin_freq_ocp.program.backends.{name}_" for name in ("osqp", "qpsolvers")))


@contextmanager
def spmatrix_refused() -> Generator[None]:
    """Raise DeprecationWarning wherever our code makes a matrix of the older type, named or by default."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sp.spmatrix, "__init__", _begin_spmatrix, raising=False)
        yield


def _begin_spmatrix(self: sp.spmatrix, *args: Any, **options: Any) -> None:
    caller: FrameType | None = sys._getframe(1)
    while caller is not None and caller.f_globals.get("__name__", "").startswith(CONSTRUCTORS):
        caller = caller.f_back
    ours = caller is not None and caller.f_code.co_filename.startswith(OURS)
    if caller is not None and ours and caller.f_globals["__name__"] not in INTENDED:
        raise DeprecationWarning(f"{type(self).__name__}: make a sparse array, from sparse arrays or by its own name")
    super(sp.spmatrix, self).__init__(*args, **options)
