"""What is made of a problem with modes or formulas: its standard forms, smooth modes of costs, the reach of modes."""

from lin_freq_ocp.base import lazy_exports
from lin_freq_ocp.problem.costs.formula_cost import PRICED
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.transform.hybrid.priced import price_linear, price_smooth

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "convex_cost": "with_convex_terms", "forms": "linear_along piecewise_affine piecewise_smooth",
    "mode_reach": "ModeReach", "priced": "cost_as_state",
})
# fmt: on

PRICED.update({LinearDynamics: price_linear, PiecewiseSmoothDynamics: price_smooth})
