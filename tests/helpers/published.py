"""Smooth problems with published optima: CUTEst's discrete-time control problems, Kelly's and acados' examples.

Stage costs that are not quadratic are the steps of an additional last state, which the cost takes at the end. The
optima are CUTEst's, acados' or those of IPOPT on the same statement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array

Map = Callable[[Any, Any], Sequence[Any]]


def smooth_problem(
    f: Map,
    start: Sequence[float],
    controls: int,
    horizon: int,
    stage: Callable[[Any, Any], Any] | None = None,
    P: Array | None = None,
    Q: Array | float = 0.0,
    R: Array | float = 0.0,
    **sets: Any,
) -> lfo.OptimalControlProblem:
    """Return the problem of a map from an initial state, with a stage cost in an additional state if it is given."""
    n = len(start) + (stage is not None)
    if stage is None:
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, n, controls)
        cost = lfo.QuadraticCost(Q=Q, R=R, **({} if P is None else {"P": P}))
        return lfo.OptimalControlProblem(dynamics, horizon, cost, initial_state=list(start), **sets)
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [*f(x[:-1], u), x[-1] + stage(x[:-1], u)], n, controls
    )
    end, ends = np.zeros((n, n)), np.zeros(n)
    if P is not None:
        end[:-1, :-1] = P
    ends[-1] = 1.0
    cost = lfo.QuadraticCost(P=end, p=ends)
    return lfo.OptimalControlProblem(dynamics, horizon, cost, initial_state=[*start, 0.0], **sets)


def dtoc1l(horizon: int, nx: int, ny: int) -> lfo.OptimalControlProblem:
    """Return DTOC1L with N = horizon + 1 points: nx controls, ny states, quartic costs."""

    def f(x, u):
        padded = [0.0, *x, 0.0]
        pushes = [sum((j - i) / (nx + ny) * u[i] for i in range(nx)) for j in range(ny)]
        return [0.5 * x[j] + 0.25 * padded[j + 2] - 0.25 * padded[j] + pushes[j] for j in range(ny)]

    def stage(x, u):
        return sum((u[i] - 0.5) ** 4 for i in range(nx)) + sum((x[j] - 0.25) ** 4 for j in range(ny))

    return smooth_problem(f, np.zeros(ny), nx, horizon, stage)


def dtoc2(horizon: int) -> lfo.OptimalControlProblem:
    """Return DTOC2 with N = horizon + 1 points."""
    C = np.array([[(i + j) / 8 for j in range(1, 5)] for i in range(1, 3)])

    def f(x, u):
        return [np.sin(x[j]) + sum(C[i, j] * np.sin(u[i]) for i in range(2)) for j in range(4)]

    def stage(x, u):
        return sum(a**2 for a in x) * (np.sin((u[0] ** 2 + u[1] ** 2) / 2) ** 2 + 1)

    return smooth_problem(f, np.arange(1, 5) / 8, 2, horizon, stage, P=2 * np.eye(4))


def dtoc4(horizon: int) -> lfo.OptimalControlProblem:
    """Return DTOC4 with N = horizon + 1 points."""
    h = 5 / (horizon + 1)

    def f(x, u):
        return [(1 + h) * x[0] - h * x[1] + h * u[0] - h * x[1] ** 2 * x[0], x[1] + h * x[0]]

    Q = np.broadcast_to(2 * h * np.eye(2), (horizon, 2, 2)).copy()
    Q[0] /= 2
    return smooth_problem(f, [0.0, 1.0], 1, horizon, P=h * np.eye(2), Q=Q, R=2 * h)


def dtoc5(horizon: int) -> lfo.OptimalControlProblem:
    """Return DTOC5 with N = horizon + 1 points."""
    h = 1 / (horizon + 1)
    return smooth_problem(lambda x, u: [x[0] - h * u[0] + h * x[0] ** 2], [1.0], 1, horizon, Q=2 * h, R=2 * h)


def dtoc6(horizon: int) -> lfo.OptimalControlProblem:
    """Return DTOC6 with N = horizon + 1 points."""
    return smooth_problem(
        lambda x, u: [x[0] + np.exp(u[0])],
        [0.0],
        1,
        horizon,
        lambda x, u: u[0] ** 2 / 2 + (np.exp(u[0]) + x[0]) ** 2 / 2,
    )


def clnlbeam(horizon: int) -> lfo.OptimalControlProblem:
    """Return CLNLBEAM: the state has theta, x and u, the control is the next u."""
    h, infinite = 1 / horizon, np.inf

    def f(x, u):
        turned = x[0] + h / 2 * (u[0] + x[2])
        return [turned, x[1] + h / 2 * (np.sin(x[0]) + np.sin(turned)), u[0]]

    def stage(x, u):
        turned = x[0] + h / 2 * (u[0] + x[2])
        return h / 2 * (x[2] ** 2 + u[0] ** 2) + 350 * h / 2 * (np.cos(x[0]) + np.cos(turned))

    problem = smooth_problem(f, np.zeros(3), 1, horizon, stage)
    free = [0.0, 0.0, infinite, 0.0]
    return lfo.OptimalControlProblem(
        problem.dynamics,
        horizon,
        problem.cost,
        state_set=lfo.Box([-1.0, -0.05, -infinite, -infinite], [1.0, 0.05, infinite, infinite]),
        initial_state=lfo.Box([-a for a in free], free),
        terminal_state=lfo.Box([0.0, 0.0, -infinite, -infinite], [0.0, 0.0, infinite, infinite]),
    )


def runge_kutta(rates: Map, step: float) -> Map:
    """Return one step of the classical Runge-Kutta method with constant controls."""

    def f(x, u):
        def moved(slope, part):
            return [a + part * step * b for a, b in zip(x, slope, strict=True)]

        first = rates(list(x), u)
        second = rates(moved(first, 0.5), u)
        third = rates(moved(second, 0.5), u)
        fourth = rates(moved(third, 1.0), u)
        slopes = zip(x, first, second, third, fourth, strict=True)
        return [start + step / 6 * (a + 2 * b + 2 * c + d) for start, a, b, c, d in slopes]

    return f


def chen_allgoewer(horizon: int, seconds: float = 10.0) -> lfo.OptimalControlProblem:
    """Return Chen's and Allgoewer's unstable system (Automatica 34(10), 1998) over some seconds."""
    step = seconds / horizon

    def rates(x, u):
        return [x[1] + u[0] * (0.5 + 0.5 * x[0]), x[0] + u[0] * (0.5 - 2 * x[1])]

    P = 2 * np.array([[16.5926, 11.5926], [11.5926, 16.5926]])
    return smooth_problem(
        runge_kutta(rates, step),
        [-0.683, -0.864],
        1,
        horizon,
        P=P,
        Q=2 * step * 0.5,
        R=2 * step,
        control_set=lfo.Box(-2, 2),
    )


def acados_pendulum(horizon: int) -> lfo.OptimalControlProblem:
    """Return acados' first example, a pendulum on a cart that is to stand upright after a second."""
    step, M, m, g, length = 1.0 / horizon, 1.0, 0.1, 9.81, 0.8

    def rates(x, u):
        sine, cosine = np.sin(x[1]), np.cos(x[1])
        denominator = M + m - m * cosine * cosine
        push = -m * length * sine * x[3] * x[3] + m * g * cosine * sine + u[0]
        turn = -m * length * cosine * sine * x[3] * x[3] + u[0] * cosine + (M + m) * g * sine
        return [x[2], x[3], push / denominator, turn / (length * denominator)]

    Q = 2 * np.diag([1e3, 1e3, 1e-2, 1e-2])
    f = runge_kutta(rates, step)
    return smooth_problem(
        f, [0.0, np.pi, 0.0, 0.0], 1, horizon, P=Q, Q=step * Q, R=step * 2e-2, control_set=lfo.Box(-80, 80)
    )


