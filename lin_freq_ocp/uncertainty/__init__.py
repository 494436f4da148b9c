"""Plans that hold for every load and every plant of a set, and the proof of the worst case of a plan."""

from lin_freq_ocp.base import lazy_exports
from lin_freq_ocp.base.errors import answering_misspelt

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "discs": "Discs radius_of_coherence", "disturbance": "Disturbance", "loads": "Gaussian Records", "plants": "Plants",
    "protocol": "RobustProblem robust worst_case", "worst_loads": "Worst WorstCase",
}, answering_misspelt)
