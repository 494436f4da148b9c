"""Costs and constraints by formulas that cancel, against balls (see tests/helpers/checks/cancellation.py)."""

from __future__ import annotations

from helpers.checks.cancellation import check
from verify.seeded import trial

verify = trial("formulas with cancellation, against balls", check)
