"""The errors that the package raises on purpose, and its one warning."""

from lin_freq_ocp.base.errors import (
    BandWarning,
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    MissingExtraError,
    NumericalError,
    ProblemError,
    SolveError,
    UnboundedError,
    UnsupportedError,
)

__all__ = [
    "BandWarning",
    "InfeasibleError",
    "LimitError",
    "LinFreqOCPError",
    "MissingExtraError",
    "NumericalError",
    "ProblemError",
    "SolveError",
    "UnboundedError",
    "UnsupportedError",
]
