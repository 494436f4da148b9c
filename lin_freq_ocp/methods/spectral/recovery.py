"""The multipliers of the maximum principle from the final spectra (docs/spectral.md, 8 and 9).

Let r_t = M y_t + h_t + g_t be the gradient in y_t = (x_t, u_t) of the cost and of all forces g = G'l + E_y'zeta, and
r_k its DFT. The Lagrangian has the term <eta_t, x_{t+1} - A x_t - B u_t - d_t>. As one period, it is stationary where

    in x:   eta_{t-1} - A'eta_t + (r_t)_x = 0      <=>   eta_k = -(z I - A)^{-*} (r_k)_x
    in u:   -B'eta_t + (r_t)_u + (R'rho)_t = 0     <=>   (R'rho)_k = B'eta_k - (r_k)_u, zero at passed bins

A recursion for eta would multiply rounding errors by the growth of the dynamics, 3e46 for the pendulum sampled at
0.1 s. Near eigenvalues, D_k = U diag(sigma) V^* replaces zI - A: eta_k = -U diag(1/sigma) V^* r_k along large singular
values; along small ones, it is the multiplier of the compatibility equation of that bin.

The equation x(0) = x_0 is a force that closes the period. In its place, fixed ends have the forces of transversality:

    mu_0 = A'eta_0 - (M y_0 + h_0)_x - (joint rows and state bands at 0)
    mu_T = -eta_{T-1} - P x_T - p - (state bands at T)

Of a ray, eta_C = 0: all terms of the cost are absent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, seal
from lin_freq_ocp.methods.spectral.exchange import ExchangeOutcome
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.reductions import SoftBounds, soft_sets
from lin_freq_ocp.methods.spectral.spaces import bin_multiplicity
from lin_freq_ocp.methods.spectral.structure import Data, Structure
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.linked_ends import Periodic
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program_rows import bin_multipliers


def trajectory(outcome: ExchangeOutcome, units: LtiUnits) -> Trajectory:
    """Return the trajectory in the user's units."""
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
    rho_x: ComplexArray  # ((T+1)//2 + 1, n)


def recover(data: Data, outcome: ExchangeOutcome) -> LtiMultipliers:
    """Return the multipliers of an outcome; of its ray (eta_C = 0) if it has one."""
    lti, kkt, ray = data.lti, data.structure.kkt, outcome.ray
    n, working, zeta = lti.state_dim, *((outcome.working, outcome.zeta) if ray is None else (ray.working, ray.zeta))
    gradient, _ = data.forces(zeta, working)  # r_k
    if ray is None:
        gradient += lti.M @ outcome.signals.spectrum
        if data.linear is not None:
            gradient += data.linear
    eta_k = _adjoint(data.structure, gradient, zeta)
    if lti.response is None:
        through_controls = lti.B.T @ eta_k
    else:
        through_controls = np.einsum("imk,ik->mk", lti.response.conj(), eta_k)
    band = through_controls - gradient[n:]
    band[lti.passed] = 0.0
    eta = np.fft.irfft(eta_k, lti.horizon)
    # values of bounds that are equal are rows, too; x(0) = x_0 is not, see below
    on_rows, fixed = np.zeros((len(lti.F), lti.horizon + 1)), slice(lti.start_points, len(kkt.point_t))
    np.add.at(on_rows, (working.f, working.t), working.sign * working.weights)
    np.add.at(on_rows, (kkt.point_f[fixed], kkt.point_t[fixed]), zeta[fixed])
    on_bands = zeta[len(zeta) - len(kkt.bands) :]
    # fixed ends: any force is normal there, and transversality determines it
    joint = slice(n + lti.control_dim, None)
    at_start = lti.F[joint, :n].T @ on_rows[joint, 0] - lti.A.T @ eta[:, 0]
    at_end = np.array(eta[:, -1])
    np.add.at(at_start, kkt.band_component, on_bands * kkt.bands[:, 0])
    np.add.at(at_end, kkt.band_component, on_bands * kkt.bands[:, -1])
    if ray is None:
        y, last = outcome.signals.y, outcome.signals.last
        at_start += lti.M[:n] @ y[:, 0] + (0.0 if lti.linear is None else lti.linear[:n, 0])
        at_end += lti.P @ last + lti.p
    on_rows[:n, 0] = np.where(np.isnan(lti.start), on_rows[:n, 0], -at_start)
    on_rows[:n, -1] = np.where(np.isnan(lti.end), on_rows[:n, -1], -at_end)
    rho_x = np.zeros(lti.state_stop.shape, dtype=np.complex128)
    for i in kkt.band_components:
        rho_x[:, i] = bin_multipliers(lti.state_samples, lti.state_stop[:, i], on_bands[kkt.band_component == i])
    return LtiMultipliers(float(ray is None), eta, on_rows, band, rho_x)


def _adjoint(structure: Structure, gradient: ComplexArray, zeta: Array) -> ComplexArray:
    """Return eta_k, (n, bins), for the gradient r_k of the Lagrangian, (n+m, bins)."""
    spaces, kkt, T = structure.spaces, structure.kkt, structure.kkt.lti.horizon
    near, n = spaces.near, kkt.lti.state_dim
    with np.errstate(all="ignore"):
        eta_k = -spaces.resolvent.apply(spaces.z, gradient[:n, None], adjoint=True)[:, 0]
    eta_k[:, near.k] = -near.adjoint(gradient[:, None, near.k])[:, 0]
    row = len(kkt.point_t)  # of zeta: a compatibility equation has a real and, but for real bins, an imaginary part
    for scale, equation in zip(kkt.compatibility_scale, spaces.compatibility, strict=True):
        count = int(spaces.multiplicity[equation.k])
        multiplier = zeta[row] if count == 1 else zeta[row] + 1j * zeta[row + 1]
        eta_k[:, equation.k] += equation.left * (scale * T / count * multiplier)
        row += count
    return eta_k


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
        (scaled.band * (bin_multiplicity(problem.horizon) / problem.horizon)).T * u,
        scaled.rho_x * x,
        {rows.name: part.T for rows, part in zip(problem.stage_rows, on_stage_rows, strict=True)} | on_ends,
    )
    sets = soft_sets(problem) if problem.terms else None
    if not sets:
        return multipliers
    # the model includes the prices of soft sets, so that the problem was not replaced: only its multipliers are mapped
    return SoftBounds(problem, problem, sets).multipliers(multipliers)
