"""A linear time-invariant problem in units of order 1, with time as the last axis (docs/spectral.md, 1).

    minimise    sum_{t<T} 1/2 y_t'M y_t + h_t'y_t  +  1/2 x_T'P x_T + p'x_T,      y_t = (x_t, u_t)
    subject to  x_{t+1} = A x_t + B u_t + d_t,     lower_t <= F y_t <= upper_t,
                ends fixed, free or in a box, per component,   stopped bins of u (length T) and of x (length T+1)

M is the Hessian of the stage cost, and h_t contains the references. F is the identity, for bounds on single components,
above the joint rows.

``lti_problem`` changes the form of a problem, not its constraints: arrays in units of order 1, which are powers of two,
so that conversions do not round. A problem must be of the class for which ``refusal`` has no reason. ``reductions``
makes others so, before: in the user's units, and with a way back for the multipliers.

A bound with a finite price is soft: the price times its violation joins the cost, and limits its multiplier. Without a
recursion, the dynamics are the frequency response of x_{t+1} at every bin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import matrix_balance
from scipy.sparse.csgraph import connected_components

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, assign, with_fields
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.reductions import priced_bounds, soft_set
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.transform.sizes import FAR_BEYOND, natural_sizes

STATE_BAND_ROWS = 2000  # real rows of state bands that may be dense equations of the bordered system
WRONG_UNIT = 1e-5  # largest value of a component, in its unit, below which that unit was wrong
ROUNDED_COMPONENT = 1e-13  # largest value below which a component holds rounding only
MUCH_LARGER = 30.0  # factor between a component's stated size and other evidence of it from which the evidence counts


@dataclass(frozen=True, eq=False)
class Lti:
    """The problem; a new solve may change the fields after ``horizon``."""

    A: Array
    B: Array
    M: Array
    P: Array
    F: Array  # (rows, n+m): the identity, then the stage rows
    passed: Mask  # (m, T//2 + 1): which bins each control may use
    state_stop: Mask  # (state_samples//2 + 1, n): which bins are removed from each state
    horizon: int
    start: Array  # x_0, NaN where it is free
    end: Array  # x_T, NaN where it is free
    linear: Array | None  # h_t, (n+m, T)
    p: Array
    offset: Array | None  # d_t, (n, T)
    bounds: Bounds
    prices: Bounds  # of a unit of violation, infinite for hard bounds
    constant: float  # cost at x = 0, u = 0
    response: ComplexArray | None = None  # of x_{t+1} at every bin, (n, m, T//2 + 1), instead of A, B
    periodic: bool = False  # whether x_T = x_0: then the ends are free, and bounds on x_T are on x_0

    @cached_property
    def state_dim(self) -> int:
        """Number of states n."""
        return len(self.A)

    @cached_property
    def control_dim(self) -> int:
        """Number of controls m."""
        return self.B.shape[1]

    @property
    def state_samples(self) -> int:
        """Number of samples in spectra of states: T+1, or T with periodic ends."""
        return self.horizon + 1 - self.periodic

    @property
    def start_points(self) -> int:
        """Number of equations x(0) = x_0: none if the ends are periodic."""
        return 0 if self.periodic else self.state_dim

    @property
    def ends(self) -> tuple[Array, Array]:
        """x_0 and x_T with zeros for free components, (n,)."""
        return np.where(np.isnan(self.start), 0.0, self.start), np.where(np.isnan(self.end), 0.0, self.end)

    def with_ends(self, ends: tuple[Box, Box], units: Array) -> Lti | None:
        """Return the problem between other ends, for units (n,) of the states; None if x_0 has free components."""
        start, end = (_fixed_values(box) / units for box in ends)
        if np.isnan(self.start).any() or np.isnan(start).any():  # their bounds are those of y_0
            return None
        changed = with_fields(self, start=start, end=end)
        if not self.soft:  # else, the end is the same
            last_lower, last_upper = (side / units for side in ends[1].bounds)
            assign(changed, bounds=replace(self.bounds, last_lower=last_lower, last_upper=last_upper))
        return changed

    def row_values(self, y: Array, t: Indices, f: Indices) -> Array:
        """Return F_f y_t of some rows at t < T, (count,), for y (n+m, T)."""
        return y[f, t] if len(self.F) == len(y) else np.einsum("ri,ir->r", self.F[f], y[:, t])

    @cached_property
    def soft(self) -> bool:
        """Whether some bound has a price."""
        return not all(map(np.all, map(np.isinf, vars(self.prices).values())))

    def price_of(self, t: Indices, f: Indices, sign: Array) -> Array:
        """Return the prices of rows as ``Bounds.at`` does; most problems have none."""
        return self.prices.at(t, f, sign) if self.soft else np.full(len(t), np.inf)

    @cached_property
    def state_cost(self) -> bool:
        """Whether M has a row of a state that is not zero."""
        return bool(self.M[: self.state_dim].any())

    @cached_property
    def curvature_unit(self) -> float:
        """Mean diagonal entry of R, of Q if R = 0: small Hessians are relative to it."""
        n = self.state_dim
        return float(np.trace(self.M[n:, n:])) / self.control_dim or float(np.trace(self.M[:n, :n])) / n

    @cached_property
    def diagonal_bound(self) -> Array:
        """A diagonal, (rows of F,), with diag - S >= 0 for small QPs on control rows: 1/R there, else 0.

        It is zero if R is not diagonal, or if the cost has products of states and controls.
        """
        n, bound = self.state_dim, np.zeros(len(self.F))
        R = np.diagonal(self.M)[n:]
        if not self.M[:n, n:].any() and np.array_equal(self.M[n:, n:], np.diag(R)) and R.all():
            bound[n : len(self.M)] = 1 / R
        return bound

    @cached_property
    def cost_level(self) -> float:
        """Cost of a stage or the end where states and controls are of order 1."""
        return max(float(np.abs(self.M).max()), float(np.abs(self.P).max()))

    @property
    def has_limits(self) -> bool:
        """Whether any constraint is more than an equation."""
        sides = self.bounds.lower, self.bounds.upper
        limited = (np.isfinite(sides) & (sides[0] < sides[1])).any()
        last = np.isfinite([self.bounds.last_lower, self.bounds.last_upper]) & np.isnan(self.end)
        return bool(limited or last.any())

    def is_fixed(self, t: Indices, f: Indices) -> Mask:
        """Return whether equal bounds or a fixed end determine F_f y_t, (count,); component f of x_T at t = T."""
        state = f % self.state_dim  # where f is a state
        at_start = (t == 0) & (f < self.state_dim) & ~np.isnan(self.start[state])
        at_end = (t == self.horizon) & ~np.isnan(self.end[state])
        return at_start | at_end | (self.bounds.at(t, f, -1.0) >= self.bounds.at(t, f, 1.0))

    @cached_property
    def fixed_points(self) -> tuple[Indices, Indices]:
        """(t, f) of the rows F_f y_t with equal bounds, without fixed ends: 0 <= t < T."""
        f, t = np.nonzero(self.bounds.lower == self.bounds.upper)
        not_at_start = (t > 0) | (f >= self.state_dim)
        return t[not_at_start], f[not_at_start]


@dataclass(frozen=True, eq=False)
class Bounds:
    """A number for each bound, its limit or its price: of F y_t at t < T, (rows, T), and of x_T, (n,)."""

    lower: Array
    upper: Array
    last_lower: Array
    last_upper: Array

    def map(self, change: Callable[[Array], Array]) -> Bounds:
        """Return the numbers with those at t < T, (rows, T), changed by a function."""
        return replace(self, lower=change(self.lower), upper=change(self.upper))

    def at(self, t: Indices, f: Indices, sign: Array | float) -> Array:
        """Return the numbers of rows f at times t, at T of the components f of x_T; upper ones where sign > 0."""
        T = self.lower.shape[1]
        time = np.minimum(t, T - 1)
        numbers = np.where(sign > 0, self.upper[f, time], self.lower[f, time])
        last = np.flatnonzero(t == T)
        if len(last):
            f, sign = f[last], np.broadcast_to(sign, t.shape)[last]
            numbers[last] = np.where(sign > 0, self.last_upper[f], self.last_lower[f])
        return numbers


@dataclass(frozen=True, eq=False)
class LtiUnits:
    """Units of the Lti problem in those of the user: of states (n,), controls (m,), stage rows, cost."""

    x: Array
    u: Array
    rows: Array
    cost: float

    @property
    def signals(self) -> Array:
        """Units of (x, u), (n+m,)."""
        return np.concatenate([self.x, self.u])

    @property
    def multipliers(self) -> Array:
        """Units of multipliers of (x, u), (n+m,)."""
        return self.cost / self.signals


def lti_problem(problem: OptimalControlProblem, units: LtiUnits) -> Lti:
    """Return the problem in the given units; it must not be one that ``refusal`` names."""
    n, T, cost = problem.state_dim, problem.horizon, problem.quadratic
    x_unit, u_unit, y_unit = units.x, units.u, units.signals
    outputs = problem.response
    if outputs is None:
        A, B, d, response = problem.linear.A, problem.linear.B, problem.linear.offset, None
    else:  # the outputs lead by one step: x_{t+1} follows from the controls, without a recursion
        lead = np.exp(2j * np.pi * np.arange(T // 2 + 1) / T)
        A, B, d = np.zeros((n, n)), np.zeros((n, len(u_unit))), outputs.base[1:]
        response = lead * np.moveaxis(outputs.G, 0, -1)
    linear = _linear_terms(problem)
    offset = d.T if d.ndim == 2 else d[:, None]
    bounds, hard = _bounds(problem, units), np.broadcast_to(np.inf, (len(y_unit) + len(units.rows), T))
    prices = Bounds(hard, hard, np.full(n, np.inf), np.full(n, np.inf))
    if not all(term.hard for term in problem.terms):
        bounds, prices = _soft_bounds(problem, units, bounds)
    periodic = closes_on_the_circle(problem)
    if periodic:
        lower = _with_end_bound(np.maximum, bounds.lower, bounds.last_lower)
        upper = _with_end_bound(np.minimum, bounds.upper, bounds.last_upper)
        bounds = Bounds(lower, upper, np.full(n, -np.inf), np.full(n, np.inf))
    start, end = (_fixed_values(box) / x_unit for box in problem.ends)
    p = cost.p - cost.P @ np.broadcast_to(cost.x_ref, (T + 1, n))[T]
    referred = cost.x_ref.any() or cost.u_ref.any()
    constant = cost.value(np.zeros((T + 1, n)), np.zeros((T, len(u_unit)))) if referred else 0.0
    return Lti(
        A=A * x_unit / x_unit[:, None],
        B=B * u_unit / x_unit[:, None],
        M=cost.stage_hessians[0] * y_unit * y_unit[:, None] / units.cost,
        P=cost.P * x_unit * x_unit[:, None] / units.cost,
        F=np.vstack([np.eye(len(y_unit)), _scaled_rows(problem, x_unit, u_unit) / units.rows[:, None]]),
        passed=~problem.control_stop.T,
        state_stop=problem.state_stop,
        horizon=T,
        start=start,
        end=end,
        linear=None if linear is None else np.broadcast_to(linear * y_unit[:, None] / units.cost, (len(y_unit), T)),
        p=p * x_unit / units.cost,
        offset=np.broadcast_to(offset / x_unit[:, None], (n, T)) if offset.any() else None,
        bounds=bounds,
        prices=prices,
        constant=constant / units.cost,
        periodic=periodic,
        response=None if response is None else response * (u_unit / x_unit[:, None])[:, :, None],
    )


def _linear_terms(problem: OptimalControlProblem) -> Array | None:
    """Return h, shape (n+m, T) or (n+m, 1): the gradient of the stage costs at x = 0, u = 0."""
    cost, T = problem.quadratic, problem.horizon
    x_ref = cost.x_ref[:T] if cost.x_ref.ndim == 2 else cost.x_ref[None]
    u_ref = np.atleast_2d(cost.u_ref)
    in_x = np.atleast_2d(cost.q) - x_ref @ cost.Q.T - u_ref @ cost.S.T
    in_u = np.atleast_2d(cost.r) - u_ref @ cost.R.T - x_ref @ cost.S
    if not (in_x.any() or in_u.any()):
        return None
    times = max(len(in_x), len(in_u))
    return np.vstack([np.broadcast_to(part.T, (part.shape[1], times)) for part in (in_x, in_u)])


def _bounds(problem: OptimalControlProblem, units: LtiUnits) -> Bounds:
    """Return the limits of boxes and stage rows; limits that do not depend on time take no memory."""
    T, states, controls = problem.horizon, problem.state_tube, problem.control_tube
    free = ~states.fixed[0]  # a fixed start is an equation, not a bound on x_0
    joint = [np.atleast_2d(rows.e).T for rows in problem.stage_rows]

    def side(state: Array, control: Array, joint: list[Array]) -> Array:
        first = np.where(free, state[0], state[min(1, T - 1)])
        columns = [_as_columns(state[:T], first), _as_columns(control, control[0]), *joint]
        times = max(part.shape[1] for part in columns)
        rows = np.vstack([np.broadcast_to(part, (len(part), times)) for part in columns])
        rows /= np.concatenate([units.signals, units.rows])[:, None]
        return np.broadcast_to(rows, (len(rows), T))

    absent = [np.full((len(e), 1), -np.inf) for e in joint]
    sides = side(states.lower, controls.lower, absent), side(states.upper, controls.upper, joint)
    return Bounds(*sides, *(last / units.x for last in problem.ends[1].bounds))


def _as_columns(bounds: Array, first: Array) -> Array:
    """Return bounds (T, k) as columns (k, T), with ``first`` at t = 0; (k, 1) if they do not depend on time."""
    if (bounds[1:] == first).all():
        return first[:, None]
    columns = np.array(bounds.T)
    columns[:, 0] = first
    return columns


def _fixed_values(box: Box) -> Array:
    """Return the values that a box fixes, NaN elsewhere."""
    return np.where(box.fixed, box.lower, np.nan)


def _scaled_rows(problem: OptimalControlProblem, x_unit: Array, u_unit: Array) -> Array:
    """Return the matrix of all joint rows, for states and controls in these units, (rows, n+m)."""
    rows = [np.hstack([family.C * x_unit, family.D * u_unit]) for family in problem.stage_rows]
    return np.concatenate([*rows, np.zeros((0, len(x_unit) + len(u_unit)))])


# A first reader may stop here. What follows: problems that are refused, periodic ends, soft bounds, and units.


def refusal(problem: OptimalControlProblem) -> str | None:
    """Return why the Fourier-domain method cannot take the problem, or None."""
    cost, response = problem.quadratic, problem.response
    if response is not None and not closes_on_the_circle(problem):
        return "only a periodic frequency response, without terminal cost, fixed ends and soft sets"
    taken = TermKind.STAGE_ROWS, TermKind.LINKED_ENDS
    sets = [term for term in problem.terms if term.kind not in taken]
    unsupported = [term for term in sets if soft_set(problem, term) is None]
    if unsupported:
        return f"{unsupported[0].name}: only boxes, joint rows, stop bands and quadratic costs"
    if any(term.kind == TermKind.LINKED_ENDS for term in problem.terms) and not closes_on_the_circle(problem):
        return "the ends are linked otherwise than by x_T = x_0 alone, without terminal cost, fixed ends and soft sets"
    if sets and priced_bounds(problem) is None:
        return "a hard and a soft bound on the same side of a component"
    if response is None and problem.linear.time_varying:
        return "A or B depends on time; the Fourier-domain method needs time-invariant dynamics"
    if any(part.ndim == 3 for part in (cost.Q, cost.R, cost.S)):
        return "Q, R or S depends on time; the Fourier-domain method needs a constant stage Hessian"
    if any(rows.time_varying for rows in problem.stage_rows):
        return "C or D of a stage row depends on time; the Fourier-domain method needs them constant"
    bins = 2 * int(problem.state_stop.sum())
    if bins > STATE_BAND_ROWS:
        return f"the state bands are about {bins} dense rows; the Fourier-domain method takes {STATE_BAND_ROWS}"
    if not any(part.any() for part in (cost.Q, cost.R)):
        advice = "" if response is None else " (solve takes such a cost over a frequency response)"
        return f"neither Q nor R is above zero; the Fourier-domain method needs a strictly convex cost{advice}"
    return None


def closes_on_the_circle(problem: OptimalControlProblem) -> bool:
    """Whether x_T = x_0 is the only constraint on the ends, apart from bounds: the trajectory is then one period."""
    links, cost = problem.links, problem.quadratic
    return (
        [(link.periodic, link.penalty.reach) for link in links] == [(True, 0.0)]
        and not (cost.P.any() or cost.p.any() or problem.state_tube.fixed[[0, -1]].any())
        and all(term.hard for term in problem.terms)
    )


def _with_end_bound(tighter: np.ufunc, side: Array, last: Array) -> Array:
    """Return bounds (rows, T) whose bounds on x_0 include those of x_T, (n,)."""
    first = tighter(side[: len(last), 0], last)
    if (first == side[: len(last), 0]).all():
        return side
    bounds = np.array(side)
    bounds[: len(last), 0] = first
    return bounds


def _soft_bounds(problem: OptimalControlProblem, units: LtiUnits, hard: Bounds) -> tuple[Bounds, Bounds]:
    """Return the bounds, including those of soft sets, and all prices; rows are soft on their upper side."""
    n, T, y_unit = problem.state_dim, problem.horizon, units.signals
    priced = priced_bounds(problem)
    if priced is None:
        text = "method 'spectral': a soft set that is not a set of bounds on components. Use method 'convex'."
        raise UnsupportedError(text)
    per_row = [np.full(rows.rows, np.inf if rows.penalty is None else rows.penalty) for rows in problem.stage_rows]
    joint = np.concatenate([*per_row, np.zeros(0)]) * units.rows / units.cost
    of_lower, of_upper = (side.T * y_unit[:, None] / units.cost for side in (priced.of_lower, priced.of_upper))
    sides = list[Array]()
    for side, limit, price in ((hard.lower, priced.lower, of_lower), (hard.upper, priced.upper, of_upper)):
        soft = np.isfinite(price[:, :T])
        sides.append(
            np.vstack([np.where(soft, limit[:T].T / y_unit[:, None], side[: len(y_unit)]), side[len(y_unit) :]])
        )
    last = (priced.lower[T, :n] / units.x, priced.upper[T, :n] / units.x)
    rows = np.broadcast_to(joint[:, None], (len(joint), T))
    prices = Bounds(
        np.vstack([of_lower[:, :T], np.full(rows.shape, np.inf)]),
        np.vstack([of_upper[:, :T], rows]),
        of_lower[:n, T],
        of_upper[:n, T],
    )
    return Bounds(sides[0], sides[1], *last), prices


def natural_units(problem: OptimalControlProblem) -> LtiUnits:
    """Return units with data of order 1; UnsupportedError if the cost of the sizes is not finite and above 0."""
    states, controls, known = natural_sizes(problem)
    balanced = problem.response is None and not known.all()
    x_unit = _power_of_two(_state_sizes(problem.linear.A, states, known) if balanced else states)
    u_unit = _power_of_two(_control_sizes(problem.control_tube, controls))
    cost = problem.quadratic
    level = float((np.diagonal(cost.R) * u_unit**2).mean()) or float((np.diagonal(cost.Q) * x_unit**2).mean())
    if not 0 < level < np.inf:
        raise UnsupportedError(f"method 'spectral': states and controls of their sizes cost {level:g}; change units.")
    rows = np.abs(_scaled_rows(problem, x_unit, u_unit)).max(1)
    return LtiUnits(x_unit, u_unit, _power_of_two(np.where(rows > 0, rows, 1.0)), float(_power_of_two(np.array(level))))


def _state_sizes(A: Array, stated: Array, given: Mask) -> Array:
    """Return sizes of the states, (n,): as given, else such that A is balanced among states that act on each other.

    The estimate |x| <= T |A| |x| of a state without a given size grows with T, once per state of a chain, even if
    states oscillate against each other. In such units A would be nearly defective.
    """
    sizes = stated.copy()
    count, group = connected_components(A != 0, connection="strong")
    for members in (np.flatnonzero(group == i) for i in range(count)):
        coupling = A[np.ix_(members, members)] * ~np.eye(len(members), dtype=bool)
        balanced = matrix_balance(coupling, permute=False, separate=True)[1][0]
        known, ratio = given[members], sizes[members] / balanced
        level = ratio[known].max() if known.any() else np.exp(np.log(ratio).mean())
        wrong = np.abs(np.log(ratio / level)) > np.log(MUCH_LARGER)
        sizes[members] = np.where(wrong & ~known, level * balanced, sizes[members])
    return sizes


def _control_sizes(tube: Box, stated: Array) -> Array:
    """Return sizes of the controls, (m,): as stated, or their bounds if the stated sizes are much smaller."""
    sides = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in tube.bounds]
    if all((side <= MUCH_LARGER * stated).all() for side in sides):
        return stated
    bounds = np.maximum(*(np.median(side, axis=0) for side in sides))
    larger = (bounds > MUCH_LARGER * stated) & (bounds <= FAR_BEYOND * stated)
    return np.where(larger, bounds, stated)


def _power_of_two(size: Array) -> Array:
    return np.exp2(np.round(np.log2(size)))


def revised_units(units: LtiUnits, y: Array) -> LtiUnits | None:
    """Return units from a solution y (n+m, T) in the given units, or None if those were right.

    If bounds such as 1e9 stand for no bound, all signals may be rounding errors in the first units.
    """
    reached = np.abs(y).max(1)
    wrong = (reached > ROUNDED_COMPONENT) & (reached < WRONG_UNIT)
    if not wrong.any():
        return None
    factor = np.where(wrong, _power_of_two(np.where(wrong, reached, 1.0)), 1.0)
    n = len(units.x)
    smallest = float(factor[n:].max()) ** 2
    return LtiUnits(units.x * factor[:n], units.u * factor[n:], units.rows, units.cost * smallest)
