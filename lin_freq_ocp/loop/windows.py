"""Windows of applied controls in the condensed kernel: each step has a plan that keeps them (docs/condensed.md)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import number, short_name
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import RIGOROUS
from lin_freq_ocp.certificate.tolerances import GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.loop.step_problem import free_first_state, known_states, soften
from lin_freq_ocp.methods.condensed.plans import UNLIMITED, Budget, CondensedSolver, Plan
from lin_freq_ocp.methods.condensed.windows import FACET_LEVEL, FACETS, ControlWindows, WindowSet
from lin_freq_ocp.methods.repair import repair_trajectory
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.reductions import REDUCTIONS
from lin_freq_ocp.methods.spectral.solver import SpectralSolver
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import limited_signals
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, entries_of, named_entries
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.judging import allowed_residual
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.transform.reductions import Change, reduce_problem
from lin_freq_ocp.transform.reformulations import Translation, translated_by, translation_of

FAR = 1e20  # units: a bound of a control that has none; the kernel leaves out rows without bounds
KERNEL_TAKES = "the condensed kernel takes hard, finite limits above zero on windows of controls with a length"


def has_windows(problem: OptimalControlProblem) -> bool:
    """Whether windows of a Spectrogram limit the controls."""
    return any(one.remembers for one in entries_of(problem.control_spectrum))


def without_windows(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without the windows of its controls."""
    rest = [one for one in entries_of(problem.control_spectrum) if not one.remembers]
    return problem.derived(control_spectrum=rest or None)


def maps_of_windows(
    problem: OptimalControlProblem, entries: Sequence[FrequencyConstraint] | None = None, delay: int = 0
) -> Iterator[tuple[FrequencyConstraint, SpectrumMap, Array]]:
    """Yield the constraint, the windows and the limits of V of each limited control; by default at the first plan."""
    if entries is None:  # no control acts before the first plan
        none = np.zeros((problem.horizon, problem.control_dim))
        entries = [one.with_past(none[:delay], 0).hold_last(none) for one in entries_of(problem.control_spectrum)]
    signal = limited_signals(problem, problem.state_samples, problem.horizon)["control_spectrum"]
    for where, one in named_entries("control_spectrum", entries):
        for _, windows, levels, sums in one.windows(signal, where):
            yield one, windows, np.broadcast_to(levels * sums, len(windows.bins))


def control_windows(problem: OptimalControlProblem, units: LtiUnits, delay: int) -> ControlWindows | None:
    """Return the windows of the controls of a problem, None without any.

    UnsupportedError, with the field, if the kernel does not take one of them.
    """
    sets = list[WindowSet]()
    for one, windows, limits in maps_of_windows(problem, delay=delay):
        if not one.slides or not (np.isfinite(limits) & (limits > 0)).all():
            raise UnsupportedError(f"control_spectrum: {one.describe(problem.control_names)}; {KERNEL_TAKES}.")
        unit, hop = units.u[windows.component], int(getattr(one, "hop", 1))
        frequencies, begin = 2 * np.pi * windows.bins / windows.points, int(windows.starts[0])
        scaled = limits / unit, windows.past / unit
        sets.append(WindowSet(windows.component, hop, begin, windows.window, frequencies, *scaled))
    return ControlWindows(tuple(sets), known_states(problem.linear)) if sets else None


def promises(problem: OptimalControlProblem) -> list[str]:
    """Return the largest amplitudes of the applied controls at every frequency of the bands and in every window."""
    found, largest = list[str](), np.abs(problem.control_tube.bounds).max(axis=(0, 1))
    for one, windows, limits in maps_of_windows(problem):
        taper, hop, j = windows.window, int(getattr(one, "hop", 1)), windows.component
        times, U, size = np.arange(len(taper)), largest[j], 2 / taper.sum()
        bend = (np.pi / windows.points) ** 2 / 2 * (taper * (times - times.mean()) ** 2).sum()
        ends, parts = np.append(taper, np.zeros(hop)), np.arange(1, hop) / hop
        moved = [np.roll(ends, i) - (1 - part) * ends - part * np.roll(ends, hop) for i, part in enumerate(parts, 1)]
        turn = max((np.abs(one).sum() for one in moved), default=0.0)
        level, between, other = (number(size * value, 3) for value in (limits.max(), bend * U, turn * U))
        found.append(
            f"applied {short_name(problem.control_names[j])}: amplitude at most {level} at the points of its windows, "
            f"{between} more at other frequencies of the band, {other} more in other windows"
        )
        waves = np.exp(-2j * np.pi * np.outer(windows.bins, times) / windows.points)
        of_bound = U * np.abs(waves @ taper)  # what the windows of a constant control have
        if np.isfinite(U) and (of_bound > limits).any():
            end, least = number(U * float((limits / of_bound).min()), 3), number(size * float(of_bound.max()), 3)
            found.append(
                f"plans end with at most {end}: only from an amplitude of {least} on can they end at the bound"
            )
    return found


