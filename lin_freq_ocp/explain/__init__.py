"""Why a problem has no solution: a smallest family of constraints in conflict, and the least that cures it."""

from lin_freq_ocp.explain.explanation import Explanation, explain
from lin_freq_ocp.explain.relaxation import Cure

__all__ = ["Cure", "Explanation", "explain"]
