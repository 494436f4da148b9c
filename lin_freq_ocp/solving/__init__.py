"""From a problem to a judged outcome: a method for its dynamics, and the proof of the answer by the judge."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "families": "FAMILIES Family Shorthand choose_method family_of", "linear": "LinearAuto", "method": "Request",
    "judging": "candidate_of judge_candidate verified_direction", "outcome": "Outcome", "solve": "ROUNDS solve_judged",
    "resolver": "PlannedStart Resolver proven_in_batch", "solver_cache": "SolverCache solve_spectral",
})
# fmt: on
