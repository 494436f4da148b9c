"""Relaxations and mixed-integer programs of problems with modes."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "mixed_integer": "big_m_bounds big_m_program", "path_relaxation": "PathRelaxation", "relaxation": "ModeRelaxation",
    "rows": "Quadratic",
})
