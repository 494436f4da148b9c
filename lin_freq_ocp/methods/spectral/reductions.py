"""Reductions of constraints to those of the Fourier-domain method.

Soft stop bands become hard ones, if their multipliers do not exceed their prices (SoftBins). Polyhedral sets become
joint rows (RowForm). Soft sets whose rows bound single components become bounds with prices (SoftBounds), which the
model of the method contains in addition to hard bounds. docs/spectral.md, 12, derives soft bounds and soft bands.

Reductions replace a problem by another one, in the user's units, and map its multipliers back. They precede
``lti_problem`` in ``model``, which only writes the arrays of the last problem in units of order 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, seal, split_signals, stack_signals
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.methods.absorbed_cost import absorb_cost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import stop_band
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.terms.maps import OutputMap
from lin_freq_ocp.problem.terms.penalty import HARD
from lin_freq_ocp.problem.terms.term import LinearRows, Term, TermKind
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reductions import Reduced

SETS = (TermKind.STATE_SET, TermKind.CONTROL_SET)
PRICE_ROUNDING = 1e-9  # part of a price, and of other forces on the component in a ray, that may be rounding
FIELDS = {TermKind.CONTROL_SPECTRUM: "control_spectrum", TermKind.STATE_SPECTRUM: "state_spectrum"}
AT_THE_END = " at the end"  # suffix of the names of rows on x_T


@dataclass(frozen=True, eq=False)
class RowForm(Reduced):
    """The problem with its polyhedral sets as joint rows, and the sets that became rows.

    F x_t <= g for t < T is a row with D = 0, and F x_T <= g is one on the step before: F A x + F B u <= g - F d. There
    the adjoint of the rows' problem is eta', that of the given one eta_{T-1} = eta'_{T-1} - F'lambda.
    """

    polyhedra: tuple[LinearRows, ...]

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers of the rows as those of the sets, and the adjoint without the rows on x_T."""
        eta, stage, T = reduced.eta.copy(), dict(reduced.stage), self.given.horizon
        for rows in self.polyhedra:
            weights, before = np.zeros(rows.e.shape), rows.times < T
            if before.any():
                weights[before] = stage.pop(rows.name)[rows.times[before]]
            if not before.all():
                weights[~before] = stage.pop(rows.name + AT_THE_END)[-1:]
                eta[-1] -= rows.C[0, :, : eta.shape[1]].T @ weights[~before][0]
            stage[rows.name] = weights
        return replace(reduced, eta=eta, stage=stage)


def row_form(problem: OptimalControlProblem) -> RowForm | None:
    """Return the problem with its polyhedral sets as joint rows.

    None if it has no such sets, or other sets too, or if all are soft sets that bounds can express.
    """
    sets = [term for term in problem.terms if term.kind != TermKind.STAGE_ROWS]
    if not sets:
        return None
    polyhedra = [(rows, term) for term in sets if (rows := _polyhedron(problem, term)) is not None]
    unsuited = len(polyhedra) < len(sets) or priced_bounds(problem) is not None
    if unsuited or problem.response is not None or problem.linear.time_varying:
        return None
    try:
        joint = list[StageRows]()
        for rows, term in polyhedra:
            joint += _stage_rows(problem, rows, None if term.hard else float(np.max(term.penalty.weights)))
        changed = problem.derived(
            state_set=problem.state_boxes,
            control_set=problem.control_tube,
            initial_state=problem.initial_box,
            terminal_state=problem.terminal_box,
            stage_rows=[*problem.stage_rows, *joint],
        )
    except ProblemError:  # a row on x_T that no control and no state before it can change
        return None
    return RowForm(problem, changed, tuple(rows for rows, _ in polyhedra))


def _polyhedron(problem: OptimalControlProblem, term: Term) -> LinearRows | None:
    """Return the rows of a polyhedral set that is the same at all its times, with one price; else None."""
    if term.kind not in SETS or not term.penalty.polyhedral or len(np.unique(term.penalty.weights)) > 1:
        return None
    hard = term if term.hard else replace(term, penalty=term.penalty.softened(HARD))
    rows = hard.polyhedron(problem.state_dim, problem.control_dim)
    if rows is None or len(rows.C) > 1:
        return None
    return rows if len(set(rows.times)) == len(rows.times) else None


def _stage_rows(problem: OptimalControlProblem, polyhedron: LinearRows, price: float | None) -> list[StageRows]:
    """Return the joint rows of a polyhedral set, with the price of a unit of violation; None for a hard set."""
    T, n, dynamics = problem.horizon, problem.state_dim, problem.linear
    before, rows, name = polyhedron.times < T, list[StageRows](), polyhedron.name
    C, D = polyhedron.C[0, :, :n], polyhedron.C[0, :, n:]
    if before.any():
        e = np.full((T, polyhedron.e.shape[1]), np.inf)
        e[polyhedron.times[before]] = polyhedron.e[before]
        rows.append(StageRows(C, D, e, name, price))
    if not before.all():
        e = np.full((T, polyhedron.e.shape[1]), np.inf)
        e[-1] = polyhedron.e[~before][0] - C @ dynamics.at(T - 1)[2]
        rows.append(StageRows(C @ dynamics.A, C @ dynamics.B, e, name + AT_THE_END, price))
    return rows


