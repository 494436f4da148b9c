"""The search over mode sequences: reach, relaxations, branch and bound, enumeration, and the judge of their trees."""

from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

import lin_freq_ocp as lfo
from helpers.modes import brute_force, random_problem, two_sides
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate.hybrid import tree_bound
from lin_freq_ocp.methods.hybrid import solve_relaxation
from lin_freq_ocp.problem.hybrid import ModeTree
from lin_freq_ocp.program.hybrid import ModeRelaxation
from lin_freq_ocp.transform.hybrid import ModeReach, piecewise_affine

library = lfo.library

REFERENCES = [  # shared/reference/hybrid.md
    ("switched_rotation", {"horizon": 6, "initial_state": (-6, 7)}, 159.320358),
    ("switched_rotation", {"horizon": 6, "initial_state": (-6, 7), "control_spectrum": "freq"}, 161.197114),
    ("switched_rotation", {"horizon": 5, "initial_state": (1, 1), "terminal_cost": False}, 2.8371550),
    ("pendulum_with_wall", {"horizon": 6}, 34.990971),
    ("pendulum_with_wall", {"horizon": 6, "control_spectrum": "freq"}, 35.066890),
    ("buck_affine", {"horizon": 6}, 32.681386),
]
LONGER = [
    ("switched_rotation", {"horizon": 10, "initial_state": (1, 1), "terminal_cost": False}, 2.8378768),
    (
        "switched_rotation",
        {"horizon": 10, "initial_state": (1, 1), "terminal_cost": False, "control_spectrum": lfo.stop_band(bins=[5])},
        2.8944270,
    ),
    (
        "switched_rotation",
        {"horizon": 5, "initial_state": (1, 1), "terminal_cost": False, "control_spectrum": lfo.stop_band(bins=[2])},
        3.0424267,
    ),
]
NOTCHED = library.buck_affine(horizon=12, control_spectrum="freq")


@pytest.fixture(scope="module")
def notched():
    """The answer of a search without limits, starts or help."""
    return lfo.solve(NOTCHED)


def ones(problem):
    return np.ones((problem.horizon, len(problem.dynamics.modes)), dtype=bool)


@pytest.mark.parametrize(("name", "given", "cost"), seeds(REFERENCES + LONGER))
def test_branch_and_bound_finds_and_proves_the_reference_values(name, given, cost):
    result = lfo.solve(library.by_name(name)(**given))
    assert result.status == "optimal"
    assert result.method == "branch_and_bound"
    assert result.cost == pytest.approx(cost, rel=1e-6)
    assert abs(result.gap) < 1e-6
    assert result.certificate.globally_optimal
    assert result.tree_bound.covers


@expensive
@pytest.mark.parametrize(("name", "given", "cost"), REFERENCES)
def test_enumeration_finds_and_proves_the_reference_values(name, given, cost):
    result = lfo.solve(library.by_name(name)(**given), method="enumerate")
    assert result.cost == pytest.approx(cost, rel=1e-6)
    assert abs(result.gap) < 1e-6


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_search_agrees_with_brute_force(seed):
    band = lfo.stop_band(bins=[2]) if seed % 2 else None
    kinks, horizon = (2, 2) if seed == 1 else (1, 4)
    problem = random_problem(seed, n=1 + seed % 3, kinks=kinks, horizon=horizon, control_spectrum=band)
    expected, _ = brute_force(problem)
    for method in ("branch_and_bound", "enumerate"):
        result = lfo.solve(problem, method=method)
        assert result.cost == pytest.approx(expected, rel=1e-7, abs=1e-7)
        assert abs(result.gap) < 1e-6
        assert result.certificate.feasible
        replayed = lfo.simulate(problem, result.control)
        assert np.abs(replayed.x - result.trajectory.x).max() < 1e-5


@expensive
@pytest.mark.parametrize(
    "fields",
    [
        {"cost": lfo.QuadraticCost(Q=np.eye(2), R=0.1) + lfo.costs.L1Cost(u=0.5)},
        {"state_set": lfo.sets.Soft(lfo.sets.Ball(radius=0.8), 5.0)},
        {"control_spectrum": lfo.MagnitudeBound(0.5, bins=[1, 2])},
        {"stage_rows": lfo.StageRows([[1.0, 1.0]], [[1.0]], [1.5])},
        {"cost": lfo.QuadraticCost(Q=[[2, 1.5], [1.5, 2]], R=0.3, S=[[0.2], [0.1]], P=[[3, -1], [-1, 1]])},
        {"initial_state": None},
        {"terminal_state": [0.2, 0.1]},
    ],
    ids=["L1", "soft ball", "mask", "rows", "full Hessian", "free start", "fixed end"],
)
def test_everything_that_linear_problems_have(fields):
    bounds = {"state_set": lfo.Box([-4, -4], [4, 4])} if "state_set" not in fields else {}
    if not bounds:
        fields = {"state_set": lfo.sets.Intersection([lfo.Box([-4, -4], [4, 4]), fields["state_set"]])}
    problem = random_problem(3, horizon=3, **fields)
    expected, _ = brute_force(problem)
    result = lfo.solve(problem)
    assert result.cost == pytest.approx(expected, rel=2e-7, abs=1e-7)
    assert abs(result.gap) < 1e-6


