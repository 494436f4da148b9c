"""The command, run in the process of the test."""

from __future__ import annotations

import io
import json
import shutil
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import pytest

from lin_freq_ocp import cli


def run(*arguments: str) -> tuple[int, str, str]:
    """Run the command in this process; return exit status, stdout and stderr."""
    out, err = io.StringIO(), io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(out), redirect_stderr(err):
        warnings.simplefilter("default")
        with pytest.raises(SystemExit) as ended:
            cli.main(arguments)
    return int(ended.value.code or 0), out.getvalue(), err.getvalue()


def parsed(text: str):
    """Return the one JSON object that is the whole text; NaN and Infinity, which are not JSON, are refused."""

    def refuse(constant):
        raise ValueError(f"{constant} in JSON")

    return json.loads(text, parse_constant=refuse)


COMMAND = shutil.which("lin-freq-ocp", path=str(Path(sys.executable).parent)) or "lin-freq-ocp"
once = cache(run)
"""Runs of the command that change nothing: each is made once."""
