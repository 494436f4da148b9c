"""Big-M programs of piecewise-affine problems, and what SCIP and DAQP make of them."""

import os
import signal
import sys
import threading
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.sparse as sp

import lin_freq_ocp as lfo
from helpers.checks.claimed import resolved
from helpers.clocks import Clock
from helpers.modes import brute_force, random_problem
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods.hybrid import solve_miqp
from lin_freq_ocp.program import Block, Claim, Program, Solution
from lin_freq_ocp.program import backend as solver_named
from lin_freq_ocp.program.hybrid import big_m_bounds, big_m_program
from lin_freq_ocp.transform.hybrid import ModeReach

library = lfo.library
BACKENDS = ["scip", "daqp"]
each_backend = pytest.mark.parametrize("backend", BACKENDS)

REFERENCES = [  # shared/reference/hybrid.md
    ("pendulum_with_wall", {"horizon": 6}, 34.990971),
    ("pendulum_with_wall", {"horizon": 6, "control_spectrum": "freq"}, 35.066890),
    ("switched_rotation", {"horizon": 6, "initial_state": (-6, 7)}, 159.320358),
    ("switched_rotation", {"horizon": 6, "initial_state": (-6, 7), "control_spectrum": "freq"}, 161.197114),
    ("switched_rotation", {"horizon": 5, "initial_state": (1, 1), "terminal_cost": False}, 2.8371550),
    (
        "switched_rotation",
        {"horizon": 5, "initial_state": (1, 1), "terminal_cost": False, "control_spectrum": lfo.stop_band(bins=[2])},
        3.0424267,
    ),
    ("buck_affine", {"horizon": 6}, 32.681386),
]


@each_backend
@pytest.mark.parametrize(("name", "given", "cost"), seeds(REFERENCES))
def test_the_reference_values_are_found(backend, name, given, cost):
    problem = library.by_name(name)(**given)
    outcome = solve_miqp(problem, backend)
    again = resolved(problem, outcome)
    assert outcome.status is Claim.SOLVED
    assert again.message == ""
    assert again.cost == pytest.approx(cost, rel=1e-6)
    assert outcome.cost == pytest.approx(cost, rel=1e-6)
    assert cost * (1 - 2e-5) < outcome.bound < cost * (1 + 1e-7)
    assert set(outcome.seconds) == {"setup", "solve"}


@each_backend
@pytest.mark.parametrize("seed", seeds(range(3)))
def test_problems_with_four_modes_agree_with_branch_and_bound(backend, seed):
    problem = random_problem(seed, horizon=3, kinks=2, control_spectrum=lfo.stop_band(bins=[1]))
    best = lfo.solve(problem).cost
    again = resolved(problem, solve_miqp(problem, backend))
    assert again.message == ""
    assert again.cost == pytest.approx(best, rel=1e-6)


def sampled(problem, count, seed=0, size=1.0):
    """Yield trajectories by simulation that stay in the state sets, with their sequences."""
    rng = np.random.default_rng(seed)
    lower, upper = problem.control_tube.lower, problem.control_tube.upper
    start, found = problem.initial_box, 0
    for _ in range(50 * count):
        u = (lower + upper) / 2 + size * (upper - lower) / 2 * rng.uniform(-1, 1, lower.shape)
        try:
            trajectory = lfo.simulate(problem, u, rng.uniform(start.lower, start.upper))
        except lfo.errors.NumericalError:
            continue
        if (problem.state_tube.violation(trajectory.x) == 0).all():
            found += 1
            yield trajectory, problem.dynamics.sequence_of(trajectory.x, trajectory.u)
        if found == count:
            return
    pytest.fail(f"only {found} of {count} trajectories stay in the sets")


SAMPLED = [
    library.switched_rotation(horizon=8, initial_state=(-6, 7)),
    library.pendulum_with_wall(horizon=6),
    library.buck_affine(horizon=6, pieces=3),
    library.cart_pole_with_walls(horizon=4, initial_state=(0.1, 0.05, 1.2, -0.3)),
    random_problem(5, horizon=5, kinks=2),
    replace(random_problem(7, horizon=4), initial_state=lfo.Box(-1, 1)),
]


