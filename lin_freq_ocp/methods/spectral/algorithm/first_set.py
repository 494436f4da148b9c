"""A first working set from a cheaper problem: a shorter horizon, or samples held together (docs/spectral.md, 11)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.algorithm.exchange import Exchange, Stop
from lin_freq_ocp.methods.spectral.algorithm.structure import Structure, prepare
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.methods.spectral.rows.working_set import Rows

GUESSED_HORIZON = 600  # from which a first guess costs less than the rounds it saves
HOLD_FACTOR = 8  # samples of a control that are equal in the coarse problem
SPREAD = 2  # further samples on each side of an active coarse control
DECAY_EXPONENT = 40.0  # the ends do not affect each other where the slowest mode decays by exp(-DECAY_EXPONENT)
ON_CIRCLE = 1e-6  # |log |lambda|| of a mode that does not decay, and is not counted
LEAST_SHORTENING = 2  # least ratio of the horizons; HOLD_FACTOR where samples may be held instead
HOLD_GROWTH = 4.0  # largest growth of the fastest mode over held samples
LARGEST_SHORTENING = 10  # largest ratio of the horizons


def first_working_set(lti: Lti, stop: Stop, structures: dict[int, Structure]) -> Rows | None:
    """Return a guess of the active rows, or None; ``structures`` keeps those of the cheaper problems by horizon."""
    if lti.horizon < GUESSED_HORIZON or lti.response is not None:
        return None
    shorter = _shortened_horizon(lti)
    hold = shorter * HOLD_FACTOR > lti.horizon and _may_be_held(lti)
    if not hold and shorter * LEAST_SHORTENING > lti.horizon:
        return None
    coarse, tolerance = (_held(lti), tol.HOLD_TOLERANCE) if hold else (_shortened(lti, shorter), tol.SHORT_TOLERANCE)
    try:
        if coarse.horizon not in structures:
            structures[coarse.horizon] = Structure(coarse)
        structure = structures[coarse.horizon]
        guess = first_working_set(coarse, stop, structures)
        outcome = Exchange(structure, prepare(structure, coarse), guess, tolerance, stop).run()
    except (UnsupportedError, np.linalg.LinAlgError):
        return None
    if outcome.status != "optimal":
        return None
    active = outcome.working.weights > 0
    working = outcome.working
    t, f, sign = working.t[active], working.f[active], working.sign[active]
    if hold:
        return _spread(lti, t, f, sign)
    return Rows(np.where(t < shorter // 2, t, t + lti.horizon - shorter), f, sign)


def _may_be_held(lti: Lti) -> bool:
    """Whether the dynamics hardly grow while a control is held."""
    return float(np.abs(np.linalg.eigvals(lti.A)).max()) ** HOLD_FACTOR <= HOLD_GROWTH


def _shortened_horizon(lti: Lti) -> int:
    """Return the horizon at which the ends do not affect each other; the given horizon if there is none."""
    rate = np.abs(np.log(np.abs(np.linalg.eigvals(lti.A)) + 1e-300))
    rate = rate[rate > ON_CIRCLE]
    decay_time = int(DECAY_EXPONENT / rate.min()) if len(rate) else lti.horizon
    return max(2 * decay_time, lti.horizon // LARGEST_SHORTENING)


def _shortened(lti: Lti, T: int) -> Lti:
    """Return the problem without its middle; bands keep their frequencies."""
    head, tail = slice(0, T // 2), slice(lti.horizon - (T - T // 2), lti.horizon)

    def cut(signal: Array) -> Array:
        return np.hstack([signal[:, head], signal[:, tail]])

    bins = np.round(np.arange(T // 2 + 1) * (lti.horizon / T)).astype(int).clip(0, lti.horizon // 2)
    return _without_equations(lti, T, lti.passed[:, bins], cut)


def _held(lti: Lti) -> Lti:
    """Return the problem in which HOLD_FACTOR samples of the control are equal."""
    T, n = lti.horizon // HOLD_FACTOR, lti.state_dim
    A, B = np.eye(n), np.zeros_like(lti.B)
    offset = None if lti.offset is None else np.zeros((n, T))
    for j in range(HOLD_FACTOR):
        A, B = lti.A @ A, lti.A @ B + lti.B
        if offset is not None and lti.offset is not None:
            offset = lti.A @ offset + lti.offset[:, j : HOLD_FACTOR * T : HOLD_FACTOR]
    coarse = _without_equations(lti, T, lti.passed[:, : T // 2 + 1], lambda v: v[:, : HOLD_FACTOR * T : HOLD_FACTOR])
    linear = None if lti.linear is None else lti.linear[:, : HOLD_FACTOR * T].reshape(len(lti.M), T, HOLD_FACTOR).sum(2)
    prices = None if coarse.prices is None else coarse.prices.times(HOLD_FACTOR)
    return replace(coarse, A=A, B=B, M=lti.M * HOLD_FACTOR, linear=linear, offset=offset, prices=prices)


def _without_equations(lti: Lti, T: int, passed: Mask, cut: Callable[[Array], Array]) -> Lti:
    """Return the problem at another horizon, without state bands and without values that bounds fix."""
    lower, upper = cut(lti.lower), cut(lti.upper)
    fixed = lower == upper
    return replace(
        lti,
        horizon=T,
        passed=passed,
        state_stop=np.zeros(((T + 1) // 2 + 1, lti.state_dim), dtype=bool),
        lower=np.where(fixed, -np.inf, lower),
        upper=np.where(fixed, np.inf, upper),
        linear=None if lti.linear is None else cut(lti.linear),
        offset=None if lti.offset is None else cut(lti.offset),
        prices=None if lti.prices is None else lti.prices.at(cut),
    )


def _spread(lti: Lti, t: Indices, f: Indices, sign: Array) -> Rows:
    """Return rows of the coarse problem as rows of the given: controls with their neighbours, states once, and x_T."""
    n, T = lti.state_dim, lti.horizon
    last = t == T // HOLD_FACTOR
    states = ~last & ~lti.F[f, n:].any(1)
    controls = ~last & ~states
    around = np.arange(-SPREAD, HOLD_FACTOR + SPREAD)
    many = (t[controls, None] * HOLD_FACTOR + around).clip(0, T - 1).ravel()
    times = np.concatenate([np.full(int(last.sum()), T), t[states] * HOLD_FACTOR, many])
    rows = np.concatenate([f[last], f[states], np.repeat(f[controls], len(around))])
    signs = np.concatenate([sign[last], sign[states], np.repeat(sign[controls], len(around))])
    _, unique = np.unique((times * len(lti.F) + rows) * 2 + (signs > 0), return_index=True)
    return Rows(times[unique], rows[unique], signs[unique])
