"""What is made of a problem: reduced and sampled problems with the way back, limits, sizes, simulations, starts."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "level_rows": "few_between_levels rows_of_levels",
    "limits": "Limit all_limits changed_fields constraints drop_limits numbers",
    "reductions": "Change Reduced Reduction reduce_problem",
    "reformulations": "RATE_LIMIT far_origin rate_limit sampled_masks semi_infinite_terms translated_by translation_of",
    "response_curvature": "BinCurvature bin_curvature", "simulation": "motions_at_rest reach_of_bounds",
    "sizes": "search_scale stated_sizes", "starts": "start_of",
})