def straight_line(problem: lfo.OptimalControlProblem, end: Sequence[float]) -> lfo.Trajectory:
    """Return states on a straight line to an end, which are no trajectory, with controls of zero."""
    part = np.linspace(0.0, 1.0, problem.horizon + 1)[:, None]
    start = problem.ends[0].lower
    return lfo.Trajectory((1 - part) * start + part * np.asarray(end), np.zeros((problem.horizon, problem.control_dim)))


def mass_around_disc(horizon: int = 20) -> lfo.OptimalControlProblem:
    """Return acados' test of the Maratos effect: a mass moves around a disc, which is the region of its only mode."""
    step = 2.0 / horizon

    def f(x, u):
        moved = [x[i] + step * x[2 + i] + step**2 / 2 * u[i] for i in range(2)]
        return [*moved, *(x[2 + i] + step * u[i] for i in range(2))]

    mode = lfo.dynamics.SmoothMode(f, region=lambda x, u: [1.0 - x[0] ** 2 - x[1] ** 2], name="outside the disc")
    return lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics([mode], 4, 2),
        horizon,
        lfo.QuadraticCost(Q=0.0, R=20.0 * step),
        control_set=lfo.Box(-5, 5),
        initial_state=[0.1, 1.1, 0, 0],
        terminal_state=[0, -1.1, 0, 0],
    )


