"""The conditions of the maximum principle (paper, Theorem 4.1 for smooth dynamics), one function each.

Every condition is a residual with its scale, a tolerance, and the worst time and component. C-i .. C-vii are labels of
the paper. S-x, S-u (x_t in X_t, u_t in U_t) and N-x, N-u (normal cones) are conditions of the paper without a label.
Each term h(L(x, u)) other than boxes, stop bands and quadratic costs adds two conditions: h(L(x, u)) is finite, if the
term is a constraint, and its multipliers are subgradients of h there (normals, for a set).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, first_largest, largest_over_time, split_signals
from lin_freq_ocp.certificate.bound import box_minimum
from lin_freq_ocp.certificate.hamiltonian import Extremal, PricedTerm, curvature_in_u
from lin_freq_ocp.certificate.peaks import Peak, proven_peak
from lin_freq_ocp.certificate.sizes import Floors
from lin_freq_ocp.certificate.tolerances import (
    CONDITION_TOLERANCE,
    DATA_ROUNDING,
    MAXIMISATION_REACH,
    NEGLIGIBLE_SHARE,
    PEAK_TOLERANCE,
    SCALE_FLOOR,
    TRIVIALITY,
)
from lin_freq_ocp.problem.terms.semi_infinite import SemiInfiniteConstraint
from lin_freq_ocp.problem.terms.term import Term

# By kind of term: the labels of the condition on its values, and on its multipliers
LABELS = {
    "state set": ("S-x", "N-x"),
    "control set": ("S-u", "N-u"),
    "stage rows": ("S-z", "N-z"),
    "state spectrum": ("C-vi", "N-xhat"),
    "control spectrum": ("C-vii", "N-uhat"),
    "output spectrum": ("S-yhat", "N-yhat"),
    "limits of outputs": ("S-z", "N-z"),
    "linked ends": ("S-ends", "N-ends"),
    "stage cost": ("", "N-c"),
    "terminal cost": ("", "N-c"),
}
OF_RESIDUALS = "N-r"  # of the residuals of all constraints
FEASIBILITY_LABELS = {"C-vi", "C-vii", "S-x", "S-u", "S-z", "S-yhat", "S-ends", "S-f"}


@dataclass(frozen=True)
class Condition:
    """A checked condition: it passes iff residual <= tolerance * scale.

    Attributes
    ----------
    label, name : str
        The label of the paper, and the condition in words.
    residual, scale, tolerance : float
        Of the worst component, in the units of the condition.
    time, component : int or None
        Of the worst residual; for a frequency constraint, time is the bin. None if the condition is a single number,
        or a vector without components.
    peak : Peak or None
        Of a mask at every frequency: the largest magnitude relative to its limit, with proof.
    rounding : float
        Of states: the residual that rounding of the data explains.
    """

    label: str
    name: str
    residual: float
    scale: float
    tolerance: float
    time: int | None = None
    component: int | None = None
    peak: Peak | None = None
    rounding: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the condition holds; it fails if the residual or scale overflows."""
        return bool(self.residual <= self.tolerance * self.scale < np.inf)

    @property
    def exact(self) -> bool:
        """Whether the residual is rounding: of solvers, or of data if that is small relative to the scale."""
        rounding = self.rounding if self.rounding <= CONDITION_TOLERANCE * self.scale else 0.0
        return bool(self.residual <= max(DATA_ROUNDING * self.scale, rounding))

    @property
    def on_feasibility(self) -> bool:
        """Whether it is a constraint of the problem; the others are conditions on multipliers."""
        return self.label in FEASIBILITY_LABELS or self.name == "state equation"

    def within(self, tolerance: float) -> Condition:
        """Return the condition with another tolerance; exact conditions and that of regions keep theirs."""
        if self.tolerance == 0 or self.label == "S-f":
            return self
        return replace(self, tolerance=tolerance)

    @property
    def relative(self) -> float:
        """Return residual / scale (0 where both are 0)."""
        return self.residual / self.scale if self.scale > 0 else (0.0 if self.residual == 0 else np.inf)


