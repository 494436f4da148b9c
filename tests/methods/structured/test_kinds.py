"""One problem of every kind by the structured method, judged."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS, infeasible
from lin_freq_ocp.certificate.conflict import prove_infeasible
from lin_freq_ocp.methods.structured.algorithm.embedding import End, Targets
from lin_freq_ocp.methods.structured.algorithm.exchange import solve_with_exchange
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.methods.structured.kkt.reduction import StepSystem
from lin_freq_ocp.methods.structured.kkt.stopped_side import StoppedSide
from lin_freq_ocp.methods.structured.model.assembly import stages_of


def solved(problem):
    assembly, numpy_loops = stages_of(problem), loops(compiled=False)

    def step_system(system):
        return StepSystem(system, StoppedSide(system.stages, numpy_loops), numpy_loops)

    return assembly.recovery, solve_with_exchange(assembly.stages, step_system, Targets(), lambda z: False)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_solved(kind):
    problem = KINDS[kind]()
    recovery, answer = solved(problem)
    assert answer.end is End.OPTIMAL
    trajectory = recovery.trajectory(answer.y)
    assert lfo.certify(problem, trajectory, recovery.multipliers(answer.z, 1.0)).globally_optimal
    known = lfo.solve(problem, method="convex").cost
    assert problem.value(trajectory.x, trajectory.u) == pytest.approx(known, rel=1e-8)
    assert np.isfinite(trajectory.x).all()


@pytest.mark.parametrize("kind", ["boxes", "cones", "bands", "masks", "rows"])
def test_every_kind_of_ray_proves(kind):
    problem = infeasible(kind)
    recovery, answer = solved(problem)
    assert answer.end is End.INFEASIBLE
    assert prove_infeasible(problem, recovery.multipliers(answer.z, 0.0)) is not None
