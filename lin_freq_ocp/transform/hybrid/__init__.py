"""What is made of a problem with modes or formulas: its standard forms, smooth modes of costs, the reach of modes."""

from lin_freq_ocp.base import lazy_exports
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.forms import FORMS
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.transform.hybrid.forms import form_of_linear, form_of_others, form_of_smooth

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "convex_cost": "with_convex_terms", "cost_state": "cost_as_state",
    "forms": "boxes_of_steps linear_along piecewise_affine piecewise_smooth", "mode_reach": "ModeReach",
})
# fmt: on

FORMS.update({LinearDynamics: form_of_linear, PiecewiseSmoothDynamics: form_of_smooth, Dynamics: form_of_others})
