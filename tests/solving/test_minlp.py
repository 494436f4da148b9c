"""SCIP's second opinion on piecewise-smooth problems, and what of it is believed."""

import os
import signal
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.modes import random_problem
from lin_freq_ocp import library
from lin_freq_ocp.backends.base import Claim
from lin_freq_ocp.backends.mixed import nonlinear_backend
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.nonsmooth import minlp
from lin_freq_ocp.methods.nonsmooth.minlp import solve_minlp
from lin_freq_ocp.solving import smooth as solve_smooth
from lin_freq_ocp.transcription.smooth import smooth_program

BUCK, NORM = library.buck_converter, library.norm_dynamics

REFERENCES = [  # shared/reference/nonsmooth.json
    (BUCK, {"horizon": 3}, 17.345547997984184),
    (BUCK, {"horizon": 4}, 22.36493035150289),
    (BUCK, {"control_spectrum": [3, 4, 5]}, 44.69913880875864),
    (NORM, {"initial_state": (0.0, 1.0), "horizon": 3}, 1.0),
    (NORM, {"initial_state": (1.0, 0.0), "horizon": 3}, 1.959023692803284),
]


@pytest.mark.parametrize(("build", "arguments", "cost"), REFERENCES)
def test_the_reference_values_are_found_and_certified_by_us(monkeypatch, build, arguments, cost):
    problem, claims = build(**arguments), []
    monkeypatch.setattr(solve_smooth, "solve_minlp", lambda *asked: claims.append(solve_minlp(*asked)) or claims[0])
    result = lfo.solve(problem, method="minlp", backend="scip")
    claim = claims[0]
    assert claim.status == "optimal"
    assert claim.cost == pytest.approx(cost, rel=1e-5)
    assert cost * (1 - 1e-5) < claim.bound < cost * (1 + 1e-8)
    assert result.cost == pytest.approx(cost, rel=1e-8)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.worst.relative <= 1e-8
    replay = lfo.simulate(problem, result.control)
    np.testing.assert_allclose(replay.x, result.trajectory.x, atol=1e-9)
    assert result.claimed_bound == claim.bound
    assert (result.lower_bound, result.dual) == (None, False)
    assert "by the word of scip" in result.message
    assert "not proven" in result.message


def smooth(affine):
    """Return a piecewise-affine problem with its modes written as formulas."""

    def mode(one):
        A, B, offset = (np.asarray(part) for part in (one.linear.A, one.linear.B, one.linear.offset))
        G, H, h = (np.asarray(part) for part in (one.region.C, one.region.D, one.region.e))
        return lfo.SmoothMode(
            lambda x, u: [a @ x + b @ u + d for a, b, d in zip(A, B, offset, strict=True)],
            lambda x, u: [a @ x + b @ u - d for a, b, d in zip(G, H, h, strict=True)],
        )

    modes = [mode(one) for one in affine.dynamics.modes]
    return replace(affine, dynamics=lfo.PiecewiseSmoothDynamics(modes, affine.state_dim, affine.control_dim))


@pytest.mark.parametrize(
    ("seed", "fields"),
    [
        (0, {"kinks": 2, "horizon": 3, "control_spectrum": lfo.stop_band(bins=[1])}),
        (1, {"control_spectrum": lfo.MagnitudeBound(0.4, bins=[1])}),
        (2, {"state_set": lfo.Ball(2.5), "terminal_state": lfo.Box(-0.5, 0.5)}),
        (4, {"stage_rows": lfo.StageRows([[1.0, 0.5]], [[1.0]], [0.1], penalty=2.0)}),
        (5, {"cost": lfo.QuadraticCost(Q=0.2, R=0.1, q=[0.3, 0.0], r=[-0.2]) + lfo.L1Cost(u=0.3)}),
        (6, {"state_spectrum": lfo.EnergyBound(0.5, bins=[1, 2], component=0), "initial_state": lfo.Box(-0.5, 0.5)}),
    ],
    ids=["bins, 4 modes", "mask", "ball", "soft rows", "L1", "energy, free start"],
)
def test_affine_modes_as_formulas_agree_with_branch_and_bound(seed, fields):
    affine = random_problem(seed, **fields)
    best = lfo.solve(affine).cost
    claim = solve_minlp(smooth(affine))
    assert claim.status == "optimal"
    assert claim.cost == pytest.approx(best, rel=1e-5)
    assert claim.bound <= best * (1 + 1e-6)


