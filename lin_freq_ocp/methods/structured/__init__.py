"""An interior-point method over stages and frequencies: Riccati recursions, coupling rows in range or null space."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "active": "MOST_NUMBERS RowResponses TRIES solve_active", "assembly": "assemble_stages choose_origin",
    "choice": "LARGEST_BYTES RANGE_SPACE_BYTES Sizes choose_kkt_solver sizes_of step_seconds", "kkt.dense": "OpenLoop",
    "embedding": "CORRECTORS EmbeddedPoint Embedding End Targets",
    "kkt.recursions": "BandedLoops break_times can_compile loops",
    "kkt.null_space": "Coefficients NullSpace NullSpaceSolver Slacks sort_rows unit_scale",
    "kkt.range_space": "CouplingResponse LowRankSolver RangeSpaceSolver fine_rows range_space_solver",
    "kkt.reduced": "CLIP DenseReduced LEAST_REST TwoLevel clip", "rows": "assign_slots stage_rows",
    "kkt.system": "BALLS Compliance EQUATIONS INEQUALITIES STAGES StepSystem System SystemSolution largest",
    "solver": "solve_from_warm_start solve_structured",
    "stages": "Balls Coupling Equations Inequalities SparseRows SpectrumRows Stages",
})
