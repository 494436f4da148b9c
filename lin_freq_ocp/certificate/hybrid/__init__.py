"""The judge of dynamics with modes and kinks, and their global bounds."""

from lin_freq_ocp.certificate.hybrid.clarke import judge_modes
from lin_freq_ocp.certificate.hybrid.smooth import judge_priced
from lin_freq_ocp.certificate.verdict import JUDGES
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics

JUDGES[PiecewiseAffineDynamics] = judge_modes
JUDGES[PiecewiseSmoothDynamics] = judge_priced