@dataclass(frozen=True, eq=False)
class SoftSet:
    """The rows of a soft set as bounds sign y_f <= limit of the components f of (x, u), in the user's units.

    A row c y_f + d <= e with a price is a bound (e - d)/|c| on y_f with the price times |c|, an upper one if c > 0. The
    hard bound of that component, side and time must be absent. If an end fixes the component, the violation is a
    constant, and its subgradient is the price or zero. Of N initial states, it is one for each of them.
    """

    name: str
    times: Indices  # (groups,)
    f: Indices  # (dim,)
    sign: Array  # (dim,), +1 for an upper bound
    size: Array  # (dim,), |c|
    limit: Array  # (groups, dim), inf where there is none
    price: Array  # (groups, dim), per unit of y_f
    constant: Mask  # (groups, dim): where an end fixes y_f
    violation: Array  # (groups, dim) or (N, groups, dim), of constant rows

    def multipliers(self, forces: Array, eta_C: float) -> Array:
        """Return the multipliers of the rows from the forces on all components, (T+1, n+m); subtract these forces.

        If no end fixes the component, all of its force is due to this set. Forces (N, T+1, n+m) are of N trajectories.
        """
        on_bounds = np.maximum(self.sign * forces[..., self.times[:, None], self.f], 0.0)
        paid = np.where(self.violation > 0, eta_C * self.price, 0.0)
        weights = np.where(self.constant, paid, np.where(np.isfinite(self.limit), on_bounds, 0.0))
        for row, component in enumerate(self.f):  # two rows may bound the same component
            forces[..., self.times, component] -= self.sign[row] * weights[..., row]
        return seal(weights / self.size)


def soft_set(problem: OptimalControlProblem, term: Term, starts: Array | None = None) -> SoftSet | None:
    """Return a soft set as bounds; None if it is hard, or some row concerns several components.

    ``starts`` are N initial states, (N, n), in place of the problem's own.
    """
    form = term.map.stage_form(problem.state_dim, problem.control_dim)
    if form is None or term.kind not in SETS or not term.penalty.polyhedral or len(form[0]) > 1:
        return None
    (rows,), constant, shape = form[0], form[1], term.shape
    weights = np.broadcast_to(term.penalty.weights, shape)
    if np.isinf(weights).any() or (np.count_nonzero(rows, axis=1) != 1).any():
        return None
    f, times = np.argmax(rows != 0, axis=1), term.map.positions
    coefficient = rows[np.arange(len(f)), f]
    sign, size = np.sign(coefficient), np.abs(coefficient)
    limit = (term.penalty.bounds(shape)[1] - constant) / size
    fixed = np.zeros((len(times), len(f)), dtype=bool)
    violation = np.zeros(fixed.shape if starts is None else (len(starts), *fixed.shape))
    if term.kind == TermKind.STATE_SET:
        values = problem.ends[0].lower if starts is None else starts[:, None], problem.ends[1].lower
        for t, end, value in zip((0, problem.horizon), problem.ends, values, strict=True):
            groups = times == t
            fixed[groups] = end.fixed[f]
            violation[..., groups, :] = sign * np.where(end.fixed, value, 0.0)[..., f] - limit[groups]
    return SoftSet(term.name, times, f, sign, size, limit, weights * size, fixed, violation)


@dataclass(frozen=True, eq=False)
class PricedBounds:
    """All soft sets; all bounds and their prices, (T+1, n+m), in the user's units; u_T is zero."""

    sets: tuple[SoftSet, ...]
    lower: Array
    upper: Array
    of_lower: Array
    of_upper: Array


def soft_sets(problem: OptimalControlProblem, starts: Array | None = None) -> tuple[SoftSet, ...] | None:
    """Return all sets that are terms; None if some is not a soft set of bounds."""
    sets = [term for term in problem.terms if term.kind not in (TermKind.STAGE_ROWS, TermKind.LINKED_ENDS)]
    found = [bounds for term in sets if (bounds := soft_set(problem, term, starts)) is not None]
    return tuple(found) if len(found) == len(sets) else None


def priced_bounds(problem: OptimalControlProblem) -> PricedBounds | None:
    """Return all bounds, hard and soft.

    None if some set is not a soft set of bounds, if two bounds share a component, side and time, or if a soft bound is
    outside the opposite one.
    """
    sets = soft_sets(problem)
    if sets is None:
        return None
    sides = [side.copy() for side in problem.signal_bounds]
    prices = [np.full(side.shape, np.inf) for side in sides]
    for bounds in sets:
        group, row = np.nonzero(np.isfinite(bounds.limit) & ~bounds.constant)
        t, f, limit = bounds.times[group], bounds.f[row], bounds.limit[group, row]
        for above, sign in ((False, -1.0), (True, 1.0)):
            on_side = bounds.sign[row] == sign
            at, side = (t[on_side], f[on_side]), sides[above]
            keys = at[0] * side.shape[1] + at[1]
            if np.isfinite(side[at]).any() or len(np.unique(keys)) < len(keys):
                return None
            side[at], prices[above][at] = sign * limit[on_side], bounds.price[group[on_side], row[on_side]]
    soft = np.isfinite(prices[0]) | np.isfinite(prices[1])
    return None if (soft & (sides[0] >= sides[1])).any() else PricedBounds(sets, *sides, *prices)


