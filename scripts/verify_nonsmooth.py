"""Examples 2 and 3 of the paper from cold starts: known optima, certificates, and what is proven of them.

The optimal costs were found by dynamic programming, enumeration with a local solver, and a global solver.
"""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo

COST, CONDITION = 1e-7, 1e-8
"""Relative difference of costs, and the worst condition of the certificate."""

SECONDS = 60.0
"""For each global bound."""

FREE: dict[str, Any] = {"terminal_state": None}

OPTIMA: dict[str, tuple[str, dict[str, Any], float]] = {
    "norm from (0, 1), T = 3": ("norm_dynamics", {"initial_state": (0.0, 1.0), "horizon": 3}, 1.0),
    "norm from (1, 0), T = 3": ("norm_dynamics", {"initial_state": (1.0, 0.0), "horizon": 3}, 1.959023692803284),
    "norm from (1, 0), T = 10": ("norm_dynamics", {"initial_state": (1.0, 0.0)}, 2.382234308047054),
    "norm from (1, 1), T = 10": ("norm_dynamics", {"initial_state": (1.0, 1.0)}, 3.644688839725019),
    "buck, T = 3": ("buck_converter", {"horizon": 3}, 17.345547997984184),
    "buck, T = 4": ("buck_converter", {"horizon": 4}, 22.36493035150289),
    "buck, T = 8": ("buck_converter", {"horizon": 8}, 44.67772239475926),
    "buck to I_ref, T = 4": ("buck_converter", {"horizon": 4, "terminal_state": [1.0]}, 22.400633302541934),
    "buck, T = 8, bins 3 to 5": ("buck_converter", {"control_spectrum": [3, 4, 5]}, 44.69913880875864),
    "buck, T = 15": ("buck_converter", {"horizon": 15}, 83.66744364376612),
    "buck, wrong sign at 0": (
        "buck_converter",
        {"horizon": 2, "initial_state": [0.9351278729299871], **FREE},
        11.554464138730564,
    ),
    "buck, wrong sign inside": (
        "buck_converter",
        {"horizon": 3, "initial_state": [0.8281718171540953], **FREE},
        17.080332697458882,
    ),
    "buck as posed, T = 8": ("buck_converter", {"v_min": None, "v_max": None}, 11.221825808084372),
    "buck on the border, T = 4": ("buck_converter", {"horizon": 4, "terminal_price": -40.0, **FREE}, -17.5993666975),
}


def verify(console: Console, bounds: bool = True) -> bool:
    """Solve all and print what became of them; return whether all are as they must."""
    table, good = Table("problem", "optimal cost", title="piecewise-smooth dynamics from cold starts"), True
    for heading in ("error of the cost", "worst condition", "joint", "printed", "seconds", "proven gap"):
        table.add_column(heading, justify="right")
    for name in track(list(OPTIMA), "solving", console=Console(stderr=True), transient=True):
        system, arguments, optimum = OPTIMA[name]
        problem = lfo.library.by_name(system)(**arguments)
        result = lfo.solve(problem, method="nonsmooth", throw=False)
        certificate = result.certificate
        if certificate is None or certificate.borders is None:
            table.add_row(name, f"{optimum:.12g}", result.status)
            good = False
            continue
        error, worst = abs(certificate.cost / optimum - 1), certificate.worst.relative
        good &= error <= COST and worst <= CONDITION and certificate.pmp == "satisfied" and certificate.borders.joint
        bound = lfo.solve(problem, time_limit=SECONDS, throw=False) if bounds else None
        gap = None if bound is None else bound.gap
        good &= gap is None or gap >= -1e-9
        table.add_row(
            name,
            f"{optimum:.12g}",
            f"{error:.0e}",
            f"{worst:.0e}",
            "holds" if certificate.borders.joint else "fails",
            "holds" if certificate.borders.printed else "fails",
            f"{sum(result.seconds.values()):.1f}",
            "" if gap is None else f"{gap:.1e}",
        )
    console.print(table)
    return good
