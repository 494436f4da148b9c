"""A problem solved again at every step of a control loop."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "embedded": "markdown", "step_problem": "ControlLimits checked_penalties depends_on_past excess free_first_state "
    "known_states soften with_past", "windows": "control_windows without_windows",
})
