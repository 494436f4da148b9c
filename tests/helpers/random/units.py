"""Random problems of all classes whose data can be written in any units, from any origin, and with looser bounds.

``drawn(seed)`` has the numbers of a problem; ``problem(numbers, change)`` writes them down in other units.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import lin_freq_ocp as lfo

CLASSES = ("linear", "terms", "time-varying", "affine modes", "smooth pieces")


@dataclass(frozen=True, eq=False)
class Change:
    """How a problem is written: x' = units x + origin, u' = units u + origin, c' = cost c, t' = time t.

    Attributes
    ----------
    x, u : (n,), (m,)
        Units.
    x_origin, u_origin : (n,), (m,)
    cost, time : float
    loosened : float
        Added on either side to bounds that are not active, in units of the problem as drawn; inf: removed.
    slack : pairs of masks or None
        Which bounds are not active: (lower, upper) of the states (n,) and of the controls (m,).
    """

    x: np.ndarray
    u: np.ndarray
    x_origin: np.ndarray
    u_origin: np.ndarray
    cost: float = 1.0
    time: float = 1.0
    loosened: float = 0.0
    slack: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None

    @classmethod
    def none(cls, n: int, m: int, **changed: Any) -> Change:
        """Return the change to the same words, or to others where they are given."""
        plain: dict[str, Any] = {"x": np.ones(n), "u": np.ones(m), "x_origin": np.zeros(n), "u_origin": np.zeros(m)}
        return cls(**{**plain, **changed})


@dataclass(frozen=True, eq=False)
class Drawn:
    """The numbers of a problem, as drawn: everything of order 1.

    Attributes
    ----------
    kind : str
        One of CLASSES.
    modes : sequence of (A, B, d, G, h)
        One without rows, or affine modes G x <= h; (T, n, n) and (T, n, m) where time-varying.
    shifts : bool
        Whether the origin may move: no bin 0 is constrained, and no absolute value stands in a cost or formula.
    """

    kind: str
    T: int
    modes: Sequence[tuple[np.ndarray, ...]]
    Q: np.ndarray
    R: np.ndarray
    P: np.ndarray
    q: np.ndarray
    r: np.ndarray
    x_ref: np.ndarray
    sparse: np.ndarray
    x_bound: tuple[np.ndarray, np.ndarray]
    u_bound: tuple[np.ndarray, np.ndarray]
    start: np.ndarray
    end: np.ndarray | None
    cutoff: float | None
    mask: float | None
    row: tuple[np.ndarray, np.ndarray, float] | None
    shifts: bool

    @property
    def n(self) -> int:
        """Return the number of states."""
        return len(self.start)

    @property
    def m(self) -> int:
        """Return the number of controls."""
        return len(self.R)


def drawn(seed: int) -> Drawn:
    """Return the numbers of one problem, around a trajectory that satisfies everything."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(CLASSES, p=[0.45, 0.25, 0.1, 0.15, 0.05]))
    modes_or_pieces = kind in ("affine modes", "smooth pieces")
    n, m = int(rng.integers(1, 3 if modes_or_pieces else 5)), int(rng.integers(1, 3))
    n, m = (1, 1) if kind == "smooth pieces" else (n, m)
    T = int(rng.integers(3, 6) if modes_or_pieces else rng.integers(4, 40))
    modes = _modes(rng, kind, n, m, T)
    u = 0.5 * rng.standard_normal((T, m))
    nyquist = 2 * np.pi * (T // 2) / T
    cutoff = float(rng.uniform(0.25, 0.9)) * nyquist if rng.random() < 0.6 else None
    if cutoff is not None:
        spectrum = np.fft.rfft(u, axis=0)
        spectrum[2 * np.pi * np.arange(len(spectrum)) / T > cutoff] = 0
        u = np.fft.irfft(spectrum, n=T, axis=0)
    start = rng.standard_normal(n)
    x = _replayed(kind, modes, start, u)
    factor = rng.standard_normal((n, n))
    room = rng.uniform(0.0, 0.4, (4, max(n, m)))
    some_x, some_u = rng.random((2, n)) < 0.5, rng.random((2, m)) < 0.8
    if modes_or_pieces:
        some_x[:], some_u[:] = True, True
    plain = kind in ("linear", "time-varying", "affine modes")
    return Drawn(
        kind=kind,
        T=T,
        modes=modes,
        Q=(factor @ factor.T) * (rng.random() < 0.6) if rng.random() < 0.5 else np.diag(rng.uniform(0, 1, n)),
        R=rng.uniform(0.1, 1, m),
        P=np.diag(rng.uniform(0, 3, n)) * (rng.random() < 0.5),
        q=rng.standard_normal(n) * (rng.random() < 0.3) * (not modes_or_pieces),
        r=rng.standard_normal(m) * (rng.random() < 0.3),
        x_ref=rng.standard_normal(n) * (rng.random() < 0.5),
        sparse=rng.uniform(0.1, 1, m) * (kind == "terms" and rng.random() < 0.5),
        x_bound=(
            np.where(some_x[0], x.min(0) - room[0, :n], -np.inf),
            np.where(some_x[1], x.max(0) + room[1, :n], np.inf),
        ),
        u_bound=(
            np.where(some_u[0], u.min(0) - room[2, :m], -np.inf),
            np.where(some_u[1], u.max(0) + room[3, :m], np.inf),
        ),
        start=start,
        end=x[-1] if rng.random() < 0.5 else None,
        cutoff=cutoff,
        mask=float(np.abs(np.fft.rfft(u[:, 0])).max() * rng.uniform(0.8, 1.1)) if kind == "terms" else None,
        row=_row(rng, x, u) if kind in ("linear", "terms") and rng.random() < 0.4 else None,
        shifts=plain and rng.random() < 0.9,
    )


def _modes(rng: np.random.Generator, kind: str, n: int, m: int, T: int) -> list[tuple[np.ndarray, ...]]:
    A = rng.standard_normal((n, n))
    A *= rng.choice([0.7, 0.95, 1.0, 1.05]) / max(np.abs(np.linalg.eigvals(A)).max(), 1e-3)
    B, d = rng.standard_normal((n, m)), 0.1 * rng.standard_normal(n) * (rng.random() < 0.5)
    if kind == "time-varying":
        return [(A * rng.uniform(0.9, 1.0, (T, 1, 1)), B * rng.uniform(0.8, 1.2, (T, 1, 1)), d)]
    if kind != "affine modes":
        return [(A, B, d)]
    across, jump, place = rng.standard_normal(n), 0.7 * rng.standard_normal(n), rng.uniform(-0.3, 0.3)
    other = A + np.outer(jump, across), B, d - jump * place
    return [(A, B, d, across[None], np.array([place])), (*other, -across[None], np.array([-place]))]


def _replayed(kind: str, modes: Sequence[tuple[np.ndarray, ...]], start: np.ndarray, u: np.ndarray) -> np.ndarray:
    x = [start]
    for t in range(len(u)):
        if kind == "smooth pieces":
            x.append(0.8 * x[-1] + 0.3 * np.abs(x[-1]) + u[t] * (1 - 0.2 * x[-1]))
            continue
        mode = modes[0] if len(modes) == 1 or (modes[0][3] @ x[-1] <= modes[0][4]).all() else modes[1]
        A, B = (part[t] if part.ndim == 3 else part for part in mode[:2])
        x.append(A @ x[-1] + B @ u[t] + mode[2])
    return np.array(x)


def _row(rng: np.random.Generator, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    C, D = rng.standard_normal(x.shape[1]), rng.standard_normal(u.shape[1])
    return C, D, float((x[:-1] @ C + u @ D).max() + rng.uniform(0, 0.3))


def problem(data: Drawn, change: Change | None = None) -> lfo.OptimalControlProblem:
    """Return the problem of these numbers, written in other words."""
    change = change or Change.none(data.n, data.m)
    X, U = np.diag(change.x), np.diag(change.u)
    from_x, from_u = np.diag(1 / change.x), np.diag(1 / change.u)
    a, b, cost = change.x_origin, change.u_origin, change.cost
    (x_low, x_high), (u_low, u_high) = _bounds(data, change)
    rows, sampling_time = None, 0.1 * change.time
    if data.row is not None:
        C, D = data.row[0] @ from_x, data.row[1] @ from_u
        rows = lfo.StageRows(C[None], D[None], [data.row[2] + C @ a + D @ b])
    costs: Any = lfo.QuadraticCost(
        Q=cost * _symmetric(from_x @ data.Q @ from_x),
        R=cost * np.diag(data.R / change.u**2),
        P=cost * _symmetric(from_x @ data.P @ from_x),
        q=cost * data.q / change.x,
        r=cost * data.r / change.u,
        x_ref=change.x * data.x_ref + a,
        u_ref=b,
    )
    if data.sparse.any():
        costs = costs + lfo.costs.L1Cost(u=cost * data.sparse / change.u)
    spectra: list[Any] = []
    if data.cutoff is not None:
        spectra.append(lfo.low_pass(cutoff_hz=data.cutoff / (2 * np.pi * sampling_time)))
    if data.mask is not None:
        spectra.append(lfo.MagnitudeBound(data.mask * change.u[0], bins=[1, 2], component=0))
    end = None
    if data.end is not None:
        target, free = change.x * data.end + a, ~np.isfinite(data.end)
        end = lfo.Box(np.where(free, -np.inf, target), np.where(free, np.inf, target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.errors.BandWarning)
        return lfo.OptimalControlProblem(
            dynamics=_dynamics(data, change, X, U, sampling_time),
            horizon=data.T,
            cost=costs,
            control_set=lfo.Box(change.u * u_low + b, change.u * u_high + b),
            state_set=lfo.Box(change.x * x_low + a, change.x * x_high + a),
            initial_state=change.x * data.start + a,
            terminal_state=end,
            control_spectrum=spectra or None,
            stage_rows=rows,
            name=data.kind,
        )


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2


def _bounds(data: Drawn, change: Change) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the bounds as drawn, those that are not active looser."""
    if change.slack is None:
        return [data.x_bound, data.u_bound]
    return [
        (low - np.where(slack[0], change.loosened, 0.0), high + np.where(slack[1], change.loosened, 0.0))
        for (low, high), slack in zip((data.x_bound, data.u_bound), change.slack, strict=True)
    ]


def _dynamics(data: Drawn, change: Change, X: np.ndarray, U: np.ndarray, sampling_time: float) -> Any:
    a, b = change.x_origin, change.u_origin
    from_x, from_u = np.diag(1 / change.x), np.diag(1 / change.u)
    if data.kind == "smooth pieces":
        s, w = float(change.x[0]), float(change.u[0])
        return lfo.PiecewiseSmoothDynamics.from_formulas(
            lambda x, u: [0.8 * x[0] + 0.3 * abs(x[0]) + u[0] * (s / w - 0.2 * x[0] / w)], 1, 1, sampling_time
        )
    parts = []
    for mode in data.modes:
        A, B = X @ mode[0] @ from_x, X @ mode[1] @ from_u
        parts.append((A, B, change.x * mode[2] + a - A @ a - B @ b))
    if len(parts) == 1:
        return lfo.LinearDynamics(*parts[0], sampling_time=sampling_time)
    rows = [(mode[3] @ from_x, mode[4] + mode[3] @ from_x @ a) for mode in data.modes]
    modes = [lfo.AffineMode(A, B, offset=d, G=G, h=h) for (A, B, d), (G, h) in zip(parts, rows, strict=True)]
    return lfo.PiecewiseAffineDynamics(modes, sampling_time=sampling_time)


def reordered(data: Drawn, order: np.ndarray) -> Drawn:
    """Return the same numbers with the states in another order."""
    matrix = (..., order[:, None], order)
    modes = [
        (mode[0][matrix], mode[1][..., order, :], mode[2][order], *(part[:, order] for part in mode[3:4]), *mode[4:])
        for mode in data.modes
    ]
    vectors = {name: getattr(data, name)[order] for name in ("q", "x_ref", "start")}
    return replace(
        data,
        modes=modes,
        Q=data.Q[matrix],
        P=data.P[matrix],
        x_bound=(data.x_bound[0][order], data.x_bound[1][order]),
        end=None if data.end is None else data.end[order],
        row=None if data.row is None else (data.row[0][order], *data.row[1:]),
        **vectors,
    )


def with_harmless_state(data: Drawn) -> Drawn:
    """Return the same numbers with one state more, on which nothing depends: x+ = 0.5 x + 0.1 (the first), free."""
    n = data.n

    def wider(matrix: np.ndarray, last: float = 0.0) -> np.ndarray:
        padded = np.zeros((*matrix.shape[:-2], n + 1, n + 1))
        padded[..., :n, :n], padded[..., n, n] = matrix, last
        return padded

    modes = []
    for mode in data.modes:
        A = wider(mode[0], 0.5)
        A[..., n, 0] = 0.1
        B = np.concatenate([mode[1], np.zeros((*mode[1].shape[:-2], 1, data.m))], axis=-2)
        rows = [np.hstack([part, np.zeros((len(part), 1))]) for part in mode[3:4]]
        modes.append((A, B, np.append(mode[2], 0.0), *rows, *mode[4:]))
    return replace(
        data,
        modes=modes,
        Q=wider(data.Q),
        P=wider(data.P),
        q=np.append(data.q, 0.0),
        x_ref=np.append(data.x_ref, 0.0),
        start=np.append(data.start, 1.0),
        end=None if data.end is None else np.append(data.end, np.nan),
        x_bound=(np.append(data.x_bound[0], -np.inf), np.append(data.x_bound[1], np.inf)),
        row=None if data.row is None else (np.append(data.row[0], 0.0), *data.row[1:]),
    )
