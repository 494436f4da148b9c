"""Compare printed values with proven intervals: docs/published.md.

python scripts/published.py [NAME ...] [--write] [--proofs FOLDER]

Each row states a problem of a source in our words and compares the printed value with an interval that contains the
optimum. The interval is that of a proof that the checker has verified, where the format states it, else that of the
judge. A printed value is *confirmed* if the interval, or the half unit of its last digit around it, meets the other;
else it is *corrected*, with a reason. Without a reason it is unexplained, and the exit status is 1.

The second way: the objective by the source's own formula, from the trajectory alone, has to lie in the interval too.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import UnsupportedError

PAGE = Path(__file__).parents[1] / "docs" / "published.md"
AGREES = 1e-11  # relative difference of two ways to compute an objective: far below the last digit that is printed


@dataclass(frozen=True)
class Found:
    """An interval that contains the value, the value in the second way, and how it is proven."""

    low: float
    high: float
    again: float | None
    proof: str


@dataclass(frozen=True)
class Row:
    """A printed value, where it is printed, and how it is computed here."""

    name: str
    source: str
    statement: str
    printed: str
    find: Callable[[Path | None, str], Found]
    reason: str = ""  # why the printed value differs, if it does


def verdict(row: Row, found: Found) -> str:
    """Return "confirmed", "corrected" or "unexplained"."""
    number = Decimal(row.printed)
    digits = number.as_tuple().exponent
    assert isinstance(digits, int)
    half = 0.5 * 10.0**digits * (1 + 1e-6)  # the last digit is rounded
    value = float(number)
    agrees = found.low - half <= value <= found.high + half
    return "confirmed" if agrees else "corrected" if row.reason else "unexplained"


def proven(
    problem: lfo.OptimalControlProblem,
    formula: Callable[[np.ndarray, np.ndarray], float],
    constant: float,
    folder: Path | None,
    name: str,
) -> Found:
    """Return the interval of an optimum less a constant of the statement, and the source's formula on the optimum."""
    result = lfo.solve(problem)
    assert result.trajectory is not None
    again = formula(result.trajectory.x, result.trajectory.u)
    if problem.control_set is None:
        value = riccati(problem) - constant
        assert abs(value - again) <= AGREES * abs(value)
    try:
        interval = result.enclosure
        low, high, proof = interval.lower, interval.upper, "verified"
        if folder is not None:
            result.write_proof(folder / f"{name}.proof")
    except UnsupportedError:
        assert result.lower_bound is not None
        low, high, proof = result.lower_bound, result.cost, "judge"
    return Found(low - constant, high - constant, again, proof)


def riccati(problem: lfo.OptimalControlProblem) -> float:
    """Return the optimal cost from a given start without limits, by the recursion backwards in time."""
    A, B, _ = problem.linear.at(0)
    cost, x = problem.quadratic, problem.initial_state.lower
    P = cost.P
    for _ in range(problem.horizon):
        mixed = cost.S.T + B.T @ P @ A if cost.S.shape == (len(A), B.shape[1]) else cost.S + B.T @ P @ A
        P = cost.Q + A.T @ P @ A - mixed.T @ np.linalg.solve(cost.R + B.T @ P @ B, mixed)
    return float(x @ P @ x) / 2


def mpt3_control(t: int, folder: Path | None, name: str) -> Found:
    """Bound a control of the regulator: J rises by at least (u - u*)^2 from the optimum, as R = 2."""
    result = lfo.solve(regulator())
    assert result.cost is not None
    radius = math.sqrt(max(result.cost, result.enclosure.upper) - result.enclosure.lower)
    assert result.control is not None
    u = float(result.control[t, 0])
    return Found(u - radius, u + radius, None, "judge")


def mpt3(folder: Path | None, name: str) -> Found:
    """Solve the regulator; stages 0 .. 4 of the state and 0 .. 3 of the control."""
    return proven(regulator(), lambda x, u: float((x**2).sum() + (u**2).sum()), 0.0, folder, name)


