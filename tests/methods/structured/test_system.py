"""The rows of a problem over stages, one step's system, and the embedding, against dense algebra and Clarabel."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.methods.structured import (
    BALLS,
    EQUATIONS,
    INEQUALITIES,
    STAGES,
    CouplingResponse,
    EmbeddedPoint,
    Embedding,
    End,
    LowRankSolver,
    RangeSpaceSolver,
    StepSystem,
    System,
    Targets,
    can_compile,
    fine_rows,
    largest,
    loops,
)
from lin_freq_ocp.program import Claim, Program, backend

from .examples import every_kind, stages


def soft_stages(seed=0, **options):
    """Stages with every kind of coupling; w_1 is the slack of the energy at t = 0, with a price."""
    problem = stages(seed, k=2, coupling=every_kind(), **options)
    B, h = problem.B.copy(), problem.h.copy()
    B[:, :, 1] = 0.0
    h[0, 3] = 3.0
    g = problem.g.copy()
    g[0, 3] = 0.0  # -w_1 <= 0
    return replace(problem, B=B, h=h, g=g)


def flatten_inequalities(values):
    return np.concatenate([part.ravel() for part in values])


def dense_rows(system):
    """Return the matrix of all rows on y."""
    shape = system.stages.h.shape
    columns = [flatten_inequalities(system.rows(row.reshape(shape))) for row in np.eye(int(np.prod(shape)))]
    return np.array(columns).T


def split_like(vector, values):
    ends = np.cumsum([part.size for part in values])[:-1]
    return [piece.reshape(part.shape) for piece, part in zip(np.split(vector, ends), values, strict=True)]


def clarabel_cost(problem):
    """Return the optimal value by Clarabel, of the same rows as a sparse program; None if it is infeasible."""
    system = System(problem, loops(False))
    A, b = dense_rows(system), flatten_inequalities(system.b)
    of_rows = [np.arange(part.size).reshape(part.shape) for part in system.b]
    first = np.cumsum([0, *(part.size for part in system.b)])
    lower, upper = np.full(len(b), -np.inf), b.copy()
    equations = [0, 1, EQUATIONS]
    for i in equations:
        rows = first[i] + of_rows[i].ravel()
        lower[rows] = b[rows]
    n, order, cones = problem.states, [], []
    of_cones = set()
    for i, cone in system.cones.items():
        for block in cone.blocks:
            for row in np.flatnonzero(cone.present[:, block.start]):
                at = first[i] + of_rows[i][row, block]
                cones.append(at)
                of_cones |= set(at.tolist())
        absent = (first[i] + of_rows[i][~cone.present]).ravel()
        upper[absent] = np.inf
    plain = np.array([row for row in range(len(b)) if row not in of_cones], dtype=int)
    plain = plain[np.isfinite(upper[plain])]
    order = np.concatenate([plain, *cones]) if cones else plain
    sign = np.where(np.isin(order, list(of_cones)), -1.0, 1.0)
    count, slices = len(plain), []
    for at in cones:
        slices.append(slice(count, count + len(at)))
        count += len(at)
    H = np.zeros((problem.h.size, problem.h.size))
    size = problem.h.shape[1]
    for t, block in enumerate(problem.H):
        H[t * size : (t + 1) * size, t * size : (t + 1) * size] = block
    program = Program(
        sp.csc_array(H),
        problem.h.ravel(),
        sp.csc_array(sign[:, None] * A[order]),
        np.where(sign > 0, lower[order], -b[order]),
        np.where(sign > 0, upper[order], np.inf),
        cones=tuple(slices),
    )
    assert n == problem.A.shape[1]
    solution = backend("clarabel")(program, 1e-10, None)
    if solution.claim is Claim.INFEASIBLE:
        return None
    assert solution.claim is Claim.SOLVED
    return program.objective(solution.z)


def embedded(problem, compiled, side=RangeSpaceSolver, end=np.inf):
    recursions = loops(compiled)
    system = System(problem, recursions)
    chosen = side(CouplingResponse(problem, recursions))
    return system, Embedding(system, StepSystem(system, chosen), Targets(end=end)).run()


def low_rank(response):
    rows = response.coupling.equation_count + 1 + np.arange(14)  # those of the mask
    return LowRankSolver(response, rows)


def value(system, y):
    return float(0.5 * np.vdot(y, system.curvature(y)) + np.vdot(system.stages.h, y))


def test_the_adjoint_is_the_transpose_of_the_rows():
    system = System(soft_stages(1, cones=(3,)), loops(False))
    A = dense_rows(system)
    rng = np.random.default_rng(0)
    z = split_like(rng.standard_normal(A.shape[0]), system.b)
    z[0][-1] = 0.0  # no dynamics behind T
    np.testing.assert_allclose(system.adjoint(z).ravel(), A.T @ flatten_inequalities(z), atol=1e-12)


@pytest.mark.parametrize("side", [RangeSpaceSolver, low_rank])
@pytest.mark.parametrize("free", [False, True])
def test_a_step_solves_its_system(side, free):
    problem = soft_stages(2, cones=(3,), free=free)
    recursions = loops(False)
    system = System(problem, recursions)
    rng = np.random.default_rng(1)
    for cone in system.cones.values():
        s, z = (10.0 ** rng.uniform(-3, 3, cone.present.shape) * cone.present for _ in range(2))
        for block in cone.blocks:
            for v in (s, z):
                v[:, block.start] += np.linalg.norm(v[:, block.start + 1 : block.stop], axis=1)
        cone.scale(s, z)
    step = StepSystem(system, side(CouplingResponse(problem, recursions)))
    step.factor()
    of_y = rng.standard_normal(problem.h.shape)
    of_z = [rng.standard_normal(part.shape) for part in system.b]
    of_z[0][-1], of_z[1] = 0.0, np.where(problem.fixed, of_z[1], 0.0)
    of_z[STAGES] = of_z[STAGES] * problem.present
    y, z = step.solve(of_y, of_z)
    left = [right - rows for right, rows in zip(of_z, system.rows(y), strict=True)]
    for i, cone in system.cones.items():
        left[i] = left[i] + cone.scaled(z[i], 2)
    size = largest([of_y, *of_z])
    assert largest([of_y - system.curvature(y) - system.adjoint(z)]) < 1e-8 * size
    assert largest(left) < 1e-8 * size


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("side", [RangeSpaceSolver, low_rank])
@pytest.mark.parametrize("seed", [0, 3])
def test_the_optimum_is_clarabels(side, seed, compiled):
    if compiled and not can_compile():
        pytest.skip("no C compiler")
    problem = soft_stages(seed, cones=(3,) if seed else ())
    system, answer = embedded(problem, compiled, side)
    assert answer.end is End.OPTIMAL
    assert answer.errors.gap <= 1e-9
    assert value(system, answer.y) == pytest.approx(clarabel_cost(problem), rel=1e-7, abs=1e-7)
    assert max(answer.errors[:2]) <= 1e-10


def test_a_stage_that_becomes_singular_ends_the_method_with_its_best_point(monkeypatch):
    """Numbers vanish where no step improves a point any more; before the first point, that is an error."""
    factor, calls = StepSystem.factor, [0]

    def singular(limit):
        calls[0] = 0

        def counted(self):
            calls[0] += 1
            if calls[0] > limit:
                raise np.linalg.LinAlgError("singular")
            factor(self)

        monkeypatch.setattr(StepSystem, "factor", counted)

    singular(5)
    _, answer = embedded(soft_stages(0), False)
    assert answer.end is End.STALLED
    assert 0 < answer.errors.gap < np.inf
    singular(0)
    with pytest.raises(np.linalg.LinAlgError):
        embedded(soft_stages(0), False)


@expensive
def test_correctors_save_steps_near_the_boundary_of_cones(monkeypatch):
    """How many steps one problem takes depends on rounding; the sum of twelve does so by a few percent."""

    def steps():
        answers = [embedded(soft_stages(seed, cones=(2, 4)), False)[1] for seed in range(129, 141)]
        return sum(answer.steps for answer in answers)

    with_correctors = steps()
    substitute(monkeypatch, "methods.structured.CORRECTORS", 0)
    assert with_correctors < 0.9 * steps()


def test_directions_have_no_curvature_and_gaps_no_sign_and_of_rays_the_rows_alone_count():
    problem = soft_stages(3)
    system = System(problem, loops(False))
    embedding = Embedding(system, StepSystem(system, RangeSpaceSolver(CouplingResponse(problem, loops(False)))))
    y = -problem.h / np.vdot(problem.h, problem.h)
    s = {i: -system.rows(y)[i] * cone.present for i, cone in system.cones.items()}
    for below in (-1.0, -1e-3, 1.0):  # the dual objective, -b'z, below or above the primal one
        z = [below * b for b in system.b]
        rows = largest([system.adjoint(z)])
        found = embedding.measure(EmbeddedPoint(y, z, s))
        curved = largest([system.curvature(y)])
        assert found.hy == pytest.approx(-1.0)
        assert found.descent >= curved > 0
        assert found.ray == pytest.approx(rows / -found.bz if found.bz < 0 else np.inf)
        assert found.errors.gap > 0


def test_duals_are_multipliers():
    system, answer = embedded(soft_stages(4, cones=(3,)), False)
    y, z = answer.y, answer.z
    assert largest([system.curvature(y) + system.stages.h + system.adjoint(z)]) < 1e-8
    slack = [b - rows for b, rows in zip(system.b, system.rows(y), strict=True)]
    for i in (STAGES, INEQUALITIES, BALLS, BALLS + 1):
        cone = system.cones[i]
        assert cone.margin(z[i]) > -1e-9
        assert cone.margin(slack[i] * cone.present) > -1e-9
        assert abs(float(np.vdot(z[i], slack[i] * cone.present))) < 1e-6


def test_an_end_out_of_reach_gives_a_farkas_ray():
    coupling = every_kind()
    problem = soft_stages(5, bound=0.3)
    problem = replace(problem, coupling=replace(coupling, terminal_state=np.array([50.0])))
    system, answer = embedded(problem, False)
    assert answer.end is End.INFEASIBLE
    assert clarabel_cost(problem) is None
    assert sum(float(np.vdot(b, z)) for b, z in zip(system.b, answer.z, strict=True)) == pytest.approx(-1.0)
    assert largest([system.adjoint(answer.z)]) < 1e-6
    assert all(cone.margin(answer.z[i]) >= -1e-9 for i, cone in system.cones.items())


def test_a_cost_that_falls_for_ever_gives_a_direction():
    problem = stages(6)
    H, h = np.zeros_like(problem.H), problem.h.copy()
    H[-1, 2:, 2:] = 1.0
    problem = replace(problem, H=H, h=h, g=np.full_like(problem.g, np.inf))
    system, answer = embedded(problem, False)
    assert answer.end is End.UNBOUNDED
    assert float(np.vdot(h, answer.y)) == pytest.approx(-1.0)
    assert largest(system.rows(answer.y)) < 1e-6


def test_the_time_limit_and_ctrl_c_keep_the_best_point(monkeypatch):
    problem = soft_stages(7)
    _, late = embedded(problem, False, end=0.0)
    assert late.end is End.TIME
    assert np.isfinite(late.y).all()
    steps = iter(range(3))

    def factor(self, *given, own=RangeSpaceSolver.factor):
        if next(steps, None) is None:
            raise KeyboardInterrupt
        own(self, *given)

    monkeypatch.setattr(RangeSpaceSolver, "factor", factor)
    _, broken = embedded(problem, False)
    assert broken.end is End.INTERRUPTED
    assert np.isfinite(broken.y).all()


def test_masks_on_a_fine_grid_are_found_of_low_rank():
    problem = soft_stages(8)
    assert fine_rows(CouplingResponse(problem, loops(False))) is None  # 14 rows, and 40 spare directions
