"""Proofs of pulse trains: the recursion, the curvature and the point of the checker against sums of their own."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
from flint import arb, ctx, fmpq
from scipy.optimize import minimize

import lin_freq_ocp as lfo
from helpers import hand_proofs
from helpers.checks import proofs
from helpers.mutations import mutations
from helpers.seeds import expensive, seeds
from lin_freq_ocp.methods.hybrid import Quarter, local_angles
from lin_freq_ocp.proof import lfo_check, proof_of

END = np.pi / 2
CLASS = {"least_dwell": 0.0314159, "unipolar": True, "exactly": True}


def pattern(M: float, k: int, **fields) -> lfo.OptimalControlProblem:
    return lfo.library.pulse_pattern(kind="opp", modulation=M, switches=k, **fields)


def check(lines: list[str]) -> tuple[arb, arb]:
    return lfo_check.check(io.BytesIO("".join(lines).encode()), lambda text: None)


@pytest.mark.parametrize(
    ("M", "k", "fields"),
    seeds(
        [
            (0.9, 8, {}),
            (0.3, 12, {}),
            (0.05, 16, CLASS),
            (1.1, 16, CLASS),
            (0.4, 12, CLASS | {"least_dwell": 0.01 * np.pi}),
            (0.55, 20, CLASS),
            (0.5, 32, CLASS),
        ]
    ),
)
def test_the_interval_is_narrow_and_the_file_proves_it(M, k, fields, tmp_path):
    result = lfo.solve(pattern(M, k, **fields))
    proven = result.enclosure
    assert proven.lower <= result.lower_bound
    assert proven.width <= 1.01e-6 * result.cost
    assert result.cost == pytest.approx(proven.upper, rel=1e-9)
    result.write_proof(tmp_path / "run.proof")
    assert hand_proofs.check_file(tmp_path / "run.proof").status == 0  # with the usual limit of work


@expensive
@pytest.mark.parametrize("unit", [1e-9, 3.0, 1e9])
def test_the_unit_of_levels_changes_nothing(unit):
    plain = pattern(0.8, 12)
    dynamics = lfo.dynamics.PulseTrain(step=0.5 * unit, orders=plain.dynamics.orders)
    size = np.array([1.0, unit, unit, unit**2, unit, unit])
    tube, ends = plain.state_boxes, plain.ends
    scaled = replace(
        plain,
        dynamics=dynamics,
        state_set=lfo.Box(tube.lower * size, tube.upper * size),
        initial_state=lfo.Box(ends[0].lower * size, ends[0].upper * size),
        terminal_state=lfo.Box(ends[1].lower * size, ends[1].upper * size),
    )
    proven = lfo.solve(scaled).enclosure
    assert proven.upper == pytest.approx(unit**2 * lfo.solve(plain).enclosure.upper, rel=1e-9)


@expensive
def test_every_mutation_of_the_point_and_of_the_parts_is_rejected_or_still_true(tmp_path):
    proof = proofs.KINDS["a pulse train"]()
    truth, first_hash = proofs.truth_of("a pulse train", proof, tmp_path)
    found = [one for one in mutations(proof.splitlines(keepends=True)) if one.section in ("point", "nodes")]
    assert len(found) > 60
    assert not [str(one) for one in found if proofs.wrong_of(one, truth, first_hash, tmp_path)]


@pytest.mark.parametrize(("M", "k"), [(1.15, 8), (1.1, 12), (1.15, 28)])
def test_that_no_train_meets_the_limits_is_proven(M, k, tmp_path):
    result = lfo.solve(pattern(M, k, **CLASS), throw=False)
    assert result.enclosure.infeasible
    result.write_proof(tmp_path / "run.proof")
    assert hand_proofs.check_file(tmp_path / "run.proof").last == "INFEASIBLE"
    lines = (tmp_path / "run.proof").read_text().splitlines(keepends=True)
    feasible = lines[1].replace(float(M).hex(), (0.9).hex())  # the amplitude of another problem, which has trains
    assert feasible != lines[1]
    with pytest.raises(lfo_check.Failed, match="trains may meet the limits"):
        check([lines[0], feasible, *lines[2:]])


UP_AND_DOWN = {"sums": 400, "weights": ["-0x1p+0", "0x0p+0"]}  # the amplitude is less than 0.9 there
UPWARDS = {"sums": 400, "weights": ["0x1p+1030", "0x0p+0"]}
BEYOND_DOUBLES = {  # of a problem that has trains, with two steps up
    "above all doubles": [{"split": 0}, {"split": 1}, UPWARDS, UP_AND_DOWN, UP_AND_DOWN],
    "below all doubles": [{"sums": 400, "weights": ["-0x1p-20000", "0x0p+0"]}],
}


def stated(result: lfo.results.Result, folder: Path) -> list[dict]:
    """Return the lines of the proof file of a result."""
    result.write_proof(folder / "run.proof")
    return [*map(json.loads, (folder / "run.proof").read_text().splitlines())]


@pytest.mark.parametrize("nodes", BEYOND_DOUBLES)
def test_weights_whose_sums_are_no_doubles_exclude_no_train(nodes, tmp_path):
    first, problem, claim, head, *_, end = stated(lfo.solve(pattern(1.15, 8, **CLASS), throw=False), tmp_path)
    problem["low"][0] = problem["high"][0] = (0.9).hex()
    with pytest.raises(lfo_check.Failed, match=r"trains may meet the limits|larger than all doubles"):
        check([json.dumps(line) + "\n" for line in (first, problem, claim, head, *BEYOND_DOUBLES[nodes], end)])


def test_a_step_whose_energy_is_no_double_has_no_lower_bound(tmp_path):
    """Energies of 2^-1120 are zero in doubles, and no less than any price of the amplitudes."""
    power = -560
    first, problem, claim, _, head, node, *_, end = stated(lfo.solve(pattern(0.9, 8)), tmp_path)

    def scaled(number: str, by: int) -> str:
        digits, exponent = number.split("p")
        return f"{digits}p{int(exponent) + by}"

    problem["step"], problem["price"] = scaled(problem["step"], power), scaled(problem["price"], -2 * power)
    problem["offset"] = scaled(problem["offset"], 2 * power)
    for side in ("low", "high"):
        problem[side] = [scaled(limit, power) for limit in problem[side]]
    claim |= {"lower": (0.01).hex(), "upper": "inf"}  # the least cost is 0.0018
    node = {"lattice": 100, "whole": False, "prices": [scaled(price, power) for price in node["prices"]]}
    lines = first, problem, claim, head | {"level": (0.011).hex()}, node, end
    with pytest.raises(lfo_check.Failed, match=r"trains may cost less|larger than all doubles"):
        check([json.dumps(line) + "\n" for line in lines])


def test_a_search_that_was_ended_early_has_no_proof():
    result = lfo.solve(pattern(0.9, 20, **CLASS), throw=False, time_limit=1e-9)
    with pytest.raises(lfo.errors.SolveError, match="nothing to prove: the solve ended as 'limit'"):
        _ = result.enclosure


def test_amplitudes_that_start_elsewhere_are_refused():
    problem = pattern(0.9, 8)
    moved = np.array([0, 0, 0, 0, 0.25, 0])
    start, end = problem.ends
    problem = replace(
        problem,
        initial_state=lfo.Box(start.lower + moved, start.upper + moved),
        terminal_state=lfo.Box(end.lower + moved, end.upper + moved),
    )
    with pytest.raises(lfo.errors.UnsupportedError, match="initial_state: a proof of a pulse train"):
        proof_of(lfo.solve(problem))


# --- the parts of the checker ----------------------------------------------------------------------------------------


def train_of(**fields) -> lfo_check.Train:
    """Return a train of three steps of 1, at most two up and one down, with the harmonics 1 and 3."""
    given = {"section": "pulse train", "name": "", "switches": 3, "lowest": -1, "highest": 2, "orders": [1, 3]}
    numbers = {"step": 1.0, "price": 1.0, "offset": 0.0, "dwells": [0.0] * 4, "low": [-2.0] * 2, "high": [2.0] * 2}
    numbers |= {key: fields.pop(key) for key in tuple(fields) if key in numbers}

    def encoded(value):
        return list(map(encoded, value)) if isinstance(value, list) else float(value).hex()

    line = given | fields | {key: encoded(value) for key, value in numbers.items()}
    with ctx.workprec(128):
        return lfo_check.Train(lfo_check.Lines(io.BytesIO((json.dumps(line) + "\n").encode())))


def series(signs: np.ndarray, angles: np.ndarray, step: float = 1.0) -> tuple[float, np.ndarray]:
    """Return E and b_1, b_3 by the sums over odd harmonics."""
    k = np.arange(1, 40001, 2)
    b = 4 * step / (np.pi * k) * (signs[:, None] * np.cos(k * angles[:, None])).sum(0)
    return float(((b / k) ** 2).sum()), b[:2]


@pytest.mark.parametrize("seed", seeds(range(5)))
def test_energy_and_amplitudes_are_those_of_the_fourier_series(seed):
    rng = np.random.default_rng(seed)
    signs, angles, train = rng.choice([1, -1], 3), np.sort(rng.uniform(0, END, 3)), train_of()
    E, b = series(signs, angles)
    with ctx.workprec(128):
        at = [
            [arb(float(x)) + h * (j == i) for j, x in enumerate(angles)] for i in range(3) for h in (0, arb(2) ** -40)
        ]
        found, slopes = train.energy(signs.tolist(), at[0])
        values, by_angle, bends = train.amplitudes(signs.tolist(), at[0])
        assert float(found) == pytest.approx(E, abs=1e-11)
        assert [float(one) for one in values] == pytest.approx(b, abs=1e-11)
        for i in range(3):
            near = at[2 * i + 1]
            moved, again = train.amplitudes(signs.tolist(), near)[:2]
            rise = (train.energy(signs.tolist(), near)[0] - found) * 2**40
            assert float(rise) == pytest.approx(float(slopes[i]), abs=1e-10)
            for j in range(2):
                assert float((moved[j] - values[j]) * 2**40) == pytest.approx(float(by_angle[j][i]), abs=1e-9)
                assert float((again[j][i] - by_angle[j][i]) * 2**40) == pytest.approx(float(bends[j][i]), abs=1e-8)


def lattice_trains(train: lfo_check.Train, N: int, hold: list[int]):
    """Yield signs and indices of all trains of a lattice."""
    for signs in product((1, -1), repeat=train.m):
        levels = np.cumsum(signs)
        for at in combinations(range(N + 1), train.m) if hold[1] else product(range(N + 1), repeat=train.m):
            dwells = np.diff([0, *at, N])
            if (dwells >= hold).all() and train.lowest <= levels.min() and levels.max() <= train.highest:
                yield np.array(signs), np.array(at)


@pytest.mark.parametrize("seed", seeds(range(12)))
@pytest.mark.parametrize("hold", [[0, 0, 0, 0], [1, 2, 1, 1]])
def test_the_recursion_is_the_least_of_all_trains_of_the_lattice(seed, hold):
    """Of those with an angle or a sign outside of another part, and of all."""
    rng, N, train = np.random.default_rng(seed), 8, train_of()
    r = rng.normal(size=2)
    with ctx.workprec(128):
        h = train.quarter / N
        low = [sum(hold[: j + 1]) for j in range(3)]
        high = [N - sum(hold[j + 1 :]) for j in range(3)]
        bent = [
            4 * 2 / arb.pi() * sum((arb(p) * (k * i * h).cos() / k**2 for k, p in ((1, r[0]), (3, r[1]))), arb(0))
            for i in range(N + 1)
        ]
        waves = {i: (-40, 40, bent[i], i * h) for i in range(N + 1)}
        part = [(fmpq(0), fmpq(1), 0)] * 3
        inside = [(1, 4, 1), (2, 6, int(rng.choice([0, 1, -1]))), (3, 8, -1)]
        for other in (None, inside):
            found, rounding = train.recursion(part, N, low, high, hold, waves, other)
            least = math.inf
            for signs, at in lattice_trains(train, N, hold):
                outside = other is None or any(
                    (i <= a and a > 0) or (i >= b and b < N) or s == -sign
                    for i, s, (a, b, sign) in zip(at, signs, other, strict=True)
                )
                if outside:
                    E, b = series(signs, at * END / N)
                    least = min(least, E - 2 * float(r @ (b / [1, 3])))
            assert found == pytest.approx(least, abs=1e-10)
            assert 0 < float(rounding) < 1e-12


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_no_sum_excludes_a_part_with_a_train(seed):
    """Whatever the weights, of a train that meets all limits, with room or without."""
    rng, room = np.random.default_rng(seed), (1e-9, 2.0)[seed % 2]
    angles, signs = np.sort(rng.uniform(0, END, 3)), np.array([1, -1, 1])
    b = series(signs, angles)[1]
    train = train_of(low=(b - room).tolist(), high=(b + room).tolist())
    with ctx.workprec(128):
        part, least = random_part(rng, angles, signs), rng.normal(size=2)
        for weights in (least, [1.0, 0.0], [-1.0, 0.0], [0.0, -1.0], [0.0, 0.0]):
            with pytest.raises(lfo_check.Failed, match="trains may meet the limits"):
                train.require_no_train(part, {"sums": 50, "weights": [float(one).hex() for one in weights]})


def test_a_sum_of_a_lattice_loses_no_train_between_its_angles():
    """The train with the least b_3 has an angle of pi/3, which is no multiple of the step."""
    least = -4 / (3 * np.pi)
    fields = {"switches": 1, "lowest": 0, "highest": 1, "orders": [3], "dwells": [0.0, 0.0]}
    with ctx.workprec(128):
        part = [(fmpq(1, 2), fmpq(4, 5), 1)]
        for N in (50, 400):
            line, lost = {"sums": N, "weights": ["0x1p+0"]}, 4 / np.pi * (END / N) ** 2 / 8 * 3
            with pytest.raises(lfo_check.Failed, match="trains may meet the limits"):
                train_of(**fields, low=[least], high=[least]).require_no_train(part, line)
            below = [least - 1.01 * lost]
            train_of(**fields, low=below, high=below).require_no_train(part, line)


def random_part(rng: np.random.Generator, angles: np.ndarray, signs: np.ndarray) -> list:
    """Return a part that has a train, some of its signs free."""
    shares = angles / END
    low = [fmpq(int(x * 64 * s), 64) for x, s in zip(shares, rng.uniform(0, 1, len(shares)), strict=True)]
    high = [fmpq(min(int(x * 64) + int(rng.integers(1, 20)), 64), 64) for x in shares]
    return [(a, b, int(s) * int(rng.integers(0, 2))) for a, b, s in zip(low, high, signs, strict=True)]


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_no_train_of_a_part_costs_less_than_the_lattice_says(seed):
    """Also none outside of a narrower part, whatever the prices; and the finer lattice is nearer to it."""
    rng = np.random.default_rng(seed)
    dwell = float(rng.choice([0.0, 0.05, 0.2]))
    angles = np.sort(rng.uniform(0, END - 4 * dwell, 3)) + dwell * np.arange(1, 4)
    signs = np.array([1, *[[1, -1], [-1, 1], [-1, -1]][rng.integers(3)]])
    E, b = series(signs, angles)
    if not -1 <= np.cumsum(signs).min() <= np.cumsum(signs).max() <= 2:
        signs = np.array([1, -1, 1])
        E, b = series(signs, angles)
    wide = rng.choice([0.0, 0.1], 2)
    train = train_of(dwells=[dwell] * 4, low=(b - wide - 1e-9).tolist(), high=(b + wide + 1e-9).tolist())
    price = (b / [1, 3] if rng.random() < 0.5 else rng.normal(size=2)).tolist()
    with ctx.workprec(128):
        part = random_part(rng, angles, signs)
        beyond = [(0, int(64 * x), 0) for x in angles / END]  # each angle is after its range
        for N, whole in ((64, False), (64, True), (200, False)):
            line = {"prices": [float(one).hex() for one in price], "whole": whole}
            outside = [(a * N // 64, b * N // 64, s) for a, b, s in beyond]
            for inside in (None, outside):
                bound = train.least_on_lattice(part, N, line, arb(E * (1 + 1e-9)), inside)
                assert float(bound) <= E


SIGNS = np.array([1, -1, 1])
RADII = 0.3, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.02, 0.01


def curvature_bound(
    train: lfo_check.Train, c: np.ndarray, price: np.ndarray, force: np.ndarray, radius: float
) -> float:
    """Return the bound of the box around angles; minus infinity where the Lagrangian is not convex."""
    low, high = (box(c, side * radius) for side in (-1, 1))
    line = {"optimum": c, "prices": price, "forces": force}
    line = {key: [float(one).hex() for one in values] for key, values in line.items()}
    with ctx.workprec(128):
        part = [(fmpq(int(a), 4096), fmpq(int(b), 4096), s) for a, b, s in zip(low, high, SIGNS.tolist(), strict=True)]
        try:
            return float(train.least_by_curvature(part, line))
        except lfo_check.Failed:
            return -math.inf


def box(c: np.ndarray, by: float) -> np.ndarray:
    return np.clip(np.round((c + by) / END * 4096), 0, 4096)


def quarter_of(orders: tuple[int, ...], limits: np.ndarray) -> Quarter:
    return Quarter(1.0, -1, 2, np.zeros(4), orders, limits, limits, 1.0, 0.0)


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_the_curvature_bounds_the_energy_with_prices_over_a_box(seed):
    """Of an amplitude of a high order, whose waves make other minima near; angles are moved away from the minimum."""
    rng, orders = np.random.default_rng(seed), (1, 21)
    quarter, price = quarter_of(orders, np.zeros(2)), rng.normal(size=2) * [1.0, 0.3]

    def lagrangian(a: np.ndarray) -> float:
        a = np.sort(a)
        return quarter.energy(SIGNS, a)[0] + float(price @ quarter.amplitudes(SIGNS, a)[0])

    c = np.sort(minimize(lagrangian, np.sort(rng.uniform(0.3, 1.3, 3)), bounds=[(0.05, 1.5)] * 3).x)
    c = np.sort(c + rng.choice([0.0, 0.02]) * rng.uniform(-1, 1, 3))
    limit = quarter.amplitudes(SIGNS, c)[0]
    low, high = np.where(price > 0, -50.0, limit), np.where(price > 0, limit, 50.0)
    train = train_of(orders=list(orders), low=low.tolist(), high=high.tolist())

    def most(a: np.ndarray) -> float:  # with the squares that prices allow, at most
        over = quarter.amplitudes(SIGNS, a)[0] - limit
        return quarter.energy(SIGNS, a)[0] + float(price @ over + over @ over)

    for radius in RADII:
        bound = curvature_bound(train, c, price, np.zeros(4), radius)
        low, high = (box(c, side * radius) / 4096 * END for side in (-1, 1))
        for start in rng.uniform(low, high, (6 if bound > -np.inf else 0, 3)):
            a = minimize(most, start, bounds=[*zip(low, high, strict=True)]).x
            assert bound <= most(a) + 1e-9


@expensive
def test_no_train_with_the_amplitude_costs_less_than_the_curvature_says():
    """Of those with b_1 given, two angles are free; the Lagrangian alone is convex nowhere near."""
    proven = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        start = np.sort(rng.uniform(0.2, 1.4, 3))
        b = quarter_of((1,), np.zeros(1)).amplitudes(SIGNS, start)[0]
        quarter = quarter_of((1,), b)
        local = local_angles(quarter, SIGNS.astype(float), start)
        if local is None or np.diff(local[0]).min() < 0.05:
            continue
        c = local[0] + rng.choice([0.0, 0.03]) * rng.uniform(-1, 1, 3)

        def energy_of(a: np.ndarray, low: np.ndarray, high: np.ndarray, b=b, quarter=quarter) -> float:
            cosine = float(b[0]) * np.pi / 4 - SIGNS[:2] @ np.cos(a)
            a = np.append(a, np.arccos(np.clip(cosine, -1, 1)))
            inside = abs(cosine) <= 1 and (a >= low).all() and (a <= high).all() and (np.diff(a) >= 0).all()
            return quarter.energy(SIGNS, a)[0] if inside else 100.0

        price = -np.linalg.lstsq(quarter.amplitudes(SIGNS, c)[1].T, quarter.energy(SIGNS, c)[1], rcond=None)[0]
        train = train_of(orders=[1], low=b.tolist(), high=b.tolist())
        for radius in RADII:
            bound = curvature_bound(train, c, price, np.zeros(4), radius)
            proven += bound > -np.inf
            low, high = (box(c, side * radius) / 4096 * END for side in (-1, 1))
            for a in rng.uniform(low[:2], high[:2], (300 if bound > -np.inf else 0, 2)):
                assert bound <= energy_of(a, low, high) + 1e-9
            for start in rng.uniform(low[:2], high[:2], (3 if bound > -np.inf else 0, 2)):
                assert bound <= minimize(energy_of, start, (low, high), method="Nelder-Mead").fun + 1e-9
    assert proven > 20