@pytest.mark.parametrize("problem", seeds(SAMPLED), ids=lambda problem: problem.name or "random")
def test_every_trajectory_satisfies_the_program_with_its_own_modes_and_no_others(problem):
    program = big_m_program(problem)
    nothing, wrong, tried = np.zeros(len(program.program.lower)), 0, 0
    modes, costs = len(problem.dynamics.modes), []
    for trajectory, sequence in sampled(problem, 40):
        z = program.point(trajectory, sequence)
        assert program.program.residuals(z, nothing).primal <= 1e-9
        assert (program.sequence(z) == sequence).all()
        np.testing.assert_allclose(program.trajectory(z).x, trajectory.x, atol=1e-12)
        costs.append((program.cost(program.program.objective(z)), problem.value(trajectory.x, trajectory.u)))
        for t in range(problem.horizon):
            other = sequence.copy()
            other[t] = (other[t] + 1) % modes
            tried += 1
            wrong += program.program.residuals(program.point(trajectory, other), nothing).primal > 1e-7
    assert wrong > 0.9 * tried
    np.testing.assert_allclose(*np.transpose(costs), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("switched_rotation", {"initial_state": lfo.Box(-10, 10)}),
        ("pendulum_with_wall", {"initial_state": lfo.Box([-0.2, -1.5], [0.2, 1.5])}),
        ("buck_affine", {"initial_state": lfo.Box(0, 1), "pieces": 2}),
    ],
)
def test_bounds_are_those_at_the_corners_of_boxes_and_no_sample_passes_them(name, given):
    """Sample the first step of a free start; the boxes of modes are those of the forward reach."""
    problem = library.by_name(name)(horizon=2, **given)
    found, arrays, rng = big_m_bounds(problem), problem.dynamics.arrays(1), np.random.default_rng(0)
    reach = ModeReach(problem).from_start(np.ones(found.possible.shape, dtype=bool))
    states, controls = problem.state_boxes, problem.control_tube
    lower = np.append(states.lower[0], controls.lower[0])
    upper = np.append(states.upper[0], controls.upper[0])
    y = rng.uniform(lower, upper, (60_000, len(lower)))
    y = np.where(rng.random(y.shape) < 0.2, lower, np.where(rng.random(y.shape) < 0.2, upper, y))
    F, G = (np.concatenate(pair, axis=-1)[0] for pair in ((arrays.A, arrays.B), (arrays.G, arrays.H)))
    images = np.einsum("kij,sj->ski", F, y) + arrays.offset[0]
    excess = np.einsum("krj,sj->skr", G, y) - arrays.h[0]
    for j in range(len(problem.dynamics.modes)):
        inside = (excess[:, j] <= 0).all(axis=1)
        inside &= ((images[:, j] >= states.lower[1]) & (images[:, j] <= states.upper[1])).all(axis=1)
        corners = np.array(list(product(*zip(reach.mode_lower[0, j], reach.mode_upper[0, j], strict=True))))
        at_corners = np.einsum("kij,sj->ski", F[j] - F, corners) + arrays.offset[0, j] - arrays.offset[0]
        regions = (np.einsum("krj,sj->skr", G, corners) - arrays.h[0]).max(axis=0)
        others = np.arange(len(F)) != j
        np.testing.assert_allclose(found.above[0, others, j], at_corners.max(axis=0)[others], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.below[0, others, j], at_corners.min(axis=0)[others], rtol=1e-9, atol=1e-9)
        limited = np.isfinite(regions)
        np.testing.assert_allclose(found.regions[0, :, j][limited], regions[limited], rtol=1e-9, atol=1e-9)
        difference = images[inside, j, None] - images[inside]
        for figure, samples in (
            (found.above[0, :, j], difference.max(axis=0)),
            (-found.below[0, :, j], (-difference).max(axis=0)),
            (found.regions[0, :, j], excess[inside].max(axis=0)),
        ):
            known = np.isfinite(samples)
            assert (figure[known] >= samples[known] - 1e-12).all()


