"""The tests with all their random seeds, of which a run by day takes a third.

Part of scripts/verify.py.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from rich.console import Console

from helpers.seeds import ALL, VARIABLE

ROOT = Path(__file__).parents[2]


def verify(console: Console) -> bool:
    """Run the tests by two workers; return whether none failed."""
    console.print(f"[b]Tests with {VARIABLE}={ALL}[/b]")
    command = [sys.executable, "-m", "pytest", "-n", "2"]
    return subprocess.run(command, cwd=ROOT, env=os.environ | {VARIABLE: ALL}).returncode == 0
