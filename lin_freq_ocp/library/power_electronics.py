"""Power electronics: a buck converter with affine modes, and pulse patterns of multilevel inverters.

The converter is the simplified one of the paper (Example 3, completed) with its second mode in affine pieces. Pulse
patterns remove harmonics with few levels, or have the least distortion with few switches.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief, positive_integer, positive_number, to_shape
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.library.common import Spectrum, control_band, sum_of_squares
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.levels import FiniteSet
from lin_freq_ocp.problem.hybrid.piecewise_affine import AffineMode, PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.pulse_train import QUARTER, PulseTrain
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import stop_band
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound

RESISTANCE, INDUCTANCE, CURRENT_REFERENCE = 2.0, 1e-3, 1.0  # ohm, H, A
POLE = CURRENT_REFERENCE * RESISTANCE  # V: r, where the second mode has its pole
TARGET_CURRENT, CURRENT_WEIGHT = 0.75, 20.0  # A, V^2/A^2
# s and 1 as affine functions: rows of coefficients of (i, v, 1).
VOLTAGE_ABOVE_POLE, ONE = np.array([0.0, 1.0, -POLE]), np.array([0.0, 0.0, 1.0])


def buck_affine(
    horizon: int = 6,
    sampling_time: float = 2.5e-4,
    pieces: int = 1,
    linearised_at: float = 2.35,
    control_spectrum: Spectrum = None,
    initial_state: Sequence[float] = (0.65,),
    terminal_state: Sequence[float] | None = None,
    terminal_cost: bool = True,
    voltage_bounds: Sequence[float] = (2.2, 6.0),
) -> OptimalControlProblem:
    """Hold the current of a buck converter: a concave kink, and a second mode in affine pieces.

    Minimise the sum of 20 (i_t - 0.75)^2 + v_t^2 (no 1/2) within 0 <= i <= I_ref = 1 A. While the current is below the
    border i_b(v) the switch stays closed for the whole period; above it the current reaches I_ref within the period and
    falls for the rest of it. The first mode is affine; the second, a fraction in v, is given in affine pieces.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds: the switching period Tc.
    pieces : int
        Of the second mode. 1: e/s with s as it is at ``linearised_at``, exact at that voltage and on the border. More:
        triangles that follow the fraction over all voltages; docs/hybrid_systems.md says how closely.
    linearised_at : float
        Volts; looked at with one piece only.
    control_spectrum : band, list of bands, list of bins, "freq" or None
        Frequency constraints on the voltage; "freq" removes the bins max(2, ceil(T/3)) <= k <= T//2.
    initial_state, terminal_state : (1,)
        Current [A]. A terminal_state of None is free.
    terminal_cost : bool
        Whether 20 (i_T - 0.75)^2 is in the cost.
    voltage_bounds : (2,)
        Volts. The lower one must be above 2 V, where the second mode has its pole; without one an optimum never uses
        the second mode, because the first makes the same i+ of a smaller v.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Example 3 of the paper without losses in the diode (r_d = 0), R = 2 ohm, L = 1 mH; the paper gives no numbers, these
    are chosen here. Modes: "on" (e <= 0), listed first, then "off", or "off 1", "off 2", ... by increasing voltage. The
    map is continuous.

    Examples
    --------
    >>> lfo.library.buck_affine().horizon
    6
    """
    T, step = positive_integer("horizon", horizon), positive_number("sampling_time", sampling_time)
    lowest, highest = _voltages(voltage_bounds)
    count = positive_integer("pieces", pieces)
    kept, slope, excess = _border(step)
    on = _affine_mode("on", CURRENT_REFERENCE * ONE + kept * excess, [excess])
    if count == 1:
        off = [(excess / (_above_pole(linearised_at)), [-excess])]
    else:
        off = _triangles(count, np.geomspace(lowest - POLE, highest - POLE, count), slope, excess)
    modes = [
        _affine_mode("off" if count == 1 else f"off {j}", CURRENT_REFERENCE * ONE - POLE * kept * ratio, rows)
        for j, (ratio, rows) in enumerate(off, 1)
    ]
    return OptimalControlProblem(
        dynamics=PiecewiseAffineDynamics(
            [on, *modes], sampling_time=step, state_names=["current [A]"], control_names=["voltage [V]"]
        ),
        horizon=T,
        cost=sum_of_squares([[CURRENT_WEIGHT]], [[1.0]], terminal_cost, x_ref=[TARGET_CURRENT]),
        control_set=Box([lowest], [highest]),
        state_set=Box([0.0], [CURRENT_REFERENCE]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_band(control_spectrum, T),
        name="buck_affine",
    )


def _voltages(bounds: Sequence[float]) -> tuple[float, float]:
    """Return the bounds on the voltage, both above the pole."""
    lowest, highest = (float(bound) for bound in to_shape("voltage_bounds", bounds, (2,)))
    if not POLE < lowest < highest:
        expected = f"a lower bound above {POLE:g} V, where the second mode has its pole, and a larger upper one"
        raise ProblemError("voltage_bounds", brief(bounds), expected)
    return lowest, highest


def _above_pole(voltage: float) -> float:
    """Return s at a voltage that is above the pole."""
    given = positive_number("linearised_at", voltage)
    if given <= POLE:
        raise ProblemError("linearised_at", brief(voltage), f"a voltage above {POLE:g} V")
    return given - POLE


def _border(step: float) -> tuple[float, float, Array]:
    """Return a, alpha, and e as a row of coefficients of (i, v, 1)."""
    kept = exp(-RESISTANCE * step / INDUCTANCE)
    slope = (1 / kept - 1) / RESISTANCE
    return kept, slope, np.array([1.0, slope, -CURRENT_REFERENCE / kept])


def _triangles(count: int, inner: Array, slope: float, excess: Array) -> list[tuple[Array, list[Array]]]:
    """Return w of (2) and the rows <= 0 of every triangle, from q_1 .. q_count; those of odd number are above.

    With the current i, the voltage v, a = exp(-R Tc/L), r = I_ref R, c = r a and e = i - i_b(v), where i_b(v) =
    I_ref/a - alpha v is the border of the two modes, alpha = (1/a - 1)/R,

        i+ = I_ref + min(a e, -c w),   w = e/s,   s = v - r.                                                         (1)

    Because i <= I_ref the second mode has 0 <= e <= alpha s: a wedge, with w = 0 on its lower edge and w = alpha on its
    upper one. An interpolation whose vertices all lie on these edges is exact there. Let them be at s = q_0, q_1, ...,
    in turns below and above; q_0 = q_1 = s_min, and the last two are s_max. Piece j is the triangle q_{j-1}, q_j,
    q_{j+1}:

        w ~ e/q_j                       if q_j is above: two of its vertices are on the lower edge,
        w ~ alpha + (e - alpha s)/q_j   if q_j is below.                                                             (2)

    (2) differs from w most along the lines between pieces: by alpha (s - q_j)(q_{j+1} - s)/((q_{j+1} - q_j) s) in
    absolute value, so at most by alpha tanh(ln(q_{j+1}/q_j)/4), at the geometric mean of q_j and q_{j+1}. Equal ratios
    are therefore best, and the error of i+ is at most, and somewhere exactly,

        I_ref (1 - a) tanh(ln(s_max/s_min) / (4 (pieces - 1))),   pieces >= 2.                                       (3)

    A single piece w ~ e/s_0 is off by up to alpha |1 - s/s_0| at the voltage r + s: by I_ref (1 - a) max |1 - s/s_0|.
    """
    breaks = np.concatenate([inner[:1], inner, inner[-1:]])
    lines = list[Array]()
    for j in range(count + 1):  # between q_j and q_{j+1}: 0 on the line and positive to the right
        above, below = breaks[j : j + 2] if j % 2 else breaks[j : j + 2][::-1]
        lines.append(slope * above * (VOLTAGE_ABOVE_POLE - below * ONE) - (above - below) * excess)
    found: list[tuple[Array, list[Array]]] = []
    for j in range(1, count + 1):
        rows = [-lines[j - 1]] if j > 1 else []  # the first and the last line are bounds on v
        rows += [lines[j]] if j < count else []
        above = j % 2 == 1
        ratio = excess / breaks[j] if above else slope * ONE + (excess - slope * VOLTAGE_ABOVE_POLE) / breaks[j]
        found.append((ratio, [-excess, *rows] if above else rows))
    return found


def _affine_mode(name: str, row: Array, rows: list[Array]) -> AffineMode:
    """Return the mode whose map is an affine function of (i, v), where other such functions are <= 0."""
    region = np.array(rows)
    G, H, h = region[:, :1], region[:, 1:2], -region[:, 2]
    return AffineMode(row[:1, None], row[1:2, None], row[2:], G=G, H=H, h=h, name=name)


LEVELS = (-2.0, -1.0, 0.0, 1.0, 2.0)
FUNDAMENTAL = 1.5  # amplitude of the first harmonic
REMOVED = (3, 5, 7)
STEP, THIRD = 0.5, 0.01  # between levels of an optimal pulse pattern, and the largest third harmonic


def pulse_pattern(
    kind: str = "shep",
    samples: int = 128,
    tolerance: float | None = None,
    modulation: float = 0.9,
    switches: int = 8,
    least_dwell: float = 0.0,
    unipolar: bool = False,
    exactly: bool = False,
) -> OptimalControlProblem:
    """Switch an inverter between five levels: harmonics removed, or least distortion with a budget of switches.

    Selective harmonic elimination ("shep"): of u_t in {-2, -1, 0, 1, 2}, t = 0 .. N-1, the harmonics
    b_k = 2/N sum u_t sin(2 pi k t / N) and a_k, with cosines, are b_1 = 1.5 and zero for a_1 and k = 3, 5, 7; the mean
    of u_t^2 is least. Samples may be shared between levels: no more than 8 need be, the number of equations. With a
    tolerance, every sample takes one level, and |a_1|, |b_1 - 1.5| and |a_k + i b_k| may be as large as it.

    Optimal pulse pattern ("opp"): u(theta) in {-1, -1/2, 0, 1/2, 1} with quarter-wave symmetry and u(0) = 0 changes by
    one level at no more than k free angles of a period. With dI/dtheta = u, b_1 = M and |b_3| <= 0.01, the cost is the
    square of the total demand distortion, 1/pi times the integral of I^2, less M^2: the sum of (b_k / k)^2 over k >= 3.
    The published patterns have exactly k switches, at least 0.01 pi apart, and no level below zero in the first half of
    a period: ``least_dwell=0.01 * np.pi, unipolar=True, exactly=True``.

    Parameters
    ----------
    kind : str
        "shep" or "opp".
    samples : int
        "shep": N, at least 16, of one period.
    tolerance : float or None
        "shep": of every harmonic, in the unit of the levels, with whole samples at levels; None: exact, with duty
        cycles.
    modulation : float
        "opp": M, above 0 and up to 4/pi.
    switches : int
        "opp": k, a multiple of 4.
    least_dwell : float
        "opp": the least angle [rad] between two switches, also across the axes of symmetry.
    unipolar : bool
        "opp": no level below zero in the first half of a period, where the fundamental is positive.
    exactly : bool
        "opp": k switches instead of at most k. It needs a least dwell above zero, and a least dwell needs it.

    Returns
    -------
    OptimalControlProblem
        "shep": with a_1 and b_1 of the samples so far as states. "opp": a ``PulseTrain`` of k/4 + 1 dwells.

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Miller, Karamanakos and Geyer, arXiv 2512.07585 and 2512.08201, have optimal pulse patterns with bounds.
    docs/levels.md has the relaxations, their proofs, and figures.

    Examples
    --------
    >>> round(lfo.solve(lfo.library.pulse_pattern(kind="shep", samples=128)).cost, 8)
    1.25898269
    >>> round(lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=0.9, switches=8)).cost ** 0.5, 6)
    0.042203
    """
    if kind == "shep":
        return _elimination(samples, tolerance)
    if kind == "opp":
        return _optimal_pattern(modulation, switches, least_dwell, unipolar, exactly)
    raise ProblemError("kind", brief(kind), "'shep' or 'opp'", suggestion(kind, ["shep", "opp"]))


def _elimination(samples: int, tolerance: float | None) -> OptimalControlProblem:
    N = positive_integer("samples", samples)
    if N < 2 * max(REMOVED) + 2:
        raise ProblemError("samples", str(N), "at least 16: the seventh harmonic is removed")
    wide = 0.0 if tolerance is None else positive_number("tolerance", tolerance)
    target, angle = np.array([0.0, FUNDAMENTAL]), 2 * np.pi * np.arange(N) / N
    band = stop_band(bins=list(REMOVED))
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            np.eye(2),
            2 / N * np.stack([np.cos(angle), np.sin(angle)], axis=1)[..., None],
            state_names=["cosine of the fundamental", "sine of the fundamental"],
            control_names=["level"],
        ),
        horizon=N,
        cost=QuadraticCost(),
        control_set=FiniteSet(LEVELS, costs=np.square(LEVELS) / N, duty_cycles=tolerance is None),
        initial_state=np.zeros(2),
        terminal_state=Box(target - wide, target + wide),
        control_spectrum=band if tolerance is None else MagnitudeBound(amplitude=wide, band=band),
        name="pulse_pattern",
    )


def _optimal_pattern(
    modulation: float, switches: int, least_dwell: float, unipolar: bool, exactly: bool
) -> OptimalControlProblem:
    M, k = positive_number("modulation", modulation), positive_integer("switches", switches)
    if M > 4 / np.pi:
        raise ProblemError("modulation", brief(modulation), "at most 4/pi, the fundamental of a square wave")
    if k % 4:
        raise ProblemError("switches", str(k), "a multiple of 4", "Each of a quarter period happens four times.")
    dwell = 0.0 if least_dwell == 0 else positive_number("least_dwell", least_dwell)
    if exactly and not dwell:
        hint = "With switches that may coincide, k switches are no fewer than k - 4 of them. Give a least dwell."
        raise ProblemError("exactly", "True with least_dwell=0", "a least dwell above zero", hint)
    if dwell and not exactly:
        hint = "Every switch counts with a least dwell. For fewer switches, solve with a smaller number of them."
        raise ProblemError("exactly", f"False with least_dwell={brief(dwell)}", "True", hint)
    if dwell * k > 2 * np.pi:
        raise ProblemError("least_dwell", brief(dwell), f"at most 2 pi/k = {2 * np.pi / k:.6g}: k of them fit a period")
    dynamics, dwells, lowest = PulseTrain(STEP, orders=(1, 3)), np.full(k // 4 + 1, dwell), 0 if unipolar else -1
    dwells[[0, -1]] /= 2  # the other half is beyond the axis of symmetry
    energy = -(M**2)  # plus the sum over the trajectory: the square of the distortion at the end
    return OptimalControlProblem(
        dynamics=dynamics,
        horizon=k // 4 + 1,
        cost=QuadraticCost(p=[0, 0, 0, 1, 0, 0]),
        control_set=Box(np.column_stack([dwells, -np.ones_like(dwells)]) if dwell else [0, -1], [QUARTER, 1]),
        state_set=Box([0, lowest, -QUARTER, energy, -2, -2], [QUARTER, 1, QUARTER, 4, 2, 2]),
        initial_state=Box([0, 0, -QUARTER, energy, 0, 0], [0, 0, QUARTER, energy, 0, 0]),
        terminal_state=Box([QUARTER, lowest, 0, energy, M, -THIRD], [QUARTER, 1, 0, 4, M, THIRD]),
        name="pulse_pattern",
    )