def without_first_plan(problem: OptimalControlProblem) -> str:
    """Return why a step may have no plan that keeps all windows, or an empty text."""
    lower, upper = problem.control_tube.lower, problem.control_tube.upper
    if (lower > 0).any() or (upper < 0).any():
        return "control_set: bounds without 0, the control before the loop: steps may have no plan."
    if np.ptp(np.nan_to_num(np.vstack([lower.T, upper.T])), axis=1).any():
        return "control_set: bounds that differ over the horizon: steps may have no plan."
    return ""


@dataclass(frozen=True, eq=False)
class WindowedPlan:
    """The plan of a step with windows, the applied controls and the rest of the last plan, by which it is judged."""

    origin: Array  # of the states of the plan
    stated: OptimalControlProblem  # of the step, without a past
    plan: Plan
    spectrum: Sequence[FrequencyConstraint]  # with the applied controls
    rest: Array  # (T, m)
    exceeded: bool  # whether soft constraints are exceeded
    raised: float  # by how much the past exceeds the level of a window, relative

    @property
    def control(self) -> Array:
        """Return u_0, (m,)."""
        return self.plan.control

    @property
    def trajectory(self) -> Trajectory:
        """Return the plan in the given coordinates."""
        found = self.plan.trajectory
        return Trajectory(found.x + self.origin, found.u)

    @cached_property
    def translation(self) -> Translation:
        """Return the problem of the step."""
        problem = replace(self.stated, control_spectrum=[one.hold_last(self.rest, FACETS) for one in self.spectrum])
        return translated_by(problem.with_ends(self.plan.start + self.origin), self.origin)

    @one_blas_thread
    def certified(self, tolerance: float | None) -> Outcome:
        """Return the plan with its certificate for the discs: proven up to what their polygons can cost."""
        problem, units = self.translation.problem, self.plan.units
        started, base = now(), without_windows(problem)
        candidate = self.plan.candidate(base)
        assert candidate.trajectory is not None
        assert candidate.multipliers is not None
        own, trajectory = candidate.multipliers, repair_trajectory(base, candidate.trajectory) or candidate.trajectory
        duals, costs = dict[str, Array](), 0.0
        maps = maps_of_windows(problem, entries_of(problem.control_spectrum))
        terms = [term for term in problem.terms if term.kind is TermKind.CONTROL_SPECTRUM]
        windows = self.plan.windows.sets if self.plan.windows else ()
        for term, one, of_set, (_, found, _) in zip(terms, windows, self.plan.duals(), maps, strict=True):
            levels = one.levels * units.u[one.component]
            turned = of_set.duals * np.exp(-1j * of_set.begins * one.frequencies[of_set.points])
            on_points = np.zeros((len(found.starts), len(found.bins)), dtype=np.complex128)
            place = np.searchsorted(found.starts, of_set.begins), of_set.points
            np.add.at(on_points, place, turned * units.cost / levels[of_set.points])
            duals[term.name] = np.stack([on_points.real, on_points.imag], axis=-1).reshape(-1, 2)
            costs += float((duals[term.name] * found.values(trajectory.x, trajectory.u)).sum())
        on_terms = {**own.stage, **duals}
        multipliers = Multipliers(own.eta_C, own.eta, own.mu, own.nu, own.rho_u, own.rho_x, on_terms)
        certificate = judge(problem, trajectory, multipliers, allowed_residual(tolerance))
        bound, allowed = certificate.bound, (1 / FACET_LEVEL - 1) * costs + GAP_TOLERANCE * certificate.cost_scale
        proven = bound is not None and bound.kind == RIGOROUS and certificate.cost - bound.value <= allowed
        status = Status.OPTIMAL if certificate.feasible and proven else Status.NUMERICAL_ERROR
        certificate = certificate.raised(self.translation.cost)
        given, at, seconds = self.translation.given, self.translation.trajectory(trajectory), now() - started
        return Outcome(given, status, "condensed", None, {"certify": seconds}, at, multipliers, certificate)


