"""Some of many problems that differ in initial state and references: solved one from the other, judged together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import LinFreqOCPError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.repeated import Repeated
from lin_freq_ocp.certificate.many import Extremals, judged_together, verdicts
from lin_freq_ocp.solving.kept import Change
from lin_freq_ocp.solving.outcome import Outcome

ERROR = "error"  # status of what was not solved: it is no problem, or its worker died
UNSOLVED = "unsolved"  # status of what Ctrl-C left


@dataclass(frozen=True, eq=False)
class Item:
    """The answer to one of many problems, as plain data; None where there is nothing.

    ``proven`` says that its cost is within 1e-6 of a rigorous bound, or infeasibility is proven. ``x`` (T+1, n) and
    ``u`` (T, m) are the trajectory. ``lost`` says that its worker ended before the answer.
    """

    status: str
    proven: bool = False
    cost: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    message: str = ""
    seconds: float | None = None
    x: Array | None = field(default=None, repr=False)
    u: Array | None = field(default=None, repr=False)
    lost: bool = field(default=False, repr=False)


@dataclass(frozen=True, eq=False)
class Part:
    """Items by their keys, and whether Ctrl-C came before all were solved."""

    items: Mapping[str, Item]
    interrupted: bool = False


def solve_part(again: Repeated, changes: Mapping[str, Change], time_limit: float | None = None) -> Part:
    """Solve problems one after another, each from the one before; what fails is an item of its own."""
    items, interrupted = dict[str, Item](), False
    try:
        items, interrupted = _together(again, changes) if time_limit is None else ({}, False)
        for key in changes if not interrupted else ():
            if key not in items:
                items[key] = _judged_alone(again, changes[key], time_limit)
    except KeyboardInterrupt:
        interrupted = True
    return Part({key: items[key] for key in changes if key in items}, interrupted)


def _together(again: Repeated, changes: Mapping[str, Change]) -> tuple[dict[str, Item], bool]:
    """Return what the Fourier-domain method solves at once, if the bound of all proves it, and whether Ctrl-C came."""
    states = [change.initial_state for change in changes.values() if change.references is None]
    if not again.linear or not again.spectral or len(states) < len(changes) or states[0] is None:
        return {}, False
    if not judged_together(again.problem):
        return {}, False
    started = now()
    located = again.located(next(iter(changes.values())).of(again.problem))
    if located.kept is None:
        return {}, False
    translation, starts = located.translation, np.array(states, dtype=np.float64) - located.origin
    found = located.kept.together(starts)
    which = np.zeros(0, dtype=np.intp) if found is None else np.flatnonzero(found.found)
    if found is None or not len(which):
        return {}, found is not None and found.interrupted
    signals = (part[which] for part in (found.x, found.u, found.eta, found.mu, found.nu))
    judged = verdicts(translation.problem, starts[which], Extremals(*signals, rho_u=found.rho_u[which]))
    each, keys = (now() - started) / len(changes), list(changes)
    items = {
        keys[i]: Item(
            status=str(Status.OPTIMAL),
            proven=True,
            cost=float(judged.costs[k]) + translation.cost,
            lower_bound=float(judged.bounds[k]) + translation.cost,
            gap=float(judged.gaps[k]),
            seconds=each,
            x=found.x[i] + located.origin,
            u=found.u[i],
        )
        for k, i in enumerate(which)
        if judged.proven[k]
    }
    return items, found.interrupted


def _judged_alone(again: Repeated, change: Change, time_limit: float | None) -> Item:
    started = now()
    if again.excluded(change):
        message = "proven by a rigorous ray of another initial state"
        return Item(str(Status.INFEASIBLE), proven=True, message=message, seconds=now() - started)
    try:
        outcome = again.solve(change, time_limit)
    except LinFreqOCPError as error:
        return Item(ERROR, message=str(error), seconds=now() - started)
    if outcome.interrupted:
        raise KeyboardInterrupt
    if change.references is None:
        again.keep(outcome)
    return item_of(outcome, now() - started)


def item_of(outcome: Outcome, seconds: float) -> Item:
    """Return an outcome as an item; figures are of points that satisfy every constraint."""
    trajectory = outcome.trajectory if outcome.primal else None
    solved = outcome.certificate is not None and outcome.certificate.globally_optimal
    infeasible = outcome.status in (Status.INFEASIBLE, Status.UNBOUNDED) and outcome.dual
    return Item(
        status=str(outcome.status),
        proven=solved or infeasible,
        cost=outcome.cost if outcome.primal else None,
        lower_bound=outcome.lower_bound,
        gap=outcome.gap if outcome.primal else None,
        message=outcome.message,
        seconds=seconds,
        x=None if trajectory is None else trajectory.x,
        u=None if trajectory is None else trajectory.u,
    )
