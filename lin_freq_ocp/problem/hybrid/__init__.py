"""Dynamics and controls with modes, kinks or levels, and search trees as data."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "affine_mode": "ModeArrays", "formula_modes": "MOST_PIECES SMALLEST_PIECE", "levels": "cost_unit",
    "mode_tree": "ModeNode ModeTree", "piecewise_affine": "REGION", "regions": "CONTINUITY_TOLERANCE",
})
