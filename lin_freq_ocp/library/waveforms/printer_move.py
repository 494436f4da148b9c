"""The move of a printer's axis to a new place, shaped so that the machine does not ring after it."""

from __future__ import annotations

from collections.abc import Sequence

from lin_freq_ocp.base.arrays import brief, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.library.common import symmetric
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration


def printer_move(
    horizon: int = 22,
    sampling_time: float = 0.005,
    distance: float = 0.02,
    speed_bound: float | None = 0.5,
    acceleration_bound: float | None = 10.0,
    resonance_hz: float = 20.0,
    uncertainty: float = 0.1,
    damping: Sequence[float] = (0.02, 0.1),
    vibration_bound: float | None = 0.5,
) -> OptimalControlProblem:
    """Move an axis from rest to rest, and leave a resonance that is known to 10 % nearly still.

    Minimise 1/2 sum of a_t^2 over the accelerations of a position and a speed, held between the samples. What rings
    after the move is a mode q'' + 2 zeta w q' + w^2 q = w^2 a of the frame: its amplitude is bounded for every w and
    zeta of a box. With the defaults 22 samples (0.11 s) are feasible and 21 are not; without the bound on the vibration
    18 are. ``lfo.compare`` sets input shapers of the same robustness beside it.

    Parameters
    ----------
    horizon : int
        T.
    sampling_time : float
        Seconds.
    distance : float
        Of the move in m.
    speed_bound, acceleration_bound : float or None
        Symmetric bounds on the speed [m/s] and the acceleration [m/s^2].
    resonance_hz : float
        Natural frequency w / (2 pi) in Hz, as it is known.
    uncertainty : float
        From 0 to below 1: the natural frequency lies within resonance_hz * (1 - uncertainty .. 1 + uncertainty).
    damping : (lowest, highest)
        Damping ratios, from 0 to below 1.
    vibration_bound : float or None
        Largest amplitude of q after the move, in m/s^2: a constant acceleration a moves q by a. Default: 5 % of the
        bound on the acceleration. None: no bound.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If a parameter does not fit its description.

    References
    ----------
    Singer and Seering, "Preshaping command inputs to reduce system vibration", Journal of Dynamic Systems, Measurement,
    and Control 112, 1990. The numbers are chosen here, of the size of those of desktop 3D printers.

    Examples
    --------
    >>> lfo.minimum_time(lfo.library.printer_move, horizons=(1, 40)).horizon
    22
    """
    centre, spread = positive_number("resonance_hz", resonance_hz), real_array("uncertainty", uncertainty)
    if spread.ndim or not 0 <= spread < 1:
        raise ProblemError("uncertainty", brief(uncertainty), "a number from 0 to below 1")
    frequency = [centre * (1 - float(spread)), centre * (1 + float(spread))]
    return OptimalControlProblem(
        dynamics=LinearDynamics.from_continuous(
            [[0, 1], [0, 0]],
            [[0], [1]],
            sampling_time,
            state_names=["position [m]", "speed [m/s]"],
            control_names=["acceleration [m/s^2]"],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=symmetric("acceleration_bound", acceleration_bound),
        state_set=symmetric("speed_bound", [None, speed_bound]),
        initial_state=[0.0, 0.0],
        terminal_state=[positive_number("distance", distance), 0.0],
        control_spectrum=None if vibration_bound is None else ResidualVibration(frequency, damping, vibration_bound),
        name="printer_move",
    )
