"""The matrices of a problem (Structure), and its ends, linear terms, offsets and bounds (Data).

Together they determine the optimal point for given bordering unknowns and forces, its residual in the equations, and
Farkas rays of infeasible data (docs/spectral.md, 1 to 5 and 10).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.kkt import BorderedSystem
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.spectral.qp import bounded_qp
from lin_freq_ocp.methods.spectral.rows import MOST_VALUES, Violations, WholeHorizon, WorkingSet
from lin_freq_ocp.methods.spectral.spaces import BinSpaces, CirculantKernels

TEMPORARIES = 2.0  # memory at the peak over that of the arrays that are kept; 1.9 was measured


class Structure:
    """Null spaces, kernels and bordered KKT system of a problem.

    They depend on A, B, M, F, the bands, and the choice of free components at the ends.

    ``diagonal_bound`` (rows of F,) is 1/R for control rows and 0 for others if diag(1/R) - S >= 0: R is diagonal, and
    the cost has no products of states and controls.
    """

    def __init__(self, lti: Lti):
        # spectra, kernels and signals must fit into memory (docs/spectral.md, Memory)
        dimension, rows, n = len(lti.M), len(lti.F), lti.state_dim
        free = int(np.isnan(lti.start).sum() + np.isnan(lti.end).sum())
        spectra = 8 * dimension * lti.control_dim + 12 + 48 * dimension + 16 * dimension * free
        in_time = 4 * rows * (rows + 1) + 9 * rows + 2 * rows
        require_memory(
            f"method 'spectral' with horizon = {lti.horizon}, {n} states and {lti.control_dim} controls",
            TEMPORARIES * (spectra + in_time) * lti.horizon,
            "Choose a shorter horizon or a longer sampling time.",
        )
        bands = 2.0 * lti.state_stop.sum()
        require_memory(
            f"the state bands, {bands:.0f} dense rows with their responses,",
            16 * (dimension + 2) * bands * lti.horizon,
            "Stop bands of controls need no dense rows; else choose a shorter horizon.",
        )
        self.spaces = BinSpaces(lti)
        self.kernels = CirculantKernels(lti, self.spaces)
        self.kkt = BorderedSystem(lti, self.spaces, self.kernels)
        R = lti.M[n:, n:]
        self.diagonal_bound: Array | None = None
        if not lti.M[:n, n:].any() and np.array_equal(R, np.diag(np.diagonal(R))) and np.diagonal(R).all():
            self.diagonal_bound = np.zeros(len(lti.F))
            self.diagonal_bound[n:dimension] = 1 / np.diagonal(R)
        self._whole: WholeHorizon | None = None

    def whole_horizon(self, rows: Indices) -> WholeHorizon | None:
        """Return the responses of all values of the rows of F.

        None if these are many, an unknown is compliant, or the ends are periodic.
        """
        T, closed = self.kkt.lti.horizon, self.kkt.lti.periodic
        if closed or self.kkt.compliant or not self.kernels.complete or not len(rows) or len(rows) * T > MOST_VALUES:
            return None
        if self._whole is None or not np.array_equal(self._whole.rows, rows):
            self._whole = WholeHorizon(self.kkt, rows)
        return self._whole


@dataclass(frozen=True, eq=False)
class Data:
    """The quantities that depend on ends, linear terms, offsets and bounds."""

    lti: Lti
    base: ComplexArray  # spectrum of y without forces and bordering unknowns, (n+m, bins)
    linear: ComplexArray | None  # spectrum of h, (n+m, bins)
    h: Array  # gradient in theta at 0, (size,)
    e: Array  # right-hand sides of the equations, (equations,)


def data_of(structure: Structure, lti: Lti) -> Data:
    """Return the data of ``lti``, whose structure must be the given one."""
    spaces, kkt = structure.spaces, structure.kkt
    start, end = lti.ends
    jump: ComplexArray = spaces.z * (start - end)[:, None]
    if lti.offset is not None:
        jump += np.fft.rfft(lti.offset)
    linear = None if lti.linear is None else np.fft.rfft(lti.linear)
    base = spaces.particular(jump[:, None])[:, 0]
    h = kkt.gradient(lti.M @ base + (0 if linear is None else linear))
    h[kkt.at_end] += (lti.P @ end + lti.p)[kkt.free_end]
    if linear is not None:
        base -= spaces.project(linear[:, None])[:, 0]
    return Data(lti, base, linear, h, kkt.right_hand_side(lti, jump))


@dataclass(frozen=True, eq=False)
class Signals:
    """A point: it satisfies the dynamics and the control bands to rounding."""

    y: Array  # (x_t, u_t), (n+m, T)
    last: Array  # x_T


def signals(
    structure: Structure, data: Data, theta: Array, multipliers: Array, working: WorkingSet
) -> tuple[Signals, ComplexArray]:
    """Return the optimum over all bins for given bordering unknowns and forces, and the spectrum of y, (n+m, bins).

    y_k = base_k - N_k N_k^* (G'l + E'zeta)_k + (responses to theta): docs/spectral.md, (3).
    """
    lti, spaces, kkt = data.lti, structure.spaces, structure.kkt
    spectrum = data.base.copy()
    if len(working) or multipliers.any():
        spaces.respond(*forces(structure, lti, multipliers, working), spectrum)
    kkt.add(theta[:, None], spectrum[:, None])
    y, last = np.fft.irfft(spectrum, lti.horizon), lti.end.copy()
    if lti.periodic:
        last[:] = y[: lti.state_dim, 0]
    last[kkt.free_end] = theta[kkt.at_end]
    return Signals(y, last), spectrum


def forces(structure: Structure, lti: Lti, multipliers: Array, working: WorkingSet) -> tuple[ComplexArray, Mask]:
    """Return the spectrum of G'l + E'zeta, zeta the ``multipliers`` of the equations, and the mask of components."""
    kkt, dimension = structure.kkt, len(lti.M)
    pulses = np.zeros((len(lti.F), lti.horizon))
    inner = working.inner
    np.add.at(pulses, (working.f[inner], working.t[inner]), (working.sign * working.weights)[inner])
    np.add.at(pulses, (kkt.point_f, kkt.point_t), multipliers[: len(kkt.point_t)])
    force, joint = np.split(pulses, [dimension])
    if joint.any():
        force += lti.F[dimension:].T @ joint
    used: Mask = np.asarray(force.any(1))
    spectrum = np.zeros((dimension, len(structure.spaces.z)), dtype=np.complex128)
    if used.any():
        spectrum[used] = np.fft.rfft(force if used.all() else force[used])
    if len(kkt.bands):
        on_bands = multipliers[-len(kkt.bands) :]
        for i in kkt.band_components:
            of_component = kkt.band_component == i
            spectrum[i] += on_bands[of_component] @ kkt.band_hat[of_component]
            used[i] = True
    return spectrum, used


def equation_residual(structure: Structure, data: Data, theta: Array, at: Signals) -> Array:
    """Return e - E(x, theta), measured on the signals where possible."""
    kkt, points = structure.kkt, len(structure.kkt.point_t)
    residual = data.e - kkt.E @ theta
    residual[:points] = data.e[:points] - at.y[kkt.point_f, kkt.point_t]
    residual[kkt.free_start] += theta[kkt.at_start]
    if len(kkt.bands):
        before_end = np.einsum("dt,dt->d", kkt.bands[:, :-1], at.y[kkt.band_component])
        residual[-len(kkt.bands) :] = -before_end - kkt.bands[:, -1] * at.last[kkt.band_component]
    return residual


def _point_without_forces(structure: Structure, data: Data) -> tuple[Signals, Array]:
    """Return the point c without forces, and the residual of the equations there."""
    theta = np.zeros(structure.kkt.size)
    c, _ = signals(structure, data, theta, np.zeros(len(data.e)), WorkingSet(structure.kkt))
    return c, equation_residual(structure, data, theta, c)


def unconstrained_point(
    structure: Structure, data: Data, violations: Violations, whole: WholeHorizon
) -> tuple[Array, Array]:
    """Return the point without working rows: the step of (theta, zeta), to the accuracy of K_b, and bounded values."""
    at, residual = _point_without_forces(structure, data)
    step = structure.kkt.inverse @ np.concatenate([-data.h, residual])
    return step, np.append(violations.values(at.y), at.last) + step @ whole.coupling


@dataclass(frozen=True, eq=False)
class Ray:
    """A Farkas ray, verified within this method: weights l of the working rows, and multipliers zeta of the equations.

    A ray (l >= 0, zeta), with l = 0 on soft rows, proves infeasibility if the forces G'l + E'zeta move nothing
    (N^* ghat = 0, and no slope in theta) and the weighted sum of the constraints cannot hold: at any point c that
    satisfies the dynamics, l'(limit - G c) + zeta'(e - E c) < 0.
    """

    working: WorkingSet
    multipliers: Array


def verified_ray(
    structure: Structure, data: Data, working: WorkingSet, zeta: Array, tolerance: float = tol.RAY_TOLERANCE
) -> Ray | None:
    """Return the ray if it is stationary to a tolerance and proves that these data are infeasible, else None."""
    kkt, lti = structure.kkt, data.lti
    force, _ = forces(structure, lti, zeta, working)
    size = float(working.weights @ np.abs(lti.F[working.f]).sum(1) + np.abs(zeta).sum()) + 1e-300
    response = sum(np.conj(structure.spaces.N[i]) * force[i] for i in range(len(lti.M)))
    stationarity = float(np.abs(response).max()) / (
        max(float(np.abs(structure.spaces.N).max()), tol.TINY_SQUARED) * size
    )
    slope = np.abs(kkt.E.T @ zeta + working.coupling[: kkt.size] @ working.weights).max(initial=0.0)
    stationarity = max(stationarity, float(slope) / size)
    c, residual = _point_without_forces(structure, data)
    value = float(working.weights @ working.slacks(lti, c.y, c.last) + zeta @ residual)
    terms = float(working.weights @ np.abs(working.limits(lti)) + np.abs(zeta) @ np.abs(data.e)) + 1e-300
    proven = stationarity < tolerance * min(1.0, -tol.RAY_VALUE * value / terms)
    return Ray(working, zeta) if proven else None


def equation_ray(structure: Structure, data: Data, residual: Array) -> Ray | None:
    """Return a ray of the dependent equations."""
    dependent = structure.kkt.dependent
    zeta = -dependent @ (dependent.T @ residual)
    largest = float(np.abs(zeta).max(initial=0.0))
    return None if largest == 0 else verified_ray(structure, data, WorkingSet(structure.kkt), zeta / largest)


def row_ray(
    structure: Structure,
    data: Data,
    working: WorkingSet,
    S: Array,
    d: Array,
    Z: Array,
    combine: bool,
    tolerance: float,
    stop: Callable[[], str | None],
) -> Ray | None:
    """Return a ray of working rows: a row that the equations decide, or (``combine``) a combination of many.

    The homogeneous dual min 1/2 l'S l + d'l + rho/2 (d'l)^2 is bounded; tau = 1 + rho d'l vanishes where rows conflict.
    """
    hard, free = np.isinf(working.prices(data.lti)), working.free_response()
    violated = d < -tol.DECIDED_VIOLATION * (1 + np.abs(working.limits(data.lti)))
    decided = hard & violated & (np.diagonal(S) < tol.DECIDED_RESPONSE * free)
    weights = np.zeros(len(d))
    if decided.any():
        weights[np.argmin(np.where(decided, d, np.inf))] = 1.0
    elif combine and hard.any():
        S, b = S[np.ix_(hard, hard)], d[hard]
        size = np.abs(b) / np.sqrt(np.maximum(np.diagonal(S), tol.TINY_SQUARED))
        rho = max(float(size.max()), tol.TINY_SQUARED) ** -2
        weights[hard], _ = bounded_qp(S + rho * np.outer(b, b), b, np.zeros(len(b)), stop=stop)
        if not weights.any() or 1 + rho * float(d @ weights) >= tol.CONFLICT_TAU:
            return None
    else:
        return None
    weights /= weights.max()
    zeta = -(Z @ weights)[structure.kkt.size :]
    return verified_ray(structure, data, working.weighted(weights), zeta, tolerance)


def regularised_ray(
    structure: Structure, data: Data, working: WorkingSet, tolerance: float, stop: Callable[[], str | None]
) -> Ray | None:
    """Return a ray of working rows from a unit Hessian of the bordering unknowns.

    Feasibility does not depend on the cost.
    """
    kkt, (c, residual) = structure.kkt, _point_without_forces(structure, data)
    step = kkt.regularised @ np.concatenate([np.zeros(kkt.size), residual])
    Z, S = working.eliminated(kkt.regularised)
    d = working.slacks(data.lti, c.y, c.last) - working.coupling.T @ step
    return row_ray(structure, data, working, S, d, Z, True, tolerance, stop)
