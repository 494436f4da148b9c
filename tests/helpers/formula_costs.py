"""CUTEst's discrete-time control problems with their costs as costs, or as the steps of an additional last state."""

from __future__ import annotations

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.transform.hybrid import cost_as_state


def dtoc1l(points: int, controls: int = 2, states: int = 4) -> lfo.OptimalControlProblem:
    """Return DTOC1L: linear dynamics with quartic costs."""
    j, i, total = np.arange(states), np.arange(controls), controls + states
    A = 0.5 * np.eye(states) + 0.25 * np.eye(states, k=1) - 0.25 * np.eye(states, k=-1)
    B = (j[:, None] - i) / total

    def stage(x, u):
        return sum((one - 0.5) ** 4 for one in u) + sum((one - 0.25) ** 4 for one in x)

    cost = lfo.costs.SmoothCost(stage=stage)
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), points - 1, cost, initial_state=np.zeros(states))


def dtoc2(points: int) -> lfo.OptimalControlProblem:
    """Return DTOC2: sines in the dynamics and in the cost."""
    C = np.add.outer(np.arange(1, 3), np.arange(1, 5)) / 8

    def f(x, u):
        return [np.sin(x[j]) + sum(C[i, j] * np.sin(u[i]) for i in range(2)) for j in range(4)]

    def stage(x, u):
        return sum(one**2 for one in x) * (np.sin((u[0] ** 2 + u[1] ** 2) / 2) ** 2 + 1)

    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 4, 2)
    cost = lfo.costs.SmoothCost(stage=stage) + lfo.QuadraticCost(P=2.0)
    return lfo.OptimalControlProblem(dynamics, points - 1, cost, initial_state=np.arange(1, 5) / 8)


def dtoc6(points: int) -> lfo.OptimalControlProblem:
    """Return DTOC6: an exponential in the dynamics and in the cost."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [x[0] + np.exp(u[0])], 1, 1)
    cost = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage=lambda x, u: (np.exp(u[0]) + x[0]) ** 2 / 2)
    return lfo.OptimalControlProblem(dynamics, points - 1, cost, initial_state=[0.0])


def clnlbeam(intervals: int) -> lfo.OptimalControlProblem:
    """Return CLNLBEAM: the state has theta, x and u, the control is the next u."""
    h, infinite = 1 / intervals, np.inf

    def f(x, u):
        turned = x[0] + h / 2 * (u[0] + x[2])
        return [turned, x[1] + h / 2 * (np.sin(x[0]) + np.sin(turned)), u[0]]

    def stage(x, u):
        return 350 * h / 2 * (np.cos(x[0]) + np.cos(x[0] + h / 2 * (u[0] + x[2])))

    cost = lfo.QuadraticCost(Q=np.diag([0, 0, h]), R=h) + lfo.costs.SmoothCost(stage=stage)
    ends = lfo.Box([0.0, 0.0, -infinite], [0.0, 0.0, infinite])
    bounds = lfo.Box([-1.0, -0.05, -infinite], [1.0, 0.05, infinite])
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 3, 1)
    return lfo.OptimalControlProblem(
        dynamics, intervals, cost, state_set=bounds, initial_state=ends, terminal_state=ends
    )


def hs99() -> lfo.OptimalControlProblem:
    """Return problem 99 of Hock and Schittkowski: a rocket whose data change with time, and which is to fly far."""
    times = np.array([0, 25, 50, 100, 150, 200, 290, 380.0])
    thrust, gravity, steps = [50.0, 50, 75, 75, 75, 100, 100], 32.0, np.diff(times)

    def f(t, x, u):
        a, h = t.look_up(thrust), t.look_up(steps)
        climb = a * np.sin(u[0]) - gravity
        return [x[0] + a * h * np.cos(u[0]), x[1] + climb * h, x[2] + climb * h**2 / 2 + x[1] * h]

    cost = lfo.costs.SmoothCost(terminal=lambda x: -(x[0] ** 2))
    return lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(f, 3, 1),
        7,
        cost,
        control_set=lfo.Box(0.0, 1.58),
        initial_state=[0.0, 0.0, 0.0],
        terminal_state=lfo.Box([-np.inf, 1000.0, 1e5], [np.inf, 1000.0, 1e5]),
    )


PUBLISHED = {
    "DTOC1L, N = 10": (lambda: dtoc1l(10), 0.06977261110845),
    "DTOC1L, N = 50": (lambda: dtoc1l(50), 0.2260333478713),
    "DTOC1L (5, 10), N = 100": (lambda: dtoc1l(100, 5, 10), 12.31452448226),
    "DTOC2, N = 10": (lambda: dtoc2(10), 0.485983918948),
    "DTOC2, N = 50": (lambda: dtoc2(50), 0.4887862099681),
    "DTOC6, N = 11": (lambda: dtoc6(11), 19.80414462185),
    "DTOC6, N = 51": (lambda: dtoc6(51), 261.1132939067),
    "DTOC6, N = 101": (lambda: dtoc6(101), 727.981316583),
    "CLNLBEAM, N = 10": (lambda: clnlbeam(10), 345.0301196587),
    "CLNLBEAM, N = 50": (lambda: clnlbeam(50), 344.8673691861),
    "HS99": (hs99, -831079892.0),
}


def with_state(problem: lfo.OptimalControlProblem) -> lfo.OptimalControlProblem:
    """Return the problem with its stage cost by formulas as a state, as it was stated before costs by formulas."""
    reduced = cost_as_state(problem, lfo.simulate(problem, np.zeros((problem.horizon, problem.control_dim))))
    assert reduced is not None
    return reduced.problem