SHIFTED = [  # every kind of node; a map, where it is defined
    (lambda x, u: [x[0] + 0.2 * np.sin(x[1]) + u[0], 0.5 * np.cos(x[0]) + np.exp(-(x[1] ** 2)) * u[0]], ()),
    (lambda x, u: [abs(x[0]) ** 3 * 0.3 + u[0], lfo.norm(x) - (x[0] * x[1]) ** 4], ()),
    (lambda x, u: [np.sqrt(x[0] ** 2 + 1) - u[0], u[0] / (2 + x[1]) + lfo.maximum(x[0], x[1]) * 0.5], ()),
    (lambda x, u: [1 + np.log(x[0] + 1) / (1 + x[0] ** 2) + u[0], x[0] * 0.5], lambda x, u: [x[0] + 1]),
]


@pytest.mark.parametrize(("f", "domain"), SHIFTED)
def test_a_simulated_trajectory_is_a_point_of_the_program(f, domain):
    """Its controls are what the cost asks for: the least cost is 0, and that is the trajectory."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 2, 1, domain=domain)
    wanted = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 1))
    cost = lfo.QuadraticCost(R=2.0, u_ref=wanted)
    problem = lfo.OptimalControlProblem(dynamics, 3, cost, control_set=lfo.Box(-1, 1), initial_state=[0.6, -0.4])
    claim, trajectory = solve_minlp(problem), lfo.simulate(problem, wanted)
    assert claim.status == "optimal"
    assert claim.cost == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(claim.trajectory.u, wanted, atol=2e-3)
    again = lfo.simulate(problem, claim.trajectory.u)
    np.testing.assert_allclose(claim.trajectory.x, again.x, atol=1e-5)
    np.testing.assert_allclose(again.x, trajectory.x, atol=1e-2)


PARTIAL = {
    "log": [
        lfo.SmoothMode(lambda x, u: [np.log(x[0]) + u[0]], lambda x, u: [1 - x[0]], lambda x, u: [x[0]]),
        lfo.SmoothMode(lambda x, u: [x[0] - 1 + u[0]], lambda x, u: [x[0] - 1]),
    ],
    "sqrt": [
        lfo.SmoothMode(lambda x, u: [np.sqrt(x[0]) + u[0]], lambda x, u: [-x[0]]),
        lfo.SmoothMode(lambda x, u: [x[0] + u[0]], lambda x, u: [x[0]]),
    ],
    "quotient": [
        lfo.SmoothMode(lambda x, u: [u[0] / x[0]], lambda x, u: [1 - x[0]], lambda x, u: [x[0]]),
        lfo.SmoothMode(lambda x, u: [u[0] * (2 - x[0])], lambda x, u: [x[0] - 1]),
    ],
}
"""Pieces that are not defined where another mode holds: nothing of them may bind there."""

STEPS = {
    "log": lambda x, u: np.where(x >= 1, np.log(np.maximum(x, 1.0)), x - 1) + u,
    "sqrt": lambda x, u: np.where(x >= 0, np.sqrt(np.maximum(x, 0.0)), x) + u,
    "quotient": lambda x, u: np.where(x >= 1, u / np.maximum(x, 1.0), u * (2 - x)),
}
"""The same, as functions of arrays."""


@pytest.mark.parametrize("kind", list(PARTIAL))
def test_a_piece_binds_nothing_where_it_is_not_defined(kind):
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics(PARTIAL[kind], 1, 1),
        2,
        lfo.QuadraticCost(Q=2.0, R=0.4, P=2.0, x_ref=[-1.0]),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-3, 3),
        initial_state=[0.8 if kind == "sqrt" else 1.5],
    )
    result = lfo.solve(problem, method="minlp")
    u0, u1 = np.meshgrid(*[np.linspace(-1, 1, 801)] * 2)
    x0 = problem.initial_box.lower[0]
    x1 = STEPS[kind](x0, u0)
    x2 = STEPS[kind](x1, u1)
    costs = (x0 + 1) ** 2 + (x1 + 1) ** 2 + (x2 + 1) ** 2 + 0.2 * (u0**2 + u1**2)
    least = costs[np.maximum(abs(x1), abs(x2)) <= 3].min()
    assert set(result.sequence) == {0, 1}
    assert least - 1e-3 < result.cost <= least + 1e-9
    assert result.claimed_bound <= result.cost * (1 + 1e-6)
    assert result.certificate.pmp == "satisfied"


def test_a_piece_that_is_defined_nowhere_excludes_nothing_else():
    modes = [
        lfo.SmoothMode(lambda x, u: [np.sqrt(x[0] - 10) + u[0]], lambda x, u: [3 - x[0]]),
        lfo.SmoothMode(lambda x, u: [x[0] + u[0]], lambda x, u: [x[0] - 3]),
    ]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics(modes, 1, 1),
        3,
        lfo.QuadraticCost(Q=2.0, R=2.0, P=2.0),
        control_set=lfo.Box(-2, 2),
        initial_state=[1.5],
    )
    assert not smooth_program(problem).possible[:, 0].any()
    assert lfo.solve(problem, method="minlp").cost == pytest.approx(3.634615384615385, rel=1e-8)


@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_units_do_not_matter(factor):
    """The current of x+ = sqrt(x^2 + 1)/2 + u x + log(2 + u), in other units."""

    def f(x, u):
        i = x[0] * (1 / factor)
        return [factor * (np.sqrt(i**2 + 1) * 0.5 + u[0] * i + np.log(2 + u[0]))]

    def problem(map_of_x, size):
        return lfo.OptimalControlProblem(
            lfo.PiecewiseSmoothDynamics.from_formulas(map_of_x, 1, 1),
            3,
            lfo.QuadraticCost(Q=2 / size**2, R=2.0, P=2 / size**2),
            control_set=lfo.Box(-1, 1),
            initial_state=[0.8 * size],
        )

    plain = problem(lambda x, u: [np.sqrt(x[0] ** 2 + 1) * 0.5 + u[0] * x[0] + np.log(2 + u[0])], 1.0)
    assert solve_minlp(problem(f, factor)).cost == pytest.approx(solve_minlp(plain).cost, rel=2e-6)


def test_states_and_controls_without_bounds_are_indicators():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [abs(x[0]) + u[0]], 1, 1)
    problem = lfo.OptimalControlProblem(dynamics, 3, lfo.QuadraticCost(Q=2.0, R=2.0, P=2.0), initial_state=[1.5])
    result = lfo.solve(problem, method="minlp")
    assert result.cost == pytest.approx(3.634615384615385, rel=1e-8)
    assert result.claimed_bound <= result.cost * (1 + 1e-6)
    endless = replace(problem, cost=lfo.QuadraticCost(p=[-1.0]))
    result = lfo.solve(endless, method="minlp", throw=False)
    assert (result.status, result.claimed_bound, result.dual) == ("unbounded", -np.inf, False)
    with pytest.raises(lfo.UnboundedError):
        lfo.solve(endless, method="minlp")


def test_an_end_out_of_reach_is_infeasible_and_it_is_said_who_says_so():
    result = lfo.solve(BUCK(horizon=1, terminal_state=[0.1]), method="minlp", throw=False)
    assert (result.status, result.dual, result.trajectory) == ("infeasible", True, None)
    assert "proven by dynamic programming with intervals" in result.message
    far = replace(NORM(horizon=2), terminal_state=[0.0, 5.0])
    result = lfo.solve(far, method="minlp", throw=False)
    assert (result.status, result.dual) == ("infeasible", True)
    assert "proven by intervals" in result.message
    still = NORM(horizon=3, control_spectrum=[0], terminal_state=[0.5, 0.0])  # sum u = 0 and u >= 0: nothing moves
    result = lfo.solve(still, method="minlp", throw=False, time_limit=2.0)
    assert (result.status, result.dual, result.claimed_bound) == ("infeasible", False, np.inf)
    assert result.message.endswith("not proven")


def test_a_time_limit_keeps_the_best_point_and_says_so():
    result = lfo.solve(BUCK(v_min=None, v_max=None), method="minlp", time_limit=1.0, throw=False)
    assert result.status == "limit"
    assert "timelimit" in result.message
    assert result.claimed_bound < 11.2218258
    if result.trajectory is not None:
        assert result.cost >= 11.2218258
        assert result.certificate.feasible


@pytest.mark.skipif(os.name != "posix", reason="a process cannot send itself Ctrl-C there")
def test_ctrl_c_stops_scip_with_the_best_point_so_far():
    before, stop = signal.getsignal(signal.SIGINT), threading.Event()

    def send():
        while not stop.wait(0.01):
            if signal.getsignal(signal.SIGINT) is not before:
                stop.wait(0.3)
                os.kill(os.getpid(), signal.SIGINT)
                return

    sender = threading.Thread(target=send)
    sender.start()
    try:
        claim = solve_minlp(BUCK(v_min=None, v_max=None), time_limit=60)
    finally:
        stop.set()
        sender.join()
    assert claim.status == "interrupted"
    assert claim.seconds["solve"] < 20
    assert signal.getsignal(signal.SIGINT) is before


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    with pytest.raises(lfo.MissingExtraError, match=r"pyscipopt.*pip install 'lin-freq-ocp\[scip\]'"):
        lfo.solve(BUCK(horizon=2), method="minlp")


def test_what_cannot_be_taken_is_refused():
    problem = BUCK(horizon=2)
    with pytest.raises(lfo.UnsupportedError, match="'daqp'; expected 'scip'"):
        lfo.solve(problem, method="minlp", backend="daqp")
    with pytest.raises(lfo.UnsupportedError, match="eigenvalue -1"):
        lfo.solve(replace(problem, cost=lfo.QuadraticCost(R=-1.0)), method="minlp")
    with pytest.raises(lfo.UnsupportedError, match="'minlp'"):
        lfo.solve(library.pendulum(horizon=10), method="minlp")
    with pytest.raises(lfo.UnsupportedError, match="'minlp'"):
        lfo.solve(library.buck_affine(horizon=2), method="minlp")
    with pytest.raises(lfo.UnsupportedError, match="expected PiecewiseSmoothDynamics"):
        solve_minlp(library.buck_affine(horizon=2))


def claiming(monkeypatch, change):
    """Let SCIP return what ``change`` makes of its answer."""
    real = nonlinear_backend("scip")
    monkeypatch.setattr(minlp, "nonlinear_backend", lambda name: lambda *asked: change(real(*asked)))


def test_wrong_claims_are_told(monkeypatch):
    problem = BUCK(horizon=3)
    claiming(monkeypatch, lambda found: replace(found, bound=found.bound * 1.01))
    result = lfo.solve(problem, method="minlp")
    assert "is above the cost" in result.message
    claiming(monkeypatch, lambda found: replace(found, claim=Claim.FAILED, z=None))
    assert lfo.solve(problem, method="minlp", throw=False).status == "numerical_error"

    def spoiled(found):
        z = found.z.copy()
        z[1:3] += 0.2
        return replace(found, z=z)

    claiming(monkeypatch, spoiled)
    result = lfo.solve(problem, method="minlp", throw=False)
    assert "of the trajectory it leads to" in result.message
    assert judge(problem, result.trajectory, result.multipliers).feasible


def test_modes_that_cannot_hold_are_left_out_and_equal_nodes_are_shared():
    problem = BUCK(horizon=4)
    program = smooth_program(problem)
    assert program.possible.all()
    on, off = program.modes
    assert off.domain[0] in off.f[0].arguments[0].arguments
    assert on.region[0] is not off.region[0]
    low = replace(BUCK(horizon=2, terminal_state=None), initial_state=[0.0], control_set=lfo.Box(2.2, 2.3))
    assert (smooth_program(low).possible[0] == [True, False]).all()


def test_scip_is_silent_and_repeats_itself(capfd):
    problem = BUCK(horizon=3)
    first, second = solve_minlp(problem), solve_minlp(problem)
    assert capfd.readouterr() == ("", "")
    assert (first.cost, first.bound, first.words) == (second.cost, second.bound, second.words)
