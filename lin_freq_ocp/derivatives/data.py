"""The data of a problem: the slope of the Lagrangian by each, and problems with other data.

L = J + sum <eta_t, x_{t+1} - A x_t - B u_t - d_t> + <mu, x - bound> + ... (docs/derivatives.md). Its slope at an
optimum is that of the optimal cost; the derivative of its slope along a change of states, controls and multipliers
gives that of the optimum. Bins and responses are complex: a change d of a datum with the slope g adds Re(conj(g) d).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, complex_array, real_array, split_signals, stack_signals
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError, entry_named, suggestion
from lin_freq_ocp.problem.costs.quadratic import AXES, CostSum, require_symmetric
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

Values = dict[str, Array]  # complex arrays for bins and responses
ENDS = ("initial_state", "terminal_state")
BINS = ("control_bins", "state_bins")
MATRICES = ("Q", "R", "S", "P", "A", "B", "response")
SYMMETRIC = ("Q", "R", "P")


class ByDatum(Mapping[str, Array]):
    """Derivatives by every datum, under its name."""

    slopes: Values

    def __getitem__(self, name: str) -> Array:
        return entry_named("derivatives", name, self.slopes)

    def __iter__(self) -> Iterator[str]:
        return iter(self.slopes)

    def __len__(self) -> int:
        return len(self.slopes)


def is_matrix(name: str) -> bool:
    """Whether a datum is a matrix, or one per time."""
    return name in MATRICES or name.endswith((".C", ".D"))


@dataclass(frozen=True, eq=False)
class Variables:
    """States and controls, their deviations a and b from the references, and multipliers; or a change of all."""

    x: Array
    u: Array
    a: Array
    b: Array
    multipliers: Multipliers

    @classmethod
    def at(cls, problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Variables:
        """Return the signals of a point."""
        x, u = trajectory.x, trajectory.u
        return cls(x, u, *problem.quadratic.deviations(x, u), multipliers)

    @classmethod
    def along(cls, change: Trajectory, multipliers: Multipliers) -> Variables:
        """Return a change of signals: that of the deviations is that of states and controls."""
        return cls(change.x, change.u, change.x, change.u, multipliers)


def slopes(problem: OptimalControlProblem, at: Variables, along: Variables | None = None) -> Values:
    """Return the slope of the Lagrangian by every datum at a point, or the derivative of that slope along a change.

    Matrices, q, r and references that are constant in time have one slope, the sum over time. Signals and multipliers
    may have an axis of problems in front, as may those slopes, where there are only bounds and ends.
    """
    cost, one = problem.quadratic, along or at
    both = (at,) if along is None else (along, at)
    signals = ((of.a[..., :-1, :], of.b, of.a[..., -1:, :], of.x[..., :-1, :], of.u) for of in both)
    a, b, last, x, u = zip(*signals, strict=True)
    eta = [of.multipliers.eta for of in both]

    def product(left: Sequence[Array], right: Sequence[Array], datum: Array) -> Array:
        """Return the sum of left right' over both orders, and over time where the datum is constant."""
        form = "...ti,...tj->...ij" if datum.ndim == 2 else "...ti,...tj->...tij"
        return sum((np.einsum(form, i, j) for i, j in zip(left, reversed(right), strict=True)), np.zeros(()))

    def fit(datum: Array, values: Array) -> Array:
        return values.sum(axis=-2) if datum.ndim == 1 else values

    in_x, in_u = split_signals(cost.bend(stack_signals(one.a, one.b)), problem.state_dim)
    found: Values = {"Q": 0.5 * product(a, a, cost.Q), "R": 0.5 * product(b, b, cost.R), "S": product(a, b, cost.S)}
    found |= {"P": 0.5 * product(last, last, cost.P), "p": one.x[..., -1, :]}
    found |= {"q": fit(cost.q, one.x[..., :-1, :]), "r": fit(cost.r, one.u), "offset": -one.multipliers.eta}
    found |= {"x_ref": fit(cost.x_ref, -in_x), "u_ref": fit(cost.u_ref, -in_u)}
    if problem.response is not None:
        of_G = sum(_response_slope(problem.response, i, j) for i, j in zip(both, reversed(both), strict=True))
        found["response"] = cast("Array", of_G)
    elif not problem.mode_names:
        found |= {"A": -product(eta, x, problem.linear.A), "B": -product(eta, u, problem.linear.B)}
    for rows in () if problem.path_constraints else problem.stage_rows:
        prices = [of.multipliers.stage[rows.name] for of in both]
        found |= {f"{rows.name}.C": product(prices, x, rows.C), f"{rows.name}.D": product(prices, u, rows.D)}
    return found | _limit_slopes(problem, at, along)


