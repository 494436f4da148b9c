"""Verdicts do not depend on units, on scale, on the origin, or on which large number stands for none.

A random problem is solved as drawn, and again written differently: the cost times 1e-15..1e15, units of states,
controls and time 1e-9..1e9, another origin, bounds that are not active looser by 1..1e19 or removed, states in another
order, a state more on which nothing depends. The status, whether the maximum principle is satisfied, the class of the
gap and the cost must be the same; ``certify`` must say the same of both trajectories, and of the controls spoiled by a
part in ten.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

import lin_freq_ocp as lfo
from helpers.random.units import Change, Drawn, drawn, problem, reordered, with_harmless_state

COST_AGREEMENT = 1e-7  # difference of two costs, relative to what the terms of the cost add up to
ACTIVE = 1e-3  # part of the range of a component within which a bound counts as active, and stays where it is
CHANGES = ("cost", "units", "time", "bounds", "origin", "order", "harmless state")


@dataclass(frozen=True)
class Verdict:
    """What is said of a problem or trajectory."""

    status: str
    pmp: str | None
    optimal: bool | None
    bound: str | None


@dataclass(frozen=True)
class Outcome:
    """What became of one problem in other words."""

    seed: int
    kind: str
    change: str
    first: Verdict
    second: Verdict
    difference: float
    spoiled: tuple[Verdict | None, Verdict | None]

    @property
    def passed(self) -> bool:
        """Whether both verdicts and costs are the same."""
        same = self.first == self.second and self.spoiled[0] == self.spoiled[1]
        return same and self.difference <= COST_AGREEMENT


@cache
def solved(seed: int) -> lfo.results.Result:
    """Return the answer to a problem as drawn."""
    return lfo.solve(problem(drawn(seed)), throw=False)


def check(seed: int, kind_of_change: str | None = None) -> Outcome:
    """Solve a problem as drawn and in other words, and judge both and a spoiled trajectory."""
    rng = np.random.default_rng([seed, 1])
    data = drawn(seed)
    kind_of_change = kind_of_change or str(rng.choice(CHANGES))
    first = solved(seed)
    other, change = _changed(rng, data, first, kind_of_change)
    again = problem(other, change)
    second = lfo.solve(again, throw=False)
    difference = 0.0
    if first.cost is not None and second.cost is not None and second.trajectory is not None:
        u = (second.trajectory.u - change.u_origin) / change.u
        x = (second.trajectory.x - change.x_origin) / change.x
        x = _in_order_of(data, other, x)
        assert first.certificate is not None
        difference = abs(first.problem.value(x, u) - first.cost) / first.certificate.cost_scale
    spoiled = _spoiled(rng, first, data, other, change, again)
    return Outcome(seed, data.kind, kind_of_change, verdict(first), verdict(second), difference, spoiled)


def verdict(result: lfo.results.Result) -> Verdict:
    """Return what a result says."""
    return Verdict(result.status, *_said(result.certificate))


def _said(certificate: lfo.results.Certificate | None) -> tuple[str | None, bool | None, str | None]:
    if certificate is None:
        return None, None, None
    return certificate.pmp, certificate.globally_optimal, certificate.bound.kind if certificate.bound else None


def _changed(rng: np.random.Generator, data: Drawn, first: lfo.results.Result, what: str) -> tuple[Drawn, Change]:
    """Return the numbers and the words of the second problem."""
    n, m = data.n, data.m
    if what == "cost":
        return data, Change.none(n, m, cost=10.0 ** rng.uniform(-15, 15))
    if what == "units":
        return data, Change.none(n, m, x=10.0 ** rng.uniform(-9, 9, n), u=10.0 ** rng.uniform(-9, 9, m))
    if what == "time":
        return data, Change.none(n, m, time=10.0 ** rng.uniform(-9, 9))
    if what == "origin" and data.shifts:
        return data, Change.none(n, m, x_origin=3 * rng.standard_normal(n), u_origin=_control_origin(rng, data))
    if what == "order" and n > 1 and data.kind != "smooth pieces":
        return reordered(data, rng.permutation(n)), Change.none(n, m)
    if what == "harmless state" and data.kind not in ("smooth pieces", "affine modes"):
        return with_harmless_state(data), Change.none(n + 1, m)
    if first.trajectory is None or data.kind in ("affine modes", "smooth pieces"):  # which need finite bounds
        return data, Change.none(n, m)
    loosened = float(np.inf if rng.random() < 0.3 else 10.0 ** rng.uniform(0, 19))
    return data, Change.none(n, m, loosened=loosened, slack=_slack(data, first.trajectory))


def _control_origin(rng: np.random.Generator, data: Drawn) -> np.ndarray:
    """Return a shift of the controls, which a mask does not allow."""
    return np.zeros(data.m) if data.mask is not None else 3 * rng.standard_normal(data.m)


def _slack(data: Drawn, found: lfo.Trajectory) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return which bounds are not active at any time."""
    pairs = []
    for signal, (low, high) in ((found.x, data.x_bound), (found.u, data.u_bound)):
        near = ACTIVE * (signal.max(0) - signal.min(0)) + ACTIVE * np.abs(signal).max(0)
        pairs.append((signal.min(0) > low + near, signal.max(0) < high - near))
    return tuple(pairs)


def _in_order_of(data: Drawn, other: Drawn, x: np.ndarray) -> np.ndarray:
    """Return states of the second problem in the order of the first."""
    places = [int(np.flatnonzero(np.isclose(other.start, value, rtol=0, atol=0))[0]) for value in data.start]
    return x[:, places]


def _spoiled(
    rng: np.random.Generator,
    first: lfo.results.Result,
    data: Drawn,
    other: Drawn,
    change: Change,
    again: lfo.OptimalControlProblem,
) -> tuple[Verdict | None, Verdict | None]:
    """Return what ``certify`` says of controls changed by a part in ten, in the first words and in the others."""
    if first.trajectory is None or other is not data or data.kind == "smooth pieces":
        return None, None
    u = first.trajectory.u
    u = u + 0.1 * np.abs(u).max(0) * rng.standard_normal(u.shape)
    found = []
    for one, controls in ((first.problem, u), (again, change.u * u + change.u_origin)):
        try:
            certificate = lfo.certify(one, controls)
        except lfo.errors.NumericalError as error:
            found.append(Verdict(type(error).__name__, None, None, None))
            continue
        found.append(Verdict("certified", certificate.pmp, certificate.globally_optimal, None))
    return found[0], found[1]