def regulator() -> lfo.OptimalControlProblem:
    """Return the regulator of MPT3."""
    two = 2 * np.eye(2)
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 1], [0, 1]], [[1], [0.5]]),
        4,
        lfo.QuadraticCost(Q=two, R=2.0, P=two),
        lfo.Box(-1, 1),
        lfo.Box([-5, -5], [5, 5]),
        initial_state=[4, 0],
    )


def dtoc3(N: int, folder: Path | None, name: str) -> Found:
    """Solve for periods 1 .. N; the state of period 1 has no cost."""
    S = 1 / N
    weight = S * np.diag([2.0, 1.0])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, S], [-S, 1]], [[0], [S]]),
        N - 1,
        lfo.QuadraticCost(Q=weight, R=6 * S, P=weight),
        initial_state=[15, 5],
    )
    first = S / 2 * (2 * 15**2 + 5**2)

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        return math.fsum((S / 2 * (2 * x[1:, 0] ** 2 + x[1:, 1] ** 2 + 6 * u[:, 0] ** 2)).tolist())

    return proven(problem, formula, first, folder, name)


def hager1(N: int, folder: Path | None, name: str) -> Found:
    """Solve with the trapezoidal rule, in the form of the next state."""
    h = 1 / N
    dynamics = lfo.LinearDynamics([[(1 + h / 2) / (1 - h / 2)]], [[h / (1 - h / 2)]])
    problem = lfo.OptimalControlProblem(dynamics, N, lfo.QuadraticCost(R=h, P=1.0), initial_state=[1])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        return float(x[-1, 0] ** 2 / 2 + h / 2 * (u**2).sum())

    return proven(problem, formula, 0.0, folder, name)


def hager2(N: int, folder: Path | None, name: str) -> Found:
    """Weigh both states of a step, with the next one as a x + b u."""
    h = 1 / N
    a, b, w = (1 + h / 4) / (1 - h / 4), h / (1 - h / 4), h / 6
    cost = lfo.QuadraticCost(Q=[[2 * w * (1 + a + a * a)]], S=[[w * (b + 2 * a * b)]], R=[[2 * w * b * b + h / 2]])
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[a]], [[b]]), N, cost, initial_state=[1])

    def formula(x: np.ndarray, u: np.ndarray) -> float:
        before, after = x[:-1, 0], x[1:, 0]
        return float((h / 6 * (after**2 + after * before + before**2) + h / 4 * u[:, 0] ** 2).sum())

    return proven(problem, formula, 0.0, folder, name)


def gropt(folder: Path | None, name: str) -> Found:
    """Search samples of 10 us: the number is exact, one sample less is proven infeasible."""
    found = lfo.minimum_time(lfo.library.mri_gradient, horizons=(100, 200))
    assert found.proven
    assert found.horizon is not None
    assert found.result is not None
    assert found.result.control is not None
    g = found.result.control[:, 0]
    moment = 0.01 * float(np.sum(g * 0.01 * np.arange(len(g))))
    assert abs(moment - 11.74) <= 1e-3 + 1e-8
    return Found(found.horizon / 100, found.horizon / 100, len(g) / 100, "ray, judge")


