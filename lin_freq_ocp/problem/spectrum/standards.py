"""Limits of standards on harmonic currents, as bounds.

The tables state facts of the standards; the texts of the standards decide what they apply to.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterable

from lin_freq_ocp.base.arrays import brief, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, MagnitudeBound

CLASS_A = {2: 1.08, 3: 2.30, 4: 0.43, 5: 1.14, 6: 0.30, 7: 0.77, 9: 0.40, 11: 0.33, 13: 0.21}  # A RMS
CLASS_A |= {n: 0.15 * 15 / n for n in range(15, 40, 2)} | {n: 0.23 * 8 / n for n in range(8, 41, 2)}
# For a ratio of short-circuit to load current below each key: percent of the load current for odd orders below the
# entries of ORDERS, and the total demand distortion
ORDERS = 11, 17, 23, 35, 51
DISTORTION = {
    20.0: (4.0, 2.0, 1.5, 0.6, 0.3, 5.0),
    50.0: (7.0, 3.5, 2.5, 1.0, 0.5, 8.0),
    100.0: (10.0, 4.5, 4.0, 1.5, 0.7, 12.0),
    1000.0: (12.0, 5.5, 5.0, 2.0, 1.0, 15.0),
    float("inf"): (15.0, 7.0, 6.0, 2.5, 1.4, 20.0),
}
OF_EVEN = 0.25  # of the limit of odd orders


def iec_61000_3_2_class_a(
    fundamental_hz: float = 50.0, orders: Iterable[int] = range(2, 41), component: int | str | None = None
) -> MagnitudeBound:
    """Return the limits of IEC 61000-3-2, class A, on the harmonic currents of equipment of up to 16 A per phase.

    Parameters
    ----------
    fundamental_hz : float
        Of the mains.
    orders : iterable of int
        Those to limit, within 2 .. 40; leave out what the sampling time does not resolve.
    component : int or str, optional
        Index or name of the current in A; default all.

    Returns
    -------
    MagnitudeBound
        On RMS values.

    Raises
    ------
    ProblemError
        If an order is not in the table.

    References
    ----------
    IEC 61000-3-2:2018, Table 1.

    Examples
    --------
    >>> limits = lfo.spectrum.iec_61000_3_2_class_a(orders=[3, 5, 7])
    >>> limits.describe(["i [A]"])
    'mask of i: RMS value ≤ 0.77 to 2.3 A RMS (a limit for each bin) at harmonics 3, 5 and 7 of 50 Hz'
    """
    limits = {order: CLASS_A[order] for order in _require_orders("iec_61000_3_2_class_a.orders", orders, max(CLASS_A))}
    return MagnitudeBound(rms=limits, fundamental_hz=fundamental_hz, component=component)


def ieee_519(
    load_current: float,
    short_circuit_ratio: float,
    fundamental_hz: float = 60.0,
    orders: Iterable[int] = range(2, 51),
    component: int | str | None = None,
) -> list[MagnitudeBound | EnergyBound]:
    """Return the limits of IEEE 519 on harmonic currents at a point of common coupling of 120 V to 69 kV.

    Parameters
    ----------
    load_current : float
        RMS value of the fundamental of the maximum demand load current I_L, in the unit of the signal.
    short_circuit_ratio : float
        I_SC / I_L.
    fundamental_hz, orders, component
        As for ``iec_61000_3_2_class_a``; orders within 2 .. 50.

    Returns
    -------
    list of MagnitudeBound and EnergyBound
        On the RMS value of each order, and on that of all of them: the total demand distortion.

    Raises
    ------
    ProblemError
        If a current or ratio is not above zero, or an order is not in the table.

    References
    ----------
    IEEE Std 519-2014, Table 2.

    Examples
    --------
    >>> each, total = lfo.spectrum.ieee_519(load_current=100.0, short_circuit_ratio=30, orders=[5, 7])
    >>> total.describe(["i [A]"])
    'energy of i: RMS value ≤ 8 A RMS over harmonics 5 and 7 of 60 Hz'
    """
    current = positive_number("ieee_519.load_current", load_current)
    ratio = positive_number("ieee_519.short_circuit_ratio", short_circuit_ratio)
    *percent, total = next(row for below, row in DISTORTION.items() if ratio < below)
    limits = {
        order: current * percent[bisect(ORDERS, order)] / 100 * (1.0 if order % 2 else OF_EVEN)
        for order in _require_orders("ieee_519.orders", orders, ORDERS[-1] - 1)
    }
    demand, orders = current * total / 100, list(limits)
    return [
        MagnitudeBound(rms=limits, fundamental_hz=fundamental_hz, component=component),
        EnergyBound(rms=demand, harmonics=orders, fundamental_hz=fundamental_hz, component=component),
    ]


def _require_orders(field: str, orders: Iterable[int], highest: int) -> list[int]:
    """Return the orders, from 2 to the highest of a table."""
    chosen = list(orders)
    unknown = [order for order in chosen if order not in range(2, highest + 1)]
    if unknown or not chosen:
        raise ProblemError(field, brief(unknown or chosen), f"orders from 2 to {highest}")
    return chosen