def test_a_row_that_all_modes_share_is_one_equation():
    program = big_m_program(library.pendulum_with_wall(horizon=4, initial_state=lfo.Box([-0.2, -1.5], [0.2, 1.5])))
    rows = program.program.rows[Block.DYNAMICS]
    assert program.program.equality[rows].sum() == 4  # angle+ = angle + h speed, whatever the mode
    assert rows.stop - rows.start == 4 + 4 * 2 * 2


@expensive
def test_rows_and_columns_are_of_order_one():
    for problem in SAMPLED:
        program = big_m_program(problem)
        A = abs(program.program.A)
        largest = A.max(axis=1).toarray().ravel()
        np.testing.assert_allclose(largest, 1.0)
        np.testing.assert_array_equal(program.scaling.columns[program.program.binaries], 1.0)


def micrometres(problem, factor=1e6):
    """Return the same problem with the first state in other units."""
    n, dynamics, cost = problem.state_dim, problem.dynamics, problem.quadratic
    S = np.diag([factor, *[1.0] * (n - 1)])
    back = np.linalg.inv(S)
    modes = [
        lfo.AffineMode(
            S @ mode.linear.A @ back,
            S @ mode.linear.B,
            S @ mode.linear.offset,
            G=mode.region.C @ back,
            H=mode.region.D if mode.region.D.size else None,
            h=mode.region.e,
        )
        for mode in dynamics.modes
    ]
    return replace(
        problem,
        dynamics=lfo.PiecewiseAffineDynamics(modes),
        cost=lfo.QuadraticCost(Q=back @ cost.Q @ back, R=cost.R, P=back @ cost.P @ back, x_ref=S @ cost.x_ref),
        state_set=lfo.Box(S @ problem.state_boxes.lower[0], S @ problem.state_boxes.upper[0]),
        initial_state=S @ problem.initial_box.lower,
    )


@expensive
@each_backend
@pytest.mark.parametrize(("name", "given", "cost"), REFERENCES[1::3])
def test_units_do_not_matter(backend, name, given, cost):
    problem = micrometres(library.by_name(name)(**given))
    outcome = solve_miqp(problem, backend)
    again = resolved(problem, outcome)
    assert again.message == ""
    assert again.cost == pytest.approx(cost, rel=1e-6)


def masked(horizon=4):
    """Return a problem with Euclidean norms: the first bin of the torque is limited to a part of what it would be."""
    problem = library.pendulum_with_wall(horizon=horizon)
    return replace(problem, control_spectrum=lfo.MagnitudeBound(0.18, bins=[1]))


def balled():
    """Return a problem whose controls are bounded by nothing but a ball."""
    return random_problem(3, horizon=3, m=2, control_set=lfo.sets.Ball(1.0))


@expensive
@pytest.mark.parametrize("problem", [masked(), balled()], ids=["mask", "ball"])
def test_cones_go_to_scip_and_daqp_refuses_them(problem):
    best, _ = brute_force(problem)
    again = resolved(problem, solve_miqp(problem, "scip"))
    assert again.message == ""
    assert again.cost == pytest.approx(best, rel=1e-6)
    with pytest.raises(lfo.errors.UnsupportedError, match="'daqp' solves quadratic programs only"):
        solve_miqp(problem, "daqp")


def test_the_mask_is_felt_and_branch_and_bound_proves_it():
    problem = masked()
    free = lfo.solve(replace(problem, control_spectrum=None))
    result = lfo.solve(problem)
    assert np.abs(np.fft.rfft(free.control[:, 0]))[1] > 0.36
    assert result.cost > free.cost * (1 + 1e-5)
    assert result.cost == pytest.approx(resolved(problem, solve_miqp(problem, "scip")).cost, rel=1e-6)


