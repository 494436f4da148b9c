"""Proofs by hand that are right, and the same with a fault: the checker names the line."""

import json

import pytest

from helpers import hand_proofs
from helpers.hand_proofs import check, text

BASES = {
    "double integrator": hand_proofs.double_integrator,
    "two modes": hand_proofs.two_modes,
    "infeasible": hand_proofs.infeasible,
}
ULP = 2.0**-52


def number_of(lines, **what):
    """Return the index of the line with these entries."""
    found = [index for index, line in enumerate(lines) if what.items() <= line.items()]
    assert len(found) == 1, (what, found)
    return found[0]


class Fault:
    """A change of the line that has certain entries: fields set, or the line left out, twice, or a text instead."""

    def __init__(self, base, where, line=None, status=1, **fields):
        self.base, self.where, self.line, self.status, self.fields = base, where, line, status, fields

    def spoiled(self):
        """Return the text of the proof with its fault, and the line (from 1) at which it is found."""
        lines = BASES[self.base]()
        index = number_of(lines, **self.where)
        if "drop" in self.fields:
            del lines[index]
        elif "insert" in self.fields:
            lines.insert(index, self.fields["insert"])
        elif "replace" in self.fields:
            lines[index] = self.fields["replace"]
        elif "without" in self.fields:
            del lines[index][self.fields["without"]]
        else:
            lines[index] = lines[index] | self.fields
        found = index if self.line is None else number_of(BASES[self.base](), **self.line)
        return text(lines), found + 1


