"""Files that are made to deceive the checker, or to break it; and odd files that are right."""

import json
from io import BytesIO

import pytest

from helpers.hand_proofs import check, checker, scalar_problem, text

SUM = {"A": [[1]], "B": [[1]], "d": [0], "G": [], "H": [], "h": []}
FREE = ("-inf", "inf")
BRACKETS = "[" * 100_000
REST = {"t": 1, "z": [1.5]}, {"t": 0, "z": [0, 1.5]}  # of x+ = x + u, u^2/2 + (x_1 - 3)^2/2: at least 9/4


def dual(*lines, node=0, cost=1):
    return [{"section": "dual", "node": node, "cost": cost}, *lines]


def node(index, parent, t, modes):
    return {"node": index, "parent": parent, "t": t, "modes": modes}


def proof(
    *extra, modes=(SUM,), ends=FREE, horizon=1, changes=(), claim=FREE, point=None, levels=(), tree=None, body=None
):
    """Return a proof of x+ = x + u from 0, u^2/2 + (x_T - 3)^2/2, |u| <= 4, with more lines and changed ones."""
    lines = scalar_problem(horizon, modes, [(0, 0), *[FREE] * (horizon - 1), ends], 3, 4)
    for index, fields in dict(changes).items():
        lines[index] = lines[index] | fields
    levels = {"section": "point", "x": [0], "levels": list(levels)}
    stages = [{"t": t, "u": [u], "mode": 0} for t, u in enumerate(point or ())]
    return [
        *lines,
        *extra,
        {"section": "claim", "lower": claim[0], "upper": claim[1]},
        *([levels, *stages] if point else ()),
        {"section": "nodes", "reach": tree is not None},
        *(tree or [node(0, None, 0, list(range(len(modes))))]),
        *(dual(*REST) if body is None else body),
        {"section": "end"},
    ]


def mask(limits=((0, 1, 1, 1),), **fields):
    """Return |u_0| <= 1 over all frequencies, at a price of 1."""
    own = {"output": [0, 1], "first": 0, "window": 1, "limits": [list(piece) for piece in limits]}
    return {"term": 0, "name": "mask", "gauge": "all", "weight": 1} | own | fields


def row(factors=((0, 1, 1),), constant=-1, **fields):
    """Return u_0 = 1."""
    values = [{"row": [list(factor) for factor in factors], "constant": constant}]
    return {"term": 0, "name": "row", "gauge": "1", "limit": 0, "weight": "inf", "values": values} | fields


def stop(**fields):
    return {"stop": 1, "samples": 1, "bins": [[0, 0]]} | fields


def priced(frequency):
    """Return a dual with a multiplier of 1/2 at a frequency: 9/4 - 1/2 + ... of the mask |u_0| <= 1."""
    slope = {"t": 0, "z": [0, 1.25]}
    return dual({"multiplier": 0, "frequency": frequency, "values": [0.5, 0]}, {"t": 1, "z": [1.25]}, slope)


def replaced(index, line):
    """Return the proof, as bytes, with a line replaced."""
    lines = text(proof()).encode().splitlines(keepends=True)
    lines[index] = line
    return b"".join(lines)


