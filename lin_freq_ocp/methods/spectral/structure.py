"""The matrices of a problem (Structure), and its ends, linear terms, offsets and bounds (Data).

Data return the signals that are optimal for given theta, zeta and weights, and their residual in the equations
(docs/spectral.md, 2 to 5). From the same forces follow Farkas rays, which prove that data are infeasible (10). A first
reader may skip the estimates of memory, and stop after Data and ``eliminate``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.methods.spectral.kkt import BorderedSystem
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.spectral.qp import RowQp, Stop, bounded_qp
from lin_freq_ocp.methods.spectral.rows import Rows, WorkingSet
from lin_freq_ocp.methods.spectral.spaces import BinSpaces, CirculantKernels

TEMPORARIES = 2.0  # memory at the peak over that of the arrays that are kept; 1.9 was measured
RAY_TOLERANCE = 1e-6  # stationarity of a ray, relative to its multipliers
RAY_VALUE = 100.0  # times that, its least value: less may be rounding
DECIDED_RESPONSE = 1e-11  # part of a row's own response left by the equations below which they alone decide the row
DECIDED_VIOLATION = 1e-8  # violation, relative to the bound, of a row that the equations decide
CONFLICT_TAU = 1e-4  # tau of the homogeneous dual (1: rows are consistent, 0: they conflict) below which they conflict
MOST_VALUES = 10_000  # bounded values up to which the effect of bordering unknowns on all of them is computed at once
TINY_SQUARED = 1e-150  # keeps the scale of a violation of exactly zero finite when squared


class Structure:
    """Null spaces, kernels and bordered KKT system of a problem.

    They depend on A, B, M, F, the bands, and the choice of free components at the ends.
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
class Signals:
    """A trajectory that satisfies the dynamics and the control bands to rounding."""

    y: Array  # (x_t, u_t), (n+m, T)
    last: Array  # x_T
    spectrum: ComplexArray  # of y, (n+m, bins)


class Data:
    """One solve's ends, linear terms, offsets and bounds: those of ``lti``, whose structure must be the given one.

    ``base`` (n+m, bins) is c_k = D_k^+ (z w + d_k) - N_k N_k^* h_k, the spectrum of y without forces and theta;
    ``linear`` is that of h_t, ``h_theta`` (size,) the gradient of the cost in theta at 0, and ``e`` (equations,) the
    right-hand sides of the equations. Free components of the ends count as 0 in the jump w: they are part of theta.
    """

    def __init__(self, structure: Structure, lti: Lti):
        self.structure, self.lti = structure, lti
        spaces, kkt = structure.spaces, structure.kkt
        start, end = lti.ends
        jump: ComplexArray = spaces.z * (start - end)[:, None]
        if lti.offset is not None:
            jump += np.fft.rfft(lti.offset)
        self.linear = None if lti.linear is None else np.fft.rfft(lti.linear)
        self.base = spaces.particular(jump[:, None])[:, 0]
        # responses to theta are M-orthogonal to N: the part of c_k along N, which follows, does not change h_theta
        self.h_theta = kkt.unknowns.gradient(lti.M @ self.base + (0 if self.linear is None else self.linear))
        self.h_theta[kkt.unknowns.at_end] += (lti.P @ end + lti.p)[kkt.unknowns.free_end]
        if self.linear is not None:
            self.base -= spaces.project(self.linear[:, None])[:, 0]
        self.e = kkt.right_hand_side(lti, jump)

    def signals(self, theta: Array, zeta: Array, working: WorkingSet) -> Signals:
        """Return the optimum over all bins for given theta, and forces of equations and working rows.

        y_k = c_k - N_k N_k^* (G'l + E_y'zeta)_k + Y_k theta: docs/spectral.md, (3).
        """
        lti, kkt, spectrum = self.lti, self.structure.kkt, self.base.copy()
        if len(working) or zeta.any():
            self.structure.spaces.respond(*self.forces(zeta, working), spectrum)
        kkt.unknowns.add(theta, spectrum)
        y, last = np.fft.irfft(spectrum, lti.horizon), lti.end.copy()
        if lti.periodic:
            last[:] = y[: lti.state_dim, 0]
        last[kkt.unknowns.free_end] = theta[kkt.unknowns.at_end]
        return Signals(y, last, spectrum)

    def forces(self, zeta: Array, working: WorkingSet) -> tuple[ComplexArray, Mask]:
        """Return the spectrum g_k of G'l + E_y'zeta, (n+m, bins), and the mask of its components that are not zero."""
        lti, kkt, dimension = self.lti, self.structure.kkt, len(self.lti.M)
        pulses = np.zeros((len(lti.F), lti.horizon))
        inner = working.inner
        np.add.at(pulses, (working.f[inner], working.t[inner]), (working.sign * working.weights)[inner])
        np.add.at(pulses, (kkt.point_f, kkt.point_t), zeta[: len(kkt.point_t)])
        force, joint = np.split(pulses, [dimension])
        if joint.any():
            force += lti.F[dimension:].T @ joint
        used: Mask = np.asarray(force.any(1))
        spectrum = np.zeros((dimension, len(self.structure.spaces.z)), dtype=np.complex128)
        if used.any():
            spectrum[used] = np.fft.rfft(force if used.all() else force[used])
        if len(kkt.bands):
            on_bands = zeta[-len(kkt.bands) :]
            for i in kkt.band_components:
                of_component = kkt.band_component == i
                spectrum[i] += on_bands[of_component] @ kkt.band_hat[of_component]
                used[i] = True
        return spectrum, used

    def residual(self, theta: Array, at: Signals) -> Array:
        """Return e - E_y y - E_theta theta, measured on the signals where possible."""
        kkt, points = self.structure.kkt, len(self.structure.kkt.point_t)
        residual = self.e - kkt.E @ theta
        residual[:points] = self.e[:points] - at.y[kkt.point_f, kkt.point_t]
        residual[kkt.unknowns.free_start] += theta[kkt.unknowns.at_start]
        if len(kkt.bands):
            before_end = np.einsum("dt,dt->d", kkt.bands[:, :-1], at.y[kkt.band_component])
            residual[-len(kkt.bands) :] = -before_end - kkt.bands[:, -1] * at.last[kkt.band_component]
        return residual

    def without_forces(self) -> tuple[Signals, Array]:
        """Return the trajectory c with theta = 0 and without forces, and its residual."""
        kkt, theta = self.structure.kkt, np.zeros(self.structure.kkt.size)
        c = self.signals(theta, np.zeros(len(self.e)), WorkingSet(kkt, self.lti))
        return c, self.residual(theta, c)