def phase_filter(n: int, ripple_db: float, stop_db: float) -> lfo.OptimalControlProblem:
    """Return the problem of h_0 + 2 sum h_k cos kw by its 2 n + 1 coefficients, control 0.

    Control 1 is control 0 less a pulse c at the centre. H is real, so that both sides of the passband are |H - c| <= d:
    a mask at every frequency.
    """
    N, up = 2 * n + 1, 10 ** (ripple_db / 20)
    c, d = (up + 1 / up) / 2, (up - 1 / up) / 2
    E = np.zeros((N, n + N, 2))
    for t in range(n):  # symmetric
        E[t, t, 0], E[N - 1 - t, t, 0] = 1, -1
    E[np.arange(N), n + np.arange(N)] = [1, -1]
    mask, notch = lfo.MagnitudeBound, lfo.spectrum.notch
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[0.0, 0.0]], sampling_time=1.0),
        N,
        lfo.QuadraticCost(R=1e-3 * np.eye(2)),
        lfo.Box(-2, 2),
        initial_state=[0],
        control_spectrum=[
            mask(d, band=notch(centre_hz=0.03, width_hz=0.06), every_frequency=True, component=1),
            mask(10 ** (stop_db / 20), band=notch(centre_hz=0.31, width_hz=0.38), every_frequency=True, component=0),
            lfo.spectrum.LinearConstraint(E, -c * np.eye(n + N)[2 * n]),
        ],
    )


def filter_is_feasible(n: int, ripple_db: float, stop_db: float) -> bool:
    """Return what is proven: True by a filter that holds its limits on a dense grid too, False by a ray."""
    result = lfo.solve(phase_filter(n, ripple_db, stop_db), throw=False)
    if result.status == lfo.results.Status.INFEASIBLE:
        assert result.bound == "rigorous"
        return False
    assert result.control is not None
    h = result.control[:, 0]
    for low, high, least, most in ((0, 0.12, -ripple_db, ripple_db), (0.24, 1, -np.inf, stop_db)):
        w = np.pi * np.linspace(low, high, 20001)
        dB = 20 * np.log10(np.abs(np.exp(-1j * np.outer(w, np.arange(len(h)))) @ h))
        assert least - 1e-4 <= dB.min()
        assert dB.max() <= most + 1e-4
    return True


def cvx_attenuation(folder: Path | None, name: str) -> Found:
    """Bracket the attenuation: one level is feasible, the next is not."""
    assert filter_is_feasible(10, 1, -34.526)
    assert not filter_is_feasible(10, 1, -34.527)
    return Found(-34.527, -34.526, None, "ray, judge")


def cvx_order(folder: Path | None, name: str) -> Found:
    """Find the least order: one is feasible, the one before is not."""
    assert filter_is_feasible(13, 0.5, -35)
    assert not filter_is_feasible(12, 0.5, -35)
    return Found(13, 13, None, "ray, judge")


DTOC3 = "DTOC3: y1+ = y1 + S y2, y2+ = y2 - S y1 + S x, S = 1/N, (15, 5); sum of S/2 (2 y1² + y2² + 6 x²); N = "
HAGER1 = "HAGER1: trapezoids of x' = x/2 + u, x = 1 at 0; x²/2 at 1 and half the integral of u²; N = "
HAGER2 = "HAGER2: trapezoids of x' = x/2 + u; sum of h/6 (x² + x x+ + x+²) + h/4 u²; N = "
EXCLUDED = "the proof excludes it, and a Riccati recursion has our digits"
CUTEST = "CUTEst, {0}.SIF"
MPT3 = "MPT3, mpt3.org; python-control, optimal_test.py"
ROWS = [
    *(
        Row(f"mpt3_u{t}", MPT3, f"The same regulator: its control at the step {t}", printed, partial(mpt3_control, t))
        for t, printed in ((0, "-1"), (1, "-1"), (2, ".1393"), (3, ".3361"))
    ),
    Row(
        "mpt3",
        "MPT3, mpt3.org; python-control, optimal_test.py",
        "Regulator of a double integrator, x0 = (4, 0), T = 4",
        "32.4898",
        mpt3,
    ),
    *(
        Row(f"dtoc3_{N}", CUTEST.format("DTOC3"), DTOC3 + str(N), printed, partial(dtoc3, N), EXCLUDED)
        for N, printed in (
            (10, "224.590381002"),
            (100, "234.286202920"),
            (1000, "235.182824435"),
            (5000, "235.154640099"),
        )
    ),
    Row("dtoc3_maros", "Maros, Meszaros, QP test set, DTOC3", DTOC3 + "5000", "235.262481", partial(dtoc3, 5000)),
    *(
        Row(f"hager1_{N}", CUTEST.format("HAGER1"), HAGER1 + str(N), printed, partial(hager1, N), EXCLUDED)
        for N, printed in ((10, ".88097222455"), (100, ".88079882866"))
    ),
    *(
        Row(f"hager2_{N}", CUTEST.format("HAGER2"), HAGER2 + str(N), printed, partial(hager2, N), EXCLUDED)
        for N, printed in ((10, ".4325699689"), (100, ".4320871769"))
    ),
    Row(
        "gropt",
        "GrOpt, demo of flow encoding",
        "Shortest bipolar gradient, 10 us, 40 mT/m, 200 T/m/s, in ms",
        "1.32",
        gropt,
    ),
    Row(
        "cvx_attenuation",
        "CVX, gallery of filter design",
        "Linear phase, n = 10, 1 dB ripple to .12 pi: least stop band from .24 pi in dB",
        "-35.15",
        cvx_attenuation,
        "printed on a grid of 300 points without the edges of the bands",
    ),
    Row(
        "cvx_order",
        "CVX, gallery of filter design",
        "Linear phase, .5 dB ripple to .12 pi, -35 dB from .24 pi: least n",
        "12",
        cvx_order,
        "printed on a grid of 300 points; over all frequencies 12 is proven infeasible",
    ),
]