TWO = (SUM, SUM)
WEAK = {"t": 2, "z": [0]}, {"t": 1, "z": [0, 0], "eta": [0]}, {"t": 0, "z": [0, 0]}
TWO_STEPS = {"t": 2, "z": [2]}, {"t": 1, "z": [0, 1]}, {"t": 0, "z": [0, 1]}  # at least 3/2
UNBOUNDED = {"lower": [0, "-inf"], "upper": [0, "inf"]}
SINGULAR = {3: {"hessian": [[1, -1], [-1, 1]], "linear": [1, 1]}}
BENT = {3: {"hessian": [[0, 1], [1, 0]]}}
FORGED = "x\nVERIFIED 1 1\r\x1b[2J"
UNREACHED = {"A": [[1]], "B": [[1]], "d": [0], "G": [[1]], "H": [[0]], "h": [-1]}  # x <= -1
FIXED = {"A": [[1]], "B": [[0]], "d": [0], "G": [], "H": [], "h": []}  # no control moves x
PROOF = "lfo_check.py FILE: not a proof"
FAILURES = {
    # the text
    "brackets without end, in the first line": (f"{BRACKETS}\n".encode(), PROOF),
    "brackets without end": (replaced(2, f'{{"mode": {BRACKETS}\n'.encode()), "FAILED line 3: maximum recursion"),
    "an integer of 5000 digits": (replaced(2, b'{"mode": ' + b"9" * 5000 + b"}\n"), "FAILED line 3: Exceeds the limit"),
    "a byte order mark": (b"\xef\xbb\xbf" + text(proof()).encode(), PROOF),
    "another encoding": (text(proof()).encode("utf-16-be"), PROOF),
    "a term's name of several lines": (
        proof(mask(name=FORGED), point=[3], levels=[1]),
        "FAILED line 11: 'x\\nVERIFIED 1 1\\r\\x1b[2J' is not proven",
    ),
    "a version of true": (replaced(0, b'{"format": "lfo-proof", "version": true, "bits": 64}\n'), PROOF),
    # the problem
    "no modes": (proof(modes=(), body=[], claim=("inf", "inf")), "FAILED line 2: expected names"),
    "no controls": (proof(changes={1: {"controls": []}}), "FAILED line 2: expected names"),
    "too many stages": (proof(changes={1: {"horizon": 10**7}}), "FAILED line 2: 10000000 is not"),
    "a negative mask, whose term is zero": (proof(mask([(0, 1, -1, -1)]), body=priced(0)), "FAILED line 8: limits:"),
    "a mask that turns negative": (proof(mask([(0, 1, 1, -1)]), body=priced(0)), "FAILED line 8: limits:"),
    "a mask backwards": (proof(mask([(1, 0, 1, 1)])), "FAILED line 8: limits:"),
    "a mask up to a frequency of 2^999999": (proof(mask([(0, "0x1p+999999", 1, 1)])), "FAILED line 8: limits:"),
    "a mask with values": (proof(mask(values=[])), "FAILED line 8: got the fields"),
    "a row with an output": (proof(row(output=[0, 1])), "FAILED line 8: got the fields"),
    "a value of two kinds": (
        proof(row(values=[{"row": [], "constant": 0, "output": [0, 1]}])),
        "FAILED line 8: a value has",
    ),
    "a control at T": (proof(row([(1, 1, 1)])), "FAILED line 8: 1 is not"),
    "the component -1": (proof(row([(0, -1, 1)])), "FAILED line 8: -1 is not"),
    "the time -1": (proof(row([(-1, 0, 1)])), "FAILED line 8: -1 is not"),
    "the time true": (proof(row([(True, 0, 1)])), "FAILED line 8: True is not"),
    "a weight of -inf": (proof(row(weight="-inf")), "FAILED line 8: unknown gauge"),
    "a cone with a limit": (proof(row(gauge="cone", limit=1)), "FAILED line 8: a cone"),
    "a cone at a price": (proof(row(gauge="cone", weight=1)), "FAILED line 8: a cone"),
    "a window before 0": (proof(mask(first=-1)), "FAILED line 8: -1 is not"),
    "a stop band of no bins": (proof(stop(bins=[])), "FAILED line 8: a stop band without"),
    "the bin -1": (proof(stop(bins=[[-1, 0]])), "FAILED line 8: -1 is not"),
    "two stop bands of a component": (proof(stop(), stop()), "FAILED line 9: a second stop"),
    # the point
    "more levels than masks": (proof(mask(), point=[0.5], levels=[1, 1]), "FAILED line 10: expected 1 rows"),
    "fewer levels than masks": (proof(mask(), point=[0.5], levels=[]), "FAILED line 10: expected 1 rows"),
    "a level of -1": (proof(mask(), point=[0.5], levels=[-1]), "FAILED line 11: 'mask' is not proven"),
    "a mask of zero that is not met": (
        proof(mask([(0, 1, 0, 0)]), point=[0.5], levels=[1]),
        "FAILED line 11: 'mask' is not proven",
    ),
    "an equation without variables that is wrong": (proof(row([], constant=1), point=[1]), "FAILED line 11: singular"),
    "a fixed state that no control moves": (proof(modes=(FIXED,), ends=(1, 1), point=[0]), "FAILED line 10: singular"),
    # the tree
    "a mode true": (proof(tree=[node(0, None, 0, [False])]), "FAILED line 10: False is not"),
    "a mode as text": (proof(tree=[node(0, None, 0, "0")]), "FAILED line 10: '0' is not"),
    "no nodes": (
        [line for line in proof(body=[], claim=("inf", "inf")) if "node" not in line],
        "FAILED line 9: expected a node",
    ),
    "children that leave out a mode at the end": (
        proof(modes=TWO, horizon=2, tree=[node(0, None, 0, [0, 1]), node(1, 0, 1, [0])], body=dual(*WEAK, node=1)),
        "FAILED line 17: the children of node 0 do not cover",
    ),
    "a child of a node with a dual": (
        proof(tree=[node(0, None, 0, [0])], body=[*dual(*REST), node(1, 0, 0, [0])]),
        "FAILED line 14: another time, or a dual",
    ),
    # the dual
    "an adjoint before 0": (proof(body=dual(REST[0], REST[1] | {"eta": [9]})), "FAILED line 13: got the fields"),
    "a region at T": (proof(body=dual(REST[0] | {"region": []}, REST[1])), "FAILED line 12: got the fields"),
    "a frequency outside of a mask": (
        proof(mask([(1, 2, 1, 1)]), body=priced(0.75)),
        "FAILED line 13: 'mask': a frequency",
    ),
    "a multiplier of a mask of nothing": (proof(mask([]), body=priced(0.5)), "FAILED line 13: 'mask': a frequency"),
    "a multiplier above its price": (
        proof(row(weight=0.25), body=dual({"multiplier": 0, "values": [0.5]}, *REST)),
        "FAILED line 13: 'row': multipliers above",
    ),
    "a multiplier below zero of a half-space": (
        proof(row(gauge="max"), body=dual({"multiplier": 0, "values": [-0.5]}, *REST)),
        "FAILED line 13: 'row': multipliers outside",
    ),
    "a multiplier at a price, without cost": (
        proof(row(weight=1), body=dual({"multiplier": 0, "values": [0.5]}, *REST, cost=0)),
        "FAILED line 13: 'row': multipliers above",
    ),
    "a curvature that is none": (proof(changes=BENT), "FAILED line 13: a Hessian is not"),
    "no cost where the optimum is": (
        proof(body=dual({"t": 1, "z": [0]}, {"t": 0, "z": [0, 0]}, cost=0)),
        "FAILED line 13: node 0 is not proven",
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_hostile_file_is_refused(name, tmp_path):
    given, words = FAILURES[name]
    verdict = check(given if isinstance(given, bytes) else text(given), tmp_path)
    assert verdict.status == 2 if words == PROOF else 1, verdict.printed
    assert verdict.last.startswith(words), verdict.printed


# name: proof, the true optimum, and the most and least that must be proven
BOUNDS = {
    "plain": (proof(), 2.25, 2.25, "inf"),
    "a name of several lines": (proof(changes={1: {"name": FORGED}}), 2.25, 2.25, "inf"),
    "half a surrogate": (proof(changes={1: {"name": "\ud800"}}), 2.25, 2.25, "inf"),
    "a mask's multiplier at its end": (proof(mask([(1, 2, 1, 1)]), body=priced(1)), 2.5, 2.4375, "inf"),
    "a mask of zero": (proof(mask([(0, 1, 0, 0)]), body=priced(0)), 4.5, 2.9375, "inf"),
    "the first of two masks over each other": (
        proof(mask([(0, 1, 2, 2), (0, 1, 1, 1)]), body=priced(0.5)),
        *(2.5, 1.9375, "inf"),
    ),
    "a mask at a single frequency": (proof(mask([(1, 1, 1, 0)]), point=[0.5], levels=[1]), 2.5, 2.25, 3.25),
    "a level below 1": (proof(mask(), point=[0.5], levels=[0.625]), 2.5, 2.25, 3.25),
    "a window of nothing": (proof(mask(window=[]), point=[0.5], levels=[1]), 2.25, 2.25, 3.25),
    "an equation of nothing": (proof(row(values=[]), point=[0.5]), 2.25, 2.25, 3.25),
    "a largest of nothing": (proof(row(values=[], gauge="max", limit=-5), point=[0.5]), 2.25, 2.25, 3.25),
    "an equation without variables": (proof(row([], constant=0), point=[0.5]), 2.25, 2.25, 3.25),
    "all is removed": (proof(stop(), point=[3]), 4.5, 2.25, 4.5),
    "all but the mean of a state is removed": (
        proof(stop(stop=0, samples=2, bins=[[1, 1]]), point=[3]),
        *(4.5, 2.25, 4.5),
    ),
    "the Nyquist bin": (
        proof(stop(samples=2, bins=[[1, 1]]), horizon=2, point=[1, 0], body=dual(*TWO_STEPS)),
        1.5,
        1.5,
        2.25,
    ),
    "a state that no control moves": (proof(modes=(FIXED,), ends=(0, 0), point=[0.5]), 4.5, 0, 4.625),
    "a half-bounded control, boxes propagated": (
        proof(changes={5: UNBOUNDED}, ends=(0, "inf"), tree=[node(0, None, 0, [0])]),
        *(2.25, 2.25, "inf"),
    ),
    "a Hessian that has no inverse": (
        proof(changes=SINGULAR, body=dual({"t": 1, "z": [0]}, {"t": 0, "z": [0, -3]})),
        3.5,
        -99,
        "inf",
    ),
    "points far outside of the bounds": (
        proof(body=dual({"t": 1, "z": [99]}, {"t": 0, "z": [7, -99]})),
        2.25,
        "-inf",
        "inf",
    ),
    "an infinite leaf beside a finite one": (
        proof(
            modes=TWO,
            horizon=2,
            changes={6: UNBOUNDED},
            tree=[node(0, None, 0, [0, 1]), node(1, 0, 0, [0]), node(2, 0, 0, [1])],
            body=[*dual(WEAK[0], WEAK[1] | {"eta": [1]}, WEAK[2], node=1), *dual(*WEAK, node=2)],
        ),
        *(1.5, "-inf", "inf"),
    ),
    "a mode that nothing reaches": (
        proof(
            modes=(SUM, UNREACHED),
            tree=[node(0, None, 0, [0, 1]), node(1, 0, 0, [1]), node(2, 1, 0, [1]), node(3, 0, 0, [0])],
            body=[*dual(*REST, node=3), *dual(*REST, node=2, cost=0), *dual(*REST, node=1)][:6],
        ),
        *(2.25, 2.25, "inf"),
    ),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_an_odd_file_proves_no_more_than_is_true(name, tmp_path):
    lines, optimum, lower, upper = BOUNDS[name]
    verdict = check(text(lines), tmp_path)
    assert verdict.interval, verdict.printed
    assert sum(line.startswith("VERIFIED") for line in verdict.printed.splitlines()) == 1
    found = [float(end) for end in verdict.interval]
    assert float(lower) - 1e-9 <= found[0] <= optimum <= found[1] <= float(upper) + 1e-9


def test_bounds_beyond_the_floats_are_printed(tmp_path):
    huge = proof(changes={4: {"linear": ["-0x1p+99999"]}}, ends=(0, 1), body=dual({"t": 1, "z": [0]}, REST[1]))
    assert check(text(huge), tmp_path).interval[0].endswith("E+30103")


def test_the_text_of_a_line_may_end_in_cr_lf(tmp_path):
    assert check(text(proof()).replace("\n", "\r\n"), tmp_path).status == 0


def test_zonotopes_do_not_grow_with_the_horizon():
    module = checker()
    lines = module.Lines(BytesIO(text(proof(horizon=module.MOST_GENERATORS + 9)).encode()))
    lines.advance()
    problem = module.Problem(lines)
    stages = module.reach(problem, [module.Stage(box[:1], {0}) for box in problem.boxes], 0, {0}, True)
    assert max(stage.zonotope[1].ncols() for stage in stages if stage.zonotope) == module.MOST_GENERATORS


def test_every_line_is_an_object(tmp_path):
    assert check(replaced(2, json.dumps([1]).encode() + b"\n"), tmp_path).last.startswith("FAILED line 3")


@pytest.mark.parametrize(("cubic", "positive"), [(-0.1, False), (0.1, True)])
def test_the_cubic_term_decides_where_a_square_touches_zero(cubic, positive):
    """(x - 1/2)^2 - x^3 / 10 is below zero at 1/2; with the other sign, it is positive from -1 to 1."""
    polynomial, one = checker().arb_poly([0.25, -1, 1, cubic]), checker().arb(1)
    assert checker().never_negative(polynomial, one) is positive
