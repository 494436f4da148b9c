"""Random smooth formulas."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.formulas import Formula, text_of

UNARY = [
    lambda a: a**2,
    lambda a: a**3,
    lambda a: np.exp(0.3 * a),
    lambda a: np.log(a * a + 1.5),
    lambda a: np.sqrt(a * a + 0.5),
    lambda a: np.sin(a),
    lambda a: np.cos(a),
    lambda a: np.tanh(a),
    lambda a: np.arctan(a),
    lambda a: 2 - a / 3,
    lambda a: 1 / (a * a + 1),
    lambda a: lfo.norm([a, a + 1.0]),
]
BINARY = [lambda a, b: a + b, lambda a, b: a - 2 * b, lambda a, b: a * b, lambda a, b: a / (b * b + 1)]


def random_formula(rng: np.random.Generator, size: int, leaves: list) -> object:
    """Return a smooth formula of some operations, or the same with numbers for leaves."""
    stack = list(leaves)
    for _ in range(size):
        a = stack[rng.integers(len(stack))]
        if rng.random() < 0.5:
            stack.append(UNARY[rng.integers(len(UNARY) - 1)](a))
        else:
            stack.append(BINARY[rng.integers(len(BINARY))](a, stack[rng.integers(len(stack))]))
    return stack[-1]


def exact_text(formula: Formula) -> str:
    """Return the text of a formula in full, with numbers to the last bit."""
    return text_of(formula, number=repr, longest=float("inf"))
