"""The first derivatives of the Hamiltonian along a trajectory, and the sizes of their terms.

H_t(eta, x, u) = <eta, f_t(x, u)> - eta_C c_t(x, u) - <eta_xhat, phi_t(x)> - <eta_uhat, psi_t(u)>   (e:hamiltonian)

Every other term h(L(x, u)) of a problem, with multipliers lambda, adds -<lambda+, L(x, u)>. Here lambda+ are the
nearest multipliers that are subgradients of h somewhere; for a row, lambda+ = max(lambda, 0). The bound therefore holds
for multipliers lambda of any sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse.csgraph import connected_components

from lin_freq_ocp.base.arrays import Array, seal, split_signals, stack_signals, to_long_double, total
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.semidefinite import least_rise
from lin_freq_ocp.certificate.peaks import Peak, proven_peak
from lin_freq_ocp.certificate.tolerances import EIGENVALUE_ERROR
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reformulations import at_frequencies
from lin_freq_ocp.transform.simulation import motions_at_rest, reach_of_bounds


@dataclass(frozen=True, eq=False)
class PricedTerm:
    """One term along a trajectory; arrays are (groups, dim), (groups, 1) where they are of whole groups.

    Attributes
    ----------
    multipliers, weights
        lambda, and lambda+: the nearest multipliers that are subgradients of h somewhere.
    values, sizes
        v = L(x, u) in extended precision, and the sums of the absolute values of its terms.
    gap
        h(v) + h*(lambda+) - <lambda+, v>: zero iff lambda+ is a subgradient of h at v.
    signal
        The windowed samples of a mask at every frequency, else empty.
    peak, peak_price
        Of a soft mask at every frequency: the proven maximum, and the price of its violation less that of the values,
        which ``gap`` lacks.
    """

    term: Term
    multipliers: Array
    weights: Array
    values: Array
    sizes: Array
    gap: Array
    signal: Array
    peak: Peak | None = None
    peak_price: float = 0.0

    @property
    def gap_terms(self) -> Array:
        """Return the sums of the absolute values of the terms of the gaps, (..., groups): rounding is a part."""
        limits = np.broadcast_to(self.term.penalty.sizes(), self.values.shape)
        return (np.abs(self.weights) * (self.sizes + limits)).sum(-1) + np.abs(self.gap).sum(-1)


@dataclass(frozen=True, eq=False)
class Extremal:
    """A trajectory with its multipliers, and the derivatives of the Hamiltonian there.

    Arrays of states and controls are stacked as z_t = (x_t, u_t), (T+1, n + m), with zeros for u_T. Those of N
    trajectories have a leading axis, and what is a number of one trajectory is an array (N,). Signals and derivatives
    are in extended precision, as their terms cancel. Sums of absolute values are in double precision.

    Attributes
    ----------
    bounds
        The lower and the upper bounds of the sets.
    z, deviations, bent
        The trajectory, its deviations from the references, and the slopes of the quadratic cost there.
    signal
        The frequency multipliers as functions of time, (D phi_t)' eta_xhat and (D psi_t)' eta_uhat; None if all are 0.
    in_z
        D_x H_t and D_u H_t with the terms; at T, where there is no f, -eta_C D c_T - (D phi_T)' eta_xhat.
    in_z_terms
        The sums of the absolute values of the terms of in_z. Its rounding errors are relative to these.
    cost_terms
        The part of the quadratic cost in these sums.
    terms : list of PricedTerm
        All terms of the problem except the quadratic cost, boxes and stop bands.
    """

    problem: OptimalControlProblem
    trajectory: Trajectory
    multipliers: Multipliers
    bounds: tuple[Array, Array]
    z: Array
    deviations: Array
    bent: Array
    signal: Array | None
    in_z: Array
    in_z_terms: Array
    cost_terms: Array
    terms: list[PricedTerm]

    @cached_property
    def point(self) -> Array:
        """The trajectory in double precision."""
        return self.z.astype(np.float64)

    @cached_property
    def violation(self) -> Array:
        """The distances from the sets, component by component."""
        lower, upper = self.bounds
        return np.maximum(np.maximum(lower - self.point, self.point - upper), 0.0)

    @cached_property
    def normals(self) -> Array:
        """The multipliers mu_t and nu_t."""
        return stack_signals(self.multipliers.mu, self.multipliers.nu)

    @cached_property
    def slopes(self) -> Array:
        """The slopes of l_t: eta_{t-1} - D_x H_t, with 0 for eta_{-1}, and -D_u H_t."""
        slopes = -self.in_z
        slopes[..., 1:, : self.problem.state_dim] += self.multipliers.eta
        return slopes

    @cached_property
    def slope_terms(self) -> Array:
        """The sums of the absolute values of the terms of the slopes."""
        terms = self.in_z_terms.copy()
        terms[..., 1:, : self.problem.state_dim] += np.abs(self.multipliers.eta)
        return terms

    @cached_property
    def residual(self) -> Array:
        """x_{t+1} - f_t(x_t, u_t), (T, n), in extended precision."""
        x, u = split_signals(self.z, self.problem.state_dim)
        return x[..., 1:, :] - self.problem.equations.successors(x, u)

    @cached_property
    def dynamics_term(self) -> Array:
        """<eta, x_{t+1} - f_t(x_t, u_t)>."""
        return total(self.multipliers.eta * self.residual)

    @cached_property
    def curvatures(self) -> Array | None:
        """Lower bounds of the curvature of l_t; None if J is not convex."""
        curvatures = cost_curvatures(self.problem.quadratic, self.problem.horizon)
        return None if curvatures is None else self.multipliers.eta_C * curvatures

    @cached_property
    def terms_gap(self) -> Array | float:
        """The sum of the gaps h(v) + h*(lambda+) - <lambda+, v> of all terms."""
        return sum(total(priced.gap) + priced.peak_price for priced in self.terms)

    @cached_property
    def frequency_terms(self) -> tuple[Array, Array]:
        """<rho, frequency residual> of states and of controls."""
        if self.signal is None:
            return np.zeros(self.point.shape[:-2]), np.zeros(self.point.shape[:-2])
        of_x, of_u = split_signals(self.signal * self.point, self.problem.state_dim)
        return total(of_x), total(of_u)

    @cached_property
    def cost_of_residuals(self) -> Array:
        """The residuals of the constraints times their multipliers, in units of the cost.

        If the optimal cost is differentiable in the constraints, J differs by this from the cost of the nearest
        feasible trajectory, to first order. A residual may be small for its component and large for the cost. Residuals
        of one constraint add up with their signs.
        """
        cost = total(np.abs(self.normals) * self.violation)
        for part in (self.dynamics_term, *self.frequency_terms):
            cost = cost + np.abs(part)
        for priced in (one for one in self.terms if one.term.hard):
            cost = cost + total(np.abs(priced.weights) * priced.term.penalty.violation(priced.values))
        return cost

    @cached_property
    def cost_and_size(self) -> tuple[Array, Array]:
        """J, and the sum of the sizes of its terms."""
        return cost_and_size(self.problem, self.z, (self.deviations, self.bent, [one.values for one in self.terms]))

    @property
    def cost(self) -> float:
        """Return J of one trajectory."""
        return float(self.cost_and_size[0])


def cost_and_size(
    problem: OptimalControlProblem, z: Array, known: tuple[Array, Array, Sequence[Array]] | None = None
) -> tuple[Array, Array]:
    """Return J, and the sum of the sizes of its terms; the quadratic part is a single term at each time.

    The size of a term is its absolute value, but at most the difference that bounds and dynamics let it have on another
    trajectory. The value of a linear cost of a state depends on where the zero of the state is: its size is at most its
    difference from the motions at rest.

    Parameters
    ----------
    z : (..., T+1, n + m)
        Stacked signals.
    known : tuple, optional
        If they are known: z less the references, the slopes of the quadratic part, and the values of the terms there.
    """
    n, cost, (reach, varied) = problem.state_dim, problem.quadratic, _reach_and_variation(problem)
    (x, u), slopes, in_components = split_signals(z, n), cost.linear_slopes(problem.horizon), "...ti,...ti->...t"
    if known is None:
        deviations = cost.deviations_of(z)
        known = deviations, cost.bend(deviations), [term.map.values(x, u) for term in problem.terms]
    deviations, bent, values = known
    stages, most = 0.5 * np.einsum(in_components, deviations, bent), np.einsum(in_components, np.abs(bent), reach)
    price, size = stages.sum(-1), np.minimum(np.abs(stages), most + varied).sum(-1)
    if problem.cost.has_formulas:
        formulas = problem.cost.formula_values(x, u)
        price, size = price + formulas.sum(-1), size + np.abs(formulas).sum(-1)
    for term, at in zip(problem.terms, values, strict=True):
        paid = term.penalty.cost(at) if term.semi_infinite is None else term.cost(x, u)
        if paid.any():
            price, size = price + paid.sum(-1), size + term.sizes_of_prices(at, paid, split_signals(reach, n)).sum(-1)
    if slopes is not None:
        box = problem.initial_box
        start = np.where(box.fixed, x[..., 0, :], box.project(np.zeros_like(box.lower)))
        moved = np.fmin.reduce([np.abs(x), *(np.abs(x - motion) for motion in motions_at_rest(problem, start))])
        moved = np.minimum(stack_signals(moved, np.abs(u)), reach)
        price, size = price + total(slopes * z), size + total(np.abs(slopes) * moved)
    return np.asarray(price, dtype=np.float64), np.asarray(size, dtype=np.float64)


@lru_cache(maxsize=2)
def _reach_and_variation(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return ``reach_of_bounds``, and what the curvature of the cost makes of it, (T+1,)."""
    reach = reach_of_bounds(problem)
    return reach, 0.5 * (reach * problem.quadratic.magnitudes.bend(reach)).sum(-1)


