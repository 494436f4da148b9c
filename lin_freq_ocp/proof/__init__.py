"""Proofs: files from which a checker that shares no code with the package confirms a claim (docs/proof.md)."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "dual": "growth precision project_on_bounds shrink steer_adjoint", "enclosure": "LONGEST_CHECK",
    "lfo_check": "check", "proof": "checked_enclosure convex_problem proof_of raised_by", "tree": "written_nodes",
    "point": "add_feedback interior_trajectory interpolate least_distance needs_feedback share_of_way tighten",
    "statement": "exact problem_lines vector",
})
