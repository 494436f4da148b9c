"""The exact optima that proofs are compared with: x_1 = u from x_0 = 0, minimise 1/2 u^2 + 1/2 (x_1 - 3)^2."""

import pytest
from flint import arb

from helpers import hand_proofs
from helpers.exact import Statement, optimal_cost

U, X = [[0, 1, "0x1"]], [[1, 0, "0x1"]]
ONE = {"gauge": "2", "weight": "inf", "limit": "0x1"}


def value(row, constant="0x0"):
    return {"row": row, "constant": constant}


def cost_with(*lines):
    modes = [{"A": [[1]], "B": [[1]], "d": [0], "G": [], "H": [], "h": []}]
    problem = hand_proofs.scalar_problem(1, modes, [(0, 0), ("-inf", "inf")], 3, 4)
    rest = [
        {"section": "claim", "lower": 0, "upper": "inf"},
        {"section": "point", "x": [0], "levels": []},
        {"t": 0, "u": [0.75], "mode": 0},
        {"section": "nodes", "reach": False},
    ]
    text = hand_proofs.text([*problem, *map(hand_proofs.json_line, lines), *rest])
    return optimal_cost(Statement.read(text))


@pytest.mark.parametrize(
    ("term", "cost"),
    [
        ({"values": [value(U)]} | ONE, 2.5),
        ({"values": [value(U)]} | ONE | {"weight": "0x1p-1"}, 2.4375),
        ({"values": [value(U)]} | ONE | {"weight": "0x1p+9"}, 2.5),
        ({"values": [value(U)]} | ONE | {"gauge": "max"}, 2.5),
        ({"values": [value([], "0x1"), value(U)]} | ONE | {"gauge": "cone", "limit": "0x0"}, 2.5),
        ({"values": [value(U), value(X)]} | ONE | {"gauge": "1"}, 3.25),
        ({"values": [value(U), value(X)]} | ONE | {"gauge": "inf"}, 2.5),
        ({"values": [value(U, "-0x1")]} | ONE | {"gauge": "inf", "limit": "0x0"}, 2.5),
        (
            {"values": [{"output": ["0x0", "0x1"], "first": 0, "window": 1, "frequency": [1, 3]}]}
            | ONE
            | {"limit": "0x1p-1"},
            3.25,
        ),
    ],
)
def test_terms(term, cost):
    found = cost_with({"term": 0, "name": "some"} | term)
    assert found.contains(arb(cost))
    assert found.rad() < 1e-50


def test_no_term_and_a_removed_bin():
    assert cost_with().contains(arb(2.25))
    assert cost_with({"stop": 1, "samples": 1, "bins": [[0, 0]]}).contains(arb(4.5))


def test_the_modes_of_the_point_count():
    assert optimal_cost(Statement.read(hand_proofs.text(hand_proofs.two_modes()))).contains(arb(0.25))
    assert optimal_cost(Statement.read(hand_proofs.text(hand_proofs.two_modes())), [0]).contains(arb(2.25))


def test_the_double_integrator():
    assert optimal_cost(Statement.read(hand_proofs.DOUBLE_INTEGRATOR.read_text())).contains(arb(5))
