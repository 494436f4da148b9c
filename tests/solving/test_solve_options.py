"""Every pair of a method and an option: one that a method does not know is refused, and one that it knows is not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run
from helpers.seeds import expensive
from lin_freq_ocp.solving import FAMILIES, Options, choose_method

PROBLEMS = {
    "linear": lfo.library.double_integrator(),
    "piecewise-affine": lfo.library.absolute_value(),
    "piecewise-smooth": lfo.library.norm_dynamics(),
    "pulse-train": lfo.library.pulse_pattern(kind="opp"),
}

OPTIONS = {
    "backend": "osqp",
    "tolerance": 1e-4,
    "gap": 1e-4,
    "node_limit": 3,
    "executor": ThreadPoolExecutor(1),
    "start": np.zeros((3, 1)),
    "global_bound": False,
}

TAKEN = {
    ("linear", "auto"): {"backend", "tolerance"},
    ("linear", "spectral"): {"tolerance"},
    ("linear", "structured"): {"tolerance"},
    ("linear", "convex"): {"backend", "tolerance"},
    ("frequency-response", "auto"): {"backend", "tolerance"},
    ("frequency-response", "spectral"): {"tolerance"},
    ("frequency-response", "convex"): {"backend", "tolerance"},
    ("piecewise-affine", "auto"): {"tolerance", "gap", "node_limit", "executor", "start"},
    ("piecewise-affine", "branch_and_bound"): {"tolerance", "gap", "node_limit", "executor", "start"},
    ("piecewise-affine", "enumerate"): {"tolerance", "gap", "node_limit"},
    ("piecewise-affine", "miqp"): {"backend", "tolerance", "gap", "node_limit"},
    ("piecewise-smooth", "auto"): {"tolerance", "gap", "start", "global_bound"},
    ("piecewise-smooth", "nonsmooth"): {"start"},
    ("pulse-train", "auto"): {"tolerance", "gap", "start"},
    ("pulse-train", "angles"): {"tolerance", "gap", "start"},
    ("pulse-train", "nonsmooth"): {"start"},
}

METHODS = sorted({method for _, method in TAKEN})

OBJECTS = {
    "spectral": lfo.solvers.Spectral(tolerance=1e-4),
    "structured": lfo.solvers.Structured(tolerance=1e-4),
    "convex": lfo.solvers.Convex(backend="osqp", tolerance=1e-4),
    "angles": lfo.solvers.Angles(gap=1e-4),
    "branch_and_bound": lfo.solvers.BranchAndBound(gap=1e-4, node_limit=3),
    "enumerate": lfo.solvers.Enumeration(gap=1e-4, node_limit=3),
    "miqp": lfo.solvers.MixedInteger(backend="daqp", gap=1e-4, node_limit=3),
}


def test_the_table_knows_every_method():
    assert set(TAKEN) == {(family.kind, name) for family in FAMILIES.values() for name in family.shorthands}


@pytest.mark.parametrize("kind", PROBLEMS)
@pytest.mark.parametrize("method", METHODS)
def test_an_option_is_taken_or_refused(kind, method):
    for option, value in OPTIONS.items():
        if (kind, method) not in TAKEN:
            words = f"method: got '{method}', which is for .* dynamics; expected"
        elif option not in TAKEN[kind, method]:
            words = f"{option}: got .* for the method '{method}' and {kind}"
        else:
            found = choose_method(PROBLEMS[kind], Options(method, **{option: value}))
            fields = {"tolerance": ("tolerance", "gap"), "start": ()}.get(option, (option,))
            assert not fields or value in {getattr(found, name, None) for name in fields}
            continue
        with pytest.raises(lfo.errors.UnsupportedError, match=words):
            choose_method(PROBLEMS[kind], Options(method, **{option: value}))


@pytest.mark.parametrize("kind", PROBLEMS)
@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_is_its_shorthand_with_keywords(kind, name):
    if (kind, name) not in TAKEN:
        with pytest.raises(lfo.errors.UnsupportedError, match=f"method: got '{name}', which is for"):
            choose_method(PROBLEMS[kind], Options(OBJECTS[name]))
        return
    options = {option: value for option in OPTIONS if (value := getattr(OBJECTS[name], option, None)) is not None}
    assert (
        choose_method(PROBLEMS[kind], Options(name, **options))
        == choose_method(PROBLEMS[kind], Options(OBJECTS[name]))
        == OBJECTS[name]
    )


def test_options_beside_an_object_are_refused():
    with pytest.raises(
        lfo.errors.UnsupportedError, match=r"tolerance: got 0.1 with .* belong to it: lfo.solvers.Convex\(...\)"
    ):
        lfo.solve(PROBLEMS["linear"], lfo.solvers.Convex(), tolerance=0.1)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"gap: got 0.1 without a global bound"):
        lfo.solvers.Nonsmooth(global_bound=False, gap=0.1)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"gap: got a gap and a tolerance"):
        lfo.solve(PROBLEMS["piecewise-affine"], tolerance=0.1, gap=0.1)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"method: got 3; expected a text"):
        lfo.solve(PROBLEMS["linear"], 3)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"'minlp', which is no method any more: .*verify/nonsmooth"):
        lfo.solve(PROBLEMS["piecewise-smooth"], "minlp")


@pytest.mark.parametrize(
    ("method", "saved"),
    [
        (lfo.solvers.Convex(tolerance=1e-7), {"method": "convex", "backend": "auto", "tolerance": 1e-7}),
        ("spectral", {"method": "spectral", "backend": "auto", "tolerance": None}),
    ],
)
def test_a_result_knows_the_options_that_repeat_it(method, saved):
    problem = PROBLEMS["linear"]
    assert lfo.solve(problem, method).options == {**saved, "time_limit": None}
    searched = lfo.solve(PROBLEMS["piecewise-affine"], replace(lfo.solvers.BranchAndBound(), node_limit=500)).options
    assert searched["node_limit"] == 500
    assert searched["method"] in ("auto", "branch_and_bound")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("pendulum", "--node-limit", "3"), "only a search over affine modes"),
        (("norm_dynamics", "--method", "nonsmooth", "--tolerance", "1e-3"), "'auto' does"),
        (("absolute_value", "--backend", "osqp"), "Leave it out"),
        (("pendulum", "--local"), "only 'auto' over smooth pieces"),
    ],
)
def test_the_command_line_refuses_as_well(arguments, words):
    status, out, err = run("solve", *arguments, "--json")
    assert (status, out) == (2, "")
    assert words in err


@pytest.mark.parametrize(
    "arguments",
    [
        ("absolute_value", "--node-limit", "100", "--tolerance", "1e-4"),
        ("absolute_value", "--method", "enumerate", "--tolerance", "1e-4", "--node-limit", "100"),
        ("double_integrator", "--method", "spectral", "--tolerance", "1e-9", "--time-limit", "60"),
        ("pendulum", "--method", "convex", "--backend", "osqp", "--tolerance", "1e-8"),
    ],
)
def test_an_option_that_a_method_knows_is_taken(arguments):
    assert run("solve", *arguments)[0] == 0


@expensive
def test_a_local_answer_is_repeated_from_its_file(tmp_path):
    result = lfo.solve(lfo.library.pendulum_swing_up(horizon=20, sampling_time=0.2), global_bound=False)
    result.dump(tmp_path / "run.zip")
    saved = lfo.load_run(tmp_path / "run.zip")
    assert saved.options["global_bound"] is False
    assert saved.solve().cost == result.cost
    assert lfo.solve(result.problem, lfo.solvers.Nonsmooth(global_bound=False)).options == result.options
    with pytest.raises(lfo.errors.UnsupportedError, match="global_bound: got 'no'; expected True or False"):
        lfo.solve(result.problem, global_bound="no")
