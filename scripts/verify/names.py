"""Hostile names through every writer (see tests/helpers/checks/names.py)."""

from __future__ import annotations

from helpers.checks.names import check
from verify.seeded import trial

verify = trial("hostile names through every writer", check)
