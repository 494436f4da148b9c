"""From a problem to a judged outcome: a method for its dynamics, and the proof of the answer by the judge."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "families": "FAMILIES Family Options Shorthand choose_method family_of saved_options", "linear": "LinearAuto",
    "outcome": "Outcome",
    "judging": "candidate_of judge_candidate verified_direction", "method": "Request take_best",
    "resolver": "PlannedStart Resolver proven_in_batch", "solve": "ROUNDS solve_judged",
    "solver_cache": "SolverCache solve_spectral",
})