@expensive
@each_backend
@pytest.mark.parametrize(
    "fields",
    [
        {"stage_rows": lfo.StageRows([[1.0, 0.5]], [[1.0]], [0.1], penalty=2.0)},
        {"cost": lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.1)},
        {"cost": lfo.QuadraticCost(Q=0.2, R=0.1, q=[0.3, 0.0], r=[-0.2]) + lfo.costs.L1Cost(u=0.3)},
    ],
    ids=["soft rows", "singular", "L1"],
)
def test_slacks_and_states_without_curvature(backend, fields):
    problem = random_problem(4, horizon=4, **fields)
    best = lfo.solve(problem).cost
    again = resolved(problem, solve_miqp(problem, backend))
    assert again.message == ""
    assert again.cost == pytest.approx(best, rel=2e-6)


@each_backend
def test_what_has_no_trajectory_is_infeasible(backend):
    unreachable = library.switched_rotation(horizon=3, initial_state=(-6, 7), terminal_state=(9, 9))
    outcome = solve_miqp(unreachable, backend)
    assert (outcome.status, outcome.sequence, outcome.cost) == (Claim.INFEASIBLE, None, None)
    held = library.switched_rotation(horizon=4, initial_state=(-6, 7), terminal_state=(0.3, 0.3))
    assert solve_miqp(held, backend).status is Claim.INFEASIBLE
    assert lfo.solve(held, throw=False).status == "infeasible"


@each_backend
def test_a_time_limit_is_kept_and_said(backend):
    """The clock stands still while the program is set up; solvers get the millisecond that is always left to them."""
    problem = library.buck_affine(horizon=30)
    with use_clock(Clock()):
        outcome = solve_miqp(problem, backend, time_limit=1e-9)
    assert outcome.status in (Claim.LIMIT, Claim.TIME_LIMIT)
    assert "limit" in outcome.message or "stopped early" in outcome.message
    if outcome.sequence is not None:
        assert resolved(problem, outcome).candidate.status in ("optimal", "infeasible")


@each_backend
def test_a_solver_whose_limit_is_over_before_it_begins_says_so(backend):
    """Its own set-up takes the time: every look at the clock takes longer than the limit."""
    program = big_m_program(library.buck_affine(horizon=12)).program
    with use_clock(Clock(1.0)):
        found = solver_named(backend, binaries=True)(program, 1e-6, 0.5)
    assert found.claim in (Claim.TIME_LIMIT, Claim.LIMIT)  # DAQP calls it LIMIT where it has a feasible point


@pytest.mark.skipif(os.name != "posix", reason="a process cannot send itself Ctrl-C there")
@expensive
def test_ctrl_c_stops_scip_with_the_best_point_so_far():
    problem, before, stop = library.buck_affine(horizon=20), signal.getsignal(signal.SIGINT), threading.Event()

    def send():
        while not stop.wait(0.01):
            if signal.getsignal(signal.SIGINT) is not before:
                os.kill(os.getpid(), signal.SIGINT)
                return

    sender = threading.Thread(target=send)
    sender.start()
    try:
        outcome = solve_miqp(problem, "scip")
    finally:
        stop.set()
        sender.join()
    assert outcome.status is Claim.INTERRUPTED
    assert outcome.sequence is None or outcome.sequence.shape == (20,)
    assert signal.getsignal(signal.SIGINT) is before


@expensive
@each_backend
def test_solvers_are_silent_and_repeat_themselves(backend, capfd):
    problem = library.buck_affine(horizon=4)
    first, second = solve_miqp(problem, backend), solve_miqp(problem, backend)
    assert capfd.readouterr() == ("", "")
    assert (first.cost, first.bound, first.message) == (second.cost, second.bound, second.message)


@pytest.mark.parametrize(("backend", "package"), [("scip", "pyscipopt"), ("daqp", "daqp")])
def test_a_missing_package_is_named(monkeypatch, backend, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        lfo.errors.MissingExtraError, match=rf"{package}.*'lin-freq-ocp\[{backend}\]', .* -e '\.\[{backend}\]'"
    ):
        solve_miqp(library.buck_affine(horizon=2), backend)