def _response_slope(response: Response, of_eta: Variables, of_u: Variables) -> ComplexArray:
    """Return the slope by G, (bins, p, m), for the multipliers of one point and the controls of another."""
    T, N, weights = response.horizon, response.record, of_eta.multipliers
    signal = np.zeros((N, response.G.shape[1]))
    np.add.at(signal, np.arange(1, T + 1) % N, weights.eta)
    if not response.closed:
        signal[0] += weights.stage["first output"][0]
    eta, u = np.fft.rfft(signal, axis=0), np.fft.rfft(of_u.u, n=N, axis=0)
    return -(response.weight / N)[:, None, None] * eta[:, :, None] * u[:, None, :].conj()


def _limit_slopes(problem: OptimalControlProblem, point: Variables, along: Variables | None) -> Values:
    """Return the slopes by ends, bounds, bins, and the limits of terms under their names."""
    at, one, (lower, upper) = point.multipliers, (along or point).multipliers, bounds_of_ends(problem)
    of_ends, either = np.where(is_upper(at.mu, problem.state_tube), upper, lower), lower | upper
    prices = np.where(either, np.where(of_ends, -one.mu, 0.0), np.nan)
    found: Values = {name: prices[..., t, :] for name, t in zip(ENDS, (0, -1), strict=True)}
    for signal, tube, weights, changes in (
        ("state", problem.state_tube, at.mu, np.where(of_ends, 0.0, one.mu)),
        ("control", problem.control_tube, at.nu, one.nu),
    ):
        found[f"{signal}_upper"] = -np.where(is_upper(weights, tube), changes, 0.0)
        found[f"{signal}_lower"] = -np.where(weights < 0, changes, 0.0)
    found |= {"control_bins": cast("Array", -one.rho_u), "state_bins": cast("Array", -one.rho_x)}
    for term in problem.terms:
        weights = at.stage.get(term.name)
        if weights is not None and not term.kind.is_cost:
            v, changes = term.map.values(point.x, point.u), None if along is None else one.stage[term.name]
            prices = term.penalty.limit_multipliers(weights, v, changes)
            if prices is not None:
                found[term.name] = -np.asarray(term.per_limit)[..., None] * prices
    return found


def bounds_of_ends(problem: OptimalControlProblem) -> tuple[Mask, Mask]:
    """Return which lower and upper bounds of x_t, (T+1, n), are those of an end: fixed, or tighter than the set."""
    sets, tube = problem.state_boxes, problem.state_tube
    fixed = np.zeros(tube.lower.shape, dtype=bool)
    fixed[0], fixed[-1] = problem.initial_box.fixed, problem.terminal_box.fixed
    return fixed | (tube.lower > sets.lower), fixed | (tube.upper < sets.upper)


def is_upper(multipliers: Array, tube: Box) -> Mask:
    """Whether each multiplier is that of the upper bound; with equal bounds, the one of its sign moves the value."""
    return (multipliers > 0) | (tube.fixed & (multipliers == 0))


def data_of(problem: OptimalControlProblem) -> Values:
    """Return all data with a slope, by their names.

    Ends with bounds are at the lower one, or at the upper one if there is no lower one, and move as a whole. Levels of
    removed bins, limits of terms but joint rows, and the offset of a frequency response are zeros: changes.
    """
    T, states, controls = problem.horizon, problem.state_boxes, problem.control_tube
    found: Values = {field: getattr(problem.quadratic, field) for field in AXES}
    found |= {"initial_state": _position(problem.initial_box), "terminal_state": _position(problem.terminal_box)}
    found |= {"state_upper": states.upper, "state_lower": states.lower}
    found |= {"control_upper": controls.upper, "control_lower": controls.lower}
    for term in problem.terms:
        prices = None if term.kind.is_cost else term.penalty.limit_multipliers(*np.zeros((2, *term.shape)))
        if prices is not None:
            found[term.name] = prices
    for rows in problem.stage_rows:
        e = np.broadcast_to(rows.e, (T, rows.rows))
        found |= {rows.name: e, f"{rows.name}.C": rows.C, f"{rows.name}.D": rows.D}
    for name, stop in zip(BINS, (problem.control_stop, problem.state_stop), strict=True):
        found[name] = cast("Array", np.zeros(stop.shape, dtype=np.complex128))
    if problem.response is not None:
        found |= {"response": cast("Array", problem.response.G), "offset": np.zeros((T, problem.state_dim))}
    else:
        linear = problem.linear
        found |= {"A": linear.A, "B": linear.B, "offset": np.broadcast_to(linear.offset, (T, problem.state_dim))}
    return found


