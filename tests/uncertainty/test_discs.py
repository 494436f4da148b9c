"""Plans that hold for every plant within discs of a frequency response, and the plants that attain their limits."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.program import LinearProgram, passed_bins_of
from lin_freq_ocp.uncertainty import radius_of_coherence


def converter(N: int = 100, stroke: float = 1.0, force: float = 1500.0) -> lfo.OptimalControlProblem:
    return lfo.library.wave_energy(force, horizon=N, stroke=stroke)


@pytest.fixture(scope="module")
def limited() -> lfo.OptimalControlProblem:
    free = lfo.solve(converter())
    return converter(stroke=0.85 * float(np.abs(free.trajectory.x[:, 1]).max()))


def outputs(problem: lfo.OptimalControlProblem, G: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the outputs (record, p) of a plant, by its definition."""
    N = problem.dynamics.record(problem.horizon)
    spectrum = np.fft.rfft(u, n=N, axis=0)
    return np.fft.irfft(np.einsum("kij,kj->ki", G, spectrum) + problem.dynamics.offset, n=N, axis=0)


def random_plants(rng: np.random.Generator, G: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return a plant of the discs, half of its entries on their circles."""
    size = np.where(rng.random(G.shape) < 0.5, 1.0, np.sqrt(rng.random(G.shape)))
    change = size * radius * np.exp(2j * np.pi * rng.random(G.shape))
    change[[0, -1]] = change[[0, -1]].real
    return G + change


def small(rng: np.random.Generator, mode: str, shape: tuple[int, int]) -> lfo.OptimalControlProblem:
    """Return a random problem with a joint row, of 12 steps."""
    T, (p, m) = 12, shape
    bins = (T if mode == "periodic" else 2 * T) // 2 + 1
    G = rng.standard_normal((bins, p, m)) + 1j * rng.standard_normal((bins, p, m))
    G[[0, -1]] = G[[0, -1]].real
    plant = lfo.FrequencyResponse(G, 0.1, 0.2 * np.ones((bins, p)), mode=mode)
    cost = lfo.QuadraticCost(Q=1.0, R=0.5, x_ref=rng.standard_normal(p))
    rows = lfo.StageRows(rng.standard_normal((1, p)), rng.standard_normal((1, m)), [1.2], name="joint")
    return lfo.OptimalControlProblem(plant, T, cost, lfo.Box(-1.0, 1.0), lfo.Box(-1.0, 1.5), stage_rows=rows)


@expensive
def test_the_stroke_holds_for_every_plant_and_costs_what_a_cone_program_finds():
    """Figures of the design, by a cone program in the passed bins: 96.4205, 95.3253 and 82.6488 W."""
    free = lfo.solve(converter(400, force=2000.0))
    problem = converter(400, 0.85 * float(np.abs(free.trajectory.x[:, 1]).max()), 2000.0)
    radius = 0.05 * np.abs(problem.dynamics.G)
    found = lfo.solve(lfo.robust(problem, lfo.Discs(radius)))
    assert found.status == "optimal"
    assert -lfo.solve(problem).cost == pytest.approx(96.42045902, abs=1e-6)
    assert -found.cost == pytest.approx(95.325319256, abs=1e-6)
    guaranteed = lfo.solve(lfo.robust(problem, lfo.Discs(radius, cost="worst")))
    assert guaranteed.status == "optimal"
    assert -guaranteed.cost == pytest.approx(82.6488, abs=1e-4)
    larger = problem.dynamics.G + radius
    own = found.trajectory.u[:, 0]
    assert -(outputs(problem, larger, found.trajectory.u)[:, 0] * own).mean() == pytest.approx(82.5587, abs=1e-4)
    assert (outputs(problem, larger, guaranteed.trajectory.u)[:, 0] * guaranteed.trajectory.u[:, 0]).mean() == (
        pytest.approx(guaranteed.cost, rel=1e-9)
    )


@expensive
def test_the_returned_plant_attains_the_limit_and_no_other_exceeds_it(limited):
    discs = lfo.Discs(0.05 * np.abs(limited.dynamics.G))
    found, nominal = lfo.solve(lfo.robust(limited, discs)), lfo.solve(limited)
    worst, broken = lfo.worst_case(limited, discs, found), lfo.worst_case(limited, discs, nominal)
    assert worst
    assert not broken
    assert "position, upper by up to" in broken.verdict
    for one in (worst["position, upper"], worst["position, lower"], broken["position, upper"]):
        assert (np.abs(one.plant - limited.dynamics.G) <= discs.radius * (1 + 1e-12)).all()
        plan = found if one is not broken["position, upper"] else nominal
        value = outputs(limited, one.plant, plan.trajectory.u)[one.index % limited.horizon, 1]
        assert one.attained == pytest.approx(value, abs=1e-14)
        assert one.sign * one.attained == pytest.approx(one.sign * one.planned + one.margin, rel=1e-13)
    assert worst["position, upper"].attained == pytest.approx(limited.state_set.upper[1], rel=1e-8)
    rng, limit, u = np.random.default_rng(0), limited.state_set.upper[1], found.trajectory.u
    spectrum, base = np.fft.rfft(u[:, 0]), limited.dynamics.offset[:, 1]
    of_u, radius, over = limited.dynamics.G[:, 1, 0], discs.radius[:, 1, 0], []
    for _ in range(50):  # 1e5 plants
        size = np.where(rng.random((2000, 51)) < 0.5, 1.0, np.sqrt(rng.random((2000, 51))))
        change = size * radius * np.exp(2j * np.pi * rng.random((2000, 51)))
        change[:, [0, -1]] = change[:, [0, -1]].real
        over.append(np.abs(np.fft.irfft((of_u + change) * spectrum + base, n=100)).max() - limit)
    assert max(over) <= 1e-9 * limit


@pytest.mark.parametrize("mode", ["periodic", "zero-padded"])
@pytest.mark.parametrize("seed", seeds(range(4)))
def test_several_controls_and_outputs_cost_what_a_program_stated_by_hand_costs(seed, mode):
    rng = np.random.default_rng(seed)
    problem = small(rng, mode, (2, 2))
    radius = 0.05 * rng.random(problem.dynamics.G.shape)
    found = lfo.solve(lfo.robust(problem, lfo.Discs(radius)))
    assert found.status == "optimal"
    T, (bins, p, m), response = problem.horizon, radius.shape, problem.response
    u, N = cp.Variable(T * m), response.record
    y = response.matrix @ u + response.base.ravel()
    waves = np.exp(-2j * np.pi * np.outer(np.arange(bins), np.arange(T)) / N)
    sizes = [cp.norm(np.vstack([w.real, w.imag]) @ u[j::m]) for j in range(m) for w in waves]
    weights = np.where((np.arange(bins) == 0) | (2 * np.arange(bins) == N), 1.0, 2.0) / N
    margin = [
        sum(weights[k] * radius[k, i, j] * sizes[j * bins + k] for j in range(m) for k in range(bins)) for i in range(p)
    ]
    rows, limits = problem.stage_rows[0], []
    for t in range(T + 1):
        at = [y[t * p + i] for i in range(p)]
        limits += [at[i] + margin[i] <= 1.5 for i in range(p)] + [-at[i] + margin[i] <= 1.0 for i in range(p)]
        if t < T:
            added = sum(abs(rows.C[0, i]) * margin[i] for i in range(p))
            controls = rows.D[0] @ u[t * m : (t + 1) * m]
            limits.append(sum(rows.C[0, i] * at[i] for i in range(p)) + controls + added <= 1.2)
    reference = np.tile(problem.cost.x_ref, T)
    cost = 0.5 * cp.sum_squares(y[: T * p] - reference) + 0.25 * cp.sum_squares(u)
    program = cp.Problem(cp.Minimize(cost), [*limits, cp.abs(u) <= 1.0])
    program.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    assert found.cost == pytest.approx(program.value, rel=1e-7)
    worst = lfo.worst_case(problem, lfo.Discs(radius), found)
    assert worst
    for one in worst.limits:
        assert one.sign * one.attained == pytest.approx(one.sign * one.planned + one.margin, abs=1e-12)
    for _ in range(100):
        reached = outputs(problem, random_plants(rng, problem.dynamics.G, radius), found.trajectory.u)[: T + 1]
        assert reached.max() <= 1.5 + 1e-8
        assert reached.min() >= -1.0 - 1e-8


@pytest.mark.parametrize("cost", ["nominal", "worst"])
def test_masks_of_outputs_hold_for_every_plant_and_are_attained_at_their_worst_phase(limited, cost):
    masked = replace(limited, state_spectrum=lfo.MagnitudeBound(3.0, bins=[5, 6], component="velocity [m/s]"))
    discs = lfo.Discs(0.1 * np.abs(limited.dynamics.G), cost=cost)
    plan = lfo.solve(lfo.robust(masked, discs))
    assert plan.status == "optimal"
    worst = lfo.worst_case(masked, discs, plan)
    one = worst["mask on velocity [m/s]"]
    u = np.fft.rfft(plan.trajectory.u[:, 0])[one.index]
    assert worst
    assert one.planned == pytest.approx(abs(np.fft.rfft(plan.trajectory.x[:-1, 0])[one.index]))
    assert one.margin == pytest.approx(discs.radius[one.index, 0, 0] * abs(u))
    assert one.planned + one.margin == pytest.approx(3.0, rel=1e-7)
    assert (np.abs(one.plant - limited.dynamics.G) <= discs.radius * (1 + 1e-12)).all()
    under = outputs(limited, one.plant, plan.trajectory.u)[:, 0]
    assert one.attained == pytest.approx(abs(np.fft.rfft(under)[one.index]), rel=1e-12) == pytest.approx(3.0, rel=1e-7)
    broken = lfo.worst_case(masked, discs, lfo.solve(masked))
    assert not broken["mask on velocity [m/s]"].holds


def test_several_masks_at_several_plants_of_two_controls_cost_what_a_program_stated_by_hand_costs():
    rng = np.random.default_rng(3)
    problem = small(rng, "periodic", (2, 2))
    free = lfo.solve(replace(problem, stage_rows=None, state_set=None)).trajectory
    sizes = np.abs(np.fft.rfft(free.x[:-1, 1]))
    levels, radius = 0.8 * sizes[[1, 6]], 0.05 * rng.random(problem.dynamics.G.shape)
    mask = lfo.MagnitudeBound(levels, bins=[1, 6], component=1)
    masked = replace(problem, stage_rows=None, state_set=None, state_spectrum=mask)
    found = lfo.solve(lfo.robust(masked, lfo.Discs(radius)))
    assert found.status == "optimal"
    T, response = problem.horizon, problem.response
    u = cp.Variable(T * 2)
    y = response.matrix @ u + response.base.ravel()
    waves = np.exp(-2j * np.pi * np.outer([1, 6], np.arange(T)) / T)
    pairs = [np.vstack([w.real, w.imag]) for w in waves]
    limits = [
        cp.norm(pair @ y[1 : T * 2 : 2]) + sum(radius[k, 1, j] * cp.norm(pair @ u[j::2]) for j in range(2)) <= level
        for pair, k, level in zip(pairs, (1, 6), levels, strict=True)
    ]
    cost = 0.5 * cp.sum_squares(y[: T * 2] - np.tile(problem.cost.x_ref, T)) + 0.25 * cp.sum_squares(u)
    program = cp.Problem(cp.Minimize(cost), [*limits, cp.abs(u) <= 1.0])
    program.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    assert found.cost == pytest.approx(program.value, rel=1e-7)
    assert lfo.worst_case(masked, lfo.Discs(radius), found)


@pytest.mark.parametrize(
    ("mask", "judged"),
    [
        (lfo.spectrum.EnergyBound(300.0, bins=[5], component=0), True),
        (lfo.stop_band(bins=[30], component=0), True),
        (lfo.MagnitudeBound(3.0, bins=[10], oversampling=2, component=0), False),
        (lfo.MagnitudeBound(3.0, bins=[5], window="hann", component=0), False),
    ],
)
def test_other_spectra_of_outputs_hold_for_the_plan(limited, mask, judged):
    masked, discs = replace(limited, state_spectrum=mask), lfo.Discs(0.1 * np.abs(limited.dynamics.G))
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="stop bands, energies and masks between bins of outputs"):
        plans = lfo.robust(masked, discs)
    if judged:
        (leak,) = lfo.worst_case(masked, discs, lfo.solve(masked)).leakage
        assert leak.attained == pytest.approx(leak.planned + leak.margin, rel=1e-9, abs=1e-12)
    else:
        with pytest.raises(lfo.errors.UnsupportedError, match=r"mask on velocity.*expected bins of a periodic one"):
            lfo.worst_case(plans.given, discs, lfo.solve(masked))


@expensive
def test_a_long_record_is_solved_by_few_of_its_rows():
    """The control has 50 harmonics; the limits are those of all 4000 samples."""
    problem = converter(4000, 0.26)
    nominal, discs = lfo.solve(problem, method="convex"), lfo.Discs(0.05 * np.abs(problem.dynamics.G))
    problem = converter(4000, 0.85 * float(np.abs(nominal.trajectory.x[:, 1]).max()))
    found = lfo.solve(lfo.robust(problem, discs))
    assert (found.status, found.method) == ("optimal", "convex")
    worst = lfo.worst_case(problem, discs, found)
    assert worst
    assert worst["position, upper"].attained == pytest.approx(problem.state_set.upper[1], rel=1e-7)
    assert lfo.solve(problem, method="convex").cost == pytest.approx(lfo.solve(problem, method="spectral").cost)


@pytest.mark.parametrize("N", [100, 4000])
def test_rows_of_a_long_record_keep_the_units_of_their_outputs(N):
    """Spectra sum up N samples: in their unit, 1e-9 of a row of 1e5 samples would be 2e-7 of its limit."""
    plan = lfo.robust(converter(N, 0.13), lfo.Discs(1e-6))
    linear = LinearProgram(plan)
    bins = passed_bins_of(linear, plan.response, linear.column_units([0.5, 0.125], [1024.0]))
    assert set(bins.rows[3][bins.single].tolist()) == {0.125, 1024.0}
    assert np.abs(bins.program(~bins.single).A).max() == pytest.approx(1.0)


def test_no_plan_for_wide_discs_is_proven_by_a_ray(limited):
    tight = replace(limited, state_set=lfo.Box([None, -0.03], [None, 0.03]))
    assert lfo.solve(tight, throw=False).status == "optimal"
    found = lfo.solve(lfo.robust(tight, lfo.Discs(0.9 * np.abs(limited.dynamics.G))), throw=False)
    assert found.status == "infeasible"
    assert "rigorous ray" in found.message


def test_discs_of_radius_zero_change_nothing(limited):
    nothing = lfo.Discs(0.0)
    found = lfo.solve(lfo.robust(limited, nothing))
    assert found.cost == pytest.approx(lfo.solve(limited).cost, rel=1e-11)
    assert lfo.worst_case(limited, nothing, found)["position, upper"].margin == 0.0


def test_bins_count_twice_but_the_first_and_the_last(limited):
    """Margins with a weight of 1 throughout would miss about half of what the returned plant does."""
    discs, found = lfo.Discs(0.05 * np.abs(limited.dynamics.G)), lfo.solve(limited)
    one = lfo.worst_case(limited, discs, found)["position, upper"]
    sizes = discs.radius[:, 1, 0] * np.abs(np.fft.rfft(found.trajectory.u[:, 0])) / limited.horizon
    under = outputs(limited, one.plant, found.trajectory.u)[one.index % limited.horizon, 1]
    assert under - one.planned == pytest.approx(2 * sizes.sum() - sizes[0] - sizes[-1], rel=1e-9)
    assert under - one.planned > 1.9 * sizes.sum() > 0


@expensive
def test_rate_limits_come_first_and_what_they_add_is_known(limited):
    discs, slow = lfo.Discs(0.05 * np.abs(limited.dynamics.G)), lfo.rate_limited(limited, 400.0)
    found = lfo.solve(lfo.robust(slow, discs))
    assert found.status == "optimal"
    assert np.abs(np.diff(found.trajectory.u[:, 0])).max() <= 400.0 * (1 + 1e-9)
    assert lfo.worst_case(slow, discs, found)


def test_a_disc_of_a_coherence_contains_the_response_as_often_as_stated():
    """The quantile of an F distribution is exact: 90 % of 40,000 estimates, whose standard error is 0.15 %."""
    rng, trials, n, G = np.random.default_rng(5), 40_000, 16, 0.7 - 0.4j
    x, noise = (rng.standard_normal((2, 2, trials, n)) * [[[[1.0]]], [[[1j]]]]).sum(axis=0)
    y = G * x + 0.5 * noise
    xx, yy, xy = (np.abs(x) ** 2).sum(1), (np.abs(y) ** 2).sum(1), (np.conj(x) * y).sum(1)
    radius = radius_of_coherence(xy / xx, np.abs(xy) ** 2 / (xx * yy), n, confidence=0.9)
    assert (np.abs(xy / xx - G) <= radius).mean() == pytest.approx(0.9, abs=0.006)
    assert (radius_of_coherence([1.0], [0.9], n, bins=10) > radius_of_coherence([1.0], [0.9], n)).all()


def test_discs_of_a_table_contain_the_response_at_all_bins_together_as_often_as_stated():
    """Between measured frequencies, too, where it is linear; of 2000 estimates the standard error is 0.7 %."""
    rng, n, frequencies = np.random.default_rng(6), 16, np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    G = np.array([1.0, 0.7 - 0.4j, 0.2 - 0.6j, -0.3 - 0.2j, -0.1])
    true = np.interp(np.arange(11) / 2, frequencies, G)
    inside = []
    for _ in range(2000):
        x, noise = (rng.standard_normal((2, 2, 5, n)) * [[[[1.0]]], [[[1j]]]]).sum(axis=0)
        y = G[:, None] * x + 0.1 * noise
        xx, yy, xy = (np.abs(x) ** 2).sum(1), (np.abs(y) ** 2).sum(1), (np.conj(x) * y).sum(1)
        table = np.column_stack([frequencies, (xy / xx).real, (xy / xx).imag, np.abs(xy) ** 2 / (xx * yy)])
        radius = lfo.Discs.from_table(table, 20, 0.1, averages=n, confidence=0.9).radius
        inside.append((np.abs(np.interp(np.arange(11) / 2, frequencies, xy / xx) - true) <= radius).all())
    assert np.mean(inside) == pytest.approx(1 - 0.1 + 0.004, abs=0.03)  # (1 - 0.1/5)^5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lfo.Discs.from_table([[0.0, 1.0, 0.0]], 4, 1.0, 8), r"discs.coherence: got shape \(1, 3\); expected"),
        (
            lambda: lfo.Discs.from_table([[0.0, 1, 0, 0.9], [0.2, 1, 0, 0.9]], 4, 1.0, 8),
            r"discs.coherence: got frequencies from 0 to 0.2 Hz; .*Not covered: bins 1 \(0.25 Hz\) and 2",
        ),
        (lambda: lfo.Discs.from_table([[0.0, 1, 0, 0.9], [0.5, 1, 0, 0.0]], 4, 1.0, 8), "coherence: got .*; expected"),
        (lambda: lfo.Discs(-0.1), "discs.radius: got -0.1; expected radii"),
        (lambda: lfo.Discs([[0.1]]), r"discs.radius: got shape \(1, 1\)"),
        (lambda: lfo.Discs(np.nan), "discs.radius: got nan"),
        (lambda: lfo.Discs(0.1, cost="mean"), "discs.cost: got 'mean'; expected 'nominal' or 'worst'"),
        (
            lambda: lfo.robust(converter(), lfo.Discs(np.ones(7))),
            r"discs.radius: got shape \(7,\); expected shape \(51",
        ),
        (lambda: lfo.robust(lfo.library.pendulum(), lfo.Discs(0.1)), "dynamics: got LinearDynamics; expected a Freq"),
        (lambda: radius_of_coherence([1.0], [1.2], 8), "coherence: got .1.2.; expected"),
        (lambda: radius_of_coherence([1.0], [0.9, 0.8], 8), r"coherence: got shape \(2,\)"),
        (
            lambda: radius_of_coherence([1.0], [0.9], 1),
            "averages: got 1; expected a whole number of independent records, at least 2. One record has coherence 1",
        ),
        (lambda: radius_of_coherence([1.0], [0.9], 2.5), "averages: got 2.5; expected a whole number of independent"),
        (lambda: radius_of_coherence([1.0], [0.9], True), "averages: got True; expected a whole number of independent"),
        (
            lambda: radius_of_coherence([1.0], [0.9], 8, confidence=95),
            "confidence: got 95; expected a probability between 0 and 1. State 95 % as 0.95",
        ),
        (lambda: radius_of_coherence([1.0], [0.9], 8, confidence="high"), "confidence: got 'high'; expected a probab"),
        (lambda: radius_of_coherence([1.0], [0.9], 8, confidence=np.nan), "confidence: got nan; expected a probab"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_field(make, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        make()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cost": lfo.QuadraticCost(Q=1.0, R=1.0)}, "discs.cost: got 'worst' with another cost"),
        ({"cost": lfo.QuadraticCost(R=1.0) + lfo.costs.L1Cost(u=1.0)}, "cost, stage_rows: got norms or formulas"),
    ],
)
def test_problems_outside_of_the_theorem_are_refused(limited, change, message):
    with pytest.raises(lfo.errors.UnsupportedError, match=message):
        lfo.robust(replace(limited, **change), lfo.Discs(1e-6, cost="worst"))


@expensive
def test_a_file_keeps_the_discs(limited, tmp_path):
    discs = lfo.Discs(0.05 * np.abs(limited.dynamics.G), cost="worst")
    plan = lfo.robust(limited, discs)
    lfo.write_problem(plan, tmp_path / "waves.toml")
    again = lfo.read_problem(tmp_path / "waves.toml")
    assert lfo.solve(again).cost == lfo.solve(plan).cost
    np.testing.assert_array_equal(again.uncertainty.radius, discs.radius)


@expensive
def test_a_limit_of_the_end_is_one_of_the_start_of_a_period(limited):
    ending = replace(limited, terminal_state=lfo.Box([None, -0.02], [None, 0.02]))
    discs = lfo.Discs(0.05 * np.abs(limited.dynamics.G))
    found = lfo.solve(lfo.robust(ending, discs))
    worst = lfo.worst_case(ending, discs, found)
    one = next(one for one in worst.limits if one.name.startswith("end of position") and one.limit == 0.02)
    assert worst
    assert one.index == limited.horizon
    assert abs(found.trajectory.x[-1, 1]) + one.margin <= 0.02 * (1 + 1e-8)
    assert not lfo.worst_case(ending, discs, lfo.solve(ending))


@expensive
@pytest.mark.parametrize("mode", ["periodic", "zero-padded"])
@pytest.mark.parametrize("place", [1e4, -1e6])
def test_outputs_far_from_zero_have_the_same_plan_and_the_same_worst_case(mode, place):
    """Both are those near zero, to the digits in which the outputs are given."""
    near, radius = small(np.random.default_rng(1), mode, (2, 2)), 0.02
    free, joint = lfo.solve(near).trajectory, near.stage_rows[0]
    near = replace(near, stage_rows=replace(joint, e=0.9 * joint.values(free.x, free.u).max(axis=0)))  # it binds
    dynamics, cost = near.dynamics, near.quadratic
    offset = dynamics.offset.copy()
    offset[0] += dynamics.record(near.horizon) * place
    row, state_set = near.stage_rows[0], near.state_boxes
    far = lfo.OptimalControlProblem(
        lfo.FrequencyResponse(dynamics.G, 0.1, offset, mode=mode),
        near.horizon,
        replace(cost, x_ref=cost.x_ref + place),
        near.control_set,
        lfo.Box(state_set.lower + place, state_set.upper + place),
        stage_rows=lfo.StageRows(row.C, row.D, row.e + row.C @ np.full(2, place), name="joint"),
    )
    discs, digits = lfo.Discs(radius), 1e-8 + 40 * np.spacing(abs(place))
    plans = [lfo.solve(lfo.robust(problem, discs)) for problem in (near, far)]
    assert [plan.status for plan in plans] == ["optimal", "optimal"]
    assert plans[1].cost == pytest.approx(plans[0].cost, abs=100 * digits)
    np.testing.assert_allclose(plans[1].trajectory.x - place, plans[0].trajectory.x, atol=100 * digits)
    x, u = plans[0].trajectory.x, plans[0].trajectory.u
    for larger in (1.0, 1.1):  # the plan has no margin for larger discs
        wider = lfo.Discs(larger * radius)
        cases = [lfo.worst_case(*one) for one in ((near, wider, plans[0]), (far, wider, lfo.Trajectory(x + place, u)))]
        assert bool(cases[0]) is bool(cases[1]) is (larger == 1)
        for one, other in zip(cases[0].limits, cases[1].limits, strict=True):
            assert (other.name, other.index) == (one.name, one.index)
            assert other.violation == pytest.approx(one.violation, abs=digits)
            assert other.attained - other.limit == pytest.approx(one.attained - one.limit, abs=digits)
            np.testing.assert_allclose(other.trajectory.x - place, one.trajectory.x, atol=digits)


def test_the_bin_of_a_mask_is_the_one_that_margins_bring_closest():
    """The spectrum of the plan is 4 at bin 1 and 3.6 at bin 2, which is uncertain by 40 %."""
    plant, t = lfo.FrequencyResponse(np.ones((5, 1, 1)), 1.0), 2 * np.pi * np.arange(8) / 8
    mask = lfo.MagnitudeBound(6.0, bins=[1, 2], component=0)
    problem = lfo.OptimalControlProblem(plant, 8, lfo.QuadraticCost(R=1.0), state_spectrum=mask)
    plan = lfo.Trajectory(np.zeros((9, 1)), (np.cos(t) + 0.9 * np.cos(2 * t))[:, None])
    (one,) = lfo.worst_case(problem, lfo.Discs(np.array([0.0, 0, 0.4, 0, 0])), plan).limits
    assert one.index == 2
    assert [one.planned, one.margin, one.attained] == pytest.approx([3.6, 1.44, 5.04], rel=1e-12)
