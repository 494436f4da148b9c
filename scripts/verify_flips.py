"""Random continuous piecewise-affine problems: where the judge says "flip", it improves, and where not, it does not.

A random mode sequence is optimised; at every border that its optimum lies on, every other mode that holds there is
tried by solving the sequence with that mode instead. Then the steepest flips are followed to where there is none, and
``certify`` is given the trajectory alone: it must find multipliers that satisfy the maximum principle.
"""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.certificate.modes.clarke import BorderFacts
from lin_freq_ocp.certificate.sizes import measured_modes
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.methods.multipliers import uniqueness

KINDS = ("one kink", "two parallel kinks", "two crossing kinks", "three wedges")

VISIBLE = 1e-9
"""Relative change of a cost that solvers which stop at 1e-10 show."""

MOST_STEPS = 20
"""Flips that are followed, one after the other."""


@dataclass(frozen=True)
class Outcome:
    """What became of one problem: flips and stays that were tried, and what is wrong, if anything."""

    seed: int
    kind: str
    borders: int
    counts: Counter[str] = field(default_factory=Counter)
    wrong: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def random_map(rng: np.random.Generator, n: int, m: int, kind: str) -> lfo.PiecewiseAffineDynamics:
    """Return f = F y + c plus kinks of rank one: continuous everywhere."""
    F = np.hstack([rng.standard_normal((n, n)) * 0.8 / np.sqrt(n), rng.standard_normal((n, m))])
    c = 0.2 * rng.standard_normal(n)
    g1, g2 = rng.standard_normal((2, n))
    h1, h2 = rng.standard_normal((2, n + m))
    d1, d2 = 0.4 * rng.standard_normal(2)

    def mode(pieces: list[tuple[np.ndarray, np.ndarray, float]], rows: list[tuple[np.ndarray, float]]):
        matrix, offset = F.copy(), c.copy()
        for g, h, d in pieces:
            matrix, offset = matrix + np.outer(g, h), offset - g * d
        G, limits = np.array([row for row, _ in rows]), np.array([limit for _, limit in rows])
        return lfo.AffineMode(matrix[:, :n], matrix[:, n:], offset, G[:, :n], G[:, n:], limits)

    def above(h: np.ndarray, d: float) -> tuple[np.ndarray, float]:
        return -h, -d

    one, two = (g1, h1, d1), (g2, h2, d2)
    if kind == "one kink":
        modes = [mode([], [(h1, d1)]), mode([one], [above(h1, d1)])]
    elif kind == "two parallel kinks":
        further = d1 + abs(d2) + 0.1
        second = (g2, h1, further)
        modes = [
            mode([], [(h1, d1)]),
            mode([one], [above(h1, d1), (h1, further)]),
            mode([one, second], [above(h1, further)]),
        ]
    elif kind == "two crossing kinks":
        modes = [
            mode([], [(h1, d1), (h2, d2)]),
            mode([one], [above(h1, d1), (h2, d2)]),
            mode([two], [(h1, d1), above(h2, d2)]),
            mode([one, two], [above(h1, d1), above(h2, d2)]),
        ]
    else:  # g max(0, h1'y - d1, h2'y - d2)
        same = (g1, h2, d2)
        modes = [
            mode([], [(h1, d1), (h2, d2)]),
            mode([one], [above(h1, d1), above(h1 - h2, d1 - d2)]),
            mode([same], [above(h2, d2), above(h2 - h1, d2 - d1)]),
        ]
    return lfo.PiecewiseAffineDynamics(modes)


