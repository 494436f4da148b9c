"""Loops whose state jumps to 1e30 and to no number, in Python and in C (see tests/helpers/checks/jumps.py)."""

from __future__ import annotations

from helpers.checks.jumps import check
from verify.seeded import trial

verify = trial("controls after jumps of the state", check)
