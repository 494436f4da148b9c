"""Methods for dynamics with modes, kinks or levels: search over modes, interior points, polish."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "search.branch_and_bound": "CoverNode TreeSearch shifted_cover", "search.enumeration": "MOST_SEQUENCES",
    "search.common": "SearchLimits TOLERANCES solve_relaxation", "search.mixed": "SolverClaim solve_miqp",
    "search.level_rounding": "level_rounding neighbouring_levels", "search.multipliers": "multipliers_with_weights",
    "search.node": "NodeSolution solve_path_relaxation", "search.parts": "PARTS", "smooth.model": "Pieces SmoothModel",
    "search.path_native": "OPTIMAL path_library run_path",
    "smooth.interior_point": "Barrier BarrierPoint FEW_ROWS Filter Measure",
    "smooth.local_optimum": "End LocalOptimum smooth_optimum",
    "smooth.local_search": "FAR_REACHES LONGEST_REPLAY LocalSearch SMOOTH_STARTS SmoothProgress states_of_controls",
    "smooth.polish": "newton_points quadratic_model",
    "angles": "bound_near local_angles local_prices nearest_train", "angle_lattice": "AngleLattice AngleRange",
    "quarter": "Quarter",
})
