"""The distance of every verdict that a test obtains from the tolerance at which it would flip.

Results of this library's functions count, and certificates from calls of ``certify`` in tests. A verdict is close to
its tolerance if its residual is a large part of it, or exceeds it by little: other processors round otherwise. What
``judge`` returns does not count: tests call it with arbitrary multipliers, whose residuals may be close to any number.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

import lin_freq_ocp as lfo
from lin_freq_ocp.api import present_as
from lin_freq_ocp.certificate import GAP_TOLERANCE, RIGOROUS, Condition
from lin_freq_ocp.results import Certificate, Status
from lin_freq_ocp.solving import Outcome

TESTS = str(Path(__file__).parents[1])
CLOSEST = "closest verdict"  # the property of a test's report
LISTED, REFUSED = 0.3, 0.8  # closeness from which the run lists a verdict, and from which its test fails


class Close(NamedTuple):
    """How close a verdict is to its tolerance, 1 where it flips, and what it is about."""

    closeness: float
    subject: str


FAR = Close(0.0, "")


def closeness(ratio: float) -> float:
    """Return how close a residual is to its tolerance, 0 to 1; the ratio may be on either side of 1."""
    return float(min(ratio, 1 / ratio)) if ratio > 0 else 0.0


def worst(conditions: list[Condition]) -> Close:
    """Return the closeness of the verdict that all conditions hold."""
    ratios = {
        f"{one.label} {one.name}": one.relative / one.tolerance for one in conditions if one.tolerance and one.relative
    }
    if any(not one.passed and not one.tolerance for one in conditions):
        return Close(0.0, "an exact condition fails")
    name = max(ratios, key=lambda key: ratios[key], default="no residual")
    return Close(closeness(ratios.get(name, 0.0)), name)


def close_verdicts(certificate: Certificate) -> list[Close]:
    """Return the closeness of the verdicts of a certificate: the principle, feasibility, and the global optimum."""
    conditions = list(certificate.conditions)
    verdicts = [worst(conditions), worst([one for one in conditions if one.on_feasibility])]
    bound, gap, scale = certificate.bound, certificate.gap, certificate.cost_scale
    if bound is not None and bound.kind == RIGOROUS and gap is not None and certificate.feasible and scale > 0:
        worth = certificate.worth_of_residuals / scale
        verdicts.append(Close(closeness(max(abs(gap), worth) / GAP_TOLERANCE), "gap and worth of residuals"))
    return verdicts


class Record:
    """The closest verdict of the present test, from the functions that it watches."""

    def __init__(self):
        self.closest = FAR

    def add(self, certificate: Certificate | None) -> None:
        """Keep the closest verdict of a certificate if it is closer than those before."""
        for close in [] if certificate is None else close_verdicts(certificate):
            self.closest = max(self.closest, close)

    def watch(self) -> None:
        """Replace the functions that return verdicts by ones that record them, in every module that has them."""

        def present(cls: type, record: object) -> object:
            if isinstance(record, Outcome) and record.status != Status.LIMIT:
                self.add(record.certificate)
            return present_as(cls, record)

        replacements = {present_as: present, lfo.certify: self._recording(lfo.certify)}
        for module in [one for name, one in sys.modules.items() if name.startswith("lin_freq_ocp")]:
            for name, value in list(vars(module).items()):
                if callable(value) and value in replacements:
                    setattr(module, name, replacements[value])

    def _recording(self, function: Callable[..., Certificate]) -> Callable[..., Certificate]:
        @wraps(function)
        def recorded(*given: Any, **named: Any) -> Certificate:
            certificate = function(*given, **named)
            if sys._getframe(1).f_code.co_filename.startswith(TESTS):
                self.add(certificate)
            return certificate

        return recorded


def list_close_verdicts(closest: dict[str, tuple[float, str]]) -> list[str]:
    """Return a line for each test whose closest verdict is listed, the closest first."""
    close = sorted(
        ((value, test, subject) for test, (value, subject) in closest.items() if value > LISTED), reverse=True
    )
    return [f"{value:.2f} of the tolerance  {test}: {subject}" for value, test, subject in close]