def random_problem(seed: int) -> tuple[str, lfo.OptimalControlProblem, np.ndarray]:
    """Return the kind of map, a problem around a random trajectory, and the controls of that trajectory."""
    rng = np.random.default_rng(seed)
    kind, n, m, T = KINDS[seed % len(KINDS)], *rng.integers(1, 4, 2), int(rng.integers(3, 7))
    dynamics = random_map(rng, n, m, kind)
    factor = rng.standard_normal((n + m, n + m))
    M = factor @ factor.T / (n + m) + np.diag([0.0] * n + [0.2] * m)
    M = (M + M.T) / 2
    P = rng.standard_normal((n, n))
    cost = lfo.QuadraticCost(
        Q=M[:n, :n], R=M[n:, n:], S=M[:n, n:], q=rng.standard_normal(n), P=P @ P.T, p=2 * rng.standard_normal(n)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.BandWarning)
        band = lfo.stop_band(bins=[int(rng.integers(1, T // 2 + 1))], component=0) if rng.random() < 0.5 else None
        problem = lfo.OptimalControlProblem(
            dynamics=dynamics,
            horizon=T,
            cost=cost,
            control_set=lfo.Box(-2.0, 2.0) if rng.random() < 0.7 else None,
            initial_state=_initial(rng, dynamics, n, m),
            control_spectrum=band,
            name=f"{kind} {seed}",
        )
        u = np.clip(rng.standard_normal((T, m)), -1, 1)
        u = np.fft.irfft(np.where(problem.control_stop, 0, np.fft.rfft(u, axis=0)), n=T, axis=0)
        u = u / max(1.0, np.abs(u).max())
        x = lfo.simulate(problem, u).x
        if rng.random() < 0.5:  # bounds that the trajectory meets, so that it is feasible
            size = np.abs(x).max(0) + 0.2
            problem = replace(problem, state_set=lfo.Box(-size, size))
        if rng.random() < 0.2:
            problem = replace(problem, terminal_state=x[-1])
    return kind, problem, u


def _initial(rng: np.random.Generator, dynamics: lfo.PiecewiseAffineDynamics, n: int, m: int) -> np.ndarray:
    """Return an initial state, at times one that u = 0 has on a border."""
    x, region = rng.standard_normal(n), dynamics.modes[0].region
    if rng.random() < 0.2:
        h, limit = region.C[0], region.e[0]
        x += h * (limit - h @ x) / (h @ h)
    return x


def sequence_optimum(problem: lfo.OptimalControlProblem, sequence: np.ndarray) -> lfo.Result | None:
    """Return the optimum of a mode sequence; None if it has none."""
    result = lfo.solve(problem.with_modes(sequence), throw=False)
    return result if "optimal" in result.status and result.certificate.pmp == "satisfied" else None


def check(seed: int) -> Outcome:
    """Optimise one random mode sequence, and try every flip."""
    kind, problem, u = random_problem(seed)
    start = lfo.simulate(problem, u)
    sequence = problem.dynamics.sequence_of(start.x, start.u)
    result = sequence_optimum(problem, sequence)
    if result is None:
        return Outcome(seed, kind, 0, Counter(unsolved=1))
    multipliers = weighted(problem, result.trajectory, sequence, result.multipliers)
    certificate = judge(problem, result.trajectory, multipliers)
    facts = certificate.borders
    wrong = [] if certificate.feasible else ["the optimum of a mode sequence breaks a constraint"]
    counts = Counter({"joint": int(facts.joint and bool(facts.times))})
    if facts.flip_stationary and not facts.joint:
        wrong.append("flip-stationary without the joint inclusion")
    if facts.regular and facts.joint and not facts.flip_stationary:
        wrong.append("joint and regular, but not flip-stationary")
    if facts.joint != (certificate.pmp == "satisfied"):
        wrong.append("the facts and the verdict differ")
    for what, words in tried(problem, sequence, result, facts):
        counts[what] += 1
        wrong += [words] if words else []
    for what, words in followed(problem, sequence, result):
        counts[what] += 1
        wrong += [words] if words else []
    return Outcome(seed, kind, len(facts.times), counts, tuple(wrong))


def followed(problem: lfo.OptimalControlProblem, sequence: np.ndarray, result: lfo.Result):
    """Follow flips to the end; yield what certify says there of the trajectory alone, and words if that is wrong."""
    for _ in range(MOST_STEPS):
        certificate = lfo.certify(problem, result.trajectory)
        better = None
        for flip in certificate.borders.flips:
            flipped = problem.dynamics.sequence_of(result.trajectory.x, result.trajectory.u)
            flipped[flip.time] = flip.mode
            other = lfo.solve(problem.with_modes(flipped), throw=False)
            change = (
                np.inf if "optimal" not in other.status else (other.cost - result.cost) / max(1.0, abs(result.cost))
            )
            if flip.improves is False and change < -VISIBLE:
                yield "wrong refusal", f"t = {flip.time} to {flip.mode} is said not to improve, and gains {-change:.1e}"
            if flip.improves and not change < 0:
                yield "wrong flip", f"t = {flip.time} to {flip.mode} is said to improve, and gains {-change:.1e}"
            if change < -VISIBLE and (better is None or other.cost < better.cost):
                better = other
        if better is None:
            break
        result = better
    else:
        yield "long way", ""
        return
    feasible, facts = certificate.feasible, certificate.borders
    if not facts.times:
        alone = problem.with_modes(problem.dynamics.sequence_of(result.trajectory.x, result.trajectory.u))
        same = lfo.certify(alone, result.trajectory).pmp == certificate.pmp  # "violated" where a solver was inaccurate
        yield "inside", "" if same else f"an optimum inside modes: {certificate.worst}"
    elif facts.flip_stationary:
        yield "flip-stationary", "" if certificate.pmp == "satisfied" and feasible else "but not satisfied"
    elif certificate.pmp == "satisfied":
        yield "joint only", ""
    else:
        yield "no multipliers found", "no flip improves, and no multipliers are found" if feasible else ""


def tried(problem: lfo.OptimalControlProblem, sequence: np.ndarray, result: lfo.Result, facts: BorderFacts):
    """Yield what each flip turned out to be, and words if that is not what was said."""
    arrays = measured_modes(problem, result.trajectory)
    meeting = arrays.meeting(result.trajectory.x, result.trajectory.u)
    said = {(flip.time, flip.mode): flip.rate for flip in facts.flips}
    unique = None
    for t, j in np.argwhere(meeting):
        if j == sequence[t]:
            if (t, j) in said:
                yield "own mode", f"a flip at t = {t} to the mode {j} that the sequence has"
            continue
        flipped = sequence.copy()
        flipped[t] = j
        other = lfo.solve(problem.with_modes(flipped), throw=False)
        if "optimal" not in other.status:
            yield "undecided", ""
            continue
        change = (other.cost - result.cost) / max(1.0, abs(result.cost))
        if (t, j) not in said:
            yield "stay", f"a stay at t = {t}, mode {j}, that would gain {-change:.1e}" if change < -VISIBLE else ""
        elif change < -VISIBLE:
            yield "flip", ""
        else:
            unique = unique or uniqueness(problem.with_modes(sequence), result.trajectory)
            both = unique.unique and uniqueness(problem.with_modes(flipped), result.trajectory).unique
            rate = said[t, j]
            words = f"a flip at t = {t} to mode {j}, rate {rate:.1e}, that gains {-change:.1e}" if both else ""
            yield "wrong flip" if both else "degenerate", words


def verify(console: Console, seeds: range) -> bool:
    """Check the problems of these seeds and print what became of them; return whether nothing is wrong."""
    outcomes = [check(seed) for seed in track(seeds, "flipping", console=Console(stderr=True), transient=True)]
    columns = (
        *("joint", "flip", "stay", "degenerate", "undecided"),
        *("inside", "flip-stationary", "joint only", "no multipliers found", "long way"),
    )
    table = Table("map", "problems", "at borders", *columns, "failed", title="flips at the borders of modes")
    for kind in [*KINDS, "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        total = sum((one.counts for one in some), Counter[str]())
        numbers = len(some), sum(one.borders > 0 for one in some), *(total[column] for column in columns)
        table.add_row(kind, *map(str, numbers), str(sum(not one.passed for one in some)))
    console.print(table)
    for one in outcomes:
        if not one.passed:
            console.print(f"FAILED seed {one.seed}, {one.kind}: {'; '.join(one.wrong)}", markup=False)
    return all(one.passed for one in outcomes)
