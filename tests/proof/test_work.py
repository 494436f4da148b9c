"""Files of a few bytes that ask for much work are refused before it is done; honest files stay far from the limit."""

import sys

import pytest

from helpers.hand_proofs import DOUBLE_INTEGRATOR, check, checker, scalar_problem, text, two_modes
from helpers.seeds import seeds

FREE = ("-inf", "inf")
SUM = {"A": [[1]], "B": [[1]], "d": [0], "G": [], "H": [], "h": []}
CLAIM, NODES = {"section": "claim", "lower": "-inf", "upper": "inf"}, {"section": "nodes", "reach": True}
ROOT, DUAL = {"node": 0, "parent": None, "t": 0, "modes": [0]}, {"section": "dual", "node": 0, "cost": 1}


def problem(horizon, bits=64, size=1):
    """Return a problem with so many states, and a horizon of any length in as many lines."""
    eye = [[int(i == j) for j in range(size)] for i in range(size)]
    head, names, _, cost, end, bounds, last = scalar_problem(1, [SUM], [FREE, FREE], 0, 4)
    return [
        head | {"bits": bits},
        names | {"horizon": horizon, "states": ["x"] * size},
        {"mode": 0, "A": eye, "B": [[1]] * size, "d": [0] * size, "G": [], "H": [], "h": []},
        cost | {"hessian": [[0] * (size + 1)] * (size + 1), "center": [0] * (size + 1), "linear": [0] * (size + 1)},
        end | {"hessian": [[0] * size] * size, "center": [0] * size, "linear": [0] * size},
        bounds | {"lower": ["-inf"] * size + [-4], "upper": ["inf"] * size + [4]},
        last | {"lower": ["-inf"] * size, "upper": ["inf"] * size},
    ]


def far_apart(size):
    """Return a positive definite Hessian whose elimination takes rational numbers of millions of digits."""
    lines, powers = problem(1, size=size), range(size + 1)
    hessian = [
        ["0x1p+999999" if i == j else f"0x1p{(-1) ** (i + j) * 90_000 * (i + j)}" for j in powers] for i in powers
    ]
    lines[3] = lines[3] | {"hessian": hessian}
    return [*lines, CLAIM, NODES, ROOT, DUAL, {"t": 1, "z": [0] * size}, {"t": 0, "z": [0] * (size + 1)}]


def point(horizon, *terms, fixed=False):
    lines = problem(horizon)
    if fixed:
        lines[5] = lines[5] | {"lower": [0, -4], "upper": [0, 4]}
    stages = [{"t": t, "u": [1], "mode": 0} for t in range(horizon)]
    return [*lines, *terms, CLAIM, {"section": "point", "x": [0], "levels": [2] * len(terms)}, *stages, NODES]


MASK = {"term": 0, "name": "mask", "gauge": "all", "weight": 1, "output": [0, 1], "first": 0}
SPECTRUM = {"output": [1, 0], "first": 0, "window": 5 * 10**5, "frequency": [1, 7]}
ROW = {"term": 0, "name": "row", "gauge": "2", "limit": 1, "weight": 1}
HOSTILE = {
    "a long horizon": problem(10**6),
    "a long horizon in long numbers": problem(10**4, bits=100_000),
    "a long number": [line | {"A": [["0x1." + "f" * 20_000]]} if "A" in line else line for line in problem(10**5)],
    "a reach over many steps": [*problem(2 * 10**5), CLAIM, NODES, ROOT],
    "many nodes over many steps": [
        *(*problem(10**5), CLAIM, NODES | {"reach": False}, ROOT),
        *({"node": i, "parent": i - 1, "t": 0, "modes": [0]} for i in range(1, 40)),
    ],
    "a Hessian of exponents far apart": far_apart(5),
    "a stop band of long numbers": [*problem(500, bits=100_000), {"stop": 1, "samples": 500, "bins": [[0, 9]]}],
    "a stop band of many parts": [
        *problem(20_000),
        {"stop": 1, "samples": 20_000, "bins": [[2 * i, 2 * i] for i in range(500)]},
    ],
    "spectra of long windows": [*problem(5 * 10**5), ROW | {"values": [SPECTRUM] * 10}],
    "a mask of a long window": point(1000, MASK | {"window": 1000, "limits": [[0, 7, 1000, 1000]]}),
    "many equations": point(500, fixed=True),
}


@pytest.mark.parametrize("name", seeds(HOSTILE))
def test_a_file_that_asks_for_much_is_refused_before_it_is_done(name, tmp_path):
    verdict = check(text(HOSTILE[name]), tmp_path)
    assert verdict.status == 1, verdict.printed
    assert verdict.last.startswith("FAILED line "), verdict.printed
    assert " needs " in verdict.last, verdict.printed
    assert "--limit N sets another" in verdict.last


def checked(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["lfo_check.py", *map(str, arguments)])
    return checker().main(), capsys.readouterr().out


def test_an_option_sets_the_limit(monkeypatch, capsys):
    status, printed = checked(monkeypatch, capsys, DOUBLE_INTEGRATOR, "--limit", "100")
    assert status == 1
    assert "the limit is 100, and --limit N sets another" in printed
    for arguments in ((DOUBLE_INTEGRATOR, "--limit", "1e6"), ("--limit", "1000000", DOUBLE_INTEGRATOR)):
        assert checked(monkeypatch, capsys, *arguments)[0] == 0


@pytest.mark.parametrize("limit", ["-1", "nan", "many", "0x10", ""])
def test_another_word_is_no_limit(limit, monkeypatch, capsys):
    status, printed = checked(monkeypatch, capsys, DOUBLE_INTEGRATOR, "--limit", limit)
    assert status == 2
    assert "[--limit N]" in printed


def test_small_proofs_take_a_thousandth_of_what_is_allowed(tmp_path):
    for given in (DOUBLE_INTEGRATOR.read_text(), text(two_modes())):
        assert check(given, tmp_path).status == 0
        assert checker().Work.done < 1e-3 * checker().LEAST_WORK
