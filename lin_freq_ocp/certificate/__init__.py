"""JUDGE: sees the problem, a trajectory and multipliers, from any source; never how they were found."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "between_samples": "BERNSTEIN DEGREE LARGEST_REACH LATEST_HALVING REACH bounds_between_samples",
    "bound": "Bound RIGOROUS box_minimum optimum_box ray_bound unit_rounding",
    "hamiltonian": "diagonal_curvature extremal_at", "many": "batch_judge_takes judge_batch", "verdict": "JUDGES judge",
    "peaks": "Cells HALVINGS TERMS certified_peak certified_vibration proven_peak", "response_bound": "farkas_bound",
    "rays": "Conflict descent_direction infeasibility_certificate prove_infeasible unbounded_direction",
    "reach": "Region cost_is_never_negative implied_bounds reachable_bounds",
    "sizes": "cost_scale trajectory_sizes", "conditions": "Condition",
    "tolerances": "CONDITION_TOLERANCE DATA_ROUNDING GAP_TOLERANCE RADIUS_MARGIN",
})
