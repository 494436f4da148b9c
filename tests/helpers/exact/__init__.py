"""Optimal costs of proofs' problems to 50 digits: an active set, solved in balls, and nothing of the package."""

from helpers.exact.optimum import optimal_cost
from helpers.exact.statement import Statement

__all__ = ["Statement", "optimal_cost"]