def test_what_cannot_be_taken_is_refused():
    problem = library.buck_affine(horizon=3)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"'gurobi'; expected 'scip' or 'daqp'"):
        solve_miqp(problem, "gurobi")
    with pytest.raises(lfo.errors.UnsupportedError, match="LinearDynamics; expected PiecewiseAffine"):
        solve_miqp(library.pendulum(horizon=10), "daqp")
    with pytest.raises(lfo.errors.UnsupportedError, match="eigenvalue -1"):
        solve_miqp(replace(problem, cost=lfo.QuadraticCost(R=-1.0)), "daqp")
    unbounded = {"control_set": lfo.Box(-1, None), "state_set": None, "initial_state": lfo.Box(-4, 4)}
    with pytest.raises(lfo.errors.UnsupportedError, match=r"u_0: no upper bound at t = 0, where several modes"):
        solve_miqp(random_problem(3, horizon=3, **unbounded), "daqp")


def claiming(monkeypatch, change):
    """Let every mixed-integer backend return what ``change`` makes of DAQP's answer."""
    real = solver_named("daqp", binaries=True)

    def chosen(name, binaries=False):
        return (lambda *asked: change(real(*asked))) if binaries else solver_named(name)

    substitute(monkeypatch, "program.backend", chosen)


def test_the_bound_of_daqp_is_one_in_spite_of_its_regularisation():
    """Min -z / 100 with 0 <= z <= 1 is -1/100; DAQP minimises z^2 / 20 - z / 100, for y has a Hessian of 1e6."""
    P, q = sp.csc_array(np.diag([0.0, 1e6, 0.0])), np.array([-0.01, 0.0, 0.0])
    program = Program(P, q, sp.csc_array(np.eye(3)), np.array([0.0, -1.0, 0.0]), np.ones(3), binaries=np.array([2]))
    answer = solver_named("daqp", binaries=True)(program, 1e-6, None)
    assert answer.claim == Claim.SOLVED
    assert answer.z[0] == pytest.approx(0.1)
    assert -0.1 < answer.bound <= -0.01


def test_a_point_that_is_none_is_no_answer(monkeypatch):
    problem = library.pendulum_with_wall(horizon=6)

    def shifted(answer):
        return replace(answer, z=np.where(np.arange(len(answer.z)) == 5, answer.z + 1e-3, answer.z))

    claiming(monkeypatch, shifted)
    outcome = solve_miqp(problem)
    assert outcome.status is Claim.FAILED
    assert "violates a row of order 1 by" in outcome.message
    claiming(monkeypatch, lambda answer: Solution(Claim.SOLVED, None, None, "done"))
    assert solve_miqp(problem).status is Claim.FAILED


def test_a_point_with_shares_of_modes_is_no_answer(monkeypatch):
    """The optimum of the relaxation satisfies all rows; with whole modes, it does not."""

    def relaxed(name, binaries):
        return lambda program, *_: solver_named("clarabel")(replace(program, binaries=program.binaries[:0]), 1e-8, None)

    substitute(monkeypatch, "program.backend", relaxed)
    outcome = solve_miqp(library.buck_affine(horizon=6))
    assert outcome.status is Claim.FAILED
    assert "with binaries rounded its point violates a row of order 1 by" in outcome.message


def test_wrong_claims_are_told():
    problem = library.pendulum_with_wall(horizon=6)
    outcome = solve_miqp(problem, "daqp")
    assert "claimed cost 34 is below" in resolved(problem, replace(outcome, cost=34.0)).message
    assert "claimed cost 36 is above" in resolved(problem, replace(outcome, cost=36.0)).message
    assert "claimed bound 36 is above the cost" in resolved(problem, replace(outcome, bound=36.0)).message
    free = np.zeros(6, dtype=int)
    assert "ended as infeasible" in resolved(problem, replace(outcome, sequence=free)).message


def test_bounds_of_single_variables_are_told_from_rows():
    program = big_m_program(library.pendulum_with_wall(horizon=3)).program
    rows = program.single_bounds()
    singles = np.diff(program.A.tocsr().indptr) == 1
    assert len(rows.lower) == (~singles).sum()
    z = np.random.default_rng(0).uniform(-1, 1, len(program.q))
    held = ((program.A @ z >= program.lower) & (program.A @ z <= program.upper))[singles].all()
    assert held == ((z >= rows.below) & (z <= rows.above)).all()


