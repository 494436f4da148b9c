"""Derivatives of the optimum and of its cost by the data of a problem, and whether they exist."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "adjoint": "AdjointDerivatives LongKKT derivatives_of", "data": "data_for data_of slopes with_data",
    "derivatives": "Derivative SolutionDerivatives Gradient Side",
    "sensitivities": "bin_prices sensitivities_of",
})