def all_conditions(extremal: Extremal, least: Floors) -> tuple[Condition, ...]:
    """Judge all conditions, in the order of the paper, with these least scales."""
    problem, (x, u) = extremal.problem, (extremal.trajectory.x, extremal.trajectory.u)
    eta_C = extremal.multipliers.eta_C
    return (
        Condition("C-i", "eta_C is 0 or 1", min(abs(eta_C), abs(eta_C - 1)), 1.0, 0.0),
        non_triviality(extremal),
        state_equation(extremal.residual.astype(np.float64), problem.equations.motion_sizes(x, u), least),
        *stationarity(extremal, least),
        *hamiltonian_maximum(extremal, least),
        *frequency(extremal, least),
        *membership(extremal, least),
        *normal_cones(extremal, least),
        *worth_of_residuals(extremal, least),
        *(
            condition
            for priced, size, precise in zip(extremal.terms, least.terms, least.limits, strict=True)
            for condition in term_conditions(priced, least.level, size, precise)
        ),
    )


def non_triviality(extremal: Extremal) -> Condition:
    """C-ii: eta_C, the adjoint and the frequency multipliers are not all zero."""
    multipliers = extremal.multipliers
    trivial = False
    if multipliers.eta_C == 0:
        spectra = [priced.weights for priced in extremal.terms if priced.term.kind.is_spectrum]
        counted = _largest(multipliers.eta, multipliers.rho_u, multipliers.rho_x, *spectra)
        on_sets = _largest(multipliers.mu, multipliers.nu, *(priced.weights for priced in extremal.terms))
        trivial = counted <= TRIVIALITY * on_sets
    return Condition("C-ii", "multipliers not all zero", float(trivial), 1.0, 0.0)


def state_equation(residual: Array, moved: Array, least: Floors) -> Condition:
    """C-iii: x_{t+1} = f_t(x_t, u_t); the residual (T, n) compared with the largest move of each component, (n,)."""
    scales = np.maximum(moved, least.z[: len(moved)])
    return worst_condition("C-iii", "state equation", np.abs(residual), scales, rounding=least.rounding)


def stationarity(extremal: Extremal, least: Floors) -> list[Condition]:
    """C-iii: eta_{t-1} = D_x H_t - mu_t, 0 < t < T; C-iv: D_x H_0 = mu_0, eta_{T-1} = -eta_C D c_T - ... - mu_T.

    C-v, to first order: D_u H_t = nu_t (and nu_t in N_U(u_t), which is N-u). Residuals count by their worth, a part of
    S, where that is smaller than their part of their scale.
    """
    last, n, normals = extremal.problem.horizon, extremal.problem.state_dim, extremal.normals
    residual = np.abs((extremal.slopes + normals).astype(np.float64))
    scales = _scales(extremal.slope_terms + np.abs(normals), least.slopes)
    worth: Array | None = None
    conditions, of_x, of_u = list[Condition](), slice(0, n), slice(n, None)
    for label, name, t, end, part in (
        ("C-iii", "adjoint equation", 1, last, of_x),
        ("C-iv", "transversality at 0", 0, 1, of_x),
        ("C-iv", "transversality at T", last, last + 1, of_x),
        ("C-v", "Hamiltonian stationary in u", 0, last, of_u),
    ):
        if t == end:  # there is no time between the ends
            continue
        chosen = slice(t, end), part
        condition = worst_condition(label, name, residual[chosen], scales[chosen], t)
        if condition.relative > NEGLIGIBLE_SHARE * CONDITION_TOLERANCE and extremal.multipliers.eta_C == 1:
            worth = _worth(residual, scales, extremal) if worth is None else worth
            if worth is not None:
                condition = _count_by_worth(condition, residual[chosen], scales[chosen], worth[chosen], least.level)
        conditions.append(condition)
    return conditions


def _count_by_worth(condition: Condition, residual: Array, scales: Array, worth: Array, level: float) -> Condition:
    """Return a condition whose residuals count by their worth, a part of S, where that is less than by their scales."""
    by_worth = worth * scales < residual * level
    rest = worst_condition(condition.label, condition.name, np.where(by_worth, 0.0, residual), scales)
    total = float(worth[by_worth].sum())
    share = max(rest.relative, total / level if total > 0 else 0.0)
    return replace(condition, residual=share * level, scale=level) if share < condition.relative else condition


