"""A ball between a paddle and a ceiling, to be turned by friction: contact by time-stepping, with Coulomb's law.

The ball (mass m, radius r, inertia j) has the position (x_b, y_b) and the angle theta, counterclockwise; the paddle has
(x_p, y_p) and is moved by its accelerations u. Heights are measured so that the ball touches the paddle where
y_b = y_p, and the ceiling where y_b = d - 2 r: d is the gap between paddle and ceiling when y_p = 0. One step of length
h takes the velocities first, with the impulses of a contact, normal N >= 0 and tangential P, and then the positions
with the new velocities. Without contact the velocities x', y', theta' of the ball become x', y' - h g, theta', and
those of the paddle x_p' + h u_x, y_p' + h u_y. Let, after this free step,

    gap_p = y_b - y_p,   gap_c = d - 2 r - y_b,   slip_p = x' + r theta' - x_p',   slip_c = x' - r theta'.         (1)

If a gap would be negative there is an impulse, which closes it: N = -m gap/h (the impact is perfectly inelastic). It
acts on the ball as x' += P/m, and on the paddle y' += N/m, theta' += r P/j, at the ceiling y' -= N/m, theta' -= r P/j;
the paddle is driven and does not feel it. The slip then becomes slip + (1/m + r^2/j) P, and Coulomb's law says

    stick         P = P_0 = -slip / (1/m + r^2/j)   if |P_0| <= mu N,
    slide right   P = -mu N                         if P_0 <= -mu N,
    slide left    P = +mu N                         if P_0 >= mu N.                                               (2)

N and P are affine in (x, u), so this is a piecewise-affine map, and it is continuous: P is P_0 clipped to [-mu N, mu N]
and N is max(0, -m gap/h).

In the published model friction at the ceiling has the other sign: P = +mu N where the slip after it is >= 0, -mu N
where it is <= 0. Where |P_0| <= mu N all three laws hold, and the optimiser chooses. Here a choice is a control: a
third one, without cost, whose regions [-1, -1/2], [-1/2, 1/2] and [1/2, 1] stand for left, stick and right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np
from scipy.linalg import block_diag

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import Spectrum, control_band, flag, sum_of_squares, symmetric
from lin_freq_ocp.problem.hybrid.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.convex import Polyhedron
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, entries_of

MASS, RADIUS, GRAVITY, FRICTION = 1.0, 0.1, 10.0, 0.2  # kg, m, m/s^2, none
INERTIA = 0.4 * MASS * RADIUS**2  # kg m^2
GAP, HALF_WIDTH = 0.4, 0.3  # m: d between paddle at rest and ceiling; of the paddle
CLEARANCE = GAP - 2 * RADIUS
BY_IMPULSE = 1 / MASS + RADIUS**2 / INERTIA  # 1/kg: slip made by a tangential impulse
STATE_WEIGHTS = np.diag([1.0, 1.0, 0.01, 1.0, 1.0, 1.0, 1.0, 0.01, 1.0, 1.0])
CONTROL_WEIGHTS = np.diag([0.01, 0.001])
STATES, CONTROLS = 10, 2
MODELS = "braking", "published"


def ball_and_paddle(
    horizon: int = 20,
    sampling_time: float = 0.05,
    keep_over_paddle: bool = True,
    control_spectrum: Spectrum = None,
    initial_state: Sequence[float] = (0.0, 0.0, pi, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.0,) * STATES,
    terminal_cost: bool = True,
    state_bounds: Sequence[float] = (0.3, 0.2, 1.2 * pi, 0.3, 0.15, 2.0, 2.0, 10.0, 2.0, 2.0),
    acceleration_bounds: Sequence[float] = (30.0, 30.0),
    friction: str = "braking",
) -> OptimalControlProblem:
    """Turn a ball by half a turn between a paddle and a ceiling, by stick and slip: a hard one.

    Minimise the sum of x_t'Q x_t + u_t'R u_t (no 1/2), Q = diag(1, 1, 0.01, 1, 1, 1, 1, 0.01, 1, 1), R = diag(0.01,
    0.001), from an angle of pi to rest in the middle, at an angle of zero.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: h of the time-stepping.
    keep_over_paddle : bool
        Whether |x_b - x_p| <= 0.3 m, the half width of the paddle, at all times (in the published model: after every
        step that touches it); without, the paddle has no end.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the accelerations; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (10,)
        x and y [m] and angle [rad] of the ball, x and y [m] of the paddle, then their rates in the same order. A
        terminal_state of None is free.
    terminal_cost : bool
        Whether x_T'Q x_T is in the cost.
    state_bounds : (10,)
        Symmetric bounds on the states.
    acceleration_bounds : (2,)
        Symmetric bounds on the accelerations of the paddle in x and y [m/s^2].
    friction : {"braking", "published"}
        "braking": it opposes sliding, at the paddle and at the ceiling. "published": the model of the record, with
        regions that leave gaps, friction that drives a sliding ball on at the ceiling, and a third control which
        chooses the law there.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Marcucci and Tedrake, "Mixed-integer formulations for optimal control of piecewise-affine systems", Hybrid Systems:
    Computation and Control, 2019. Numbers, states, weights and bounds are theirs. The paper prints no matrices; those
    here are derived in this module, and "published" agrees with the paper's public code
    (github.com/TobiaMarcucci/pympc). "braking" differs in three points. (a) There the regions leave out the ball
    squeezed between paddle and ceiling; here the paddle comes first. So the map jumps between contacts with the paddle
    and with the ceiling, where y_b+ = y_p+ > 0.2 m, which the bounds exclude. (b) There the ball must be over the
    paddle only while they touch, here at all times. (c) There friction at the ceiling drives a sliding ball on, so that
    laws overlap; here it brakes.

    Modes: "free", then "stick", "slide right", "slide left" on the paddle, and the same at the ceiling; right and left
    say where the ball's lowest, or highest, point slides to.

    Examples
    --------
    >>> lfo.library.ball_and_paddle().horizon
    20
    """
    T, h = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    if friction not in MODELS:
        raise ProblemError("friction", brief(friction), "'braking' or 'published'")
    published, ends = friction == "published", flag("keep_over_paddle", keep_over_paddle)
    bounds, limits = symmetric("state_bounds", state_bounds), symmetric("acceleration_bounds", acceleration_bounds)
    over = np.zeros((2, STATES))
    over[:, [0, 3]] = [[1.0, -1.0], [-1.0, 1.0]]
    accelerations = ["acceleration x [m/s^2]", "acceleration y [m/s^2]"]
    bands = list[FrequencyConstraint]()
    for constraint in entries_of(control_band(control_spectrum, T)):  # of the accelerations: a law has no spectrum
        match constraint:
            case Band(component=None):
                bands += [replace(constraint, component=i) for i in range(CONTROLS)]
            case _:
                bands.append(constraint)
    if published:
        limits = limits.at_dimension(CONTROLS, "acceleration_bounds")
        limits = Box(np.append(limits.lower, -1.0), np.append(limits.upper, 1.0))
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            _published_modes(h, ends) if published else _modes(h),
            sampling_time=h,
            state_names=[
                *("ball x [m]", "ball y [m]", "angle [rad]", "paddle x [m]", "paddle y [m]"),
                *("ball speed x [m/s]", "ball speed y [m/s]", "angular speed [rad/s]"),
                *("paddle speed x [m/s]", "paddle speed y [m/s]"),
            ],
            control_names=[*accelerations, "law at ceiling"] if published else accelerations,
        ),
        horizon=T,
        cost=sum_of_squares(STATE_WEIGHTS, block_diag(CONTROL_WEIGHTS, np.zeros((int(published),) * 2)), terminal_cost),
        control_set=limits,
        state_set=bounds & Polyhedron(over, [HALF_WIDTH, HALF_WIDTH]) if ends and not published else bounds,
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=bands,
        name="ball_and_paddle",
    )


class _Contacts:
    """The free step, and steps with a contact, as rows of coefficients of (x, u, 1)."""

    def __init__(self, h: float, controls: int):
        rows = np.eye(STATES + controls + 1)
        self.h, self.one, self.law = h, rows[-1], rows[-2]  # the law is the last control, if it is one
        self.positions, self.velocities = rows[:5], rows[5:10].copy()
        self.velocities[1] -= h * GRAVITY * self.one
        self.velocities[3] += h * rows[10]
        self.velocities[4] += h * rows[11]
        after = self.positions + h * self.velocities
        self.gap_paddle, self.gap_ceiling = after[1] - after[4], CLEARANCE * self.one - after[1]
        ball, paddle = self.velocities[0], self.velocities[3]
        self.slip_paddle = ball + RADIUS * self.velocities[2] - paddle
        self.slip_ceiling = ball - RADIUS * self.velocities[2]

    def velocities_after(self, normal: Array, tangential: Array, side: float) -> Array:
        """Return the velocities after the impulses N and P of the paddle (side 1) or of the ceiling (side -1)."""
        velocities = self.velocities.copy()
        velocities[0] += tangential / MASS
        velocities[1] += side * normal / MASS
        velocities[2] += side * RADIUS * tangential / INERTIA
        return velocities

    def mode(self, name: str, velocities: Array, region: Sequence[Array]) -> AffineMode:
        """Return the step that ends with these velocities, where all rows of the region are <= 0."""
        A, B, offset = np.split(np.vstack([self.positions + self.h * velocities, velocities]), [STATES, -1], axis=1)
        G, H, constant = np.split(np.array(region), [STATES, -1], axis=1)
        return AffineMode(A, B, offset[:, 0], G, H, -constant[:, 0], name)

    def rows_past_edge(self, velocities: Array) -> list[Array]:
        """Return |x_b - x_p| - 0.3 m after the step, as two rows."""
        ahead = (self.positions + self.h * velocities)[[0, 3]]
        return [way * (ahead[0] - ahead[1]) - HALF_WIDTH * self.one for way in (1.0, -1.0)]


def _modes(h: float) -> list[AffineMode]:
    """Return the modes of friction that brakes: a paddle and a ceiling that push, the paddle first."""
    step = _Contacts(h, CONTROLS)
    modes = [step.mode("free", step.velocities, [-step.gap_paddle, -step.gap_ceiling])]
    for where, side, gap, slip, others in (
        ("on paddle", 1.0, step.gap_paddle, step.slip_paddle, []),
        ("at ceiling", -1.0, step.gap_ceiling, step.slip_ceiling, [-step.gap_paddle]),
    ):
        normal, stick = -MASS / h * gap, -slip / BY_IMPULSE
        for law, (tangential, region) in _coulomb(normal, stick, gap).items():
            after = step.velocities_after(normal, tangential, side)
            modes.append(step.mode(f"{law} {where}", after, [*region, *others]))
    return modes


def _coulomb(normal: Array, stick: Array, gap: Array) -> dict[str, tuple[Array, list[Array]]]:
    """Return P of every law (2), and the rows <= 0 of its region; those of stick imply that the gap is closed."""
    limit = FRICTION * normal
    return {
        "stick": (stick, [stick - limit, -stick - limit]),
        "slide right": (-limit, [stick + limit, gap]),
        "slide left": (limit, [limit - stick, gap]),
    }


def _published_modes(h: float, ends: bool) -> list[AffineMode]:
    """Return the modes of the record's model: never two contacts in a step; the last control chooses at the ceiling."""
    step = _Contacts(h, CONTROLS + 1)
    modes = [step.mode("free", step.velocities, [-step.gap_paddle, -step.gap_ceiling])]
    normal, stick = -MASS / h * step.gap_paddle, -step.slip_paddle / BY_IMPULSE
    for law, (tangential, region) in _coulomb(normal, stick, step.gap_paddle).items():
        after = step.velocities_after(normal, tangential, 1.0)
        edges = step.rows_past_edge(after) if ends else []
        modes.append(step.mode(f"{law} on paddle", after, [*region, -step.gap_ceiling, *edges]))
    normal, stick = -MASS / h * step.gap_ceiling, -step.slip_ceiling / BY_IMPULSE
    limit, half = FRICTION * normal, 0.5 * step.one
    for law, tangential, region in (
        ("stick", stick, [stick - limit, -stick - limit, step.law - half, -step.law - half]),
        ("slide right", limit, [stick - limit, half - step.law]),
        ("slide left", -limit, [-stick - limit, half + step.law]),
    ):
        others, after = [step.gap_ceiling, -step.gap_paddle], step.velocities_after(normal, tangential, -1.0)
        modes.append(step.mode(f"{law} at ceiling", after, [*region, *others]))
    return modes
