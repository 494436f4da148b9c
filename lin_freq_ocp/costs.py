"""Costs: quadratic, L1, L-infinity, and by formulas."""

from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.problem.costs.formula_cost import SmoothCost
from lin_freq_ocp.problem.costs.norms import L1Cost, LInfCost
from lin_freq_ocp.problem.costs.quadratic import CostSum, QuadraticCost

__all__ = ["CostSum", "L1Cost", "LInfCost", "QuadraticCost", "SmoothCost"]

answer_misspelt(globals())