@dataclass(frozen=True, eq=False)
class Ray:
    """A Farkas ray, verified within this method: weights l of the working rows, and multipliers zeta of the equations.

    A ray (l >= 0, zeta), with l = 0 on soft rows, proves infeasibility if its forces g = G'l + E_y'zeta move nothing,

        N_k^* g_k = 0 at all bins,    E'zeta + (G Y)'l = 0 (no slope in theta),

    and the weighted sum of the constraints cannot hold: with the slacks of the rows and the residual of the equations
    at the signals c without forces,

        l'(limit - G c) + zeta'(e - E_y c) < 0.
    """

    working: WorkingSet
    zeta: Array


def verified_ray(data: Data, working: WorkingSet, zeta: Array, tolerance: float = RAY_TOLERANCE) -> Ray | None:
    """Return the ray if it is stationary to a tolerance and proves that these data are infeasible, else None."""
    kkt, F, N = data.structure.kkt, data.lti.F, data.structure.spaces.N
    force, _ = data.forces(zeta, working)
    size = float(working.weights @ np.abs(F[working.f]).sum(1) + np.abs(zeta).sum()) + 1e-300
    response = sum(np.conj(N[i]) * force[i] for i in range(len(N)))
    stationarity = float(np.abs(response).max()) / (max(float(np.abs(N).max()), TINY_SQUARED) * size)
    slope = np.abs(kkt.E.T @ zeta + working.coupling[: kkt.size] @ working.weights).max(initial=0.0)
    stationarity = max(stationarity, float(slope) / size)
    c, residual = data.without_forces()
    value = float(working.weights @ working.slacks(c.y, c.last) + zeta @ residual)
    terms = float(working.weights @ np.abs(working.limits) + np.abs(zeta) @ np.abs(data.e)) + 1e-300
    proven = stationarity < tolerance * min(1.0, -RAY_VALUE * value / terms)
    return Ray(working, zeta) if proven else None


def equation_ray(data: Data, residual: Array) -> Ray | None:
    """Return a ray of the dependent equations."""
    kkt = data.structure.kkt
    zeta = -kkt.dependent @ (kkt.dependent.T @ residual)
    largest = float(np.abs(zeta).max(initial=0.0))
    return None if largest == 0 else verified_ray(data, WorkingSet(kkt, data.lti), zeta / largest)


class EliminatedQp(NamedTuple):
    """The small QP of the working rows, with theta and zeta eliminated: docs/spectral.md, (4)."""

    step: Array  # K^{-1} defects, that of theta and zeta for unchanged weights
    through: Array  # K^{-1} C
    rows: RowQp


def eliminate(working: WorkingSet, inverse: Array, defects: Array, slack: Array, weights: Array) -> EliminatedQp:
    """Return the small QP for an inverse of K, and the defects and slacks that these weights leave."""
    gram = working.gram  # first: it refuses rows that do not fit into memory
    step, through = inverse @ defects, inverse @ working.coupling
    half = working.coupling.T @ (through / 2)
    S = half + half.T  # exactly symmetric: else the QP stalls at rounding
    S += gram
    delta = slack - working.coupling.T @ step - S @ weights
    diagonal_bound = working.lti.diagonal_bound[working.f] * working.inner
    response = working.kkt.kernels.free_response(working.t, working.f)
    return EliminatedQp(step, through, RowQp(S, delta, working.prices, diagonal_bound, response))