def test_the_root_relaxation_is_below_the_optimum():
    for problem in (random_problem(5, horizon=5), library.buck_affine(horizon=6)):
        relaxation = ModeRelaxation(problem)
        bound = solve_relaxation(relaxation, relaxation.reach.from_start(ones(problem))).bound
        assert np.isfinite(bound)
        assert bound <= lfo.solve(problem).cost + 1e-6


@expensive
@pytest.mark.parametrize("kinks", [1, 2])
def test_reach_holds_every_simulated_trajectory(kinks):
    problem = random_problem(11, horizon=6, n=3, kinks=kinks)
    reach, rng = ModeReach(problem), np.random.default_rng(0)
    whole = reach.from_start(ones(problem))
    inside = 0
    for _ in range(60):
        u = rng.uniform(problem.control_tube.lower, problem.control_tube.upper)
        x = lfo.simulate(problem, u).x
        if not problem.state_tube.contains(x).all():
            continue
        inside += 1
        sequence = problem.dynamics.sequence_of(x, u)
        assert whole.allowed[np.arange(6), sequence].all()
        assert (whole.lower <= x).all()
        assert (x <= whole.upper).all()
        narrowed = whole
        for t in rng.permutation(6):
            (narrowed,) = reach.after(narrowed, t, [np.arange(2**kinks) == sequence[t]])
            assert (narrowed.lower <= x).all()
            assert (x <= narrowed.upper).all()
        fresh = reach.from_start(np.arange(2**kinks) == sequence[:, None])
        assert (fresh.allowed == narrowed.allowed).all()
        y = np.hstack([x[:-1], u])
        assert (narrowed.mode_lower[np.arange(6), sequence] <= y).all()
        assert (y <= narrowed.mode_upper[np.arange(6), sequence]).all()
    assert inside > 5


@pytest.fixture(scope="module")
def solved():
    result = lfo.solve(library.buck_affine(horizon=8))
    assert result.tree_bound.leaves > 3
    return result


def test_a_tree_that_lost_a_leaf_proves_nothing(solved):
    nodes = solved.tree.nodes
    parents = {node.parent for node in nodes}
    leaves = [i for i in range(len(nodes)) if i not in parents and solved.tree_bound.bounds[i] < np.inf]
    for leaf in leaves[:4]:
        kept = [node for i, node in enumerate(nodes) if i != leaf]
        moved = tuple(replace(node, parent=node.parent - (node.parent > leaf)) for node in kept)
        assert tree_bound(solved.problem, ModeTree(moved)).value == -np.inf


def test_a_leaf_that_claims_too_few_modes_is_noticed(solved):
    nodes = list(solved.tree.nodes)
    root = nodes[0]
    smaller = root.allowed.copy()
    smaller[3] = [True, False]
    nodes[0] = replace(root, allowed=smaller)
    assert not tree_bound(solved.problem, ModeTree(tuple(nodes))).covers


@expensive
@pytest.mark.parametrize("change", ["eta", "region", "sign", "none", "other problem"])
def test_a_leaf_with_other_multipliers_proves_less(solved, change):
    nodes, weakest, problem = list(solved.tree.nodes), int(np.nanargmin(solved.tree_bound.bounds)), solved.problem
    if change == "region":  # a leaf for which they count
        weakest = max(range(len(nodes)), key=lambda i: 0.0 if nodes[i].proof is None else nodes[i].proof.region.sum())
    proof = nodes[weakest].proof
    given = proof.multipliers
    if change == "other problem":
        problem = library.buck_affine(horizon=8, initial_state=[0.55])
    changed = {
        "eta": replace(proof, multipliers=replace_eta(given, 1.1 * given.eta)),
        "sign": replace(proof, multipliers=replace_eta(given, -given.eta)),
        "region": replace(proof, region=-proof.region - 1.0),
        "none": None,
        "other problem": proof,
    }[change]
    nodes[weakest] = replace(nodes[weakest], proof=changed, bound=1e9)  # what a leaf says of itself does not count
    found = tree_bound(problem, ModeTree(tuple(nodes)))
    assert found.value <= lfo.solve(problem).cost + 1e-9
    if change != "other problem":
        assert found.bounds[weakest] < solved.tree_bound.bounds[weakest] - 1e-6


