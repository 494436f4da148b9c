"""The conditions of the maximum principle (paper, Theorem 4.1 for smooth dynamics), one function each.

Every condition is a residual with the scale it is to be compared with, a tolerance, and the worst time and component.
C-i .. C-vii are the paper's; S-x, S-u (x_t in X_t, u_t in U_t) and N-x, N-u (normal cones) are used by it unnamed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.certificate.bound import box_minimum, diagonal_curvature
from lin_freq_ocp.certificate.hamiltonian import Lift
from lin_freq_ocp.problem.arrays import Array, Mask
from lin_freq_ocp.problem.measures import one_step_residual
from lin_freq_ocp.problem.sets import Box

CONDITION_TOLERANCE = 1e-6
"""Residual over scale. Good solvers reach 1e-9; an error in a sign, an index or a row gives 1e-3 or more."""

SCALE_FLOOR = 1e-4
"""No component is measured more finely than this fraction of the largest: one that should be 0 holds rounding only."""

ZERO_SCALE = 1e-9
"""Least scale, in the problem's own units: where all data are zero, so are numbers of this size times the tolerance."""


@dataclass(frozen=True)
class Condition:
    """One checked condition: it passes iff residual <= tolerance * scale.

    Attributes
    ----------
    label, name : str
        The paper's label, and what it says.
    residual, scale, tolerance : float
        In the units of the condition; of the worst component.
    time, component : int or None
        Where it is worst; for a frequency constraint, time is the bin. None: the condition is one number.
    """

    label: str
    name: str
    residual: float
    scale: float
    tolerance: float
    time: int | None = None
    component: int | None = None

    @property
    def passed(self) -> bool:
        """Whether the condition holds."""
        return bool(self.residual <= self.tolerance * self.scale)

    @property
    def relative(self) -> float:
        """Return residual / scale (0 where both are 0)."""
        return self.residual / self.scale if self.scale > 0 else (0.0 if self.residual == 0 else np.inf)


def all_conditions(lift: Lift) -> tuple[Condition, ...]:
    """Judge all conditions, in the paper's order."""
    conditions = [non_negativity(lift), non_triviality(lift), state_equation(lift), *adjoint_and_transversality(lift)]
    conditions += [stationarity_in_u(lift), *hamiltonian_maximum(lift)]
    conditions += [
        frequency("C-vi", "state frequency constraint", lift.trajectory.x, lift.problem.state_stop),
        frequency("C-vii", "control frequency constraint", lift.trajectory.u, lift.problem.control_stop, felt(lift)),
        membership("S-x", "state in its set", lift.trajectory.x, lift.problem.state_tube),
        membership("S-u", "control in its set", lift.trajectory.u, lift.problem.control_tube),
    ]
    level = abs(lift.problem.cost.value(lift.trajectory.x, lift.trajectory.u))
    for label, signal, normal, tube in (
        ("N-x", lift.trajectory.x, lift.multipliers.mu, lift.problem.state_tube),
        ("N-u", lift.trajectory.u, lift.multipliers.nu, lift.problem.control_tube),
    ):
        what = "state" if label == "N-x" else "control"
        conditions.append(normal_cone(label, f"{what} multiplier in the normal cone", signal, normal, tube, level))
    return tuple(conditions)


def non_negativity(lift: Lift) -> Condition:
    """C-i: eta_C is 0 or 1."""
    eta_C = lift.multipliers.eta_C
    return Condition("C-i", "eta_C is 0 or 1", min(abs(eta_C), abs(eta_C - 1)), 1.0, 0.0)


def non_triviality(lift: Lift) -> Condition:
    """C-ii: eta_C, the adjoint and the frequency multipliers are not all zero."""
    multipliers = lift.multipliers
    parts = [np.array([multipliers.eta_C]), multipliers.eta, multipliers.rho_u, multipliers.rho_x]
    trivial = not any(np.any(part) for part in parts)
    return Condition("C-ii", "multipliers not all zero", float(trivial), 1.0, 0.0)


def state_equation(lift: Lift) -> Condition:
    """C-iii: x_{t+1} = f_t(x_t, u_t)."""
    x, u = np.abs(lift.trajectory.x), np.abs(lift.trajectory.u)
    terms = x[1:] + lift.problem.dynamics.magnitudes().successors(x, u)
    residual = np.abs(one_step_residual(lift.problem, lift.trajectory))
    return _worst("C-iii", "state equation", residual, _scales(terms))


def adjoint_and_transversality(lift: Lift) -> list[Condition]:
    """C-iii: eta_{t-1} = D_x H_t - mu_t, 0 < t < T; C-iv: D_x H_0 = mu_0, eta_{T-1} = -eta_C D c_T - ... - mu_T."""
    before, mu = lift.eta_before, lift.multipliers.mu
    residual = np.abs(before - lift.in_x + mu)
    scales = _scales(np.abs(before) + lift.in_x_terms + np.abs(mu))
    last = len(residual) - 1
    conditions = [_worst("C-iii", "adjoint equation", residual[1:-1], scales, first=1)] if last > 1 else []
    conditions.append(_worst("C-iv", "transversality at 0", residual[:1], scales))
    conditions.append(_worst("C-iv", "transversality at T", residual[-1:], scales, first=last))
    return conditions


