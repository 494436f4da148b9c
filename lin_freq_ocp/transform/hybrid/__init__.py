"""What is made of a problem with modes or formulas: its standard forms, smooth modes of costs, the reach of modes."""

from lin_freq_ocp.problem.costs.formula_cost import PRICED
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.transform.hybrid.priced import price_linear, price_smooth

PRICED.update({LinearDynamics: price_linear, PiecewiseSmoothDynamics: price_smooth})