def _worth(residual: Array, scales: Array, extremal: Extremal) -> Array | None:
    """Return the cost that residuals s of stationarity explain, entry by entry: min(|s| w, s^2 / (2 m)).

    A trajectory of a convex problem that is stationary up to s is an optimum of the cost J - <s, (x, u)>. So its cost
    exceeds the optimal one by at most their sum, with the curvatures m and the distances w to the far bounds. A
    component that is fixed takes any multiplier: its residual is worth nothing if it is small, and is not priced else.
    None if J is not convex.
    """
    curvature, (lower, upper), point = extremal.curvatures, extremal.bounds, extremal.point
    if curvature is None:
        return None
    far = np.maximum(upper - point, point - lower)
    over_box = np.where(residual > 0, residual, 0.0) * np.where(residual > 0, far, 0.0)
    bent = np.divide(residual**2, 2 * curvature, out=np.full(residual.shape, np.inf), where=curvature > 0)
    fixed = np.where(residual <= CONDITION_TOLERANCE * scales, 0.0, np.inf)
    return np.where(lower == upper, fixed, np.minimum(over_box, np.where(residual > 0, bent, 0.0)))


def hamiltonian_maximum(extremal: Extremal, least: Floors) -> list[Condition]:
    """C-v, if H is concave in u: max over U_t of H_t exceeds H_t(u_t) by 0 (paper, corollary for linear systems).

    The difference is exact for a diagonal Hessian, else an upper bound. As H is concave, a maximum over all v that
    differ from u_t by at most MAXIMISATION_REACH times the sizes of the components is one over U_t. Inactive bounds
    therefore do not matter.
    With joint rows, the maximum over {v in U_t : D v <= e - C x_t} of H is at most the maximum over U_t of
    H - <l+, C x_t + D v - e>. The difference is then that of the latter from its value at u_t (the difference over U_t
    with the slope D_u H - D'l+), plus the complementarity <l+, e - C x_t - D u_t>. Other terms of u_t add their gaps.
    """
    problem, u = extremal.problem, extremal.trajectory.u
    curvature, n = curvature_in_u(problem.quadratic, extremal.multipliers.eta_C), problem.state_dim
    if curvature is None:
        return []
    tube, reach = problem.control_tube, MAXIMISATION_REACH * least.z[n:] / SCALE_FLOOR
    low, high = np.maximum(tube.lower - u, -reach), np.minimum(tube.upper - u, reach)
    slopes, in_u_terms = extremal.slopes[:-1, n:].astype(np.float64), extremal.slope_terms[:-1, n:]
    rise = -box_minimum(slopes, curvature, low, np.maximum(low, high))
    rise = np.maximum(rise, 0.0)  # negative if u_t is outside U_t by a rounding error
    total = rise.sum(1)
    for priced in extremal.terms:
        form = priced.term.map.stage_form(n, problem.control_dim)
        if form is not None and form[0][..., n:].any():  # of the control of a single time
            np.add.at(total, priced.term.map.positions, np.maximum(priced.gap, 0.0).sum(1))
    terms = (in_u_terms * np.abs(u)).sum(1)
    scale = max(least.level, float(terms.max()))
    (t,) = first_largest(total)
    (component,) = first_largest(rise[t])
    return [Condition("C-v", "Hamiltonian maximal in u", float(total[t]), scale, CONDITION_TOLERANCE, t, component)]


def frequency(extremal: Extremal, least: Floors) -> Iterator[Condition]:
    """C-vi, C-vii: the removed bins are zero; compared with the root mean square over all bins of the component."""
    problem, at, n = extremal.problem, extremal.trajectory, len(least.rounding)
    for label, name, signal, stopped, floor in (
        ("C-vi", "state frequency constraint", at.x[: problem.state_samples], problem.state_stop, least.z[:n]),
        ("C-vii", "control frequency constraint", at.u, problem.control_stop, least.z[n:]),
    ):
        magnitude = np.zeros(stopped.shape)
        if stopped.any():
            magnitude[stopped] = np.abs(np.fft.rfft(signal, axis=0)[stopped])
        yield worst_condition(label, name, magnitude, np.maximum(np.sqrt((signal**2).sum(0)), floor))