def replace_eta(multipliers, eta):
    parts = multipliers.mu, multipliers.nu, multipliers.rho_u, multipliers.rho_x, multipliers.stage
    return lfo.results.Multipliers(multipliers.eta_C, eta, *parts)


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_any_multipliers_bound_every_sequence_from_below(seed):
    problem, rng = (
        random_problem(seed, horizon=3, control_spectrum=lfo.stop_band(bins=[1])),
        np.random.default_rng(seed),
    )
    result = lfo.solve(problem, method="enumerate")
    nodes = []
    for node in result.tree.nodes:
        if node.proof is not None:
            own = node.proof.multipliers
            eta = own.eta + 0.1 * rng.normal(size=own.eta.shape)
            region = node.proof.region + rng.uniform(0, 0.1)
            node = replace(node, proof=replace(node.proof, multipliers=replace_eta(own, eta), region=region))
        nodes.append(node)
    assert tree_bound(problem, ModeTree(tuple(nodes))).value <= result.cost + 1e-9


def test_multipliers_of_regions_below_zero_prove_nothing():
    """The start is far inside of its region: such a multiplier would count the room that is left as cost."""
    result = lfo.solve(two_sides(), method="enumerate")
    proofs = [node.proof and replace(node.proof, region=node.proof.region - 1.0) for node in result.tree.nodes]
    nodes = tuple(replace(node, proof=proof) for node, proof in zip(result.tree.nodes, proofs, strict=True))
    assert any(proofs)
    assert tree_bound(result.problem, ModeTree(nodes)).value <= result.cost


def test_infeasible_is_proven_by_the_tree():
    problem = replace(library.pendulum_with_wall(horizon=4), terminal_state=[0.19, 1.4])
    with pytest.raises(lfo.errors.InfeasibleError, match="search tree") as caught:
        lfo.solve(problem)
    result = caught.value.result
    assert result.tree_bound.value == np.inf
    assert result.dual
    assert not result.primal
    assert result.cost is None
    assert result.lower_bound is None
    assert brute_force(problem)[0] == np.inf


@expensive
def test_limits_leave_a_point_and_a_valid_bound(notched):
    problem, best = NOTCHED, notched.cost
    stopped = lfo.solve(problem, node_limit=15, throw=False)
    assert stopped.status == "limit"
    assert "15 nodes" in stopped.message
    assert stopped.lower_bound <= best <= stopped.cost + 1e-9
    assert stopped.tree_bound.covers
    loose = lfo.solve(problem, tolerance=0.05)
    assert loose.status == "optimal"
    assert loose.gap <= 0.05
    assert len(loose.tree.nodes) < len(notched.tree.nodes)
    with pytest.raises(lfo.errors.LimitError, match="time limit"):
        lfo.solve(problem, time_limit=1e-9)


def test_an_interrupt_keeps_what_was_found():
    problem = NOTCHED
    seen = []

    def interrupt(progress):
        seen.append(progress)
        if len(seen) == 12:
            raise KeyboardInterrupt

    result = lfo.solve(problem, progress=interrupt, throw=False)
    assert result.interrupted
    assert result.status == "limit"
    assert result.primal
    assert result.lower_bound < result.cost
    bounds = [one.lower_bound for one in seen if np.isfinite(one.cost)]
    assert bounds == sorted(bounds)
    assert "open" in str(seen[-1])


def test_the_same_search_twice_is_the_same():
    first, second = (lfo.solve(library.buck_affine(horizon=8)) for _ in range(2))
    assert len(first.tree.nodes) == len(second.tree.nodes)
    assert first.cost == second.cost
    assert first.lower_bound == second.lower_bound


class Here(Executor):
    """Runs tasks when they are given; some of them are lost with their worker."""

    def __init__(self, lost=(), error=BrokenExecutor):
        self.lost, self.error, self.given = set(lost), error, 0

    def submit(self, function, /, *arguments, **named):
        future = Future()
        if self.given in self.lost:
            future.set_exception(self.error("the worker died"))
        else:
            future.set_result(function(*arguments, **named))
        self.given += 1
        return future


@expensive
def test_parts_searched_elsewhere_give_the_same_answer(monkeypatch, notched):
    substitute(monkeypatch, "methods.hybrid.PARTS", 6)
    for executor in (Here(), Here(lost=[0, 3])):
        result = lfo.solve(NOTCHED, executor=executor)
        assert executor.given >= 5
        assert result.cost == pytest.approx(notched.cost, rel=1e-9)
        assert abs(result.gap) < 1e-6
        assert result.tree_bound.covers


