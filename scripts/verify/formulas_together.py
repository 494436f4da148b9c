"""Random formulas beside other features, by NumPy and CVXPY (see tests/helpers/checks/formulas_together.py)."""

from __future__ import annotations

from helpers.checks.formulas_together import check
from verify.seeded import trial

verify = trial("random formulas beside other features", check)
