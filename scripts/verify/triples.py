"""Three features at random in a small problem (see tests/helpers/checks/pairs.py)."""

from __future__ import annotations

from helpers.checks.pairs import check_triple
from verify.seeded import trial

verify = trial("three features together", check_triple)