def membership(extremal: Extremal, least: Floors) -> Iterator[Condition]:
    """S-x, S-u: distance outside the set; compared with the largest value of the component, or the bound.

    A bound of zero does not say what is small: there the size of the component counts, too.
    """
    (lower, upper), point, n = extremal.bounds, extremal.point, len(least.rounding)
    bound = np.abs(np.where(point > upper, upper, lower))
    scales = np.maximum(largest_over_time(np.abs(point)), _least_at(bound, least.bounds, least.z))
    (of_x, of_u), (in_x, in_u) = split_signals(extremal.violation, n), split_signals(scales, n)
    yield worst_condition("S-x", "state in its set", of_x, in_x, rounding=least.rounding)
    yield worst_condition("S-u", "control in its set", of_u, in_u)


def normal_cones(extremal: Extremal, least: Floors) -> Iterator[Condition]:
    """N-x, N-u: sigma(mu_t) - <mu_t, x_t> = 0; compared with the largest <|mu_t|, |x_t|>, or the cost.

    Absent bounds, and bounds at a distance above the size of the component, count as if they were at that distance.
    """
    normals, (lower, upper), n = extremal.normals, extremal.bounds, len(least.rounding)
    sizes, weights = np.abs(extremal.point), np.abs(normals)
    slack = np.where(normals > 0, upper - extremal.point, np.where(normals < 0, extremal.point - lower, 0.0))
    gaps = np.minimum(np.abs(weights * slack), weights * _scales(sizes, least.z))
    pairs = split_signals(gaps, n), split_signals(weights * sizes, n)
    names = ("N-x", "state"), ("N-u", "control")
    for (label, signal), gap, terms in zip(names, *pairs, strict=True):
        scale, (t, component) = max(least.level, float(terms.sum(1).max())), first_largest(gap) if gap.any() else (0, 0)
        name = f"{signal} multiplier in the normal cone"
        yield Condition(label, name, float(gap[t, component]), scale, CONDITION_TOLERANCE, t, component)


def worth_of_residuals(extremal: Extremal, least: Floors) -> list[Condition]:
    """N-r: residuals of the constraints times their multipliers are worth nothing; compared with S.

    A residual may be small for its component and large for the cost: where states decay, one that is small beside the
    first of them may decide the last.
    """
    if (multipliers := extremal.multipliers).eta_C != 1:
        return []
    rounded = least.bounds[: multipliers.eta.shape[1]]  # whether states are at rest or not
    rounding = float((np.abs(multipliers.eta) @ rounded).sum())
    residual, scale = float(extremal.cost_of_residuals), max(least.level, rounding)
    return [Condition(OF_RESIDUALS, "residuals are worth nothing", residual, scale, CONDITION_TOLERANCE)]


def term_conditions(priced: PricedTerm, level: float, least: Array, precise: Array) -> list[Condition]:
    """Judge a term: its values, if it is a constraint, and its multipliers, which must be subgradients.

    The least scales of its values (dim,) are ``precise`` at limits other than zero, else ``least``.
    """
    term, least = priced.term, np.where(least > 0, least, least.max(initial=0.0))
    on_values, on_multipliers = LABELS[term.kind]
    subgradient = term_subgradient(on_multipliers, priced, level, least)
    if term.hard and term.semi_infinite is not None:
        return [mask_condition(on_values, priced, term.semi_infinite, precise), subgradient]
    if term.hard:
        return [term_condition(on_values, priced, least, precise), subgradient]
    if term.semi_infinite is None:
        return [subgradient]
    # a soft mask at every frequency: the sum over its atoms, and the largest violation at all other frequencies
    gap = np.abs(priced.gap).sum() + abs(priced.peak_price)
    never = np.abs(priced.multipliers - priced.weights) * priced.sizes
    time = _bin_of(priced.peak, term.semi_infinite)
    return [replace(subgradient, residual=float(gap + never.sum()), time=time, peak=priced.peak)]


def mask_condition(label: str, priced: PricedTerm, everywhere: SemiInfiniteConstraint, least: Array) -> Condition:
    """C-vi, C-vii, S-yhat at every frequency: |V| <= l; compared with l, or a part of the norm of the samples."""
    peak = proven_peak(everywhere, priced.signal)
    frequency, plants = peak.frequency, peak.damping is not None
    limit = float(everywhere.limit_at(np.array([[frequency, peak.damping] if plants else frequency]))[0])
    scale = max(limit, SCALE_FLOOR * float(_scales(priced.sizes, least).max()))
    name = f"holds {'for all plants' if plants else 'at every frequency'}: {priced.term.name}"
    time = _bin_of(peak, everywhere)
    residual = max(peak.ratio - 1.0, 0.0) * limit
    return Condition(label, name, residual, scale, PEAK_TOLERANCE, time, peak=peak)