@dataclass(frozen=True, eq=False)
class SoftBounds(Reduced):
    """The problem with soft sets as bounds at their limits, whose multipliers must not exceed the prices.

    The model of the Fourier-domain method has the prices, and needs only the way back of the multipliers. A method
    without prices is right if they are high enough; else the judge refuses its multipliers.
    """

    sets: tuple[SoftSet, ...]

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers of soft bounds as those of their sets."""
        forces = stack_signals(reduced.mu, reduced.nu)
        on_sets = {bounds.name: bounds.multipliers(forces, reduced.eta_C) for bounds in self.sets}
        mu, nu = split_signals(forces, self.given.state_dim)
        return replace(reduced, mu=mu, nu=nu, stage={**reduced.stage, **on_sets})


@dataclass(frozen=True, eq=False)
class SoftBins(Reduced):
    """The problem with its soft bins removed from the spectra, and the terms of these bins with their spectra.

    The penalty is exact: if the price of a bin exceeds its multiplier, the bin is zero. A bound of zero with a price w
    costs w |uhat_k|, whose subgradients at uhat_k = 0 are all lambda with |lambda| <= w. With these bins removed, rho_k
    is such a subgradient if |rho_k| <= w: passing them would not lower the cost.
    """

    bands: tuple[tuple[Term, OutputMap], ...]

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return multipliers of the given problem; UnsupportedError if one exceeds eta_C times its price.

        The multipliers of bins that a hard band of the given problem also removes stay with that band.
        """
        through_u = self.given.equations.pull_back(reduced.eta)[:, self.given.state_dim :]
        rho = {
            TermKind.CONTROL_SPECTRUM: (reduced.rho_u.copy(), self.given.control_stop, through_u),
            TermKind.STATE_SPECTRUM: (reduced.rho_x.copy(), self.given.state_stop, reduced.eta),
        }
        stage = dict(reduced.stage)
        for term, spectrum in self.bands:
            bins, component, (forces, stopped, others) = spectrum.nearest_bins, spectrum.component, rho[term.kind]
            on_bins = np.where(stopped[bins, component], 0.0, forces[bins, component])
            price = reduced.eta_C * np.broadcast_to(term.penalty.weights, (len(bins), 1))[:, 0]
            rounding = 0.0 if reduced.eta_C else np.abs(others[:, component]).max()
            if (np.abs(on_bins) > price + PRICE_ROUNDING * (price + rounding)).any():
                raise UnsupportedError(
                    f"method 'spectral': {term.name}: a soft bin is not zero at its price; the Fourier-domain method "
                    "takes soft bins whose price keeps them zero. Use method 'structured'."
                )
            forces[bins, component] -= on_bins
            paid = np.asarray(on_bins if reduced.eta_C else np.zeros_like(on_bins), dtype=np.complex128)
            stage[term.name] = seal(np.stack([paid.real, paid.imag], axis=1))
        rho_u, rho_x = (seal(forces) for forces, *_ in rho.values())
        return replace(reduced, rho_u=rho_u, rho_x=rho_x, stage=stage)


def soft_bins(problem: OptimalControlProblem) -> SoftBins | None:
    """Return the problem with its soft bins removed; None if it has none."""
    bands = tuple(
        (term, spectrum)
        for term in problem.terms
        if (spectrum := term.map.spectrum) is not None and _is_soft_band(problem, term)
    )
    changes: dict[str, object] = {}
    for kind, field in FIELDS.items():
        soft = [(term, spectrum) for term, spectrum in bands if term.kind == kind]
        if soft:
            replaced = {term.source[1] for term, _ in soft if term.source is not None}
            hard = [entry for i, entry in enumerate(entries_of(getattr(problem, field))) if i not in replaced]
            stops = [stop_band(bins=spectrum.nearest_bins, component=spectrum.component) for _, spectrum in soft]
            changes[field] = [*hard, *stops]
    return SoftBins(problem, problem.derived(**changes), bands) if bands else None


def _is_soft_band(problem: OptimalControlProblem, term: Term) -> bool:
    """Whether a term is the price of plain DFT bins of a single component, bin by bin."""
    if term.kind not in FIELDS or term.hard:
        return False
    form = term.map.spectrum_form(problem.state_dim, problem.control_dim)
    if form is None or term.shape != (len(form.bins), 2) or form.points != len(form.window):
        return False
    plain = (form.window == 1).all() and (form.row[form.row != 0] == 1).all()
    return bool(plain) and not term.penalty.sizes().any()


REDUCTIONS = soft_bins, row_form, absorb_cost
"""Applied to a problem before the Fourier-domain method; soft sets become priced bounds in its model."""
