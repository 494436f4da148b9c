"""Masses that move along one axis: a double integrator, a resonant scanner, and masses joined by springs."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np

from lin_freq_ocp.base.arrays import positive_integer, positive_number, to_shape
from lin_freq_ocp.library.common import flag, low_pass_at, notch_at, sampled_plant, symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import low_pass, notch


def double_integrator(
    horizon: int = 200,
    sampling_time: float = 0.02,
    cutoff_hz: float | None = 5.0,
    initial_state: Sequence[float] = (0.0, 0.0),
    terminal_state: Sequence[float] | None = (1.0, 0.0),
    speed_bound: float | None = 0.3,
    control_bound: float | None = 1.0,
) -> OptimalControlProblem:
    """Move a unit mass from rest to rest under a speed limit and a low pass.

    Minimise 1/2 sum of u_t^2. Without bounds the acceleration falls along a line and the speed is a parabola, which the
    speed limit cuts flat over half of the time. That needs an acceleration of exactly 0 there, which a low-passed one
    cannot have for long: it touches the limit again and again instead, and costs more.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    cutoff_hz : float or None
        Low-pass cut-off of the acceleration in Hz; None: no frequency constraint.
    initial_state, terminal_state : (2,)
        Position [m], speed [m/s]. A terminal_state of None is free.
    speed_bound, control_bound : float or None
        Symmetric bounds on the speed [m/s] and the acceleration [m/s^2].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    The plant: Rao and Bernstein, "Naive control of the double integrator", IEEE Control Systems Magazine 21(5), 2001.
    State bounds in minimum-energy problems on it: Bryson and Ho, "Applied Optimal Control", 1975, chapter 3.
    The numbers are chosen here.

    Examples
    --------
    >>> lfo.library.double_integrator().horizon
    200
    """
    return OptimalControlProblem(
        dynamics=sampled_plant(
            [[0, 1], [0, 0]], [[0], [1]], sampling_time, "position [m], speed [m/s]", "acceleration [m/s^2]"
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("control_bound", control_bound),
        state_set=symmetric("speed_bound", [None, speed_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=low_pass_at(cutoff_hz),
        name="double_integrator",
    )


STROKE = 10.0  # um, length of the line
DAMPING_RATIO = 0.02
TRACKING_WEIGHT = 100.0  # 1/um^2, on the squared tracking error against 1 for the squared deviation of the drive


def scanner(
    horizon: int = 250,
    sampling_time: float = 1e-4,
    resonance_hz: float = 850.0,
    cutoff_hz: float | None = 1500.0,
    notch_width_hz: float | None = 200.0,
    initial_state: Sequence[float] = (-STROKE / 2, 0.0),
    terminal_state: Sequence[float] | None = (-STROKE / 2, 0.0),
    speed_bound: float | None = 0.95,
    drive_bound: float | None = 6.0,
) -> OptimalControlProblem:
    """Follow a triangle wave with a resonant scanner, two stop bands united on its drive.

    Minimise 1/2 sum of 100 (x_t - r_t)^2 + (u_t - r_t)^2, where x is the position and r one period of a triangle of
    10 um that fills the horizon (40 Hz). The scanner has a resonance, x'' + 2 zeta w x' + w^2 x = w^2 u; the drive has
    neither the bins around it nor those above the cut-off. Lines follow one another without end, so that here the
    horizon is a true period and the DFT bins are all the frequencies there are.

    Parameters
    ----------
    horizon : int
        T, the samples of one period of the triangle.
    sampling_time : float
        Seconds.
    resonance_hz : float
        Of the scanner, w/(2 pi); its damping ratio zeta is 0.02.
    cutoff_hz, notch_width_hz : float or None
        Low-pass cut-off, and width of the band removed around the resonance, in Hz; each None: not there.
    initial_state, terminal_state : (2,)
        Position [um], speed [mm/s]. A terminal_state of None is free.
    speed_bound, drive_bound : float or None
        Symmetric bounds on the speed [mm/s] and on the drive, given as the position [um] that it holds at rest.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Perez, Zou and Devasia, "Design and control of optimal scan trajectories: scanning tunneling microscope example",
    J. Dynamic Systems, Measurement, and Control 126(1), 2004; Fleming and Wills, "Optimal periodic trajectories for
    band-limited systems", IEEE Transactions on Control Systems Technology 17(3), 2009. The numbers are chosen here, of
    the size usual for a piezoelectric tube.

    Examples
    --------
    >>> lfo.library.scanner().horizon
    250
    """
    T = positive_integer("horizon", horizon)
    w = 2 * pi * positive_number("resonance_hz", resonance_hz)  # rad/s
    A = [[0, 1e3], [-1e-3 * w**2, -2 * DAMPING_RATIO * w]]
    B = [[0], [1e-3 * w**2]]  # in um and mm/s, of which 1 mm/s = 1000 um/s
    line = STROKE / 2 * (1 - 4 * np.abs(np.arange(T + 1) / T - 0.5))
    bands = [low_pass(cutoff_hz=cutoff_hz)] if cutoff_hz is not None else []
    if notch_width_hz is not None:
        bands.append(notch(centre_hz=resonance_hz, width_hz=notch_width_hz))
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, "position [um], speed [mm/s]", "drive [um]"),
        horizon=T,
        cost=QuadraticCost(
            Q=np.diag([TRACKING_WEIGHT, 0.0]),
            R=1.0,
            x_ref=np.column_stack([line, np.zeros(T + 1)]),
            u_ref=line[:-1, None],
        ),
        control_set=symmetric("drive_bound", drive_bound),
        state_set=symmetric("speed_bound", [None, speed_bound]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=bands or None,
        name="scanner",
    )


MASSES = 4  # of 1 kg each


def mass_chain(
    horizon: int = 400,
    sampling_time: float = 0.05,
    stiffness: float = 10.0,
    damping: float = 0.1,
    cutoffs_hz: Sequence[float] | None = (3.95, 5.95),
    initial_state: Sequence[float] = (1.0, -0.5, 0.7, 0.3, 0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    state_bound: float | None = 6.0,
    force_bound: float | None = 0.9,
    terminal_weight: float = 0.1,
) -> OptimalControlProblem:
    """Bring a vibrating chain of four masses to rest with two forces, each with a low pass of its own.

    Minimise sum of 0.05 |x_t|^2 + 0.05 |u_t|^2, and terminal_weight/2 |x_T|^2. The forces act on the first and the
    last mass; their stop bands differ, so that no single filter would do.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    stiffness, damping : float
        Of each of the five springs [N/m] and dampers [N s/m]; the outer ones hold the chain to the walls.
    cutoffs_hz : (2,) or None
        Low-pass cut-offs of the two forces in Hz; None: no frequency constraint.
    initial_state, terminal_state : (8,)
        Four positions [m] and four speeds [m/s]. A terminal_state of None is free.
    state_bound, force_bound : float or None
        Symmetric bounds on all states [m, m/s] and on both forces [N].
    terminal_weight : float
        P; it matters when the end is free.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Of the family of oscillating masses in Wang and Boyd, "Fast model predictive control using online optimization",
    IEEE Transactions on Control Systems Technology 18(2), 2010. Masses of 1 kg; the other numbers are chosen here.

    Examples
    --------
    >>> lfo.library.mass_chain().horizon
    400
    """
    coupling = 2 * np.eye(MASSES) - np.eye(MASSES, k=1) - np.eye(MASSES, k=-1)
    A, B = np.zeros((2 * MASSES, 2 * MASSES)), np.zeros((2 * MASSES, 2))
    A[:MASSES, MASSES:] = np.eye(MASSES)
    A[MASSES:, :MASSES] = -positive_number("stiffness", stiffness) * coupling
    A[MASSES:, MASSES:] = -to_shape("damping", damping, ()) * coupling
    B[MASSES, 0] = B[-1, 1] = 1
    names = [
        f"{what} {i} [{unit}]" for what, unit in (("position", "m"), ("speed", "m/s")) for i in range(1, MASSES + 1)
    ]
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, ", ".join(names), "first force [N], last force [N]"),
        horizon=horizon,
        cost=QuadraticCost(Q=0.1, R=0.1, P=terminal_weight),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("state_bound", state_bound),
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=None
        if cutoffs_hz is None
        else [
            low_pass(cutoff_hz=cutoff, component=j) for j, cutoff in enumerate(to_shape("cutoffs_hz", cutoffs_hz, (2,)))
        ],
        name="mass_chain",
    )


MASS_1, MASS_2 = 1.0, 1.0  # kg


def two_mass_spring(
    horizon: int = 200,
    sampling_time: float = 0.05,
    stiffness: float = 1.0,
    notch_width_hz: float | None = 0.2,
    initial_state: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    terminal_state: Sequence[float] | None = (9.0, 0.0, 0.0, 0.0),
    deflection_bound: float | None = 1.0,
    force_bound: float | None = 1.0,
) -> OptimalControlProblem:
    """Push one of two masses joined by a spring, without exciting the frequency of the spring.

    Minimise 1/2 sum of u_t^2. The stop band lies on a *state*, the deflection of the spring, around the frequency
    sqrt(k (1/m1 + 1/m2)) at which the masses swing against each other; for k = 1 N/m it is sqrt(2) rad/s. The
    deflection is 0 at both ends, so that its DFT shows the vibration and not a ramp.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    stiffness : float
        Of the spring [N/m]; the benchmark's nominal value is 1, its uncertainty 0.5 to 2.
    notch_width_hz : float or None
        Width in Hz of the band removed from the deflection; None: no frequency constraint.
    initial_state, terminal_state : (4,)
        Position of body 1 [m], deflection x2 - x1 [m], speed of body 1 [m/s], rate of the deflection [m/s]. A
        terminal_state of None is free.
    deflection_bound, force_bound : float or None
        Symmetric bounds on the deflection [m] and the force [N].

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Wie and Bernstein, "Benchmark problems for robust control design", J. Guidance, Control, and Dynamics 15(5), 1992:
    m1 = m2 = 1 kg, k = 1 N/m, force on body 1. The move, its time and the bounds are chosen here.

    Examples
    --------
    >>> lfo.library.two_mass_spring().horizon
    200
    """
    k = positive_number("stiffness", stiffness)
    flexible = sqrt(k * (1 / MASS_1 + 1 / MASS_2))  # rad/s
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [0, k / MASS_1, 0, 0], [0, -(flexible**2), 0, 0]]
    B = [[0], [0], [1 / MASS_1], [-1 / MASS_1]]
    states = "position [m], deflection [m], speed [m/s], deflection rate [m/s]"
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, states, "force [N]"),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("force_bound", force_bound),
        state_set=symmetric("deflection_bound", [None, deflection_bound, None, None]),
        initial_state=initial_state,
        terminal_state=terminal_state,
        state_spectrum=notch_at(flexible, notch_width_hz, "deflection"),
        name="two_mass_spring",
    )


INERTIA, RESONANCE_HZ, RESONANCE_DAMPING, FRICTION = 0.5, 12.0, 0.01, 0.5
"""Of each mass [kg m^2]; of their mode against each other; 1/s, of both turning together."""


def two_mass_drive(
    horizon: int = 60,
    sampling_time: float = 0.005,
    notch_width_hz: float | None = 8.0,
    initial_state: Sequence[float] = (0.3, 0.0),
    terminal_state: Sequence[float] | None = None,
    torque_bound: float | None = 1.0,
    elastic: bool = False,
) -> OptimalControlProblem:
    """Turn a drive of two masses on a spring that its controller does not know: a notch at 12 Hz.

    Minimise 1/2 sum of 40 angle^2 + speed^2 + 0.02 u^2, and 1/2 (2000 angle^2 + 100 speed^2) at the end. Motor and load
    turn together in the model of the controller. In truth they swing against each other at 12 Hz, damped by some 1 %,
    and the torque avoids that band: by a stop band in one move, by ``lfo.spectrum.closed_loop`` in a loop.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    notch_width_hz : float or None
        Width in Hz of the band removed from the torque around 12 Hz; None: no frequency constraint.
    initial_state, terminal_state : (2,)
        Angle [rad] and speed [rad/s] of both. A terminal_state of None is free.
    torque_bound : float or None
        Symmetric bound on the torque [Nm].
    elastic : bool
        The true drive: its states are angle and speed of the motor, then of the load, which costs.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Two-mass drives: Vukosavic and Stojic, "Suppression of torsional oscillations in a high-performance speed servo
    drive", IEEE Transactions on Industrial Electronics 45(1), 1998. The numbers are chosen here.

    Examples
    --------
    >>> lfo.library.two_mass_drive().horizon
    60
    """
    J, omega = INERTIA, 2 * pi * RESONANCE_HZ
    spring, damper = J / 2 * omega**2, J * RESONANCE_DAMPING * omega
    A, B, names = np.array([[0, 1], [0, -FRICTION]]), np.array([[0], [0.5 / J]]), "angle [rad], speed [rad/s]"
    Q, P = np.diag([40.0, 1.0]), np.diag([2000.0, 100.0])
    given, copies = (("initial_state", initial_state), ("terminal_state", terminal_state)), 1
    if flag("elastic", elastic):
        of_motor = np.hstack([A[1], 0, 0]) + np.array([-spring, -damper, spring, damper]) / J
        A = np.array([[0, 1, 0, 0], of_motor, [0, 0, 0, 1], np.roll(of_motor, 2)])
        B = np.array([[0], [1 / J], [0], [0]])
        names = "motor angle [rad], motor speed [rad/s], load angle [rad], load speed [rad/s]"
        Q, P = (np.kron(np.diag([0.0, 1.0]), of_load) for of_load in (Q, P))
        copies = 2
    start, end = (None if one is None else np.tile(to_shape(key, one, (2,)), copies) for key, one in given)
    return OptimalControlProblem(
        dynamics=sampled_plant(A, B, sampling_time, names, "torque [Nm]"),
        horizon=horizon,
        cost=QuadraticCost(Q=Q, R=0.02, P=P),
        control_set=symmetric("torque_bound", torque_bound),
        initial_state=start,
        terminal_state=end,
        control_spectrum=notch_at(omega, notch_width_hz),
        name="two_mass_drive",
    )