STAGE_0 = {"cost": "stage"}
LAST_CONTROL = {"t": 3, "u": ["-0x1ffffffffffp-40"]}
FIRST_BOUNDS = {"bounds": "stage", "lower": ["0x0p+0", "0x0p+0", "-0x2p+0"]}
SECOND_BOUNDS = {"bounds": "stage", "lower": ["-inf", "-inf", "-0x2p+0"]}
CLAIM = {"section": "claim"}
INTEGRATOR, MODES, RAY = BASES
END = {"section": "end"}
FAULTS = {
    # lines and their syntax
    "an unknown key": Fault(INTEGRATOR, {"t": 2, "u": ["-0x10000000003p-40"]}, v=1),
    "a missing key": Fault(INTEGRATOR, {"bounds": "end"}, without="upper"),
    "a repeated key": Fault(
        INTEGRATOR, {"bounds": "end"}, replace='{"bounds": "end", "bounds": "end", "lower": [], "upper": []}\n'
    ),
    "NaN": Fault(
        INTEGRATOR, {"bounds": "end"}, replace='{"bounds": "end", "lower": [NaN, "0x0"], "upper": ["0x7", "0x0"]}\n'
    ),
    "nan as text": Fault(INTEGRATOR, {"bounds": "end"}, lower=["nan", "0x0p+0"]),
    "1e308": Fault(
        INTEGRATOR, {"bounds": "end"}, replace='{"bounds": "end", "lower": [-1e308, "0x0"], "upper": ["0x7", "0x0"]}\n'
    ),
    "1e308 as text": Fault(INTEGRATOR, {"bounds": "end"}, upper=["1e308", "0x0p+0"]),
    "a decimal number": Fault(INTEGRATOR, {"bounds": "end"}, upper=["7.0", "0x0p+0"]),
    "an integer for a real number": Fault(
        INTEGRATOR, {"bounds": "end"}, replace='{"bounds": "end", "lower": [7, "0x0"], "upper": ["0x7", "0x0"]}\n'
    ),
    "a number in pieces": Fault(INTEGRATOR, {"bounds": "end"}, upper=["0x7p+0 ", "0x0p+0"]),
    "an exponent beyond all": Fault(INTEGRATOR, {"bounds": "end"}, upper=["0x7p+99999999999", "0x0p+0"]),
    "true for a time": Fault(INTEGRATOR, {"section": "problem"}, horizon=True),
    "a list": Fault(INTEGRATOR, {"bounds": "end"}, replace="[]\n"),
    "no JSON": Fault(INTEGRATOR, {"bounds": "end"}, replace='{"bounds": \n'),
    "an empty line": Fault(INTEGRATOR, {"bounds": "end"}, insert="\n"),
    # the problem
    "too few numbers": Fault(INTEGRATOR, {"bounds": "end"}, lower=[]),
    "a time beyond the horizon": Fault(INTEGRATOR, SECOND_BOUNDS, FIRST_BOUNDS, **{"from": 4}),
    "times that do not rise": Fault(INTEGRATOR, SECOND_BOUNDS, FIRST_BOUNDS, **{"from": 0}),
    "a first time that is not 0": Fault(INTEGRATOR, STAGE_0, {"mode": 0, "d": ["0x0p+0", "0x0p+0"]}, **{"from": 1}),
    "bounds that are empty": Fault(INTEGRATOR, {"bounds": "end"}, lower=["0x8p+0", "0x0p+0"]),
    "no states": Fault(INTEGRATOR, {"section": "problem"}, states=[]),
    "a horizon of zero": Fault(INTEGRATOR, {"section": "problem"}, horizon=0),
    "a fractional number of samples": Fault(
        INTEGRATOR, CLAIM, insert='{"stop": 2, "samples": "4.0", "bins": [[2, 2]]}\n'
    ),
    "a Hessian that is not symmetric": Fault(
        INTEGRATOR, {"cost": "end"}, LAST_CONTROL, hessian=[["0x1p+0", "0x1p-9"], ["0x0p+0", "0x1p+0"]]
    ),
    "a Hessian that is not convex": Fault(
        INTEGRATOR, {"cost": "end"}, LAST_CONTROL, hessian=[["0x1p+0", "0x3p+0"], ["0x3p+0", "0x1p+0"]]
    ),
    "a concave direction": Fault(MODES, STAGE_0, {"t": 0, "u": [0.5]}, hessian=[[-1e-300, 0], [0, 1]]),
    "a stop band beyond its bins": Fault(
        INTEGRATOR, {"section": "claim"}, insert='{"stop": 2, "samples": 4, "bins": [[2, 3]]}\n'
    ),
    "a stop band of no component": Fault(
        INTEGRATOR, {"section": "claim"}, insert='{"stop": 3, "samples": 4, "bins": [[2, 2]]}\n'
    ),
    "a stop band of too many samples": Fault(
        INTEGRATOR, {"section": "claim"}, insert='{"stop": 2, "samples": 5, "bins": [[2, 2]]}\n'
    ),
    # claim and order
    "a claim above": Fault(INTEGRATOR, {"section": "claim"}, END, lower="0x5000000001p-36"),
    "a claim below the point": Fault(INTEGRATOR, {"section": "claim"}, END, upper="0x5p+0"),
    "a claim without its end": Fault(INTEGRATOR, {"section": "claim"}, without="upper"),
    "a claim of infeasibility": Fault(INTEGRATOR, {"section": "claim"}, END, lower="inf", upper="inf"),
    "a claim of a value without one": Fault(RAY, {"section": "claim"}, END, lower=0, upper=1),
    "no point": Fault(INTEGRATOR, {"section": "point"}, CLAIM, drop=True),
    "a stage of the point left out": Fault(INTEGRATOR, {"t": 2, "u": ["-0x10000000003p-40"]}, drop=True),
    "a stage of the point twice": Fault(
        INTEGRATOR, {"t": 2, "u": ["-0x10000000003p-40"]}, LAST_CONTROL, insert={"t": 2, "u": [-1], "mode": 0}
    ),
    "no dual": Fault(INTEGRATOR, {"section": "dual"}, {"node": 0, "t": 0}, drop=True),
    "the end before the end": Fault(INTEGRATOR, {"section": "nodes"}, LAST_CONTROL, insert='{"section": "end"}\n'),
    "something after the end": Fault(INTEGRATOR, END, insert='{"section": "end"}\n'),
    # the point
    "a control beyond its bound by a last digit": Fault(MODES, {"t": 0, "u": [0.5]}, u=[4 + 4 * ULP]),
    "x_0 outside of its bounds by a last digit": Fault(MODES, {"section": "point"}, {"t": 0, "u": [0.5]}, x=[1 + ULP]),
    "x_0 that is not the given x_0": Fault(INTEGRATOR, {"section": "point"}, LAST_CONTROL, x=["0x1p-99", "0x0p+0"]),
    "a point in the region of another mode": Fault(MODES, {"t": 0, "u": [0.5]}, mode=0),
    "a mode that does not exist": Fault(MODES, {"t": 0, "u": [0.5]}, mode=2),
    # nodes
    "a leaf left out": Fault(MODES, {"node": 2, "parent": 0}, {"t": 0, "z": [0, 1.5]}, drop=True),
    "children that do not cover": Fault(MODES, {"node": 2, "parent": 0}, {"t": 0, "z": {"1": [1, 0.5]}}, modes=[0]),
    "a node twice": Fault(MODES, {"node": 2, "parent": 0}, node=1),
    "a node before its parent": Fault(MODES, {"node": 1, "parent": 0}, parent=2),
    "its own parent": Fault(MODES, {"node": 1, "parent": 0}, parent=1),
    "children at two times": Fault(MODES, {"node": 2, "parent": 0}, t=1),
    "a mode of a node that does not exist": Fault(MODES, {"node": 2, "parent": 0}, modes=[2]),
    "no modes": Fault(MODES, {"node": 2, "parent": 0}, {"t": 0, "z": {"1": [1, 0.5]}}, modes=[]),
    "the dual of an inner node": Fault(MODES, {"section": "dual", "node": 2}, node=0),
    "two duals of a leaf": Fault(MODES, {"section": "dual", "node": 2}, node=1),
    "a dual of no node": Fault(MODES, {"section": "dual", "node": 2}, node=3),
    # duals
    "a cost of two": Fault(MODES, {"section": "dual", "node": 2}, cost=2),
    "a ray where the optimum is": Fault(MODES, {"section": "dual", "node": 2}, {"t": 0, "z": {"1": [1, 0.5]}}, cost=0),
    "a ray with the wrong sign": Fault(RAY, {"t": 2, "z": [3]}, {"t": 0, "z": [0, 1]}, mu=[1]),
    "a ray of zero": Fault(RAY, {"t": 2, "z": [3]}, {"t": 0, "z": [0, 1]}, mu=[0]),
    "a ray that is too weak": Fault(RAY, {"bounds": "end"}, {"t": 0, "z": [0, 1]}, lower=[2], upper=[2]),
    "an adjoint that an unbounded state does not forgive": Fault(
        INTEGRATOR, {"t": 2, "z": ["0x2p+0", "0x3p+0", "-0x1p+0"]}, END, eta=["0x2p+0", "0x1000001p-24"]
    ),
    "the end's adjoint changed": Fault(
        INTEGRATOR, {"t": 4, "z": ["0x7p+0", "0x0p+0"]}, END, mu=["-0x2000000001p-36", "0x3p+0"]
    ),
    "a stage of a dual left out": Fault(MODES, {"t": 1, "z": [2.5]}, drop=True),
    "stages that rise": Fault(MODES, {"t": 1, "z": [2.5]}, t=0),
    "a point of too few numbers": Fault(MODES, {"t": 0, "z": [0, 1.5]}, z=[0]),
    "a region's multiplier below zero": Fault(MODES, {"t": 0, "z": [0, 1.5]}, region={"0": [-1]}),
    "an infinite multiplier": Fault(INTEGRATOR, {"t": 4, "z": ["0x7p+0", "0x0p+0"]}, mu=["-inf", "0x3p+0"]),
    "an infinite point": Fault(MODES, {"t": 1, "z": [2.5]}, z=["inf"]),
    "a multiplier of no stop band": Fault(
        INTEGRATOR,
        {"t": 4, "z": ["0x7p+0", "0x0p+0"]},
        insert='{"signal": 2, "values": ["0x1p+0", "0x0p+0", "0x0p+0", "0x0p+0"]}\n',
    ),
    "multipliers of vertices at the end": Fault(MODES, {"t": 1, "z": [2.5]}, vertex={"0": [-0.125]}),
    "multipliers of vertices at the start": Fault(MODES, {"t": 0, "z": {"1": [1, 0.5]}}, vertex={"1": [0.5]}),
    "a multiplier of no term": Fault(
        INTEGRATOR, {"t": 4, "z": ["0x7p+0", "0x0p+0"]}, insert='{"multiplier": 0, "values": ["0x1p+0"]}\n'
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_and_its_line_is_named(name, tmp_path):
    spoiled, line = FAULTS[name].spoiled()
    verdict = check(spoiled, tmp_path)
    assert (verdict.status, verdict.last.split(":")[0]) == (FAULTS[name].status, f"FAILED line {line}"), verdict.printed


@pytest.mark.parametrize(("name", "words"), [(INTEGRATOR, "VERIFIED"), (MODES, "VERIFIED"), (RAY, "INFEASIBLE")])
def test_the_proofs_by_hand_are_right(name, words, tmp_path):
    verdict = check(text(BASES[name]()), tmp_path)
    assert (verdict.status, verdict.last.split()[0]) == (0, words), verdict.printed


def test_the_double_integrator_costs_five(tmp_path):
    lower, upper = check(hand_proofs.DOUBLE_INTEGRATOR.read_text(), tmp_path).interval
    assert 5 - 1e-15 < float(lower) <= 5 <= float(upper) < 5 + 2.0**-38


@pytest.mark.parametrize("base", BASES)
def test_a_proof_that_ends_early_is_refused(base, tmp_path):
    whole = text(BASES[base]())
    lines = whole.splitlines(keepends=True)
    for kept in ["".join(lines[:index]) for index in range(len(lines))] + [whole[:-1], whole[: len(whole) // 2]]:
        assert check(kept, tmp_path).status != 0, kept[-100:]


def test_a_line_that_is_too_long_is_refused_without_reading_it(tmp_path, monkeypatch):
    monkeypatch.setattr(hand_proofs.checker(), "LONGEST_LINE", 2**20)
    path = tmp_path / "long.proof"
    with path.open("wb") as file:
        file.write(text(BASES[INTEGRATOR]()[:1]).encode())
        file.seek(2**31)
        file.write(b"\n")  # a line of 2 GB that takes no room on the disk
    verdict = hand_proofs.check_file(path)
    assert verdict.status in (1, 2)
    assert "long" in verdict.last


@pytest.mark.parametrize("given", [b"", b"\n", b"\xff\xfe", b"{}\n", b"null\n", b"[" * 900 + b"\n"])
def test_what_is_no_proof_is_said_to_be_none(given, tmp_path):
    assert check(given, tmp_path).status == 2


def test_the_hash_is_of_the_problem_alone(tmp_path):
    def printed_hash(lines):
        found = [line for line in check(text(lines), tmp_path).printed.splitlines() if "sha256" in line.lower()]
        assert len(found) == 1
        return found[0]

    lines = BASES[MODES]()
    first = printed_hash(lines)
    other = json.loads(json.dumps(lines))
    other[number_of(other, section="nodes")]["reach"] = True
    other[number_of(other, section="point")]["x"] = [0.75]
    assert printed_hash(other) == first
    other[number_of(other, section="problem")]["name"] = "another"
    assert printed_hash(other) != first
