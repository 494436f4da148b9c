"""The multipliers of the maximum principle from the final spectra, and their residuals (docs/spectral.md, 8 and 9).

With the spectrum p_k of M y + h + forces, the adjoint is eta_k = -(zI - A)^{-*} p_k at every bin. Near eigenvalues, its
part along small singular values is the multiplier of the compatibility equation of that bin. A recursion would multiply
rounding errors by the growth of the dynamics, 3e46 for the pendulum sampled at 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, seal
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.exchange import ExchangeOutcome
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.reductions import SoftBounds, soft_sets
from lin_freq_ocp.methods.spectral.spaces import bin_weights
from lin_freq_ocp.methods.spectral.structure import Data, Structure, forces
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.linked_ends import Periodic
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Residuals
from lin_freq_ocp.program.program_rows import bin_multipliers


def trajectory(outcome: ExchangeOutcome, units: LtiUnits) -> Trajectory:
    """Return the point in the user's units."""
    n, at = len(units.x), outcome.signals
    x = np.empty((at.y.shape[1] + 1, n))
    np.multiply(at.y[:n].T, units.x, out=x[:-1])
    x[-1] = at.last * units.x
    return Trajectory(seal(x), seal(at.y[n:].T * units.u))


@dataclass(frozen=True, eq=False)
class LtiMultipliers:
    """Multipliers in the units of the Lti problem, time or bins last."""

    eta_C: float
    eta: Array  # (n, T)
    on_rows: Array  # of F y_t, (rows, T+1): mu of states, nu of controls, those of stage rows; at T of x_T
    band: ComplexArray  # spectrum of the stop bands' forces R'rho_u, (m, bins); zero at passed bins
    stationarity: float  # stationarity residual: largest amplitude of B'eta - (gradient in u) at passed bins
    rho_x: ComplexArray  # ((T+1)//2 + 1, n)


def recover(structure: Structure, data: Data, outcome: ExchangeOutcome, spectrum: ComplexArray) -> LtiMultipliers:
    """Return the multipliers of an outcome with the spectrum of y; of its ray (eta_C = 0) if it has one."""
    lti, ray, kkt, spaces, at = data.lti, outcome.ray, structure.kkt, structure.spaces, outcome.signals
    working, y = (outcome.working, outcome.multipliers) if ray is None else (ray.working, ray.multipliers)
    n, near, eta_C = lti.state_dim, spaces.near, float(ray is None)
    gradient, _ = forces(structure, lti, y, working)  # of the Lagrangian in (x, u)
    if ray is None:
        gradient += lti.M @ spectrum
        if data.linear is not None:
            gradient += data.linear
    on_rows, fixed = np.zeros((len(lti.F), lti.horizon + 1)), slice(lti.start_points, len(kkt.point_t))
    np.add.at(on_rows, (working.f, working.t), working.sign * working.weights)
    np.add.at(on_rows, (kkt.point_f[fixed], kkt.point_t[fixed]), y[fixed])
    with np.errstate(all="ignore"):
        eta_hat = -spaces.resolvent.apply_adjoint(spaces.z, gradient[:n, None])[:, 0]
    eta_hat[:, near.k] = -near.adjoint(gradient[:, None, near.k])[:, 0]
    row = len(kkt.point_t)
    for scale, equation in zip(kkt.compatibility_scale, spaces.compatibility, strict=True):
        weight = int(spaces.weight[equation.k])
        value = y[row] if weight == 1 else y[row] + 1j * y[row + 1]
        eta_hat[:, equation.k] += equation.left * (scale * lti.horizon / weight * value)
        row += weight
    if lti.response is None:
        through_controls = lti.B.T @ eta_hat
    else:
        through_controls = np.einsum("imk,ik->mk", lti.response.conj(), eta_hat)
    band = through_controls - gradient[n:]
    at_passed = np.where(lti.passed, band, 0.0)
    band -= at_passed
    eta = fft.irfft(eta_hat, lti.horizon)
    # mu_0, mu_T of fixed ends follow from transversality: any vector is normal there
    joint, on_bands = slice(len(lti.M), None), y[len(y) - len(kkt.bands) :]
    at_start = lti.F[joint, :n].T @ on_rows[joint, 0] - lti.A.T @ eta[:, 0]
    at_end = np.array(eta[:, -1])
    for component, row, weight in zip(kkt.band_component, kkt.bands, on_bands, strict=True):
        at_start[component] += weight * row[0]
        at_end[component] += weight * row[-1]
    if ray is None:
        at_start += lti.M[:n] @ at.y[:, 0] + (0.0 if lti.linear is None else lti.linear[:n, 0])
        at_end += lti.P @ at.last + lti.p
    fixed_start, fixed_end = np.flatnonzero(~np.isnan(lti.start)), np.flatnonzero(~np.isnan(lti.end))
    on_rows[fixed_start, 0] = -at_start[fixed_start]
    on_rows[fixed_end, -1] = -at_end[fixed_end]
    rho_x = np.zeros(lti.state_stop.shape, dtype=np.complex128)
    for i in kkt.band_components:
        rho_x[:, i] = bin_multipliers(lti.state_samples, lti.state_stop[:, i], on_bands[kkt.band_component == i])
    return LtiMultipliers(eta_C, eta, on_rows, band, _largest(at_passed) / lti.horizon, rho_x)