def lines_of(rows: Iterable[Row], folder: Path | None) -> Iterable[tuple[Row, Found, str, float]]:
    """Yield each row with what is found, its verdict and the seconds of processor time."""
    for row in rows:
        start = time.process_time()
        found = row.find(folder, row.name)
        scale = max(abs(found.high), 1e-300)
        if found.again is not None and not found.low - AGREES * scale <= found.again <= found.high + AGREES * scale:
            yield row, found, "unexplained", time.process_time() - start
        else:
            yield row, found, verdict(row, found), time.process_time() - start


def table(found: Iterable[tuple[Row, Found, str, float]]) -> list[str]:
    """Return the lines of the table."""
    lines = ["| row | source | statement | printed | ours | verdict | proof | s |", "|---|---|---|---|---|---|---|---|"]
    for row, one, said, seconds in found:
        ours = f"{one.low:.12g}" if one.low == one.high else f"[{one.low:.12g}, {one.high:.12g}]"
        reason = f": {row.reason}" if said == "corrected" else ""
        cells = [row.name, row.source, row.statement.replace("|", "\\|"), row.printed, ours, said + reason, one.proof]
        lines.append(f"| {' | '.join(cells)} | {seconds:.1f} |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Print the table, or write the page; return 1 if a difference is unexplained."""
    parser = argparse.ArgumentParser(description="Compare printed values with proven intervals.")
    parser.add_argument("names", nargs="*", choices=[[], *(row.name for row in ROWS)], metavar="NAME")
    parser.add_argument("--write", action="store_true", help="write docs/published.md")
    parser.add_argument("--proofs", type=Path, metavar="FOLDER", help="write a .proof of each row that has one")
    given = parser.parse_args(arguments)
    if given.proofs is not None:
        given.proofs.mkdir(parents=True, exist_ok=True)
    found = list(lines_of([row for row in ROWS if not given.names or row.name in given.names], given.proofs))
    counts = {said: sum(one[2] == said for one in found) for said in ("confirmed", "corrected", "unexplained")}
    summary = ", ".join(f"{count} {said}" for said, count in counts.items())
    lines = table(found)
    print("\n".join([*lines, "", summary]))
    if given.write and not given.names:
        head, _, _ = PAGE.read_text(encoding="utf-8").partition("| row |")
        PAGE.write_text(head + "\n".join(lines) + f"\n\n{summary}.\n", encoding="utf-8")
    return int(counts["unexplained"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
