"""From a problem with modes, kinks or levels to a judged outcome: the methods that this folder registers."""

from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.hybrid.pulse_train import PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.certify import CERTIFIERS
from lin_freq_ocp.solving.families import FAMILIES, SOLVER, Family, Shorthand
from lin_freq_ocp.solving.hybrid.certify_modes import certify_modes
from lin_freq_ocp.solving.hybrid.modes import BranchAndBound, Enumeration, MixedInteger
from lin_freq_ocp.solving.hybrid.pulse_train import Angles
from lin_freq_ocp.solving.hybrid.smooth import Nonsmooth

GAPS = {"tolerance": "gap", "gap": "gap"}
SEARCH = {**GAPS, "node_limit": "node_limit"}
PARALLEL = {**SEARCH, "executor": "executor"}
BOUND = {"global_bound": "global_bound"}

FAMILIES[PiecewiseAffineDynamics] = Family(
    "piecewise-affine",
    {
        "auto": Shorthand(BranchAndBound(), PARALLEL),
        "branch_and_bound": Shorthand(BranchAndBound(), PARALLEL),
        "enumerate": Shorthand(Enumeration(), SEARCH),
        "miqp": Shorthand(MixedInteger(), {**SEARCH, **SOLVER}),
    },
)
FAMILIES[PulseTrain] = Family(
    "pulse-train",
    {
        "auto": Shorthand(Angles(), GAPS),
        "angles": Shorthand(Angles(), GAPS),
        "nonsmooth": Shorthand(Nonsmooth(global_bound=False)),
    },
)
FAMILIES[PiecewiseSmoothDynamics] = Family(
    "piecewise-smooth",
    {"auto": Shorthand(Nonsmooth(), {**GAPS, **BOUND}), "nonsmooth": Shorthand(Nonsmooth(global_bound=False))},
    in_loop="nonsmooth",  # a global bound takes seconds
)


def _certify_modes(problem: OptimalControlProblem, trajectory: Trajectory, allowed: float) -> Certificate:
    return certify_modes(problem, trajectory).within(allowed)


CERTIFIERS[PiecewiseAffineDynamics] = _certify_modes
CERTIFIERS[PiecewiseSmoothDynamics] = _certify_modes
