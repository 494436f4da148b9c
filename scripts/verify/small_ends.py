"""Small numbers in ends and references change no status (see tests/helpers/checks/small_ends.py)."""

from __future__ import annotations

from helpers.checks.small_ends import check
from verify.seeded import trial

verify = trial("small numbers in ends and references", check)