def mass_outside_disc(horizon: int = 20) -> lfo.OptimalControlProblem:
    """Return the same with linear dynamics, and the disc as a path constraint."""
    step, given = 2.0 / horizon, mass_around_disc(horizon)
    A, B = np.eye(4) + step * np.eye(4, k=2), np.vstack([step**2 / 2 * np.eye(2), step * np.eye(2)])
    disc = lfo.sets.PathConstraint(lambda x, u: 1.0 - x[0] ** 2 - x[1] ** 2, name="disc")
    return replace(given, dynamics=lfo.LinearDynamics(A, B), stage_rows=disc)


def turned_body(
    inertia: Sequence[float], torque: float, axis: int, angle: float, horizon: int, cutoff: float | None = None
) -> lfo.OptimalControlProblem:
    """Return the least time in which a body turns from rest to rest by an angle, with torques about three axes.

    States are a quaternion, which keeps its length of 1 exactly, so that the end implies one of its components; the
    rates of turn, by the method of Runge and Kutta; and the length of a step. ``cutoff`` is that of a low pass.
    """
    first, second, third = inertia

    def rates(w, u):
        return [
            ((second - third) * w[1] * w[2] + torque * u[0]) / first,
            ((third - first) * w[2] * w[0] + torque * u[1]) / second,
            ((first - second) * w[0] * w[1] + torque * u[2]) / third,
        ]

    def f(x, u):
        w, step = list(x[4:7]), x[7]
        after = runge_kutta(rates, step)(w, u)
        a, b, c = (step / 4 * (before + now) for before, now in zip(w, after, strict=True))
        length = np.sqrt(1 + a**2 + b**2 + c**2)
        turned = [
            x[0] + x[3] * a + x[1] * c - x[2] * b,
            x[1] + x[3] * b + x[2] * a - x[0] * c,
            x[2] + x[3] * c + x[0] * b - x[1] * a,
            x[3] - x[0] * a - x[1] * b - x[2] * c,
        ]
        return [*(part / length for part in turned), *after, step]

    usual = 2 * np.sqrt(angle * inertia[axis] / torque) / horizon  # of a step: the time about the axis alone
    steps, last = np.array([0.1, 10.0]) * usual, np.zeros(8)
    first_state, last_state = np.eye(7)[3], np.zeros(7)
    last_state[[axis, 3]] = np.sin(angle / 2), np.cos(angle / 2)
    last[7] = horizon
    return lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(f, 8, 3),
        horizon,
        lfo.QuadraticCost(p=last),
        lfo.Box(-1, 1),
        initial_state=lfo.Box(*(np.append(first_state, step) for step in steps)),
        terminal_state=lfo.Box(*(np.append(last_state, step) for step in steps)),
        control_spectrum=None if cutoff is None else [lfo.low_pass(cutoff)],
    )