def stationarity_in_u(lift: Lift) -> Condition:
    """C-v, to first order: D_u H_t = nu_t (and nu_t in N_U(u_t), which is N-u)."""
    nu = lift.multipliers.nu
    residual = np.abs(lift.in_u - nu)
    return _worst("C-v", "Hamiltonian stationary in u", residual, _scales(lift.in_u_terms + np.abs(nu)))


def hamiltonian_maximum(lift: Lift) -> list[Condition]:
    """C-v, where H is concave in u: max over U_t of H_t exceeds H_t(u_t) by 0 (paper, corollary for linear systems).

    The excess is computed exactly for a diagonal Hessian and bounded from above otherwise. Components that are
    unbounded and uncurved are left to the first-order condition: there the maximum is infinite or attained everywhere.
    """
    problem, u = lift.problem, lift.trajectory.u
    curvature = diagonal_curvature(lift.multipliers.eta_C * problem.cost.R)
    if curvature is None:
        return []
    tube = problem.control_tube
    bounded = (np.isfinite(tube.lower) & np.isfinite(tube.upper)) | (curvature > 0)
    slope = np.where(bounded, -lift.in_u, 0.0)
    excess = -box_minimum(slope, curvature, tube.lower - u, tube.upper - u)
    excess = np.maximum(excess, 0.0)  # u_t a rounding error outside U_t can exceed the maximum over it
    level = abs(problem.cost.value(lift.trajectory.x, u))
    terms = (lift.in_u_terms * np.abs(u)).sum(1)
    scale = max(level, float(terms.max()))
    t, component = _argmax(excess)
    return [
        Condition(
            "C-v", "Hamiltonian maximal in u", float(excess.sum(1).max()), scale, CONDITION_TOLERANCE, t, component
        )
    ]


def felt(lift: Lift) -> Array:
    """Return the size of a control that the states would notice, (m,): |B| times it is SCALE_FLOOR of their size."""
    effect = np.abs(lift.problem.dynamics.B).reshape(-1, lift.problem.state_dim, lift.problem.control_dim).max(0)
    states = np.abs(lift.trajectory.x).max(0)[:, None]
    sizes = np.divide(states, effect, out=np.full_like(effect, np.inf), where=effect > 0).min(0)
    return np.where(np.isfinite(sizes), SCALE_FLOOR * sizes, 0.0)


def frequency(label: str, name: str, signal: Array, stopped: Mask, least: Array | float = 0.0) -> Condition:
    """C-vi, C-vii: the removed bins are zero; compared with the root mean square over all bins of the component.

    A signal smaller than ``least`` is measured as if it had that size.
    """
    magnitude = np.where(stopped, np.abs(np.fft.rfft(signal, axis=0)), 0.0)
    scales = np.maximum(np.linalg.norm(signal, axis=0), np.sqrt(len(signal)) * least)
    return _worst(label, name, magnitude, _floored(scales))


def membership(label: str, name: str, signal: Array, tube: Box) -> Condition:
    """S-x, S-u: distance outside the set; compared with the largest bound and value of the component."""
    bounds = [np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (tube.lower, tube.upper)]
    return _worst(label, name, tube.violation(signal), _scales(np.maximum(np.abs(signal), np.maximum(*bounds))))


def normal_cone(label: str, name: str, signal: Array, normal: Array, tube: Box, level: float) -> Condition:
    """N-x, N-u: sigma(mu_t) - <mu_t, x_t> = 0; compared with the largest <|mu_t|, |x_t|>, or the cost.

    A multiplier against a bound that does not exist would give infinity; it counts as if that bound were as far away
    as the component is large.
    """
    reach = _floored(np.abs(signal).max(0))
    gap = np.abs(tube.normal_gap_terms(signal, normal))
    gap = np.where(np.isfinite(gap), gap, np.abs(normal) * reach)
    scale = max(level, float((np.abs(normal) * np.abs(signal)).sum(1).max()))
    t, component = _argmax(gap)
    return Condition(label, name, float(gap[t, component]), scale, CONDITION_TOLERANCE, t, component)


def _scales(terms: Array) -> Array:
    """Return one scale per component: the largest over time of the sum of the absolute values of its terms."""
    return _floored(terms.max(0))


def _floored(scales: Array) -> Array:
    return np.maximum(scales, max(SCALE_FLOOR * scales.max(initial=0.0), ZERO_SCALE))


def _worst(label: str, name: str, residual: Array, scales: Array, first: int = 0) -> Condition:
    """Return the condition at its worst entry relative to its component's scale; residual (times, components)."""
    relative = np.divide(residual, scales, out=np.zeros_like(residual), where=scales > 0)
    t, component = _argmax(relative)
    return Condition(
        label, name, float(residual[t, component]), float(scales[component]), CONDITION_TOLERANCE, first + t, component
    )


def _argmax(values: Array) -> Sequence[int]:
    return tuple(int(i) for i in np.unravel_index(np.argmax(values), values.shape))
