"""Problems as stages: the same costs and rows, the same optimum, in the same numbers whatever the units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS, PLANT, A, B, T
from helpers.seeds import seeds
from helpers.stage_programs import solved_stages, stage_operator
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.structured import SparseRows, SpectrumRows, Stages, assemble_stages
from lin_freq_ocp.problem import NormBall, Term, replace_fields


def cost_of(stages: Stages, y: np.ndarray) -> float:
    curved = 0.5 * np.einsum("ti,tij,tj", y, stages.H, y)
    return float(curved + (stages.h * y).sum() + stages.constant)


def worst_violation(stages: Stages, y: np.ndarray) -> float:
    """Return by how much b - A y lies outside its cones."""
    matrices, right = stage_operator(stages)
    rest = [b - M @ y.ravel() for M, b in zip(matrices, right, strict=True)]
    worst = [np.abs(rest[i]).max(initial=0.0) for i in (0, 1, 3)] + [-rest[4].min(initial=0.0)]
    first = stages.G.shape[1] - sum(stages.cones)
    s = rest[2].reshape(stages.g.shape)
    worst.append(-s[:, :first].min(initial=0.0))
    for size in stages.cones:
        cone = s[stages.present[:, first], first : first + size]
        worst.append((np.linalg.norm(cone[:, 1:], axis=1) - cone[:, 0]).max(initial=0.0))
        first += size
    for part, values in zip(stages.coupling.balls, rest[5:], strict=True):
        ball = values.reshape(len(part.radius), -1)
        worst.append((np.linalg.norm(ball[:, 1:], axis=1) - ball[:, 0]).max(initial=0.0))
    return float(max(worst))


@pytest.mark.parametrize("kind", KINDS)
def test_trajectories_cost_the_same(kind):
    problem, rng = KINDS[kind](), np.random.default_rng(1)
    assembly = assemble_stages(problem)
    for _ in range(3):
        u, tube = rng.standard_normal((T, 2)), problem.control_tube
        u = np.where(tube.lower == tube.upper, tube.lower, u)
        trajectory = lfo.Trajectory(rng.standard_normal((T + 1, 2)), u)
        y = assembly.point(trajectory)
        expected = problem.value(trajectory.x, trajectory.u)
        assert cost_of(assembly.stages, y) / assembly.units.cost == pytest.approx(expected, rel=1e-12)
        back = assembly.trajectory(y)
        np.testing.assert_allclose(back.x, trajectory.x, atol=1e-14)
        np.testing.assert_allclose(back.u, trajectory.u, atol=1e-14)
        assert worst_violation(assembly.stages, y) > 1e-3  # it follows no dynamics


@pytest.mark.parametrize("kind", seeds(KINDS))
def test_the_optimum_is_that_of_the_sparse_program(kind):
    problem = KINDS[kind]()
    known, assembly = lfo.solve(problem, method="convex"), assemble_stages(problem)
    assert worst_violation(assembly.stages, assembly.point(known.trajectory)) < 1e-8
    status, y, z = solved_stages(assembly.stages)
    assert status in ("Solved", "AlmostSolved")
    cost = cost_of(assembly.stages, y) / assembly.units.cost
    assert cost == pytest.approx(known.cost, rel=1e-8)
    certificate = lfo.certify(problem, assembly.trajectory(y), assembly.multipliers(z, 1.0, y))
    assert certificate.globally_optimal, certificate


@pytest.mark.parametrize("kind", ["boxes", "cone", "soft rows", "control ball"])
def test_stages_do_not_depend_on_units(kind):
    problem, units = KINDS[kind](), (np.array([1e6, 1e-3]), np.array([1e-6, 1e2]), 1e4)
    plain, changed = assemble_stages(problem).stages, assemble_stages(in_units(problem, *units)).stages
    for field in ("A", "B", "d", "H", "h", "G", "g", "initial"):
        np.testing.assert_allclose(getattr(changed, field), getattr(plain, field), rtol=1e-9, atol=1e-12)
    assert plain.constant == pytest.approx(changed.constant)


def in_units(problem, x, u, cost):
    """Return a problem with a quadratic cost in units x, u (x_given = x x_new), and costs of 1 / cost."""
    quadratic, sets = problem.quadratic, {}
    given = problem.control_set
    if isinstance(given, lfo.Box):
        sets["control_set"] = lfo.Box(given.lower / u, given.upper / u)
        sets["state_set"] = lfo.Box(problem.state_set.lower / x, problem.state_set.upper / x)
    elif given is not None:
        sets["control_set"] = lfo.sets.Ellipsoid(np.diag(u), given.radius, given.centre / u)
    if isinstance(problem.state_set, lfo.sets.SecondOrderCone):
        sets["state_set"] = lfo.sets.SecondOrderCone(np.diag(x), np.zeros(2), np.array([0.2, -0.5]) * x, 1.0)
    rows = [
        lfo.StageRows(one.C * x, one.D * u, one.e, one.name, one.penalty and one.penalty / cost)
        for one in problem.stage_rows
    ]
    dynamics = lfo.LinearDynamics(A / x[:, None] * x, B / x[:, None] * u, PLANT.offset / x)
    scaled = lfo.QuadraticCost(
        Q=quadratic.Q * x * x[:, None] / cost,
        R=quadratic.R * u * u[:, None] / cost,
        P=quadratic.P * x * x[:, None] / cost,
    )
    start = problem.initial_state.lower / x
    return replace(problem, dynamics=dynamics, cost=scaled, initial_state=start, stage_rows=rows or None, **sets)


def test_limits_are_of_order_one():
    stages = assemble_stages(KINDS["control ball"]()).stages
    np.testing.assert_allclose(stages.g[:-1, 0], 1.0)  # the heads
    masks = assemble_stages(KINDS["fine mask"]()).stages.coupling.balls
    assert masks
    for part in masks:
        np.testing.assert_allclose(part.radius, 1.0)


def test_long_masks_need_no_dense_rows():
    horizon = 5000
    problem = lfo.OptimalControlProblem(
        PLANT,
        horizon,
        lfo.QuadraticCost(Q=1.0, R=0.1),
        control_set=lfo.sets.Ball(0.4),
        initial_state=[1.0, 0.0],
        control_spectrum=[
            lfo.low_pass(1.0),
            lfo.MagnitudeBound(0.5, band=lfo.low_pass(0.5), oversampling=2, penalty=1.0),
        ],
    )
    stages = assemble_stages(problem).stages
    numbers = sum(array.size for array in (stages.A, stages.B, stages.H, stages.G))
    for part in stages.coupling.balls:
        assert not isinstance(part.rows, SparseRows)
        assert isinstance(part.heads, SparseRows)
        numbers += part.heads.matrix.nnz
    assert sum(part.rows.count for part in stages.coupling.balls) > 2 * horizon
    assert numbers < 150 * horizon


class OnlyLargest(NormBall):
    """A penalty whose slack bounds all groups: its conic form joins what the groups are about."""

    def conic(self, groups, dim):
        form = super().conic(groups, dim)
        slacks = form.slacks @ np.ones((form.slacks.shape[1], 1))
        return replace(form, slacks=type(form.slacks)(slacks), prices=form.prices[:1], paid=form.paid[:1])

    def least_slacks(self, v):
        return super().least_slacks(v).max(initial=0.0, keepdims=True)


@pytest.mark.parametrize("kind", ["control ball", "mask"])
def test_a_conic_form_that_joins_times_is_refused(kind):
    problem = KINDS[kind]()
    term = problem.terms[0]
    joining = OnlyLargest(np.inf, np.full(term.shape[0], 0.4), np.asarray(1.0))
    problem.__dict__["terms"] = (Term("peak", term.kind, term.map, joining),)
    with pytest.raises(UnsupportedError, match="'peak'"):
        assemble_stages(problem)


@pytest.mark.parametrize("kind", ["LInf cost", "soft mask", "soft linear constraint"])
def test_a_small_solution_has_units_of_its_own(kind):
    problem, rng = KINDS[kind](), np.random.default_rng(1)
    assembly, cost = assemble_stages(problem), problem.quadratic
    assert assembly.revised(np.ones(assembly.stages.h.shape)) is None
    x = cost.x_ref + 1e-6 * rng.standard_normal((T + 1, 2))
    u = cost.u_ref + np.array([1e-5, 1e-3]) * rng.standard_normal((T, 2))
    small = lfo.Trajectory(x, u)
    revised = assembly.revised(assembly.point(small))
    assert revised is not None
    y = revised.point(small)
    np.testing.assert_allclose(np.abs(y[:, 2:4]).max(axis=0), 1.0, rtol=1e-6)
    assert (np.abs(y[:, :2]).max(axis=0) < 1 + 1e-9).all()  # those that controls would notice are larger
    assert cost_of(revised.stages, y) / revised.units.cost == pytest.approx(problem.value(x, u), rel=1e-12)
    np.testing.assert_allclose(revised.trajectory(y).x, x, rtol=1e-14)
    status, y, z = solved_stages(revised.stages)
    assert status in ("Solved", "AlmostSolved")
    back = revised.trajectory(y), revised.multipliers(z, 1.0, y)
    assert lfo.certify(problem, *back).globally_optimal


@pytest.mark.parametrize("kind", ["fixed ends", "partly fixed ends", "end boxes", "mask", "soft rows", "time-varying"])
def test_numbers_of_dynamics_and_fixed_ends_are_exchanged(kind):
    problem = KINDS[kind]()
    assembly = assemble_stages(problem)
    slower = replace_fields(problem, dynamics=lfo.LinearDynamics(0.9 * A, 1.1 * B, [0.02, 0.01]))
    ends = [replaced_where_fixed(end) for end in (problem.initial_state, problem.terminal_state)]
    slower = slower.with_ends(*ends)
    exchanged = assembly.exchanged(slower)
    assert exchanged is not None
    status, y, z = solved_stages(exchanged.stages)
    assert status in ("Solved", "AlmostSolved")
    back = exchanged.trajectory(y), exchanged.multipliers(z, 1.0, y)
    assert lfo.certify(slower, *back).globally_optimal
    known = lfo.solve(slower, method="convex").cost
    assert cost_of(exchanged.stages, y) / exchanged.units.cost == pytest.approx(known, rel=1e-8)


def replaced_where_fixed(end):
    if not isinstance(end, lfo.Box) or end.lower.ndim == 0:
        return None
    moved = np.where(end.lower == end.upper, 0.05, 0.0)
    return lfo.Box(end.lower + moved, end.upper + moved)


def test_other_changes_are_not_exchanged():
    problem = KINDS["boxes"]()
    assembly = assemble_stages(problem)
    assert assembly.exchanged(replace(problem, control_set=lfo.Box(-0.5, 0.5))) is None
    assert assembly.exchanged(problem.with_ends(lfo.Box(-1, 1))) is None
    assert assembly.exchanged(problem.with_ends([0.5, 0.2])) is not None
    boxed = KINDS["end boxes"]()
    assert assemble_stages(boxed).exchanged(boxed.with_ends(lfo.Box(0.4, 1.0))) is None


def test_what_never_moves_does_not_measure_the_cost():
    idle = lfo.LinearDynamics(A, B * [1.0, 0.0])
    cost = lfo.QuadraticCost(Q=1.0, R=np.diag([0.1, 1e12]))
    assembly = assemble_stages(lfo.OptimalControlProblem(idle, T, cost, initial_state=[1.0, -0.5]))
    _, y, _ = solved_stages(assembly.stages)
    y[:, 3] = 0.0
    revised = assembly.revised(y)
    assert revised is not None
    assert assembly.units.cost < 1e-10
    assert revised.units.cost > 0.1


def banded(unit: float) -> lfo.OptimalControlProblem:
    """Return a problem with every kind of frequency constraint, its control in such a unit and its states in 1/unit."""
    wave = np.sin(np.arange(T))[:, None, None] * unit
    spectrum = lfo.spectrum
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, np.array([[0.05], [0.3]]) * unit**2),
        T,
        lfo.QuadraticCost(Q=1 / unit**2, R=unit**2),
        initial_state=np.array([1.0, -0.5]) * unit,
        control_set=lfo.Box(-0.6 / unit, 0.6 / unit),
        control_spectrum=[
            lfo.stop_band(bins=[4]),
            lfo.MagnitudeBound(0.5 / unit, bins=[1, 2], oversampling=2),
            lfo.MagnitudeBound(0.2 / unit, bins=[3], penalty=0.3 * unit),
            spectrum.LinearConstraint(wave, [0.1]),
        ],
        state_spectrum=[
            spectrum.EnergyBound(0.8 * unit**2, bins=[2, 5], component=0, window="hann"),
            spectrum.LinearConstraint(np.ones((T + 1, 1, 2)) / unit, [0.1], penalty=0.4),
        ],
        output_spectrum=spectrum.OutputSpectrum([[1.0, 0.5]], [[unit**2]], lfo.stop_band(bins=[1])),
    )


def test_rows_that_couple_times_do_not_depend_on_units():
    plain, changed = assemble_stages(banded(1.0)).stages, assemble_stages(banded(1e6)).stages
    rng = np.random.default_rng(1)
    y = rng.standard_normal(plain.h.size)
    for one, other in zip(stage_operator(plain), stage_operator(changed), strict=True):
        assert len(one) == len(other) == 8  # three families of balls
        for of_plain, of_changed in zip(one, other, strict=True):
            finite = np.isfinite(of_plain)
            np.testing.assert_array_equal(finite, np.isfinite(of_changed))
            np.testing.assert_allclose(of_changed[finite], of_plain[finite], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(cost_of(changed, y.reshape(plain.h.shape)), cost_of(plain, y.reshape(plain.h.shape)))


@pytest.mark.parametrize("kept", [[1, 1], [1, 0], [0, 1]], ids=["both", "real part", "imaginary part"])
def test_scaled_rows_of_a_spectrum_are_the_rows_of_scaled_signals(kept):
    rng, kept = np.random.default_rng(0), np.array([*kept, 1, 1], dtype=bool)
    rows = SpectrumRows(rng.standard_normal(2), rng.standard_normal(8), 16, np.array([3, 5]), np.ones(2), kept)
    signals, units = rng.standard_normal((9, 2, 1)), np.broadcast_to([3.0, 0.5], (9, 2))
    factors = np.array([2.0] * (rows.count - 2) + [7.0, 7.0])  # of the first bin and of the second
    scaled = rows.scaled(factors, units).forward(signals)
    np.testing.assert_allclose(scaled, factors[:, None] * rows.forward(units[:, :, None] * signals), rtol=1e-13)
