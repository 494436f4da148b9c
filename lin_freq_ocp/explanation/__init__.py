"""Why a problem has no solution: a smallest family of constraints in conflict, and the least change that helps."""

from lin_freq_ocp.base import lazy_exports

__all__, __getattr__ = lazy_exports(__name__, {"explanation": "explain least_cure"})
