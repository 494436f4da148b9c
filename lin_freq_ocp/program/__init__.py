"""The linear program of a problem: rows and their sparse form, units, and the solvers that take it."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "active_rows": "solve_active", "backends.base": "Claim REGISTER Solution SolverEntry backend",
    "backends.clarabel_": "solve", "backends.qpsolvers_": "ITERATION_LIMITS SETTINGS",
    "linear_program": "LinearProgram dense_rows", "passed_bins": "passed_bins_of", "program": "Block Program Scaling",
    "program_rows": "bin_multipliers real_rows stop_band_rows",
    "units": "is_revision natural_scaling point_units revised_scaling scaled_program stated_scaling",
})
