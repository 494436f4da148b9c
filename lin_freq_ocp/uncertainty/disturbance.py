"""Loads E w_t that are added to the coming state, and the plans that hold for all of them.

The plan (z, v) has no loads; what acts is u_t = v_t + K (x_t - z_t). Bounds, joint rows and polyhedra less their
margins are limits of an ordinary problem: its plans are those whose limits hold for all loads (docs/robust.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_discrete_are

from lin_freq_ocp.base.arrays import Array, Indices, assign, brief, real_array, require_bool, to_shape
from lin_freq_ocp.base.errors import ClosedLoopWarning, ProblemError, UnsupportedError, warn_user
from lin_freq_ocp.base.phrases import join_words, number, short_name
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box, SetOrSets
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.limits import intersection
from lin_freq_ocp.transform.sizes import stated_sizes
from lin_freq_ocp.uncertainty.error_loop import ErrorLoop
from lin_freq_ocp.uncertainty.invariant import invariant_end, lasting_rows
from lin_freq_ocp.uncertainty.leakage import largest_spectra, tightened_spectra
from lin_freq_ocp.uncertainty.loads import Loads, loads_of
from lin_freq_ocp.uncertainty.protocol import Uncertainty
from lin_freq_ocp.uncertainty.worst_loads import WorstCase, worst_loads

WEIGHTS = np.geomspace(1e-3, 1e3, 25)  # of the controls in the costs of the regulators of which "auto" takes one
SMALL_PART = 1e-6  # of the mean weight, in place of none
CHOSEN_OVER = 500  # steps over which their margins are compared


@dataclass(frozen=True, eq=False, init=False)
class Disturbance(Uncertainty):
    """Loads w_t of a set: E w_t is added to the state x_{t+1}, at every t < T, and measured states are fed back.

    The plan (z, v) is made without loads; the control that acts is u_t = v_t + K (x_t - z_t).

    Parameters
    ----------
    set : Box, Ball, Ellipsoid, Polyhedron, (samples, k), Records or Gaussian
        The loads of each time, of one bounded set or of the convex hull of measured samples; or records over time, or
        Gaussian loads, for which each limit at each time by itself holds with a probability.
    input : (n, k), or (T, n, k), optional
        E; rows of states that ``rate_limited`` or ``filtered_control`` adds may be absent. Default: a load in every
        state.
    gain : "auto", (m, n), or None
        K. "auto" takes, of the regulators of 25 weights of the controls, the one whose largest margin is the smallest
        share of its range. None for K = 0: the plan acts as it is.
    start : set, optional
        How far the true initial state may be from the planned one; it is known when the plan runs.
    forever : bool
        The loads have acted since ever, with the same feedback: margins are those of an infinite past at all times. A
        periodic plan that is repeated with its feedback then never violates a limit. Not with ``start``.

    Raises
    ------
    ProblemError
        If an argument is not of this kind; what does not fit a problem is found with it.

    Notes
    -----
    Margins are exact but for rounding, which is bounded and added. ``docs/robust.md`` has the theorems, what is
    promised of limits in frequency, and what is not.

    References
    ----------
    Chisci, Rossiter and Zappa, "Systems with persistent disturbances: predictive control with restricted constraints",
    Automatica 37, 2001. Kolmanovsky and Gilbert, "Theory and computation of disturbance invariant sets", 1998.

    Examples
    --------
    >>> load = lfo.Disturbance(lfo.Box(-0.05, 0.05), input=[[0.0], [1.0]])
    >>> load.feedback(lfo.library.double_integrator()).shape
    (1, 2)
    """

    table: ClassVar[str] = "disturbance"
    set: object
    input: Array | None
    gain: Literal["auto"] | Array | None
    start: ConvexSet | None
    forever: bool

    def __init__(
        self,
        set: ConvexSet | Loads | ArrayLike,
        input: ArrayLike | None = None,
        gain: Literal["auto"] | ArrayLike | None = "auto",
        start: ConvexSet | None = None,
        forever: bool = False,
    ):
        require_bool("disturbance.forever", forever)
        if start is not None and (not isinstance(start, ConvexSet) or forever):
            got = f"{brief(start)}{', with forever=True' if forever else ''}"
            advice = "forever=True has its own start." if forever else "The error of the start is in lfo.Box(-e, e)."
            raise ProblemError("disturbance.start", got, "a set such as Box, or None", advice)
        E = None if input is None else real_array("disturbance.input", input)
        if E is not None and (E.ndim not in (2, 3) or not E.any()):
            got = "zeros" if E.ndim in (2, 3) else f"shape {E.shape}"
            raise ProblemError("disturbance.input", got, "a matrix (n, k), or (T, n, k), that is not zero")
        if isinstance(gain, str) and gain != "auto":
            raise ProblemError("disturbance.gain", brief(gain), "'auto', a matrix (m, n), or None")
        K = gain if gain is None or isinstance(gain, str) else real_array("disturbance.gain", gain)
        assign(self, set=set, input=E, gain=K, start=start, forever=forever)

    def feedback(self, problem: OptimalControlProblem) -> Array:
        """Return K, (m, n), of u = v + K (x - z) for a problem."""
        return self.error_loop(problem).K

    def error_loop(self, problem: OptimalControlProblem) -> ErrorLoop:
        """Return the loop of x - z for a problem, with its gain."""
        n, T = problem.state_dim, problem.horizon
        E = np.eye(n) if self.input is None else _of_all_states(self.input, problem)
        E = to_shape("disturbance.input", E, (n, E.shape[-1]), T)
        loads = loads_of(self.set, E.shape[-1])
        if loads.horizon not in (None, T):
            expected = f"one load for each of the {T} steps of the horizon"
            raise ProblemError("Records.loads", f"loads of {loads.horizon} steps", expected)
        start = None if self.start is None else loads_of(self.start, n, "disturbance.start", "state")
        A, B, shape = problem.linear.A, problem.linear.B, (problem.control_dim, n)
        K = best_regulator(problem, loads, E) if isinstance(self.gain, str) else self.gain
        K = np.zeros(shape) if K is None else to_shape("disturbance.gain", K, shape)
        A_K, a, varying = A + B @ K, np.abs(A) + np.abs(B) @ np.abs(K), E.ndim == 3
        rate = float(np.abs(np.linalg.eigvals(A_K)).max()) if A_K.ndim == 2 and np.isfinite(A_K).all() else 0.0
        if rate >= 1 and (self.gain is not None or self.forever):
            got = f"a closed loop with spectral radius {number(rate)}"
            raise ProblemError("disturbance.gain", got, "below 1", "gain='auto' finds one.")
        if A_K.ndim == 3 or varying:
            A_K, a, E = (np.broadcast_to(part, (T, *part.shape[-2:])) for part in (A_K, a, E))
        if self.forever and (A_K.ndim == 3 or not loads.anew):
            expected = "dynamics, input and a bounded set of loads that are the same at all times"
            raise UnsupportedError(f"disturbance.forever: got True; expected {expected}.")
        return ErrorLoop(loads, start, A_K, a, K, E, T, self.forever)

    def largest_spectra(self, problem: OptimalControlProblem, plan: Trajectory) -> Array | None:
        """Return the largest magnitude of each bin of the controls u = v + K e, (bins, m); None without bounds."""
        return largest_spectra(self.error_loop(problem), plan)

    def plan_limits(self, problem: OptimalControlProblem, end: Literal["invariant"] | None = None) -> dict[str, object]:
        """Return the limits of the plan: those of a problem less their margins; see ``robust``."""
        loop, T = self.error_loop(problem), problem.horizon
        n, m = problem.state_dim, problem.control_dim

        def of_x(F: Array) -> Array:
            return loop.margins(F, np.zeros((len(F), m)))

        def of_u(F: Array) -> Array:
            return loop.margins(np.zeros((len(F), n)), F)

        changes: dict[str, object] = {
            "state_set": _tighten(problem, "state_set", of_x, np.arange(T + 1)),
            "control_set": _tighten(problem, "control_set", of_u, np.arange(T)),
            "stage_rows": [
                *(rows.with_limits(rows.e - loop.margins(rows.C, rows.D)[:T]) for rows in problem.stage_rows),
                *([] if end is None else [invariant_end(problem, loop)]),
            ],
        } | tightened_spectra(problem, loop)
        moved, links = np.maximum(of_x(np.eye(n))[T], of_x(-np.eye(n))[T]) > 0, problem.terminal_state.links(n, T)
        end_of_plan = (problem.terminal_box.fixed & moved).any() or links
        if not links:
            changes["terminal_state"] = _tighten(problem, "terminal_state", of_x, np.array([T]))
        stops = problem.control_stop.any() and loop.K.any(), problem.state_stop.any()
        unkept = zip(("terminal_state", "control_spectrum", "state_spectrum"), (end_of_plan, *stops), strict=True)
        if kept := [field for field, limited in unkept if limited]:
            text = f"robust: {join_words(kept)} hold for the plan; loads change them. lfo.worst_case says by how much."
            warn_user(text, ClosedLoopWarning)
        return changes

    def worst(self, problem: OptimalControlProblem, plan: Trajectory, solved: Outcome | None) -> WorstCase:
        """Return what the worst loads do to a plan; see ``worst_case``."""
        own = solved and solved.problem.uncertainty is self and solved.status.solved and not problem.control_spectrum
        return worst_loads(problem, self.error_loop(problem), plan, solved.multipliers if solved and own else None)


def _of_all_states(E: Array, problem: OptimalControlProblem) -> Array:
    """Return E; missing rows are zeros if the last states follow from the controls, such as those of rate_limited."""
    rows, dynamics = E.shape[-2], problem.linear
    absent = dynamics.state_names[rows:]
    if not absent or (dynamics.A[..., rows:, :].any() and not {*absent} <= {*(dynamics.known_states or ())}):
        return E
    return np.pad(E, ((0, 0),) * (E.ndim - 2) + ((0, len(absent)), (0, 0)))


def _tighten(
    problem: OptimalControlProblem, field: str, margins: Callable[[Array], Array], times: Indices
) -> SetOrSets:
    """Return the sets of a field at these times less margins; ``margins`` maps rows (rows, dim) to (T+1, rows)."""
    given = getattr(problem, field)
    if given is None:
        return None
    names = problem.control_names if field == "control_set" else problem.state_names
    size, sets = len(names), list(given) if isinstance(given, Sequence) else [given] * len(times)
    box = {"state_set": problem.state_boxes, "control_set": problem.control_tube}.get(field) or problem.terminal_box
    kept = box.fixed if field == "terminal_state" else False  # a fixed end is for the plan
    up, down = (np.where(kept, 0.0, margins(sign * np.eye(size))[times]) for sign in (1.0, -1.0))
    lower, upper = (np.broadcast_to(side, up.shape) for side in box.bounds)
    low, high = np.where(np.isfinite(lower), lower + down, lower), np.where(np.isfinite(upper), upper - up, upper)
    wrong = low > high
    if wrong.any():
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(wrong, (upper - lower) / (up + down), np.inf)
        t, i = (int(k) for k in np.argwhere(share == share.min())[0])
        got = f"a range of {number(upper[t, i] - lower[t, i])} for {short_name(names[i])}"
        taken = f"the loads take {number(down[t, i])} below and {number(up[t, i])} above at step {times[t]}"
        most = f"At most {number(float(share.min()), 2)} of these loads leave a plan; another gain may take less."
        raise ProblemError(field, f"{got}, of which {taken}", "smaller margins", most)
    cache = dict[bytes, Array]()

    def less(t: int, F: Array) -> Array:
        key = F.tobytes()
        if key not in cache:
            cache[key] = margins(F)
        return cache[key][t]

    if not any(one and one.members for one in sets):
        return Box(low, high) if len(times) > 1 or field != "terminal_state" else Box(low[0], high[0])
    tight = [
        intersection(
            Box(low[i], high[i]), [part.tightened(partial(less, t), size) for part in (one.members if one else ())]
        )
        for i, (t, one) in enumerate(zip(times.tolist(), sets, strict=True))
    ]
    return tight[0] if field == "terminal_state" else tight


def best_regulator(problem: OptimalControlProblem, loads: Loads, E: Array) -> Array:
    """Return the regulator, of 25 weights of the controls, whose largest margin is the smallest share of its range.

    Ranges are those between opposite limits, or within the bounds of all signals. Where no limit has one, the weights
    of the cost are best. States and controls count in units of their sizes.
    """
    cost, dynamics, n = problem.quadratic, problem.linear, problem.state_dim
    A, B, E = (part if part.ndim == 2 else part.mean(axis=0) for part in (dynamics.A, dynamics.B, E))
    x, u = stated_sizes(problem)
    Q, R = (part if part.ndim == 2 else part.mean(axis=0) for part in (cost.Q, cost.R))
    Q, R = Q * np.outer(x, x), R * np.outer(u, u)
    of_x, of_u = (float(np.trace(part)) / len(part) for part in (Q, R))
    Q, of_x = (Q, of_x) if of_x else (np.eye(n) * (of_u or 1.0), of_u or 1.0)  # all states alike if none counts
    Q, R = Q + SMALL_PART * of_x * np.eye(n), R + SMALL_PART * max(of_u, of_x) * np.eye(len(u))
    A_s, B_s, gains = A * x / x[:, None], B * u / x[:, None], list[Array]()
    for weight in sorted(WEIGHTS, key=lambda weight: abs(np.log(weight))):  # the first of equals is nearest to 1
        with one_blas_thread, suppress(np.linalg.LinAlgError):  # no finite cost: an unstable state is out of reach
            H = solve_discrete_are(A_s, B_s, Q, weight * R)
            gains.append(-np.linalg.solve(weight * R + B_s.T @ H @ B_s, B_s.T @ H @ A_s))
    K = np.array(gains).reshape(-1, len(u), n) * u[:, None] / x
    K = K[np.abs(np.linalg.eigvals(A + B @ K)).max(axis=1, initial=0.0) < 1]
    if not len(K):
        got = "'auto', but no regulator stabilises the dynamics"
        advice = "Is an unstable state out of reach of the controls? gain=None has no feedback."
        raise ProblemError("disturbance.gain", got, "a stabilising gain", advice)
    rows, limits, bounds = lasting_rows(problem)
    opposite = np.where((rows[:, None] == -rows).all(axis=2), limits, np.inf).min(axis=1, initial=np.inf)
    ranges = limits + np.minimum(bounds.support(-rows), opposite)
    A_K, both = A + B @ K, np.vstack([rows, -rows])
    R_K, T, total = both[:, :n] + both[:, n:] @ K, problem.horizon, np.zeros(())
    X = np.broadcast_to(np.eye(n), A_K.shape)
    for i in range(min(T, CHOSEN_OVER)):
        total = total + loads.contribution(R_K @ X @ E, slice(T - 1 - i, T - i))
        X = X @ A_K
    margins = loads.margin(total).reshape(len(K), 2, -1).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(margins > 0, margins / ranges, 0.0).max(axis=1, initial=0.0)
    return K[int(np.argmin(shares))]
