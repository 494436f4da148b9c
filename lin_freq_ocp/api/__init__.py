"""The public functions and the classes that they return, with everything users call on these."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "layers": "Layer", "result": "present_as", "runs": "Rerun SAME_COST outcome_fields rerun_summary",
    "shaper": "FIRST_PERIODS",
    "solve": "ERRORS raise_for",
})