def row_ray(
    data: Data, working: WorkingSet, eliminated: EliminatedQp, combine: bool, tolerance: float, stop: Stop
) -> Ray | None:
    """Return a ray of working rows: a row that the equations decide, or (``combine``) a combination of many.

    The homogeneous form min 1/2 l'S l + delta'l + squared/2 (delta'l)^2 of the small QP is bounded;
    tau = 1 + squared delta'l vanishes where rows conflict.
    """
    S, delta, prices, _, response = eliminated.rows
    hard, violated = np.isinf(prices), delta < -DECIDED_VIOLATION * (1 + np.abs(working.limits))
    decided = hard & violated & (np.diagonal(S) < DECIDED_RESPONSE * response)
    weights = np.zeros(len(delta))
    if decided.any():
        weights[np.argmin(np.where(decided, delta, np.inf))] = 1.0
    elif combine and hard.any():
        S, on_hard = S[np.ix_(hard, hard)], delta[hard]
        size = np.abs(on_hard) / np.sqrt(np.maximum(np.diagonal(S), TINY_SQUARED))
        squared = max(float(size.max()), TINY_SQUARED) ** -2
        none, free = np.zeros(len(on_hard)), np.full(len(on_hard), np.inf)
        homogeneous = RowQp(S + squared * np.outer(on_hard, on_hard), on_hard, free, none, none)
        weights[hard], _ = bounded_qp(homogeneous, none, stop)
        if not weights.any() or 1 + squared * float(delta @ weights) >= CONFLICT_TAU:
            return None
    else:
        return None
    weights /= weights.max()
    zeta = -(eliminated.through @ weights)[data.structure.kkt.size :]
    return verified_ray(data, working.weighted(weights), zeta, tolerance)


def regularised_ray(data: Data, working: WorkingSet, tolerance: float, stop: Stop) -> Ray | None:
    """Return a ray of working rows from a unit Hessian of the bordering unknowns.

    Feasibility does not depend on the cost.
    """
    kkt, (c, residual) = data.structure.kkt, data.without_forces()
    defects, slack = np.concatenate([np.zeros(kkt.size), residual]), working.slacks(c.y, c.last)
    eliminated = eliminate(working, kkt.regularised, defects, slack, np.zeros(len(slack)))
    return row_ray(data, working, eliminated, True, tolerance, stop)


class WholeHorizon:
    """All bounded values under one flat index: the bounded ``rows`` of F at all t < T, then the components of x_T.

    ``coupling`` (size + equations, values) and ``free_response`` (values,) are as in WorkingSet, ``through`` is
    K^{-1} C.
    """

    def __init__(self, kkt: BorderedSystem, rows: Indices):
        lti, T, n = kkt.lti, kkt.lti.horizon, kkt.lti.state_dim
        self.kernels, self.rows, self._inner = kkt.kernels, rows, len(rows) * T
        self.t = np.concatenate([np.arange(self._inner) % T, np.full(n, T)])
        self.f = np.concatenate([np.repeat(rows, T), np.arange(n)])
        self._row_index = np.zeros(len(lti.F), dtype=np.intp)
        self._row_index[rows] = np.arange(len(rows))
        self.coupling = np.zeros((len(kkt.matrix), len(self.t)))
        self.coupling[:, : self._inner] = kkt.coupling_at_all_times(rows).reshape(-1, self._inner)
        self.coupling[kkt.unknowns.at_end, self._inner + kkt.unknowns.free_end] = 1.0
        self.through = kkt.inverse @ self.coupling
        self.free_response = kkt.kernels.free_response(self.t, self.f)
        self._spaces = kkt.kernels.of_rows(rows)

    def flat_indices(self, t: Indices, f: Indices) -> Indices:
        """Return the flat indices of rows f at times t; at t = T, of component f of x_T."""
        T = self.kernels.lti.horizon
        return np.where(t < T, self._row_index[f] * T + t, self._inner + f)

    def distinct(self, rows: Rows) -> tuple[Indices, Array, Array]:
        """Return the flat indices of rows, each once, with signs and weights."""
        index, once = np.unique(self.flat_indices(rows.t, rows.f), return_index=True)
        return index, rows.sign[once], np.zeros(len(index)) if rows.weights is None else rows.weights[once]

    def gram(self, index: Indices) -> Array:
        """Return S of some values."""
        S = self.coupling[:, index].T @ self.through[:, index]
        return (S + S.T) / 2 + self.kernels.gram_of_rows(self.t[index], self.f[index])

    def response(self, index: Indices, mu: Array) -> Array:
        """Return S mu of all values, for multipliers mu of the values ``index``."""
        pulses = np.zeros(len(self.t))
        pulses[index] = mu
        pulses = pulses[: self._inner].reshape(len(self.rows), -1)
        acting = pulses.any(1)
        answer = (self._spaces[acting].conj() * np.fft.rfft(pulses[acting])[:, None]).sum(0)
        values = (self.through[:, index] @ mu) @ self.coupling
        values[: self._inner] += np.fft.irfft((self._spaces * answer).sum(1), self.kernels.lti.horizon).ravel()
        return values