def state_residual(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return x_{t+1} - f_t(x_t, u_t) of linear dynamics, shape (T, n)."""
    return trajectory.x[..., 1:, :] - problem.equations.successors(trajectory.x, trajectory.u)


def extremal_at(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Extremal:
    """Evaluate the derivatives of the Hamiltonian.

    Raises
    ------
    ProblemError
        If shapes do not fit the problem, or a free bin or row has a multiplier.
    """
    problem.require(trajectory)
    problem = at_frequencies(problem, multipliers.frequencies)
    require_fitting(problem, multipliers)
    return extremal_within(problem, trajectory, multipliers, problem.signal_bounds)


def extremal_within(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, bounds: tuple[Array, Array]
) -> Extremal:
    """Return the extremal of a trajectory, or of N trajectories, with these bounds; nothing is checked."""
    n, eta_C, eta, cost = problem.state_dim, multipliers.eta_C, to_long_double(multipliers.eta), problem.quadratic
    z = to_long_double(stack_signals(trajectory.x, trajectory.u))
    x, u = split_signals(z, n)
    deviations, linear = cost.deviations_of(z), cost.linear_slopes(problem.horizon)
    bent, cost_terms = cost.bend(deviations), cost.magnitudes.bend(np.abs(deviations).astype(np.float64))
    in_z = bent if linear is None else bent + linear
    cost_terms = abs(eta_C) * (cost_terms if linear is None else cost_terms + np.abs(linear))
    in_z, in_z_terms = -eta_C * in_z, cost_terms.copy()
    parts, sizes = split_signals(in_z, n), split_signals(in_z_terms, n)
    signal, in_time = None, (problem.in_time, lambda rho: time_signal(rho, problem.horizon))
    for k, rho in enumerate((multipliers.rho_x, multipliers.rho_u)):
        if rho.any():
            signal = np.zeros_like(z) if signal is None else signal
            split_signals(signal, n)[k][:] = own = in_time[k](to_long_double(rho))
            parts[k][:] -= own
            sizes[k][:] += np.abs(rho).sum(-2, keepdims=True)
    terms = _priced_terms(problem, trajectory, multipliers, x, u)
    in_z[..., :-1, :] += problem.equations.pull_back(eta)
    in_z_terms[..., :-1, :] += problem.equations.pulled_sizes(multipliers.eta)
    for priced in terms:
        pulled = priced.term.map.pull_back(priced.weights, (x.shape, u.shape))
        pulled_sizes = priced.term.map.pulled_sizes(priced.weights, (x.shape, u.shape))
        for part, size, one, one_size in zip(parts, sizes, pulled, pulled_sizes, strict=True):
            part -= one
            size += one_size
    at = z, deviations, bent, signal, in_z, in_z_terms, cost_terms
    return Extremal(problem, trajectory, multipliers, bounds, *at, terms)


def _priced_terms(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, x: Array, u: Array
) -> list[PricedTerm]:
    """Return the terms along a trajectory, which is (x, u) in extended precision."""
    priced: list[PricedTerm] = []
    for term in problem.terms:
        on_term = multipliers.stage.get(term.name, np.zeros((*x.shape[:-2], *term.shape)))
        values, weights = term.map.values(x, u), term.penalty.subgradient(to_long_double(on_term), multipliers.eta_C)
        sizes = term.map.sizes(trajectory.x, trajectory.u)
        gap = term.penalty.gap(values, weights, multipliers.eta_C)
        everywhere = term.semi_infinite
        signal = np.zeros(0) if everywhere is None else everywhere.map.signal(trajectory.x, trajectory.u)
        peak, peak_price = None, 0.0
        if everywhere is not None and not term.hard:  # the largest violation may lie between the values
            peak = proven_peak(everywhere, signal)
            price = everywhere.price * max(peak.ratio - 1.0, 0.0)
            peak_price = multipliers.eta_C * (price - float(term.penalty.cost(values).sum()))
        priced.append(PricedTerm(term, on_term, weights, values, sizes, gap, signal, peak, peak_price))
    return priced


def require_fitting(problem: OptimalControlProblem, multipliers: Multipliers) -> None:
    """Raise ProblemError if the shape of multipliers does not fit the problem, or a free bin or row has one."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    if multipliers.eta.shape != (T, n) or multipliers.nu.shape != (T, m):
        got = f"eta {multipliers.eta.shape}, nu {multipliers.nu.shape}"
        raise ProblemError("multipliers", got, f"eta {(T, n)}, nu {(T, m)}")
    for field, rho, stop in (
        ("rho_u", multipliers.rho_u, problem.control_stop),
        ("rho_x", multipliers.rho_x, problem.state_stop),
    ):
        if rho.shape != stop.shape:
            raise ProblemError(f"multipliers.{field}", f"shape {rho.shape}", f"shape {stop.shape}")
        if rho.any() and rho[~stop].any():
            k, i = np.argwhere((rho != 0) & ~stop)[0]
            raise ProblemError(f"multipliers.{field}[{k}, {i}]", f"{rho[k, i]:g}", "0", f"Bin {k} is free.")
    terms = {term.name: term for term in problem.terms}
    for name, on_term in multipliers.stage.items():
        if name not in terms:
            raise ProblemError("multipliers.stage", repr(name), f"the names of the constraints: {list(terms)}")
        field, term = f"multipliers.stage[{name!r}]", terms[name]
        if on_term.shape != term.shape:
            raise ProblemError(field, f"shape {on_term.shape}", f"shape {term.shape}")
        for t, row in np.argwhere((on_term != 0) & term.penalty.unlimited)[:1]:
            raise ProblemError(f"{field}[{t}, {row}]", f"{on_term[t, row]:g}", "0", "The row has no limit there.")


@lru_cache(maxsize=4)  # a loop judges plans of one cost, one after another
def cost_curvatures(cost: QuadraticCost, horizon: int) -> Array | None:
    """Return lower bounds of a cost's curvature, stacked, (T+1, n + m); None if it is not convex."""
    stage, terminal = diagonal_curvature(cost.stage_hessians), diagonal_curvature(cost.P)
    if stage is None or terminal is None:
        return None
    stage, n = np.broadcast_to(stage, (horizon, stage.shape[-1])), len(terminal)
    return seal(stack_signals(np.vstack([stage[:, :n], terminal]), stage[:, n:]))


@lru_cache(maxsize=4)
def curvature_in_u(cost: QuadraticCost, eta_C: float) -> Array | None:
    """Return the ``diagonal_curvature`` of eta_C R."""
    return diagonal_curvature(eta_C * cost.R)


def diagonal_curvature(hessian: Array) -> Array | None:
    """Return m with diag(m) <= H, per time, (..., k) for H (..., k, k): H's own diagonal where H is diagonal.

    None if H is not positive semidefinite up to rounding. For components that H couples, with D = diag(H) and
    C = D^-1/2 H D^-1/2: H >= lambda_min(C) D. If H is a rounded product, lambda_min(C) may be about 0; m is then zero
    only if H is exactly semidefinite, else minus the ``least_rise`` of H times its diagonal.
    """
    curvature = hessian.diagonal(axis1=-2, axis2=-1).copy()
    if (curvature < 0).any():
        return None
    if np.count_nonzero(hessian) == np.count_nonzero(curvature):
        return curvature
    if hessian[curvature == 0].any():
        return None
    pattern = (hessian != 0).any(axis=tuple(range(hessian.ndim - 2)))
    _, groups = connected_components(pattern, directed=False)
    for members in (np.flatnonzero(groups == group) for group in np.unique(groups)):
        share = _diagonal_share(hessian[..., members[:, None], members]) if len(members) > 1 else np.ones(())
        if share is None:
            return None
        curvature[..., members] *= share[..., None]
    return curvature


def _diagonal_share(hessian: Array) -> Array | None:
    """Return the largest known p with p diag(H) <= H, per time, (...,); None if some p is negative beyond rounding."""
    root = np.sqrt(np.diagonal(hessian, axis1=-2, axis2=-1))
    root = np.where(root > 0, root, np.inf)
    correlation = hessian / (root[..., :, None] * root[..., None, :])
    identity = np.eye(hessian.shape[-1], dtype=bool)
    correlation = np.where(identity, 1.0, (correlation + np.swapaxes(correlation, -1, -2)) / 2)
    error = EIGENVALUE_ERROR * hessian.shape[-1]
    smallest = np.asarray(np.linalg.eigvalsh(correlation)[..., 0] - error)
    if (smallest < -2 * error).any():
        return None
    for index in map(tuple, np.argwhere(smallest <= 0).tolist()):
        smallest[index] = max(-least_rise(hessian[index]), smallest[index])
    return smallest
