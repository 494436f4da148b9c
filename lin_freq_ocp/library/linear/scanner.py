"""A piezoelectric scanner that draws one line of an image, to and fro."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.arrays import Array, positive_integer, positive_number
from lin_freq_ocp.library.bounds import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import low_pass, notch

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

    Notes
    -----
    Perez, Zou and Devasia, "Design and control of optimal scan trajectories: scanning tunneling microscope example",
    J. Dynamic Systems, Measurement, and Control 126(1), 2004; Fleming and Wills, "Optimal periodic trajectories for
    band-limited systems", IEEE Transactions on Control Systems Technology 17(3), 2009. The numbers are chosen here, of
    the size usual for a piezoelectric tube.
    """
    T = positive_integer("horizon", horizon)
    frequency = 2 * pi * positive_number("resonance_hz", resonance_hz)
    line = STROKE / 2 * (1 - 4 * np.abs(np.arange(T + 1) / T - 0.5))
    bands = [low_pass(cutoff_hz=cutoff_hz)] if cutoff_hz is not None else []
    if notch_width_hz is not None:
        bands.append(notch(centre_hz=resonance_hz, width_hz=notch_width_hz))
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            *_continuous_model(frequency),
            sampling_time,
            state_names=["position [um]", "speed [mm/s]"],
            control_names=["drive [um]"],
        ),
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


def _continuous_model(frequency: float) -> tuple[Array, Array]:
    """Return the matrices in um and mm/s, of which 1 mm/s = 1000 um/s, for the resonance in rad/s."""
    A = np.array([[0, 1e3], [-1e-3 * frequency**2, -2 * DAMPING_RATIO * frequency]])
    B = np.array([[0], [1e-3 * frequency**2]])
    return A, B
