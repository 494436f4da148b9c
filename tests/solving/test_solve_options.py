"""An option of solve that a method does not know is refused, and one that it knows is not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run

REFUSED = [
    (("pendulum",), ("--node-limit", "3"), "node_limit: got 3", "only a search over affine modes"),
    (("pendulum", "--method", "convex"), ("--node-limit", "3"), "node_limit: got 3", "'convex' and linear dynamics"),
    (("norm_dynamics",), ("--node-limit", "3"), "node_limit: got 3", "piecewise-smooth dynamics"),
    (("norm_dynamics", "--method", "minlp"), ("--node-limit", "3"), "node_limit: got 3", "'minlp'"),
    (("norm_dynamics", "--method", "nonsmooth"), ("--tolerance", "1e-3"), "tolerance: got 0.001", "'auto' does"),
    (("absolute_value",), ("--backend", "osqp"), "backend: got 'osqp'", "leave it 'auto'"),
    (("pendulum", "--method", "spectral"), ("--backend", "osqp"), "backend: got 'osqp'", "leave it 'auto'"),
]


@pytest.mark.parametrize(("command", "option", "words", "reason"), REFUSED)
def test_an_option_that_a_method_does_not_know_is_refused(command, option, words, reason):
    status, out, err = run("solve", *command, *option, "--json")
    assert (status, out) == (2, "")
    assert words in err
    assert reason in err


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


def test_an_executor_is_for_branch_and_bound_only():
    with ThreadPoolExecutor(1) as executor:
        for problem, method in (
            (lfo.library.double_integrator(), "auto"),
            (lfo.library.norm_dynamics(), "auto"),
            (lfo.library.absolute_value(), "enumerate"),
        ):
            with pytest.raises(lfo.UnsupportedError, match=r"executor: got one .* only 'branch_and_bound'"):
                lfo.solve(problem, method=method, executor=executor)
