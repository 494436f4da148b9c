"""Large weights on one component, time or control, against balls (see tests/helpers/checks/weights.py)."""

from __future__ import annotations

from helpers.checks.weights import check
from verify.seeded import trial

verify = trial("large weights, against balls", check)
