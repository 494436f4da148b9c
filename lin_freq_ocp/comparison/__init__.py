"""Filters and input shapers, compared with the solution under the frequency constraint."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "compare": "SEARCH_SECONDS compare_methods", "filters": "FILTERS apply_filter filter_limits filter_stop",
    "moves": "LONGEST_PROFILE TRIED boxes_of impulse_text impulses remember_zero shape_controls shortest_moves "
    "vibration why_not_shaped",
    "shapers": "USUAL_SHAPERS INSENSITIVITY SHAPERS Impulses Modes bands_of eigenvalues_of known_shaper shorten",
    "trajectories": "NO_MODE ProblemSignal controls_of measured_solution mode_sequence",
})
