"""Infeasible and unbounded are proven or not said (see tests/helpers/checks/rays.py)."""

from __future__ import annotations

from helpers.checks.rays import check
from verify.seeded import trial

verify = trial("proofs of infeasible and unbounded", check)