def residuals(lti: Lti, outcome: ExchangeOutcome, multipliers: LtiMultipliers) -> Residuals:
    """Return the residuals of the maximum principle, each relative to the size of its own terms.

    primal: dynamics, ends, bands, bounds. dual: adjoint equation, transversality, stationarity in u. gap: multipliers
    times slacks, and dual residuals times the trajectory.
    """
    y, last, n = outcome.signals.y, outcome.signals.last, lti.state_dim
    band = 0.0 if lti.passed.all() else float(np.abs(fft.rfft(y[n:])[~lti.passed]).max())
    energy = max(float(np.linalg.norm(y[n:])), tol.LEAST_SIZE)
    values = max(_value_residual(lti, y, last), outcome.violation, 0.0)
    adjoint, terms, product = _adjoint_residual(lti, outcome, multipliers)
    gains = np.abs(lti.B) if lti.response is None else np.abs(lti.response).max(2)
    through_u = float(gains.sum(0).max()) * terms
    working = outcome.working
    slack = working.slacks(lti, y, last)
    slack = np.where(working.saturated(lti), np.maximum(slack, 0.0), np.abs(slack))
    gap = float(working.weights @ slack) + product + multipliers.stationarity * float(np.abs(y[n:]).sum())
    return Residuals(
        primal=max(_dynamics_residual(lti, y, last), band / energy, values),
        dual=max(adjoint / terms, multipliers.stationarity / max(through_u, tol.LEAST_SIZE * lti.curvature_unit)),
        gap=gap / max(lti.cost_level, abs(outcome.cost)),
    )


def _dynamics_residual(lti: Lti, y: Array, last: Array) -> float:
    """Return the largest residual of the dynamics, relative to the states."""
    n = lti.state_dim
    if lti.response is None:
        residual = np.hstack([lti.A, lti.B]) @ y
        residual[:, :-1] -= y[:n, 1:]
        residual[:, -1] -= last
    else:
        by_controls = np.einsum("imk,mk->ik", lti.response, fft.rfft(y[n:]))
        residual = fft.irfft(by_controls, lti.horizon) - np.roll(y[:n], -1, axis=1)
    if lti.offset is not None:
        residual += lti.offset
    return _largest(residual) / max(_largest(y[:n]), _largest(last), tol.LEAST_SIZE)


def _value_residual(lti: Lti, y: Array, last: Array) -> float:
    """Return the errors of x_0, fixed values and stopped bins of states, relative to the signals."""
    n, size = lti.state_dim, max(_largest(y), tol.LEAST_SIZE)
    t, f = lti.fixed_points
    start = np.where(np.isnan(lti.start), 0.0, lti.start - y[:n, 0])
    error = max(_largest(start), _largest(y[f, t] - lti.bounds.lower[f, t])) / size
    if not lti.state_stop.any():
        return error
    x = np.hstack([y[:n], last[:, None]])[:, : lti.state_samples]
    spectrum = np.abs(fft.rfft(x)).T[lti.state_stop].max()
    return max(error, float(spectrum) / max(float(np.linalg.norm(x)), tol.LEAST_SIZE))