def _with_bounds(lti: Lti) -> Lti:
    """Return the problem with bounds of all controls, which the kernel can move: where there is none, a far one."""
    of_controls = np.isin(np.arange(len(lti.bounds.lower)), lti.state_dim + np.arange(lti.control_dim))[:, None]
    bounds = lti.bounds.map(lambda sides: np.where(of_controls, np.clip(sides, -FAR, FAR), sides))
    return replace(lti, bounds=bounds)


class WindowedPlanner:
    """The kernel of a controller whose controls have windows, and the problems by which its plans are judged.

    Soft constraints are soft at every step.
    """

    def __init__(self, problem: OptimalControlProblem, penalties: Mapping[str, float], delay: int):
        stated = soften(free_first_state(problem), penalties)
        base = without_windows(stated)
        translation = translation_of(base if base.ends[0].fixed.all() else base.with_ends(np.zeros(base.state_dim)))
        if reduce_problem(translation.problem, REDUCTIONS).links:
            raise UnsupportedError(f"problem: it is solved as another one; {KERNEL_TAKES}.")
        self.stated, self.origin = stated, translation.origin
        self._translation, self._spectral = translation, SpectralSolver(translation.problem)
        units, self._lti = self._spectral.units, _with_bounds(self._spectral.lti)
        windows = control_windows(stated, units, delay)
        self._solver = CondensedSolver(self._lti, units, windows)
        self._rest = np.zeros((problem.horizon, problem.control_dim))
        none = np.zeros((delay, problem.control_dim))
        self._spectrum = [one.with_past(none, 0) for one in entries_of(problem.control_spectrum)]

    def plan(self, begin: Array, change: Change | None, budget: Budget) -> WindowedPlan:
        """Return the plan from a state, (n,), with previews if any."""
        stated, lti = self.stated, self._lti
        if change is not None:
            with one_blas_thread:
                stated = change.apply(self.stated)
                moved = self._translation.change(change, without_windows(stated))
                lti = _with_bounds(self._spectral.changed_problem(moved)[1])
        plan, kernel = self._solver.plan_windows(begin - self.origin, lti, budget), self._solver.kernel
        findings = kernel.exceeded, kernel.raised
        return WindowedPlan(self.origin, stated, plan, self._spectrum, self._rest, *findings)

    def hold(self, begin: Array, u: Array) -> bool:
        """Plan with this first control, (m,), and the rows of controls alone; return whether there is such a plan.

        ``apply`` goes on from it, else from the rest of the plan before.
        """
        solver, kernel, tables = self._solver, self._solver.kernel, self._solver.kernel.tables
        first = np.isin(tables.families - len(begin), np.arange(len(u)))
        of_states = tables.C[:, ~known_states(self.stated.linear)].any(axis=1, keepdims=True)
        lower, upper = (np.where(of_states, far, side) for far, side in zip((-FAR, FAR), tables.bounds, strict=True))
        lower[first, 0] = upper[first, 0] = u / solver.units.u
        kernel.take(replace(tables, bounds=(lower, upper)))
        settled = solver.plan_windows(begin - self.origin, tables.loop.lti, UNLIMITED).settled
        kernel.take(tables)
        return settled

    def shift(self, begin: Array, rounding: float, of_rows: float) -> Array:
        """Return how far rounding moves u_0 of the last plan, (m,): that of its begin, and of the levels of windows."""
        units, tables = self._solver.units, self._solver.kernel.tables
        gain = tables.loop.K + tables.W[: len(units.u), : len(begin)]  # without active rows
        return units.u * (rounding * np.abs(gain) @ np.abs(begin / units.x) + of_rows * self._solver.kernel.shift)

    def apply(self, u: Array) -> None:
        """Go on to the next step with the control that acts next."""
        units = self._solver.units.u
        chosen = self._solver.kernel.plan_of_controls * units
        self._rest = np.concatenate([chosen[1:], chosen[-1:]])
        self._spectrum = [one.with_past(u[None], 0) for one in self._spectrum]
        self._solver.kernel.apply(u / units)

    def correct(self, change: Array, ago: int) -> None:
        """Add a change to the control that acted so many samples before the next plan."""
        self._solver.kernel.correct_past(change / self._solver.units.u, ago)
        self._spectrum = [one.with_correction(change, ago) for one in self._spectrum]
