"""Many solves: sweeps over parameters, many initial states, the shortest horizon."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "grid": "fingerprint", "many": "PART solve_part tour", "sweep": "MEASURED", "tasks": "RESUBMISSIONS process_pool",
    "minimum_time": "Search Verdict obstacles problem_at_horizon search_horizons",
})
