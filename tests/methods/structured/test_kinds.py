"""One problem of every kind by the structured method, compiled and not, judged."""

from __future__ import annotations

from dataclasses import replace

import pytest

import lin_freq_ocp as lfo
from helpers.instances.statements import STATEMENTS
from helpers.linear_kinds import KINDS, infeasible
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.methods import SolveOptions
from lin_freq_ocp.methods.structured import can_compile, solve_structured


@pytest.fixture(params=["compiled", "plain"])
def compiled(request):
    if request.param == "compiled" and not can_compile():
        pytest.skip("no C compiler")
    return request.param == "compiled"


@pytest.mark.parametrize("kind", seeds([*KINDS, "variation of the controls"]))
def test_every_kind_is_solved(kind, compiled):
    problem = STATEMENTS[kind]()
    found = next(solve_structured(problem, SolveOptions(compiled=compiled)))
    assert found.status == "optimal"
    certificate = lfo.certify(problem, found.trajectory, found.multipliers)
    assert certificate.globally_optimal
    assert certificate.pmp == "satisfied"
    known = lfo.solve(problem, method="convex").cost
    assert problem.value(found.trajectory.x, found.trajectory.u) == pytest.approx(known, rel=1e-8)


@pytest.mark.parametrize(
    "kind", ["boxes", "cones", "bands", "masks", "rows", "fixed controls", "rows of fixed controls"]
)
def test_every_kind_of_ray_proves(kind, compiled):
    problem = infeasible(kind)
    found = next(solve_structured(problem, SolveOptions(compiled=compiled)))
    assert found.status == "infeasible"
    assert prove_infeasible(problem, found.ray) is not None


@expensive
@pytest.mark.parametrize("further", [0.0, 7e-6])
def test_an_end_that_is_just_out_of_reach_is_no_fault(further, compiled):
    """Its ray excludes by a margin of rounding, so that nobody believes it; the iteration ends all the same."""
    reached = [0.692307717524814, -0.0923076847425558]  # of [1, 0], as near as the low pass lets it come
    problem = replace(
        lfo.library.double_integrator(cutoff_hz=0.3),
        terminal_state=lfo.Box([reached[0] + further, reached[1]], [2 - reached[0], -reached[1]]),
    )
    found = next(solve_structured(problem, SolveOptions(compiled=compiled), lambda ray: False))
    assert found.status in ("infeasible", "numerical_error")