class Published(NamedTuple):
    """A problem, the horizon it is built with, and a local optimum that is not to be exceeded."""

    build: Callable[[int], lfo.OptimalControlProblem]
    horizon: int
    cost: float


# By IPOPT on the same statement from constant controls or a straight line, or as published; CUTEst's own values differ
# in the fourth digit for some
PUBLISHED = {
    "DTOC1L, N = 10": Published(lambda T: dtoc1l(T, 2, 4), 9, 0.06977261110845),
    "DTOC1L, N = 50": Published(lambda T: dtoc1l(T, 2, 4), 49, 0.2260333478713),
    "DTOC1L (5, 10), N = 100": Published(lambda T: dtoc1l(T, 5, 10), 99, 12.31452448226),
    "DTOC2, N = 10": Published(dtoc2, 9, 0.485983918948),
    "DTOC2, N = 50": Published(dtoc2, 49, 0.4887862099681),
    "DTOC2, N = 100": Published(dtoc2, 99, 0.48804821),
    "DTOC2, N = 500": Published(dtoc2, 499, 0.504942582166),
    "DTOC4, N = 100": Published(dtoc4, 99, 2.947346646653),
    "DTOC4, N = 500": Published(dtoc4, 499, 2.882851040643),
    "DTOC5, N = 10": Published(dtoc5, 9, 1.451900566926),
    "DTOC5, N = 50": Published(dtoc5, 49, 1.528859095685),
    "DTOC6, N = 11": Published(dtoc6, 10, 19.80414462185),
    "DTOC6, N = 21": Published(dtoc6, 20, 62.4952688317),
    "DTOC6, N = 51": Published(dtoc6, 50, 261.1132939067),
    "DTOC6, N = 101": Published(dtoc6, 100, 727.981316583),
    "CLNLBEAM, N = 10": Published(clnlbeam, 10, 345.0301196587),
    "CLNLBEAM, N = 50": Published(clnlbeam, 50, 344.8673691861),
    "Chen-Allgoewer, T = 100": Published(chen_allgoewer, 100, 4.81280255637),
    "Chen-Allgoewer, T = 400": Published(lambda T: chen_allgoewer(T, 40.0), 400, 4.812802487938),
    "pendulum of acados, T = 40": Published(acados_pendulum, 40, 2243.6764),
    "pendulum of acados, T = 100": Published(acados_pendulum, 100, 2047.23),
    "mass around a disc": Published(mass_around_disc, 20, 316.532678),
    "mass around a disc, by h": Published(mass_outside_disc, 20, 316.532678),
}

# Ours; in continuous time, the first two are 28.6304 (Betts, Practical Methods for Optimal Control, 2010) and 3.2430
# (Bilimoria and Wie, J. Guidance 16(3), 1993)
LEAST_TIMES = {
    "body of Betts, N = 50": Published(
        lambda T: turned_body((5621.0, 4547.0, 2364.0), 50.0, 0, np.deg2rad(150), T), 50, 28.655900
    ),
    "ball, N = 60": Published(lambda T: turned_body((1.0, 1.0, 1.0), 1.0, 2, np.pi, T), 60, 3.2444596),
    "ball, low pass of 0.8, N = 120": Published(
        lambda T: turned_body((1.0, 1.0, 1.0), 1.0, 2, np.pi, T, 0.8), 120, 3.6638349
    ),
    "ball, low pass of 0.4, N = 120": Published(
        lambda T: turned_body((1.0, 1.0, 1.0), 1.0, 2, np.pi, T, 0.4), 120, 3.7834252
    ),
}
