"""Small problems by compiled code against the embedding."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="the extra fast is not installed")

from lin_freq_ocp.methods.structured.algorithm.embedding import End
from lin_freq_ocp.methods.structured.algorithm.small import is_small, solve_small
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.methods.structured.kkt.system import EQUATIONS, INITIAL, STAGES, System
from lin_freq_ocp.methods.structured.model.coupling import Coupling, Equations, Inequalities, SpectrumRows
from lin_freq_ocp.methods.structured.model.stages import Stages


def stages(seed, tight=1.0, free=False):
    """Random dynamics with boxes, joint rows, a cone, a partly fixed end, and a stop band on the first control."""
    rng = np.random.default_rng(seed)
    T, n, k = int(rng.integers(8, 20)), int(rng.integers(1, 4)), int(rng.integers(1, 3))
    A, B, d = np.zeros((T + 1, n, n)), np.zeros((T + 1, n, k)), np.zeros((T + 1, n))
    A[:-1] = np.eye(n) + 0.2 * rng.standard_normal((T, n, n))
    B[:-1], d[:-1] = 0.5 * rng.standard_normal((T, n, k)), 0.02 * rng.standard_normal((T, n))
    H = np.tile(np.diag([1.0] * n + [0.1] * k), (T + 1, 1, 1))
    H[-1, n:, n:] = np.eye(k)
    h = 0.3 * rng.standard_normal((T + 1, n + k))
    h[-1, n:] = 0.0
    G = np.concatenate([np.eye(n + k), -np.eye(n + k), rng.standard_normal((1, n + k)), np.zeros((3, n + k))])
    G[-3, n], G[-2, 0], G[-1, -1] = -0.5, -1.0, -1.0
    g = np.full((T + 1, len(G)), np.inf)
    g[1:, :n] = g[1:, n + k : 2 * n + k] = 4 * tight
    g[:-1, n : n + k] = g[:-1, 2 * n + k : 2 * n + 2 * k] = 2 * tight
    g[2:-1, -4] = 3 * tight
    g[3:-2, -3:] = [4 * tight, 0.1, -0.1]
    band = SpectrumRows(np.ones(1), np.ones(T), T, np.array([T // 2 - 1]), np.ones(1), np.ones(2, dtype=bool))
    coupling = Coupling(np.array([n]), np.arange(n)[:1], np.zeros(1), (Equations(band, np.zeros(2)),))
    initial = np.where(np.arange(n) > 0, np.nan, 1.0) if free else 0.5 * rng.standard_normal(n)
    return Stages(A, B, d, H, h, np.tile(G, (T + 1, 1, 1)), g, (3,), initial, coupling, 5.0)


def errors(problem, y, z):
    """Residuals of the rows and of the stationarity, and how far duals leave the cone, from System."""
    system = System(problem, loops(False))
    s = [right - rows for right, rows in zip(system.b, system.rows(y), strict=True)]
    dual = system.curvature(y) + system.adjoint(z) + problem.h
    cone = system.cones[STAGES]
    outside = min(0.0, cone.margin(s[STAGES]), cone.margin(z[STAGES]))
    return max(*(np.abs(s[i]).max(initial=0.0) for i in (0, INITIAL, EQUATIONS)), np.abs(dual).max(), -outside)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_answers_are_those_of_the_embedding(seed, free):
    problem = stages(seed, free=free)
    found, expected = solve_small(problem, compiled=True), solve_small(problem, compiled=False)
    assert found.end is expected.end
    if found.end is End.OPTIMAL:
        assert np.abs(found.y - expected.y).max() < 1e-4 * np.abs(expected.y).max()
        assert errors(problem, found.y, found.z) < 1e-7
        cost = [
            0.5 * np.einsum("ti,tij,tj", one.y, problem.H, one.y) + np.vdot(problem.h, one.y)
            for one in (found, expected)
        ]
        assert cost[0] == pytest.approx(cost[1], rel=1e-7)


def test_both_kinds_of_problems_are_among_them():
    ends = {solve_small(stages(seed)).end for seed in range(10)}
    assert End.OPTIMAL in ends
    assert solve_small(stages(1, tight=0.02)).end is End.INFEASIBLE


@pytest.mark.parametrize("seed", range(5))
def test_rays_prove_infeasibility(seed):
    problem = stages(seed, tight=0.02)
    found = solve_small(problem)
    assert found.end is End.INFEASIBLE
    system = System(problem, loops(False))
    assert sum(np.vdot(b, z) for b, z in zip(system.b, found.z, strict=True)) == pytest.approx(-1)
    assert np.abs(system.adjoint(found.z)).max() < 1e-6
    assert system.cones[STAGES].margin(found.z[STAGES]) >= 0


def test_unbounded_problems_have_a_direction():
    problem = stages(0)
    k = problem.B.shape[2]
    G, g, H, h = problem.G[:, :1], np.full((len(problem.g), 1), np.inf), problem.H.copy(), problem.h.copy()
    H[:-1, -1], H[:-1, :, -1], h[:-1, -1] = 0.0, 0.0, 1.0
    B = problem.B.copy()
    B[:, :, -1] = 0.0
    problem = replace(problem, G=G, g=g, H=H, h=h, B=B, cones=(), coupling=replace(problem.coupling, equations=()))
    g[3, 0] = 1.0
    found = solve_small(problem)
    assert k >= 1
    assert found.end is End.UNBOUNDED
    assert np.vdot(problem.h, found.y) == pytest.approx(-1)


def test_the_iteration_stops_at_a_cutoff():
    problem = next(p for p in map(stages, range(10)) if solve_small(p).end is End.OPTIMAL)
    optimal = solve_small(problem)
    y = optimal.y
    cost = 0.5 * np.einsum("ti,tij,tj", y, problem.H, y) + np.vdot(problem.h, y) + problem.constant
    assert solve_small(problem, cutoff=cost + 1e-3 * abs(cost)).end is End.OPTIMAL
    cut = solve_small(problem, cutoff=cost - 0.05 * abs(cost))
    assert cut.end is End.CUTOFF
    assert cut.steps < optimal.steps
    assert solve_small(problem, steps=2).end is End.STALLED


def test_rows_of_several_times_must_be_equations():
    problem = stages(0)
    rows = problem.coupling.equations[0].rows
    assert is_small(problem)
    assert not is_small(
        replace(problem, coupling=replace(problem.coupling, inequalities=(Inequalities(rows, np.ones(2)),)))
    )
