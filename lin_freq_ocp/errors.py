"""The errors that the package raises on purpose, and its warnings."""

from lin_freq_ocp.base.errors import (
    BandWarning,
    ClosedLoopWarning,
    InfeasibleError,
    LimitError,
    LinFreqOCPError,
    MissingExtraError,
    NoDerivativeError,
    NumericalError,
    ProblemError,
    SolveError,
    UnboundedError,
    UnsupportedError,
)

# fmt: off
__all__ = [
    "BandWarning", "ClosedLoopWarning", "InfeasibleError", "LimitError", "LinFreqOCPError", "MissingExtraError",
    "NoDerivativeError", "NumericalError", "ProblemError", "SolveError", "UnboundedError", "UnsupportedError",
]