def _bin_of(peak: Peak | None, everywhere: SemiInfiniteConstraint) -> int | None:
    """Return the bin of the signal's DFT nearest to a peak; None of a vibration, and above Nyquist."""
    if peak is None or peak.damping is not None or peak.frequency > np.pi:
        return None
    return round(peak.frequency * everywhere.map.samples / (2 * np.pi))


def term_condition(label: str, priced: PricedTerm, least: Array, precise: Array) -> Condition:
    """S-..., C-vi, C-vii: h(L(x, u)) is finite; compared with the largest sum of the absolute values of its terms."""
    violation = priced.term.penalty.violation(priced.values).astype(np.float64)
    limits = np.broadcast_to(priced.term.penalty.sizes(), priced.values.shape)
    scales = np.maximum(largest_over_time(priced.sizes), _least_at(limits, precise, least))
    scales = scales if violation.shape == scales.shape else scales.max(axis=1, keepdims=True)
    what = "rows hold" if priced.term.kind.is_rows else "holds"
    condition = worst_condition(label, f"{what}: {priced.term.name}", violation, scales)
    return _locate_condition(priced.term, condition)


def term_subgradient(label: str, priced: PricedTerm, level: float, least: Array) -> Condition:
    """N-...: lambda is a subgradient of h at L(x, u); compared with the largest <|lambda|, its terms>, or J.

    The part of lambda that is not a subgradient of h anywhere is multiplied by the largest value of that entry.
    """
    scales = _scales(priced.sizes, least)
    never = np.abs(priced.multipliers - priced.weights) * scales
    gap = np.abs(priced.gap) + (never if priced.gap.shape == never.shape else never.sum(1, keepdims=True))
    scale = max(level, float((np.abs(priced.multipliers) * priced.sizes).sum(1).max(initial=0.0)))
    t, row = first_largest(gap.astype(np.float64)) if len(gap) else (0, 0)
    residual = float(gap[t, row]) if len(gap) else 0.0
    what = "row multipliers complementary" if priced.term.kind.is_rows else "multipliers are subgradients"
    name = f"{what}: {priced.term.name}"
    return _locate_condition(priced.term, Condition(label, name, residual, scale, CONDITION_TOLERANCE, t, row))


def _locate_condition(term: Term, condition: Condition) -> Condition:
    """Return the condition with the time or bin of its group; only entries of joint rows are components."""
    positions = term.map.positions
    group = condition.time if 0 < len(positions) == term.shape[0] else None  # None of a mask without atoms
    time = None if group is None else int(positions[group])
    return replace(condition, time=time, component=condition.component if term.kind.is_rows else None)


def _largest(*parts: Array | ComplexArray) -> float:
    return max([float(np.abs(part).max(initial=0.0)) for part in parts])


def _scales(terms: Array, least: Array) -> Array:
    """Return one scale per component: the largest over time of the sum of the absolute values of its terms."""
    return np.maximum(largest_over_time(terms), least)


def _least_at(limits: Array, precise: Array, least: Array) -> Array:
    """Return the least scales of violations of limits (absolute values): their size, or ``least`` at zero."""
    return np.where((limits > 0) & np.isfinite(limits), np.maximum(limits, precise), least)


def worst_condition(
    label: str, name: str, residual: Array, scales: Array, first: int = 0, rounding: Array | None = None
) -> Condition:
    """Return the condition at its worst entry, relative to its scale; residual (times, components).

    ``rounding`` are the rounding errors of the components, if known.
    """
    t = component = 0
    if residual.any():
        relative = residual / np.where(scales > 0, scales, np.inf)  # 0 without a scale
        t, component = first_largest(relative)
    scale = float(scales[component] if scales.ndim == 1 else scales[t, component])
    errors = 0.0 if rounding is None else float(rounding[component])
    at = float(residual[t, component]), scale
    return Condition(label, name, *at, CONDITION_TOLERANCE, first + t, component, rounding=errors)