@expensive
@pytest.mark.parametrize("executor", [None, Here()])
def test_a_start_is_the_incumbent_from_the_first_node_on(monkeypatch, executor, notched):
    substitute(monkeypatch, "methods.hybrid.PARTS", 4)
    problem, seen, cold = NOTCHED, [], notched
    warm = lfo.solve(problem, start=cold.sequence, progress=seen.append, executor=executor)
    assert seen[0].nodes <= 3 + problem.horizon  # the sequence, its flips, and the root
    assert seen[0].cost == pytest.approx(cold.cost, rel=1e-6)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-9)
    assert len(warm.tree.nodes) <= 1.5 * len(cold.tree.nodes)


@expensive
def test_an_error_of_the_search_itself_is_raised(monkeypatch):
    substitute(monkeypatch, "methods.hybrid.PARTS", 6)
    with pytest.raises(ZeroDivisionError):
        lfo.solve(library.buck_affine(horizon=12), executor=Here(lost=[0], error=ZeroDivisionError))


@expensive
def test_parts_on_two_processes(monkeypatch, notched):
    substitute(monkeypatch, "methods.hybrid.PARTS", 6)
    with ProcessPoolExecutor(2) as executor:
        result = lfo.solve(NOTCHED, executor=executor)
    assert result.cost == pytest.approx(notched.cost, rel=1e-9)
    assert result.status == "optimal"


def test_what_is_refused(monkeypatch):
    hybrid, linear = library.buck_affine(horizon=4), library.double_integrator(horizon=4)
    with pytest.raises(lfo.errors.UnsupportedError, match="'convex', which is for linear and frequency-resp"):
        lfo.solve(hybrid, method="convex")
    with pytest.raises(lfo.errors.UnsupportedError, match="which is for piecewise-affine dynamics"):
        lfo.solve(linear, method="branch_and_bound")
    with pytest.raises(lfo.errors.UnsupportedError, match="backend: got 'osqp'"):
        lfo.solve(hybrid, method="branch_and_bound", backend="osqp")
    with pytest.raises(lfo.errors.UnsupportedError, match="executor"):
        lfo.solve(hybrid, method="enumerate", executor=Here())
    substitute(monkeypatch, "methods.hybrid.MOST_SEQUENCES", 100)
    with pytest.raises(lfo.errors.UnsupportedError, match="more than"):
        lfo.solve(library.buck_affine(horizon=12), method="enumerate")
    refusals = set()
    for method in ("auto", "branch_and_bound", "enumerate"):
        with pytest.raises(lfo.errors.UnsupportedError, match="no Box bounds it at t = 0") as refused:
            lfo.solve(random_problem(1, control_set=None, state_set=None), method)
        refusals.add(str(refused.value))
    assert len(refusals) == 1
    with pytest.raises(lfo.errors.UnsupportedError, match="eigenvalue"):
        lfo.solve(replace(hybrid, cost=lfo.QuadraticCost(Q=-1.0, R=1.0)))
    with pytest.raises(lfo.errors.UnsupportedError, match="node_limit"):
        lfo.solve(hybrid, node_limit=0)


def test_states_without_bounds_are_bounded_by_the_reach():
    problem = random_problem(2, horizon=3, state_set=None)
    assert lfo.solve(problem).cost == pytest.approx(brute_force(problem)[0], rel=1e-7)


@pytest.mark.parametrize("method", ["branch_and_bound", "enumerate", "miqp"])
@pytest.mark.parametrize("controls", [None, lfo.Box(-1, None), lfo.Box(-1, 1e9), lfo.Box(None, 1.5)])
def test_controls_with_one_bound_are_bounded_by_the_states(controls, method):
    """In any unit of the controls; far bounds hid the optimum from relaxations."""
    problem = random_problem(2, horizon=3, control_set=controls)
    expected = brute_force(problem)[0]
    for unit in (1.0, 1e-6):
        modes = [
            lfo.AffineMode(mode.linear.A, mode.linear.B / unit, mode.linear.offset, G=part.C, H=part.D / unit, h=part.e)
            for mode in problem.dynamics.modes
            for part in [mode.region]
        ]
        cost = replace(problem.cost, R=problem.cost.R / unit**2)
        box = lfo.Box(*(np.where(np.abs(side) > 1e8, side, side * unit) for side in problem.control_tube.at(0).bounds))
        scaled = replace(problem, dynamics=lfo.PiecewiseAffineDynamics(modes), cost=cost, control_set=box)
        result = lfo.solve(scaled, method)
        assert (result.status, result.bound) == ("optimal", "rigorous")
        assert result.cost == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("method", ["branch_and_bound", "enumerate"])