@each_backend
def test_rows_without_variables_hold_or_exclude_everything(backend):
    program = big_m_program(library.pendulum_with_wall(horizon=3)).program
    A = sp.csc_array(sp.vstack([program.A, sp.csc_array((1, program.A.shape[1]))]))

    def with_row(lower, upper):
        return replace(program, A=A, lower=np.append(program.lower, lower), upper=np.append(program.upper, upper))

    solve = solver_named(backend, binaries=True)
    free, held = (solve(one, 1e-6, 20.0) for one in (program, with_row(-1.0, 1.0)))
    assert (free.claim, held.claim) == (Claim.SOLVED, Claim.SOLVED)
    np.testing.assert_allclose(free.z, held.z, atol=1e-7)
    assert solve(with_row(0.5, 1.0), 1e-6, 20.0).claim is Claim.INFEASIBLE


@expensive
@each_backend
def test_solve_proves_what_a_mixed_integer_solver_found(backend):
    result = lfo.solve(library.buck_affine(horizon=6), method="miqp", backend=backend)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(32.681386, rel=1e-6)
    assert result.tree_bound.covers
    assert abs(result.gap) < 1e-6


def test_solve_improves_on_a_wrong_claim(monkeypatch):
    def misled(answer):
        z = answer.z.copy()
        z[-6:] = np.tile([1.0, 0.0], 3)  # the last three modes
        return replace(answer, z=z)

    claiming(monkeypatch, misled)
    result = lfo.solve(library.pendulum_with_wall(horizon=6), method="miqp")
    assert result.cost == pytest.approx(34.990971, rel=1e-6)
    assert result.status == "optimal"


def without_a_mode(seed):
    """Return a problem whose joint rows exclude every mode at one time: levels, or a random map with a kink."""
    rng, T = np.random.default_rng(seed), 4
    limits = np.full((T, 1), np.inf)
    limits[rng.integers(T)] = -2.0 - rng.random()  # of u, above -1.5
    rows = lfo.StageRows(np.zeros((1, 1)), [[1.0]], limits)
    if seed % 2:
        return random_problem(seed, T, n=1, stage_rows=rows)
    a, b = rng.uniform(0.3, 0.9), rng.uniform(1, 1.5)
    dynamics, levels = lfo.LinearDynamics([[a]], [[b]]), lfo.FiniteSet([-0.5, 0, 0.5])
    return lfo.OptimalControlProblem(
        dynamics, T, lfo.QuadraticCost(R=1.0), levels, lfo.Box(-9, 9), [1.0], stage_rows=rows
    )


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_where_no_mode_is_possible_infeasible_is_proven_by_the_same_tree(seed):
    problem = without_a_mode(seed)
    methods = ("auto", *(lfo.solvers.MixedInteger(backend=backend) for backend in BACKENDS))
    for result in (lfo.solve(problem, method, throw=False) for method in methods):
        assert result.status == "infeasible"
        assert result.tree_bound.covers
        assert result.tree_bound.value == np.inf


@pytest.mark.parametrize("limit", [0.2, 1e9])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_a_mask_is_a_cone_of_order_one_in_every_unit(unit, limit):
    sides = [lfo.AffineMode([[a]], [[1.0 / unit]], G=[[side]], h=[0.0]) for a, side in ((0.9, 1.0), (0.5, -1.0))]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(sides),
        4,
        lfo.QuadraticCost(Q=1.0, R=0.5 / unit**2),
        lfo.Box(-unit, unit),
        lfo.Box(-2, 2),
        initial_state=[0.5],
        control_spectrum=lfo.MagnitudeBound(limit * unit, bins=[1]),
    )
    program = big_m_program(problem).program
    for cone in program.cones:
        assert 0.1 < max(abs(program.A[cone]).max(), np.abs(program.lower[cone]).max()) <= 1.0 + 1e-12
