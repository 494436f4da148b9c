"""JUDGE: sees the problem, a trajectory and multipliers, from any source; never how they were found."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "between_samples": "LARGEST_REACH REACH", "bound": "Bound RIGOROUS box_minimum", "conditions": "Condition",
    "hamiltonian": "diagonal_curvature extremal_at", "many": "batch_judge_takes judge_batch",
    "peaks": "Cells TERMS certified_peak certified_vibration proven_peak",
    "rays": "Conflict descent_direction infeasibility_certificate prove_infeasible unbounded_direction",
    "reach": "Region implied_bounds reachable_bounds", "sensitivities": "bin_prices",
    "sizes": "cost_scale trajectory_sizes", "tolerances": "CONDITION_TOLERANCE DATA_ROUNDING GAP_TOLERANCE",
    "verdict": "judge",
})
# fmt: on
