"""From a problem with modes, kinks or levels to a judged outcome: the methods that this folder registers."""

from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.hybrid.pulse_train import PulseTrain
from lin_freq_ocp.solving.certify import CERTIFIERS
from lin_freq_ocp.solving.families import FAMILIES, SOLVER, Family, Shorthand
from lin_freq_ocp.solving.hybrid.certify_modes import certify_modes
from lin_freq_ocp.solving.hybrid.fixed_modes import fix_modes
from lin_freq_ocp.solving.hybrid.modes import BranchAndBound, Enumeration, MixedInteger
from lin_freq_ocp.solving.hybrid.pulse_train import Angles
from lin_freq_ocp.solving.hybrid.smooth import GLOBAL_SECONDS, MOST_SADDLES, Nonsmooth

__all__ = ["GLOBAL_SECONDS", "MOST_SADDLES", "fix_modes"]
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

CERTIFIERS[PiecewiseAffineDynamics] = lambda given, at, allowed: certify_modes(given, at).within(allowed)
CERTIFIERS[PiecewiseSmoothDynamics] = CERTIFIERS[PiecewiseAffineDynamics]
