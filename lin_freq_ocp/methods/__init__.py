"""SOLVE, with our own methods: a problem becomes a Candidate, a trajectory with multipliers but never a verdict."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "absorbed_cost": "absorb_cost", "candidate": "Candidate SOLVED_TOLERANCE SolveOptions zero_multipliers",
    "condensed.native": "NativeKernel library", "correction": "corrections deviations_from",
    "condensed.plans": "Budget CondensedSolver extremals_of unsettled_plan", "repair": "repair_trajectory",
    "condensed.tables": "CondensedTables GRADIENT_DEPENDENCE INFEASIBLE LIMIT ROW_TOLERANCE SOLVED condense",
    "condensed.windows": "ControlWindows",
    "convex.polish": "steepest_recession zero_rounding", "convex.sparse_program":
    "ACCURATE_ANSWER MOST_PROGRAMS ProgramCache ScaledSolver convex_candidates solve_convex",
    "fitted_multipliers": "MOST_GRADIENTS Uniqueness abnormal_multipliers fit_multipliers uniqueness",
    "long_problems": "LONGEST_FACTOR", "native_code": "DAY compiled_library compiler",
})