def _adjoint_residual(lti: Lti, outcome: ExchangeOutcome, multipliers: LtiMultipliers) -> tuple[float, float, float]:
    """Return the largest residual of the adjoint equation, the size of its terms, and <|residuals|, |x|>.

    The residuals are eta_{t-1} - A'eta_t + Q x + S u + q + mu + C'l + (R'rho), (n, T+1).
    """
    at, n, eta, rho_x = outcome.signals, lti.state_dim, multipliers.eta, multipliers.rho_x
    residual = multipliers.on_rows[:n].copy()
    sizes = [_largest(residual), _largest(eta)]
    residual[:, 1:] += eta
    if lti.periodic:  # x_0 follows the end of the period, and x_T is x_0
        residual[:, 0] += eta[:, -1]
        residual[:, -1] -= eta[:, -1]

    def add(inner: Array, last: Array | float) -> None:
        sizes.append(max(_largest(inner), _largest(last)))
        residual[:, :-1] += inner
        residual[:, -1] += last

    add(-lti.A.T @ eta, 0.0)
    if multipliers.eta_C and (lti.state_cost or lti.P.any()):
        add(lti.M[:n] @ at.y, lti.P @ at.last)
    if multipliers.eta_C and (lti.linear is not None or lti.p.any()):
        add(np.zeros((n, 1)) if lti.linear is None else lti.linear[:n], lti.p)
    if len(lti.F) > len(lti.M):
        add(lti.F[len(lti.M) :, :n].T @ multipliers.on_rows[len(lti.M) :, :-1], 0.0)
    if rho_x.any():
        forces = time_signal(rho_x, lti.state_samples).T
        add(forces[:, : lti.horizon], 0.0 if lti.periodic else forces[:, -1])
    np.abs(residual, out=residual)
    x = np.abs(at.y[:n])
    product = float(np.einsum("it,it->", residual[:, :-1], x) + residual[:, -1] @ np.abs(at.last))
    return _largest(residual), max(sum(sizes), tol.LEAST_SIZE * lti.curvature_unit), product


def _largest(values: Array | ComplexArray | float) -> float:
    """Return the largest absolute value, 0 if there is none."""
    return float(np.abs(values).max(initial=0.0))


def in_units(problem: OptimalControlProblem, lti: Lti, units: LtiUnits, scaled: LtiMultipliers) -> Multipliers:
    """Return the multipliers of the maximum principle in the user's units."""
    n, m = problem.state_dim, problem.control_dim
    x, u = np.split(units.multipliers, [n])
    forces = scaled.on_rows[: n + m].T * units.multipliers
    on_ends: dict[str, Array] = {}
    if lti.periodic:  # the multiplier of x_T - x_0 = 0; mu_0 moves to mu_T where x_T has the bound
        tube, mu = problem.state_tube, forces[:, :n]
        at_end = np.where(mu[0] > 0, tube.upper[-1] < tube.upper[0], tube.lower[-1] > tube.lower[0])
        mu[-1] = np.where(at_end, mu[0], 0.0)
        mu[0] -= mu[-1]
        on_ends[Periodic.name] = seal((-(scaled.eta[:, -1] * x) - mu[-1])[None])
    weights = scaled.on_rows[n + m :, :-1] * (units.cost / units.rows)[:, None]
    splits = np.cumsum([rows.e.shape[-1] for rows in problem.stage_rows])[:-1]
    on_stage_rows = np.split(weights, splits) if problem.stage_rows else []
    multipliers = Multipliers(
        scaled.eta_C,
        seal(scaled.eta.T * x),
        seal(forces[:, :n]),
        seal(forces[:-1, n:]),
        (scaled.band * (bin_weights(problem.horizon) / problem.horizon)).T * u,
        scaled.rho_x * x,
        {rows.name: part.T for rows, part in zip(problem.stage_rows, on_stage_rows, strict=True)} | on_ends,
    )
    sets = soft_sets(problem) if problem.terms else None
    if not sets:
        return multipliers
    # the model includes the prices of soft sets: no problem with hard bounds was made
    return SoftBounds(problem, problem, sets).multipliers(multipliers)