def _position(box: Box) -> Array:
    """Return the lower bounds, upper ones where there is none, zeros where there are neither."""
    return np.where(np.isfinite(box.lower), box.lower, np.where(np.isfinite(box.upper), box.upper, 0.0))


def data_for(problem: OptimalControlProblem, data: Mapping[str, ArrayLike]) -> Values:
    """Return data, or changes of data, as arrays of their shapes; ProblemError if one does not fit.

    What depends on time may be given once for all times.
    """
    known, found = data_of(problem), Values()
    for name, value in data.items():
        if name not in known:
            expected = f"one of {', '.join(known)}"
            raise ProblemError("derivatives", f"the datum {name!r}", expected, suggestion(name, known))
        shape, axes = known[name].shape, 1 + is_matrix(name)
        real = known[name].dtype == np.float64
        array = real_array(name, value) if real else cast("Array", complex_array(name, value))
        if array.ndim < axes or array.shape != shape[len(shape) - array.ndim :]:
            once = f", or {shape[1:]}" if len(shape) > axes else ""
            raise ProblemError(name, f"shape {array.shape}", f"shape {shape}{once}")
        if name in SYMMETRIC:
            require_symmetric(name, array)
        found[name] = np.broadcast_to(array, shape)
    return found


def with_data(problem: OptimalControlProblem, data: Mapping[str, Array]) -> OptimalControlProblem:
    """Return the problem with other data, arrays of their shapes.

    Raises
    ------
    UnsupportedError
        If a datum has no single place in the problem.
    """
    fields = dict[str, object]()
    for end in (end for end in ENDS if end in data):
        given = getattr(problem, end)
        if given is not None and given.members:
            raise UnsupportedError(f"{end}: got an end that is more than a Box; expected a Box, or none.")
        box = problem.initial_box if end == ENDS[0] else problem.terminal_box
        moved = data[end] - _position(box)
        fields[end] = Box(*(np.where(box.fixed, data[end], side + moved) for side in box.bounds))
    weights = {name: data[name] for name in AXES if name in data}
    if weights:
        quadratic, norms = replace(problem.quadratic, **weights), problem.cost.norms
        fields["cost"] = CostSum([quadratic, *norms]) if norms else quadratic
    homeless = {*BINS, *(term.name for term in problem.terms)}
    if problem.response is not None:
        homeless.add("offset")
        if "response" in data:
            fields["dynamics"] = replace(cast("FrequencyResponse", problem.dynamics), G=data["response"])
    elif moved := {name: data[name] for name in ("A", "B", "offset") if name in data}:
        fields["dynamics"] = replace(problem.linear, **moved)
    for signal, box in (("state", problem.state_boxes), ("control", problem.control_tube)):
        sides = {side: data.get(f"{signal}_{side}", getattr(box, side)) for side in ("lower", "upper")}
        if any(sides[side] is not getattr(box, side) for side in sides):
            sets = entries_of(getattr(problem, f"{signal}_set"))
            if any(one is not None and one.members for one in sets):
                got = f"a {signal}_set that is more than a Box"
                raise UnsupportedError(f"{signal}_upper, {signal}_lower: got {got}; expected a Box, or none.")
            fields[f"{signal}_set"] = Box(**sides)
    names = [one.name for one in problem.stage_rows]
    if any(name.removesuffix(".C").removesuffix(".D") in names for name in data):
        fields["stage_rows"] = [
            replace(
                one, C=data.get(f"{one.name}.C", one.C), D=data.get(f"{one.name}.D", one.D), e=data.get(one.name, one.e)
            )
            for one in problem.stage_rows
        ]
    for name in data:
        if name in homeless.difference(names):
            raise UnsupportedError(f"{name}: it has no single place in the problem; state a problem with another one.")
    return replace(problem, **fields)
