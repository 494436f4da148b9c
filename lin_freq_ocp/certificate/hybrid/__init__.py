"""The judge of dynamics with modes and kinks, and their global bounds."""

from lin_freq_ocp.base import lazy_exports
from lin_freq_ocp.certificate.hybrid.clarke import judge_modes
from lin_freq_ocp.certificate.hybrid.smooth import judge_smooth
from lin_freq_ocp.certificate.verdict import JUDGES
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "clarke": "Flip SwitchingFacts modes_along", "global_bound.step": "OutOfTimeError taylor_bounds",
    "global_bound.bound": "LEVEL_BYTES terminal_minorants value_bounds",
    "global_bound.lattice": "CostToGo Lattice Minima QuadraticForm", "smooth": "kinks nearest_in_ball",
    "tree": "IntervalReach TreeBound level_boxes tree_bound",
})
# fmt: on

JUDGES[PiecewiseAffineDynamics] = judge_modes
JUDGES[PiecewiseSmoothDynamics] = judge_smooth
