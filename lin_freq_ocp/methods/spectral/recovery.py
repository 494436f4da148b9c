"""The multipliers of the maximum principle from the final spectra, and their residuals (docs/spectral.md, 8 and 9).

With the spectrum p_k of M y + h + forces, the adjoint is eta_k = -(zI - A)^{-*} p_k at every bin; near eigenvalues its
part along small singular values is the multiplier of that bin's compatibility equation. A recursion would multiply
rounding by the growth of the dynamics, 3e46 on the pendulum sampled at 0.1 s.

A batch of initial states has the same formulas, with the problems as a further axis. It is not measured: its callers
certify the answers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from lin_freq_ocp.base.arrays import Array, ComplexArray, Entry, Mask, seal
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.exchange import ExchangeOutcome
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.reductions import SoftBounds, priced_bounds
from lin_freq_ocp.methods.spectral.rows import Rows
from lin_freq_ocp.methods.spectral.spaces import times_columns
from lin_freq_ocp.methods.spectral.structure import Data, EndsModel, Structure, forces
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
class Recovered:
    """Multipliers in the units of the Lti problem, time or bins last; of a batch, with its problems before these."""

    eta_C: float
    eta: Array  # (n, T)
    on_rows: Array  # of F y_t, (rows, T+1): the states' mu, the controls' nu, the stage rows'; at T of x_T
    band: ComplexArray  # spectrum of the stop bands' forces R'rho_u, (m, bins); zero at passed bins
    stationarity: float  # stationarity residual: largest amplitude of B'eta - (gradient in u) at passed bins
    rho_x: ComplexArray  # ((T+1)//2 + 1, n)


def recover(structure: Structure, data: Data, outcome: ExchangeOutcome, spectrum: ComplexArray) -> Recovered:
    """Return the multipliers of an outcome with the spectrum of y; of its ray (eta_C = 0) if it has one."""
    lti, ray, kkt, at = data.lti, outcome.ray, structure.kkt, outcome.signals
    working, y = (outcome.working, outcome.multipliers) if ray is None else (ray.working, ray.multipliers)
    gradient, _ = forces(structure, lti, y, working)
    if ray is None:
        gradient += lti.M @ spectrum
        if data.linear is not None:
            gradient += data.linear
    on_rows, fixed = np.zeros((len(lti.F), lti.horizon + 1)), slice(lti.start_points, len(kkt.point_t))
    np.add.at(on_rows, (working.f, working.t), working.sign * working.weights)
    np.add.at(on_rows, (kkt.point_f[fixed], kkt.point_t[fixed]), y[fixed])
    ends, eta_C = (at.y[:, :1], at.last[:, None]), float(ray is None)
    found = _recover_columns(structure, lti, eta_C, gradient[:, None], y[:, None], on_rows[:, None], *ends)
    on_bands = y[len(y) - len(kkt.bands) :]
    for i in kkt.band_components:
        found.rho_x[:, i] = bin_multipliers(lti.state_samples, lti.state_stop[:, i], on_bands[kkt.band_component == i])
    return replace(found, eta=found.eta[:, 0], on_rows=on_rows, band=found.band[:, 0])


def _recover_columns(
    structure: Structure,
    lti: Lti,
    eta_C: float,
    gradient: ComplexArray,
    y: Array,
    on_rows: Array,
    first: Array,
    last: Array,
) -> Recovered:
    """Return the multipliers of N problems from the gradient of their Lagrangian in (x, u), (n+m, N, bins).

    ``y`` (equations, N) and ``on_rows`` (rows, N, T+1) are the multipliers of the exchange; mu_0 and mu_T are added to
    the latter where ends are fixed. ``first`` (n+m, N) and ``last`` (n, N) are (x_0, u_0) and x_T.
    """
    spaces, kkt, n = structure.spaces, structure.kkt, lti.state_dim
    with np.errstate(all="ignore"):
        eta_hat = -spaces.resolvent.apply_adjoint(spaces.z, gradient[:n])
    eta_hat[:, :, spaces.near.k] = -spaces.near.adjoint(gradient[:, :, spaces.near.k])
    row = len(kkt.point_t)
    for scale, singular in zip(kkt.singular_scale, spaces.singular, strict=True):
        weight = int(spaces.weight[singular.k])
        value = y[row] if weight == 1 else y[row] + 1j * y[row + 1]
        eta_hat[:, :, singular.k] += singular.left[:, None] * (scale * lti.horizon / weight * value)
        row += weight
    if lti.response is None:
        through_controls = times_columns(lti.B.T, eta_hat)
    else:
        through_controls = np.einsum("imk,ijk->mjk", lti.response.conj(), eta_hat)
    band = through_controls - gradient[n:]
    missed = np.where(lti.passed[:, None], band, 0.0)
    band -= missed
    eta = fft.irfft(eta_hat, lti.horizon)
    # mu_0, mu_T where ends are fixed follow from transversality: any vector is normal there
    joint, on_bands = slice(len(lti.M), None), y[len(y) - len(kkt.bands) :]
    at_start = lti.F[joint, :n].T @ on_rows[joint, :, 0] - lti.A.T @ eta[:, :, 0]
    at_end = np.array(eta[:, :, -1])
    for component, row, weight in zip(kkt.band_component, kkt.bands, on_bands, strict=True):
        at_start[component] += weight * row[0]
        at_end[component] += weight * row[-1]
    if eta_C:
        at_start += lti.M[:n] @ first + (0.0 if lti.linear is None else lti.linear[:n, :1])
        at_end += lti.P @ last + lti.p[:, None]
    fixed_start, fixed_end = np.flatnonzero(~np.isnan(lti.start)), np.flatnonzero(~np.isnan(lti.end))
    on_rows[fixed_start, :, 0] = -at_start[fixed_start]
    on_rows[fixed_end, :, -1] = -at_end[fixed_end]
    rho_x = np.zeros(lti.state_stop.shape, dtype=np.complex128)
    return Recovered(eta_C, eta, on_rows, band, _largest(missed) / lti.horizon, rho_x)


def residuals(lti: Lti, outcome: ExchangeOutcome, found: Recovered) -> Residuals:
    """Return the residuals of the maximum principle, each relative to the size of its own terms.

    primal: dynamics, ends, bands, bounds. dual: adjoint equation, transversality, stationarity in u. gap: multipliers
    times slacks, and dual residuals times the trajectory.
    """
    y, last, n = outcome.signals.y, outcome.signals.last, lti.state_dim
    stopped = ~lti.passed
    band = np.abs(fft.rfft(y[n:])[stopped]).max(initial=0.0) if stopped.any() else 0.0
    energy = max(float(np.linalg.norm(y[n:])), tol.LEAST_SIZE)
    missed = max(_missed_values(lti, y, last), outcome.violation, 0.0)
    adjoint, terms, product = _adjoint(lti, outcome, found)
    gains = np.abs(lti.B) if lti.response is None else np.abs(lti.response).max(2)
    through_u = float(gains.sum(0).max()) * terms
    working = outcome.working
    slack = working.slacks(lti, y, last)
    missing = np.where(working.saturated(lti), np.maximum(slack, 0.0), np.abs(slack))
    gap = float(working.weights @ missing) + product + found.stationarity * float(np.abs(y[n:]).sum())
    return Residuals(
        primal=max(_missed_steps(lti, y, last), float(band) / energy, missed),
        dual=max(adjoint / terms, found.stationarity / max(through_u, tol.LEAST_SIZE * lti.curvature_unit)),
        gap=gap / max(lti.cost_level, abs(outcome.cost)),
    )


def _missed_steps(lti: Lti, y: Array, last: Array) -> float:
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


def _missed_values(lti: Lti, y: Array, last: Array) -> float:
    """Return the errors of x_0, fixed values and stopped bins of states, relative to the signals."""
    n, size = lti.state_dim, max(_largest(y), tol.LEAST_SIZE)
    t, f = lti.fixed_points
    start = np.where(np.isnan(lti.start), 0.0, lti.start - y[:n, 0])
    missed = max(_largest(start), _largest(y[f, t] - lti.bounds.lower[f, t])) / size
    if not lti.state_stop.any():
        return missed
    x = np.hstack([y[:n], last[:, None]])[:, : lti.state_samples]
    spectrum = np.abs(fft.rfft(x)).T[lti.state_stop].max()
    return max(missed, float(spectrum) / max(float(np.linalg.norm(x)), tol.LEAST_SIZE))


def _adjoint(lti: Lti, outcome: ExchangeOutcome, found: Recovered) -> tuple[float, float, float]:
    """Return the largest residual of the adjoint equation, the size of its terms, and <|residuals|, |x|>.

    The residuals are eta_{t-1} - A'eta_t + Q x + S u + q + mu + C'l + (R'rho), (n, T+1).
    """
    at, n, eta = outcome.signals, lti.state_dim, found.eta
    residual = found.on_rows[:n].copy()
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
    if found.eta_C and (lti.state_cost or lti.P.any()):
        add(lti.M[:n] @ at.y, lti.P @ at.last)
    if found.eta_C and (lti.linear is not None or lti.p.any()):
        add(np.zeros((n, 1)) if lti.linear is None else lti.linear[:n], lti.p)
    if len(lti.F) > len(lti.M):
        add(lti.F[len(lti.M) :, :n].T @ found.on_rows[len(lti.M) :, :-1], 0.0)
    if found.rho_x.any():
        forces = time_signal(found.rho_x, lti.state_samples).T
        add(forces[:, : lti.horizon], 0.0 if lti.periodic else forces[:, -1])
    np.abs(residual, out=residual)
    x = np.abs(at.y[:n])
    product = float(np.einsum("it,it->", residual[:, :-1], x) + residual[:, -1] @ np.abs(at.last))
    return _largest(residual), max(sum(sizes), tol.LEAST_SIZE * lti.curvature_unit), product


def _largest(values: Array | ComplexArray | float) -> float:
    """Return the largest absolute value, 0 if there is none."""
    return float(np.abs(values).max(initial=0.0))


def in_units(problem: OptimalControlProblem, structure: Structure, units: LtiUnits, found: Recovered) -> Multipliers:
    """Return the theorem's multipliers in the user's units."""
    n, m = problem.state_dim, problem.control_dim
    x, u = np.split(units.multipliers, [n])
    forces = found.on_rows[: n + m].T * units.multipliers
    on_ends: dict[str, Array] = {}
    if structure.kkt.lti.periodic:  # the multiplier of x_T - x_0 = 0; mu_0 moves to mu_T where x_T has the bound
        tube, mu = problem.state_tube, forces[:, :n]
        at_end = np.where(mu[0] > 0, tube.upper[-1] < tube.upper[0], tube.lower[-1] > tube.lower[0])
        mu[-1] = np.where(at_end, mu[0], 0.0)
        mu[0] -= mu[-1]
        on_ends[Periodic.name] = seal((-(found.eta[:, -1] * x) - mu[-1])[None])
    weights = found.on_rows[n + m :, :-1] * (units.cost / units.rows)[:, None]
    splits = np.cumsum([rows.e.shape[-1] for rows in problem.stage_rows])[:-1]
    on_stage_rows = np.split(weights, splits) if problem.stage_rows else []
    multipliers = Multipliers(
        found.eta_C,
        seal(found.eta.T * x),
        seal(forces[:, :n]),
        seal(forces[:-1, n:]),
        (found.band * (structure.spaces.weight / problem.horizon)).T * u,
        found.rho_x * x,
        {rows.name: part.T for rows, part in zip(problem.stage_rows, on_stage_rows, strict=True)} | on_ends,
    )
    bounds = priced_bounds(problem) if problem.terms else None
    if bounds is None or not bounds.sets:
        return multipliers
    # the model holds the prices of soft sets, so that no problem with hard bounds was made
    return SoftBounds(problem, problem, bounds.sets).multipliers(multipliers)


@dataclass(frozen=True, eq=False)
class Together:
    """Trajectories x (N, T+1, n), u (N, T, m) with eta (N, T, n), mu, nu as x and u, and rho_u (N, bins, m).

    ``found`` (N,) says for which a working set was found, ``rows`` is the last of these, to begin with.
    """

    x: Array
    u: Array
    eta: Array
    mu: Array
    nu: Array
    rho_u: ComplexArray
    found: Mask
    rows: Rows | None
    interrupted: bool = False


def recover_batch(
    structure: Structure, units: LtiUnits, model: EndsModel, p: Array, weights: Array, found: Mask, rows: Rows | None
) -> Together:
    """Return signals and multipliers of a batch of initial states in the user's units, time before components.

    ``p`` (N, 1 + count) are the parameters of the model, ``weights`` (N, values) the multipliers of all bounded values,
    with signs; ``found`` and ``rows`` are those of Together.
    """
    lti, kkt, spaces, whole = model.lti, structure.kkt, structure.spaces, model.whole
    n, T, N = lti.state_dim, lti.horizon, len(p)
    theta, y = np.split((p @ model.step - weights @ whole.through.T).T, [kkt.size])
    on_rows = np.zeros((len(lti.F), N, T + 1))
    on_rows[whole.rows, :, :T] = np.moveaxis(weights[:, :-n].reshape(N, -1, T), 1, 0)
    on_rows[:n, :, T] = weights[:, -n:].T
    for f, t, of_point in zip(kkt.point_f, kkt.point_t, y, strict=False):
        on_rows[f, :, t] += of_point
    force = fft.rfft(on_rows[:, :, :T])
    spectrum = np.moveaxis(model.spectra(p), 1, 0) - spaces.project(force)
    kkt.add(theta, spectrum)
    signals, last = fft.irfft(spectrum, T), np.zeros((n, N))
    last[~np.isnan(lti.end)] = p[:, 1 + n :].T
    last[kkt.free_end] = theta[kkt.at_end]
    gradient = times_columns(lti.M, spectrum) + force
    if model.linear is not None:
        gradient += model.linear[:, None]
    duals = _recover_columns(structure, lti, 1.0, gradient, y, on_rows, signals[:, :, 0], last)
    y_unit, of_y, bins = units.signals, units.multipliers, spaces.weight / T

    def in_time(part: NDArray[Entry]) -> NDArray[Entry]:
        return np.ascontiguousarray(np.moveaxis(part, 0, -1))

    return Together(
        in_time(np.concatenate([signals[:n], last[:, :, None]], axis=2)) * y_unit[:n],
        in_time(signals[n:]) * y_unit[n:],
        in_time(duals.eta) * of_y[:n],
        in_time(duals.on_rows[:n]) * of_y[:n],
        in_time(duals.on_rows[n:, :, :T]) * of_y[n:],
        in_time(duals.band * bins) * of_y[n:],
        found,
        rows,
    )
