"""What Python lets a new class leave out: each class declares it, or has a reason here.

docs/source.md lists these steps. A class that leaves one out works, and is slower, hidden or less exact than need be.
"""

from __future__ import annotations

import pytest

import lin_freq_ocp as lfo
from helpers.instances import classes_of
from helpers.instances.methods import METHODS, PROBLEMS
from lin_freq_ocp.certificate import JUDGES
from lin_freq_ocp.files import RECORDS
from lin_freq_ocp.problem import AffineMap, ConvexSet, Dynamics, FrequencyConstraint, NonsmoothCost, Penalty
from lin_freq_ocp.solving import FAMILIES, Options, choose_method, family_of, saved_options

USER = "users do not state it"

BATCHES = {  # the judge of many plans takes the other terms at once
    "LargestExcess": "its judge looks at the frequencies between the samples of each trajectory",
    "NormRows": "the batch judge is for boxes, rows and bands",
    "NormBall": "the batch judge is for boxes, rows and bands",
    "StandardCone": "the batch judge is for boxes, rows and bands",
    "Within": "the batch judge is for boxes, rows and bands",
}
BATCHES_OF_MAPS = dict.fromkeys(
    ("FormulaMap", "FrequencyMap", "JoinedMap", "SpectrumMap", "SumMap", "VibrationMap", "ZeroOrderHoldMap"),
    "the batch judge is for values of single times",
)
ONE_PENALTY_A_TIME = {
    "LargestExcess": "its value belongs to all frequencies at once",
    "NormRows": "its norms belong to all times at once",
    "Within": "its set, a user's class, may be another one at each time",
}
NO_PRICE_OF_LIMITS = {
    "NormRows": "its limits are those of other fields, less margins",
    "StandardCone": "its bound is a part of the values",
    "Within": "its set, a user's class, says nothing of its limits",
}
SLOW_MAPS = {
    "FormulaMap": "it is not affine",
    "FrequencyMap": "its frequencies are no bins of the record",
    "JoinedMap": "its parts have other forms",
    "SumMap": "its parts have other forms",
    "VibrationMap": "its modes are no bins of the record",
    "ZeroOrderHoldMap": "its frequencies reach above the Nyquist frequency",
}
WITHOUT_FREQUENCIES = {
    "FormulaMap": "its values belong to times",
    "JoinedMap": "its values belong to times and bins",
    "StageMap": "its values belong to times",
    "SumMap": "a sum over times has no frequency",
}
WITHOUT_CONSTANTS = {
    "FormulaMap": "it is not affine",
    "FrequencyMap": "it has no past",
    "JoinedMap": "no loop has it",
    "StageMap": "its rows are computed in a moment",
    "SumMap": "its rows are computed in a moment",
    "VibrationMap": "it has no past",
    "ZeroOrderHoldMap": "it has no past",
}
WITHOUT_LEVELS = {
    "Band": "what it removes is zero",
    "DiscLimits": "its limits are those of other fields, less margins",
    "DiscMask": "its limits are those of other fields, less margins",
    "Harmonics": "its limits are those of the bounds that it makes",
    "LinearConstraint": "its right-hand side is no limit of a size",
}
NOT_EXPORTED = {
    "AffineNorms": USER,
    "DiscLimits": "lfo.robust makes it",
    "DiscMask": "lfo.robust makes it",
    "Band": "low_pass, high_pass, band_pass, notch and stop_band make it",
    "Harmonics": "MagnitudeBound makes it from ``harmonics``",
    "PartSet": USER,
}
WITHOUT_ENTRY = {  # in FAMILIES, JUDGES and the records of files
    "ModesWithCost": "a reformulation makes it; its base class has the entries",
    "StandardDynamics": "a base class",
    "SwitchedDynamics": "it is solved, judged and written as the piecewise-affine dynamics that it is",
}
JUDGED_AS_MODES = {"PulseTrain": "its standard form has modes, by which it is judged"}
OPTIONS = {"tolerance": 1e-5, "gap": 1e-3, "node_limit": 7, "global_bound": False, "backend": "osqp"}
OF_PROCESSES = {"executor"}  # no file has a pool of processes


def declared(kind: type, name: str, protocol: type) -> bool:
    return getattr(kind, name) is not getattr(protocol, name)


def without(protocol: type, declares) -> set[str]:
    return {kind.__name__ for kind in classes_of(protocol) if not declares(kind)}


@pytest.mark.parametrize(
    ("protocol", "declares", "reasons"),
    [
        (Penalty, lambda kind: kind.takes_batches, BATCHES),
        (Penalty, lambda kind: kind.stackable, ONE_PENALTY_A_TIME),
        (Penalty, lambda kind: declared(kind, "limit_multipliers", Penalty), NO_PRICE_OF_LIMITS),
        (AffineMap, lambda kind: kind.takes_batches, BATCHES_OF_MAPS),
        (
            AffineMap,
            lambda kind: declared(kind, "spectrum_form", AffineMap) or declared(kind, "stage_form", AffineMap),
            SLOW_MAPS,
        ),
        (AffineMap, lambda kind: declared(kind, "spectrum", AffineMap), WITHOUT_FREQUENCIES),
        (AffineMap, lambda kind: kind.constants, WITHOUT_CONSTANTS),
        (FrequencyConstraint, lambda kind: declared(kind, "at_levels", FrequencyConstraint), WITHOUT_LEVELS),
        (FrequencyConstraint, lambda kind: declared(kind, "augmented", FrequencyConstraint), {}),
    ],
    ids=[
        "batches",
        "stackable",
        "price of limits",
        "batches of maps",
        "forms",
        "frequencies",
        "constants",
        "levels",
        "further states",
    ],
)
def test_a_class_declares_it_or_has_a_reason(protocol, declares, reasons):
    assert without(protocol, declares) == set(reasons)


def test_classes_that_users_state_are_exported():
    rooms = {ConvexSet: lfo.sets, NonsmoothCost: lfo.costs, FrequencyConstraint: lfo.spectrum}
    hidden = {
        kind.__name__ for one, room in rooms.items() for kind in classes_of(one) if kind.__name__ not in room.__all__
    }
    assert hidden == set(NOT_EXPORTED)


@pytest.mark.parametrize(
    ("table", "reasons"),
    [(FAMILIES, WITHOUT_ENTRY), (JUDGES, WITHOUT_ENTRY | JUDGED_AS_MODES), (RECORDS, WITHOUT_ENTRY)],
    ids=["FAMILIES", "JUDGES", "RECORDS"],
)
def test_dynamics_have_an_entry_or_a_reason(table, reasons):
    assert {kind.__name__ for kind in classes_of(Dynamics) - set(table)} == set(reasons)


@pytest.mark.parametrize(("kind", "method"), [(kind, name) for kind, name in METHODS if kind != "bilinear"])
def test_an_option_of_a_method_is_saved(kind, method):
    """A run that is repeated from its file has the same method, with the same options."""
    problem, shorthand = PROBLEMS[kind][0], family_of(PROBLEMS[kind][0]).shorthands[method]
    for option in set(shorthand.options) - OF_PROCESSES:
        value = "daqp" if method == "miqp" and option == "backend" else OPTIONS[option]
        stated = Options(method, **{option: value})
        chosen = choose_method(problem, stated)
        saved = saved_options(problem, stated, chosen)
        assert choose_method(problem, Options(**saved)) == chosen != shorthand.method


def test_benchmark_problems_belong_to_a_field():
    assert set(" ".join(lfo.library.FIELDS.values()).split()) == set(lfo.library.PROBLEMS)
