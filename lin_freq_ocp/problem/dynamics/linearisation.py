"""Models of python-control and scipy.signal: the state equation of linear ones, the linearisation of nonlinear ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import methodcaller
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number, real_array, times_vectors
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.formulas.differentiable import DifferentiableFunction, FlatHessian

# Step of the differences, relative to a component's size: near eps^(1/5), where h^4 and eps/h are about equal.
RELATIVE_STEP = 2.0**-10
# With steps smaller by the factor SMALLER, no derivative may change by more than SMOOTH times the largest effect on the
# same state.
SMALLER, SMOOTH = 1 / 64, 1e-2
# At a kink, the derivatives on both sides differ by as much with smaller steps. At the minimum of |v|^1.5, whose
# derivative is continuous, the difference falls with the root of the step: to 1/8.
LASTING = 0.5
NO_EFFECT = 1e-9  # effects below this, relative to the larger of 1 and the value of the state, are rounding errors
# Local error of state and derivatives in the integration over one period, relative to their sizes.
INTEGRATION_TOLERANCE = 1e-12
# Evaluations of the derivatives in one period; an explicit method needs more only for a stiff model.
MOST_EVALUATIONS = 20_000
INTEGRATORS = ("DOP853", "Radau")


class ControlSystem(Protocol):
    """The part of ``control.NonlinearIOSystem`` that this package uses."""

    dt: float | None
    nstates: int | None
    ninputs: int | None
    state_labels: Sequence[str]
    input_labels: Sequence[str]

    def dynamics(self, t: float, x: Array, u: Array, params: Mapping[str, object] | None) -> ArrayLike:
        """Return dx/dt, or the next state."""
        ...


Model = Callable[[float, Array], Array]  # from the time in seconds and (x, u) to dx/dt, or to the next x
Labels = Sequence[str] | None


def state_equation(plant: object) -> tuple[Array, Array, float | None, Labels, Labels]:
    """Return A, B, the sampling time (0: continuous) and the labels of states and controls of a linear plant."""
    if type(plant).__module__.startswith("scipy.signal") and hasattr(plant, "to_ss"):
        system = methodcaller("to_ss")(plant)
        return np.asarray(system.A), np.asarray(system.B), 0.0 if system.dt is None else system.dt, None, None
    import control  # here, because it takes seconds to import and only its users need it

    expected = "a linear plant of python-control (StateSpace, TransferFunction) or of scipy.signal (lti, dlti)"
    if isinstance(plant, control.TransferFunction):
        try:
            plant = control.ss(plant)
        except (NotImplementedError, ImportError, ValueError) as error:
            got = f"a transfer function without a realisation ({error})"
            advice = "Transfer functions of several inputs need slycot; a StateSpace does not."
            raise ProblemError("plant", got, expected, advice) from None
    if not isinstance(plant, control.StateSpace):
        advice = "A measured response is lfo.FrequencyResponse, a nonlinear model LinearDynamics.linearised."
        raise ProblemError("plant", type(plant).__name__, expected, advice)
    return np.asarray(plant.A), np.asarray(plant.B), plant.dt, plant.state_labels, plant.input_labels


def linearisation(
    system: ControlSystem,
    x: ArrayLike,
    u: ArrayLike,
    sampling_time: float | None,
    params: Mapping[str, object] | None,
    sizes: tuple[ArrayLike | None, ArrayLike | None],
    integrator: str,
) -> tuple[Array, Array, Array, float | None]:
    """Return A, B, d and the sampling time of ``LinearDynamics.linearised``; one of each per time along a trajectory.

    With F_t the map over the period that begins at t, A_t and B_t are its derivatives at (x_t, u_t), and
    d_t = F_t(x_t, u_t) - A_t x_t - B_t u_t. A discrete model is F itself. For a continuous model with a zero-order hold
    of u, one integration yields the state and its derivatives Phi = (A, B): dPhi/dt = D_x f Phi + (0, D_u f),
    Phi = (I, 0) at t.
    """
    continuous, step = clock("system", system.dt, sampling_time)
    if integrator not in INTEGRATORS:
        raise ProblemError("integrator", brief(integrator), " or ".join(map(repr, INTEGRATORS)))
    states, controls = _points(system, x, u)
    n, m = states.shape[-1], controls.shape[-1]
    points = np.hstack([np.atleast_2d(states), np.atleast_2d(controls)])
    size = np.concatenate(
        [_size("state_scale", sizes[0], points[:, :n]), _size("control_scale", sizes[1], points[:, n:])]
    )
    successor, slope = np.empty((len(points), n)), np.empty((len(points), n, n + m))
    for t, point in enumerate(points):
        model, seconds = _model(system, n, params, t), t * (step or 1.0)
        successor[t] = model(seconds, point)
        slope[t] = _smooth_slope(model, seconds, point, size, successor[t], t)
        if continuous:
            span = (seconds, seconds + (step or 0.0))
            successor[t], slope[t] = _over_one_period(model, span, point, size, n, integrator, t)
    offset = successor - times_vectors(slope, points)
    if states.ndim == 1:
        return slope[0, :, :n], slope[0, :, n:], offset[0], step
    return slope[:, :, :n], slope[:, :, n:], offset, step


def sampled_map(
    system: ControlSystem,
    sampling_time: float | None,
    params: Mapping[str, object] | None,
    sizes: tuple[ArrayLike | None, ArrayLike | None],
    integrator: str,
) -> tuple[DifferentiableFunction, float | None]:
    """Return the map over one period as a function of (x, u) with a Hessian of zeros, and the sampling time.

    The map is not defined where the model has no value, no derivatives or no integral.
    """
    continuous, step = clock("system", system.dt, sampling_time)
    n, m = (positive_integer(f"system.{name}", getattr(system, name)) for name in ("nstates", "ninputs"))
    model = _model(system, n, params, 0)

    def value(x: Array, u: Array) -> Array:
        if not continuous:
            return model(0.0, np.append(x, u))
        span, units = (0.0, step or 0.0), np.sqrt(np.maximum(1.0, np.abs(x)))
        final, _ = _solve_span(lambda seconds, state: model(seconds, np.append(state, u)), span, x, units, integrator)
        return np.full(n, np.nan) if final is None else final

    def jacobian(x: Array, u: Array) -> Array:
        A, B, _, _ = linearisation(system, x, u, sampling_time, params, sizes, integrator)
        return np.hstack([A, B])

    flat = FlatHessian((n, n + m, n + m))
    return DifferentiableFunction(_defined_model(value), _defined_model(jacobian), flat, n, "system"), step


def _defined_model(function: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    def call(x: Array, u: Array) -> Array:
        try:
            return function(x, u)
        except ProblemError as error:
            raise ArithmeticError(str(error)) from error

    return call


def _solve_span(
    derivative: Model, span: tuple[float, float], start: Array, sizes: Array, integrator: Any
) -> tuple[Array | None, str]:
    """Return the solution of a differential equation at the end of a span, or None with the reason."""
    from scipy.integrate import solve_ivp  # slow to import

    tolerance = INTEGRATION_TOLERANCE
    ended = solve_ivp(derivative, span, start, method=integrator, rtol=tolerance, atol=tolerance * sizes)
    return (np.asarray(ended.y[:, -1]), "") if ended.success else (None, str(ended.message))


def clock(field: str, dt: float | None, sampling_time: float | None) -> tuple[bool, float | None]:
    """Return whether a python-control model is continuous, and the seconds per step; None if it is unknown."""
    if dt is None:
        raise ProblemError(f"{field}.dt", "None (unspecified)", "0 (continuous) or a sampling time", f"Set {field}.dt.")
    if dt == 0 and not isinstance(dt, bool):
        if sampling_time is None:
            advice = f"The {field} is continuous; on the command line: --sampling-time SECONDS."
            raise ProblemError("sampling_time", "None", "seconds per step", advice)
        return True, positive_number("dynamics.sampling_time", sampling_time)
    step = None if dt is True else float(dt)
    if step is not None and sampling_time is not None and not np.isclose(step, sampling_time, rtol=1e-12, atol=0.0):
        expected = f"{step}, the sampling time of the discrete {field}"
        advice = f"Leave it out, or resample the {field} first."
        raise ProblemError("sampling_time", brief(sampling_time), expected, advice)
    return False, step or sampling_time


def _points(system: ControlSystem, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
    """Return x (n,) and u (m,), or x (T, n) and u (T, m), without the state after the last control."""
    states, controls = real_array("x", x), real_array("u", u)
    n, m = (count or "n" for count in (system.nstates, system.ninputs))
    expected = f"x ({n},) and u ({m},), or x (T+1, {n}) and u (T, {m})"
    fit = states.ndim == controls.ndim and states.ndim in (1, 2) and states.size and controls.size
    fit = fit and system.nstates in (None, states.shape[-1]) and system.ninputs in (None, controls.shape[-1])
    if not fit or (states.ndim == 2 and len(states) - len(controls) not in (0, 1)):
        advice = "A point yields one model, a trajectory one per time; time is axis 0."
        raise ProblemError("x, u", f"shapes {states.shape} and {controls.shape}", expected, advice)
    return (states, controls) if states.ndim == 1 else (states[: len(controls)], controls)


def _size(field: str, scale: ArrayLike | None, signal: Array) -> Array:
    if scale is None:
        return np.sqrt(np.maximum(1.0, np.abs(signal).max(axis=0)))
    sizes = real_array(field, scale)
    if sizes.shape not in ((), signal.shape[1:]) or not (sizes > 0).all():
        raise ProblemError(field, brief(scale), f"a number above zero, or {signal.shape[1]} of them")
    return np.broadcast_to(sizes, signal.shape[1:])


def _model(system: ControlSystem, n: int, params: Mapping[str, object] | None, t: int) -> Model:
    def model(seconds: float, point: Array) -> Array:
        value = np.asarray(system.dynamics(seconds, point[:n], point[n:], params))
        if value.shape != (n,) or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
            at = f"{brief(value.tolist())} at x = {point[:n].tolist()}, u = {point[n:].tolist()}"
            raise ProblemError(f"system, t = {t}", at, f"{plural(n, 'finite number')}, one per state")
        return value.astype(np.float64)

    return model


def _shifted_values(model: Model, seconds: float, point: Array, steps: Array) -> Array:
    """Return the model at -2, -1, 1 and 2 steps from the point along each variable, (4, n, n + m)."""
    shifts = np.diag(steps)
    return np.stack([[model(seconds, point + k * shift) for shift in shifts] for k in (-2, -1, 1, 2)]).swapaxes(1, 2)


def _slope(shifted: Array, steps: Array) -> Array:
    """Return the derivatives of the model by (x, u), shape (n, n + m), by central differences of fourth order."""
    minus_2, minus_1, plus_1, plus_2 = shifted
    return (8 * (plus_1 - minus_1) - (plus_2 - minus_2)) / (12 * steps)


def _one_sided(shifted: Array, value: Array, steps: Array) -> Array:
    """Return the left and the right derivatives, (2, n, n + m), by differences of second order."""
    minus_2, minus_1, plus_1, plus_2 = shifted - value[:, None]
    return np.stack([minus_2 - 4 * minus_1, 4 * plus_1 - plus_2]) / (2 * steps)


def _smooth_slope(model: Model, seconds: float, point: Array, size: Array, value: Array, t: int) -> Array:
    """Return the derivatives at a point of the trajectory, or raise ProblemError at a kink."""
    steps = [RELATIVE_STEP * size, SMALLER * RELATIVE_STEP * size]
    shifted = [_shifted_values(model, seconds, point, step) for step in steps]
    slope, closer = (_slope(around, step) for around, step in zip(shifted, steps, strict=True))
    sides, closer_sides = (_one_sided(around, value, step) for around, step in zip(shifted, steps, strict=True))
    effect = np.abs(slope) * size
    allowed = (SMOOTH * effect.max(axis=1) + NO_EFFECT * np.maximum(1.0, np.abs(value)))[:, None]
    change = np.abs(slope - closer) * size - allowed
    if change.max() > 0:
        i, j = (int(index) for index in np.unravel_index(np.argmax(change), change.shape))
        pairs = zip((slope, closer), steps, strict=True)
        texts = [f"{matrix[i, j]:.6g} by steps of {step[j]:.2g}" for matrix, step in pairs]
        raise _kink(i, j, len(value), t, ", ".join(texts))
    jump, closer_jump = np.abs(sides[1] - sides[0]), np.abs(closer_sides[1] - closer_sides[0])
    lasting = np.where(closer_jump > LASTING * jump, closer_jump * size, 0.0) - allowed
    if lasting.max() > 0:
        i, j = (int(index) for index in np.unravel_index(np.argmax(lasting), lasting.shape))
        below, above = closer_sides[:, i, j]
        raise _kink(i, j, len(value), t, f"{below:.6g} on the left, {above:.6g} on the right")
    return slope


def _kink(i: int, j: int, n: int, t: int, values: str) -> ProblemError:
    variable = f"x[{j}]" if j < n else f"u[{j - n}]"
    got = f"derivatives of state {i} by {variable}: {values}"
    advice = "State state_scale and control_scale, or a point farther from the kink."
    return ProblemError(f"system, t = {t}", got, "a smooth model", advice)


def _over_one_period(
    model: Model, span: tuple[float, float], point: Array, size: Array, n: int, integrator: str, t: int
) -> tuple[Array, Array]:
    """Return the state after the period and its derivatives by (x, u) at the start, (n, n + m)."""
    count, steps = 0, RELATIVE_STEP * size

    def derivative(seconds: float, joined: Array) -> Array:
        nonlocal count
        count += 1
        if count > MOST_EVALUATIONS:
            advice = "If it is stiff, integrator='Radau' helps." if integrator != "Radau" else "Sample it faster."
            raise ProblemError(f"system, t = {t}", f"{count} evaluations in one period", "a model with fewer", advice)
        here, phi = np.concatenate([joined[:n], point[n:]]), joined[n:].reshape(n, -1)
        slope = _slope(_shifted_values(model, seconds, here, steps), steps)
        slope_phi = slope[:, :n] @ phi
        slope_phi[:, n:] += slope[:, n:]
        return np.concatenate([model(seconds, here), slope_phi.ravel()])

    start = np.concatenate([point[:n], np.eye(n, len(point)).ravel()])
    sizes = np.concatenate([size[:n], np.divide.outer(size[:n], size).ravel()])
    final, message = _solve_span(derivative, span, start, sizes, integrator)
    if final is None:
        advice = "A state may become infinite within the period."
        raise ProblemError(f"system, t = {t}", f"no solution ({message})", "one over the whole period", advice)
    return final[:n], final[n:].reshape(n, -1)
