"""The unit of the cost and constants in it change no status (see tests/helpers/checks/cost_units.py)."""

from __future__ import annotations

from helpers.checks.cost_units import check
from verify.seeded import trial

verify = trial("costs in other units and with constants", check)
