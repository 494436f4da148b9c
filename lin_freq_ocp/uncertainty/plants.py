"""Several plants under one control: a problem in the states of all of them, with every limit on each.

It is exact, and an ordinary problem: the plans are those that hold for each of the plants.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import plural, split_unit
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box, box_of, map_sets
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, component_indices, entries_of
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.limits import intersection
from lin_freq_ocp.transform.reformulations import translation_of
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.uncertainty.protocol import Uncertainty
from lin_freq_ocp.uncertainty.worst_loads import Worst, WorstCase, limit_rows, limited_spectra


class Plants(Uncertainty):
    """The plant is one of several, and the control does not know which: limits, ends and spectra hold for each.

    Parameters
    ----------
    plants : sequence of LinearDynamics or of FrequencyResponse
        Of the same states, controls and sampling time as the dynamics of the problem, which need not be among them.
    shares : (plants,), optional
        Weights of the plants in the cost, which is the mean over them. Default: all alike.

    Raises
    ------
    ProblemError
        If a plant does not fit the others; with its number.

    Examples
    --------
    >>> problem = lfo.library.double_integrator(horizon=40, cutoff_hz=None, terminal_state=None)
    >>> plants = [problem.dynamics, lfo.LinearDynamics(problem.dynamics.A, 1.1 * problem.dynamics.B, sampling_time=0.1)]
    >>> lfo.robust(problem, lfo.Plants(plants[:1])).state_dim
    2
    """

    def __init__(self, plants: Sequence[Dynamics], shares: ArrayLike | None = None):
        if not isinstance(plants, Sequence) or not plants:
            raise ProblemError("plants", brief(plants), "a list of at least one LinearDynamics or FrequencyResponse")
        self.plants = tuple(plants)
        weights = np.ones(len(plants)) if shares is None else real_array("plants.shares", shares)
        if weights.shape != (len(plants),) or (weights < 0).any() or not weights.any():
            expected = f"{len(plants)} weights, zero or above, and not all zero"
            raise ProblemError("plants.shares", brief(shares), expected)
        self.shares = weights / weights.sum()

    @property
    def stated(self) -> dict[str, object]:
        """Return what problem files say of it, by their keys."""
        return {"plants": self.plants, "plant_shares": self.shares if np.ptp(self.shares) else None}

    def _require(self, problem: OptimalControlProblem) -> None:
        own = problem.dynamics
        for k, plant in enumerate(self.plants):
            field = f"plants[{k}]"
            if type(plant) is not type(own):
                raise ProblemError(field, brief(plant), f"a {type(own).__name__}, as the problem has")
            sizes, known = (plant.state_dim, plant.control_dim), (own.state_dim, own.control_dim)
            if sizes != known or plant.sampling_time != own.sampling_time:
                got = f"{sizes[0]} states, {sizes[1]} controls, {plant.sampling_time} s"
                raise ProblemError(field, got, f"{known[0]} states, {known[1]} controls, {own.sampling_time} s")
            plant.require_horizon(problem.horizon)

    def plan_limits(self, problem: OptimalControlProblem, end: Literal["invariant"] | None = None) -> dict[str, object]:
        """Return the fields of a problem in the states of all plants; see ``robust``."""
        self._require(problem)
        self.require_plain(problem, end)
        n, K, T = problem.state_dim, len(self.plants), problem.horizon
        periodic = problem.terminal_state.links(n, T)
        if any(not link.repeats for link in periodic):
            raise UnsupportedError("terminal_state: got linked ends; expected a set, or Periodic().")
        place = [np.eye(K * n)[k * n : (k + 1) * n] for k in range(K)]  # x^k = place x
        cost, shares, names = problem.quadratic, self.shares, problem.state_names
        every = partial(_on_every_plant, place, shares)
        rows, spectra, outputs = list[StageRows](), list[FrequencyConstraint](), list[OutputSpectrum]()
        for one, k in product(problem.stage_rows, range(K)):
            if one.penalty is None or shares[k] > 0:  # a price is a part of the cost, too
                price = None if one.penalty is None else one.penalty * shares[k]
                rows.append(StageRows(one.C @ place[k], one.D, one.e, _of_plant(one.name, k), price))
        for one, k in product(entries_of(problem.state_spectrum), range(K)):
            indices = component_indices("state_spectrum", one.component, names)
            spectra += [part.changed(component=k * n + i) for part in _at_share(one, shares[k]) for i in indices]
        for one, k in product(entries_of(problem.output_spectrum), range(K)):
            if counted := [part for given in one.constraints for part in _at_share(given, shares[k])]:
                C = None if one.C is None else one.C @ place[k]
                outputs.append(OutputSpectrum(C, one.D, counted, [_of_plant(name, k) for name in one.output_names]))
        weights = {key: np.kron(np.diag(shares), getattr(cost, key)) for key in "QP"}
        slopes = {key: np.kron(shares, getattr(cost, key)) for key in "qp"}
        mean = replace(cost, **weights, **slopes, S=np.kron(shares[:, None], cost.S), x_ref=np.tile(cost.x_ref, K))
        return dict(
            dynamics=self.plants[0].stacked(self.plants, [_of_plant(name, k) for k in range(K) for name in names], T),
            cost=mean,  # over the plants; the part of the controls counts once
            state_set=map_sets(problem.state_set, every),
            initial_state=every(problem.initial_state),
            terminal_state=problem.terminal_state if periodic else every(problem.terminal_state),
            stage_rows=rows,
            state_spectrum=spectra or None,
            output_spectrum=outputs or None,
        )

    def worst(self, problem: OptimalControlProblem, plan: Trajectory, solved: Outcome | None) -> WorstCase:
        """Return what the worst plant does to the controls of a plan; see ``worst_case``."""
        self._require(problem)
        n, u, found = problem.state_dim, plan.u, dict[tuple[str, bool], list[Worst]]()
        if plan.x.shape[1] != n * len(self.plants) or u.shape != (problem.horizon, problem.control_dim):
            problem.require(plan)
        starts, cost = plan.x[0].reshape(-1, n), 0.0
        for k, plant in enumerate(self.plants):
            own = replace(problem, dynamics=plant)
            start = starts[min(k, len(starts) - 1)] if own.response is None else None
            moved = simulate(own, u, start)
            cost += self.shares[k] * own.value(moved.x, u)
            for one, priced in _closest_values(own, moved):
                found.setdefault((one.name, priced), []).append(replace(one, plant=k + 1))
        limits, soft = list[Worst](), list[Worst]()
        for (_, priced), cases in found.items():  # the plan of the first plant, and what the worst one adds
            first, most = cases[0], max(cases, key=lambda case: case.violation)
            added = most.sign * (most.planned - first.planned)
            worst = replace(most, planned=most.planned - most.sign * max(added, 0.0), margin=max(added, 0.0))
            (soft if priced else limits).append(worst)
        words = f"each of {plural(len(self.plants), 'plant')}; u = v"
        return WorstCase(words, tuple(limits), cost=cost, soft=tuple(soft))


def _closest_values(problem: OptimalControlProblem, trajectory: Trajectory) -> Iterator[tuple[Worst, bool]]:
    """Yield each limit at the time, or bin, where a trajectory is closest to it, and whether it is soft."""
    translation = translation_of(problem)
    problem, trajectory = translation.judged_at(trajectory)
    x, u = trajectory.x, trajectory.u
    for rows in limit_rows(problem, False, np.zeros(problem.state_dim, dtype=bool)):
        closest = rows.closest(x, u, np.zeros(rows.limits.shape))
        yield from ((one.of_given(translation, c), rows.soft) for one, c, _ in closest)
    for name, spectrum, limits in limited_spectra(problem):
        sizes, levels = np.linalg.norm(spectrum.values(x, u), axis=1), np.nan_to_num(limits)
        k = int(np.argmax(sizes - levels))
        size = float(np.abs(x).max() + np.abs(u).max()) * problem.horizon
        value, level = float(sizes[k]), float(levels[k])
        yield Worst(name, int(spectrum.bins[k]), value, 0.0, level, size, value, in_spectrum=True), False


def _at_share(one: FrequencyConstraint, share: float) -> list[FrequencyConstraint]:
    """Return the constraint, of a soft one with its part of the price; none if that is zero."""
    if one.penalty is None:
        return [one]
    if one.remembers:
        raise UnsupportedError("spectrum: got a soft Spectrogram with Plants; expected a hard one.")
    return [one.changed(penalty=one.penalty * share)] if share > 0 else []


def _on_every_plant(place: Sequence[Array], shares: Array, given: ConvexSet) -> ConvexSet:
    """Return the set of (x^1, .., x^K) with every x^k in a set; prices are the mean over the plants."""
    n = len(place[0])
    box = box_of(given).at_dimension(n, "state_set")
    pairs = [(member, k) for member in given.members for k in range(len(place)) if shares[k] > 0 or not member.soft]
    members = [member.preimage(place[k], float(shares[k])) for member, k in pairs]
    repeated = (np.tile(side, len(place)) for side in box.bounds)
    return intersection(Box(*repeated), members)


def _of_plant(name: str, k: int) -> str:
    label, unit = split_unit(name)
    return f"{label} of plant {k + 1} [{unit}]" if unit else f"{label} of plant {k + 1}"