@pytest.mark.parametrize(
    "control_set", [lfo.Box(-1.5, 1.5), lfo.sets.Ball(1.5), lfo.sets.Polyhedron([[1], [-1]], [1, 2])]
)
def test_rows_bound_the_control_before_the_first_one(control_set, method):
    """The control before is as free as the first one: |u_0 - u_before| <= 0.4 bounds it."""
    problem = lfo.rate_limited(random_problem(2, horizon=3, control_set=control_set), 0.4)
    result = lfo.solve(problem, method)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(brute_force(problem)[0], rel=1e-6)


def test_modes_without_a_cost_are_searched_for_any_trajectory():
    problem = random_problem(1, cost=lfo.QuadraticCost(Q=np.zeros((2, 2)), R=np.zeros((1, 1))))
    assert lfo.solve(problem).status == "optimal"


def test_a_mode_that_grows_by_itself_is_held_by_controls_that_cost_little():
    """Of one mode alone, without bounds, the cost asks for no control: units from there called its program infeasible.

    The cost is 0.626856 by SCIP as well, with mode 1 at all times.
    """
    B = [[-0.9825577153853514, 0.7724928859368677]]
    modes = [
        lfo.AffineMode([[-1.3693997696352682]], B, None, [[1.1947954284082145]], None, [-0.5]),
        lfo.AffineMode([[1.191471097849243]], B, [1.0716775468819264], [[-1.1947954284082145]], None, [0.5]),
    ]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        6,
        lfo.QuadraticCost(R=np.diag([0.5269730895982185, 0.8117865279220953])),
        control_set=lfo.Box(-1.8423, 1.8423),
        state_set=lfo.Box(-2.9920847292474027, 2.9920847292474027),
        initial_state=[0.0],
    )
    assert lfo.solve(problem).cost == pytest.approx(0.626856, abs=1e-6)
    alone = lfo.solve(problem.with_modes([1] * 6))
    assert alone.cost == pytest.approx(0.626856, abs=1e-6)
    assert alone.certificate.globally_optimal


def feasible(problem, sequence):
    """Whether a mode sequence has a trajectory, by a linear program in the controls alone."""
    T, m, modes = problem.horizon, problem.control_dim, piecewise_affine(problem).modes
    x, of_u = problem.initial_box.lower, np.zeros((problem.state_dim, T * m))
    rows, limits = [], []
    for t, mode in enumerate(modes[i] for i in sequence):
        own = np.eye(T * m)[t * m : (t + 1) * m]
        rows.append(mode.region.C @ of_u + mode.region.D @ own if mode.region.D.size else mode.region.C @ of_u)
        limits.append(mode.region.e - mode.region.C @ x)
        x = mode.linear.A @ x + mode.linear.offset
        of_u = mode.linear.A @ of_u + mode.linear.B @ own
        rows += [of_u, -of_u]
        limits += [problem.state_set.upper - x, x - problem.state_set.lower]
    bound = float(problem.control_set.upper[0])
    return linprog(np.zeros(T * m), np.vstack(rows), np.concatenate(limits), bounds=(-bound, bound)).status == 0


def test_units_come_from_all_modes():
    """In those of mode 0, which needs no control, a relaxation without a point was called solved."""
    rng = np.random.default_rng(22)
    n, m, T = int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(3, 7))
    first, _, B = rng.normal(size=(n, n)) * 1.1, rng.normal(size=(n, n)), rng.normal(size=(n, m))
    g, v, h = rng.normal(size=(1, n)), rng.normal(size=n), rng.normal() * 0.5
    bound = rng.uniform(1, 3)
    modes = [
        lfo.AffineMode(first, B, None, g, None, [h]),
        lfo.AffineMode(first + np.outer(v, g[0]), B, -v * h, -g, None, [-h]),
    ]
    weights = rng.uniform(0.3, 1, m), np.eye(n) * rng.choice([0, 1.0])
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        T,
        lfo.QuadraticCost(R=np.diag(weights[0]), Q=weights[1]),
        control_set=lfo.Box(-bound * np.ones(m), bound * np.ones(m)),
        state_set=lfo.Box(-3 * np.ones(n), 3 * np.ones(n)),
        initial_state=rng.normal(size=n) * 0.5,
    )
    assert not any(feasible(problem, sequence) for sequence in product(range(2), repeat=T))
    assert lfo.solve(problem, throw=False).status == "infeasible"
