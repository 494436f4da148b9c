"""What was found, in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.analysis.measures import stopped_runs
from lin_freq_ocp.arrays import Mask
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import filter_limits, has_frequency_constraint
from lin_freq_ocp.comparison.replay import STOPPED
from lin_freq_ocp.comparison.signals import Signal, controls_of
from lin_freq_ocp.comparison.trajectories import SAME_PEAK, MeasuredTrajectory, Violation
from lin_freq_ocp.phrases import listed, number, plural, runs_in_words, short_name
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.report.figures.scales import frequency_scale
from lin_freq_ocp.report.modes.words import border_sentences
from lin_freq_ocp.report.numbers import quantity, rough
from lin_freq_ocp.solving.outcome import Outcome

NAMED = 2
"""How many components a sentence names before it only counts the others."""

FILTERING = "Filtering afterwards"

RIGOROUS = "rigorous"
"""The kind of a bound that holds for every trajectory; any other says nothing global."""

DEARER = 1e-2
"""A filtered control that costs at most this fraction more than the constrained one costs no more in words."""

NOTABLE = 1.0
"""Percent: a smaller difference of two costs is shown with two digits."""


@dataclass(frozen=True)
class Finding:
    """The result of a comparison in a sentence for each way, without a full stop.

    Attributes
    ----------
    filtering : str
        What filtering afterwards does; empty where nothing was filtered.
    setting, solution : str
        What the solution is of, and what is found of it.
    """

    filtering: str
    setting: str
    solution: str

    def __str__(self) -> str:
        filtering = f"{FILTERING}: {self.filtering}. " if self.filtering else ""
        return f"{filtering}{self.setting}: {self.solution}."


def finding(comparison: ComparisonOutcome) -> Finding:
    """Return what filtering afterwards does, and what the constraint in the problem does."""
    result, one = comparison.constrained, comparison.shown_filter()
    if not has_frequency_constraint(comparison.problem):
        return Finding("", "No frequency constraint, so nothing to filter", _without_constraint(result))
    filtering, limits = "", filter_limits(comparison.problem)
    if one is None and limits and comparison.filtered:
        filtering = f"does not apply: {limits}"
    if one is not None:
        entry = comparison.replayed(one)
        filtering = (
            ", ".join(faults(entry, comparison))
            or f"breaks no constraint{'' if entry.replayed else ' on the controls'}"
        )
        if not entry.replayed:
            growth = rough(comparison.classical_measures.amplification)
            filtering += (
                f"; its states {STOPPED}, so that they cannot be replayed to the end"
                if one.replay.stopped
                else "; what the states would do cannot be replayed: over this horizon the dynamics amplify rounding "
                f"errors {growth}-fold"
            )
        filtering += f". Note: {limits}" if limits else ""
    return Finding(filtering, "With the constraint in the problem", _with_constraint(comparison))


def faults(entry: MeasuredTrajectory, comparison: ComparisonOutcome) -> list[str]:
    """Return in words everything that a filtered control does and should not."""
    problem, words = entry.problem, list[str]()
    if entry.trajectory is None or entry.measures is None:
        return words
    words += _exceeded(entry)
    if entry.replayed:
        left, others = _broken(entry.states, problem.state_names, "other state")
        if left:
            words.append(f"leaves the bounds on {listed([name for name, _ in left])}{others}")
        terms = [term.name for term in problem.terms if term.hard]
        violated, others = _broken(entry.terms, terms, "other constraint")
        if violated:
            words.append(f"violates {listed([f'{name} by {size}' for name, size in violated])}{others}")
        missed, others = _broken(entry.end, problem.state_names, "other state")
        words += (
            [f"misses the end by {listed([f'{size} in {name}' for name, size in missed])}{others}"] if missed else []
        )
    for of_states, what in ((False, "control"), (True, "state")):
        if entry.empties_band(of_states) is False:
            energy = entry.measures.state_stopband_energy if of_states else entry.measures.stopband_energy
            words.append(f"leaves an energy of {number(energy, 3)} at the bins of the {what} stop band")
    return [*words, *_dearer(entry, comparison)]


def verdict(certificate: Certificate, problem: OptimalControlProblem | None = None) -> list[str]:
    """Return what a certificate, of that problem, proves: the maximum principle and the bound, which are two facts."""
    sentences = list[str]()
    if certificate.pmp == "satisfied":
        kind = "normal (\N{GREEK SMALL LETTER ETA}_C = 1)" if certificate.normal else "abnormal (no cost enters)"
        sentences.append(
            f"The maximum principle is satisfied: every condition holds within its tolerance. The extremal is {kind}."
        )
    elif certificate.pmp == "violated":
        failed = listed([f"{one.label} ({one.name})" for one in certificate.failed])
        sentences.append(f"The maximum principle is violated. What does not hold: {failed}.")
    elif certificate.borders is not None:
        sentences.append("The maximum principle does not apply: it needs dynamics without jumps.")
    else:
        sentences.append("The maximum principle was not judged: there are no multipliers.")
    if certificate.borders is not None:
        sentences += border_sentences(certificate.borders)
    smooth = problem is not None and isinstance(problem.dynamics, PiecewiseSmoothDynamics)
    if smooth and certificate.bound is None:
        return [*sentences, "There is no global lower bound: the dynamics are not affine, and none was found."]
    return [*sentences, *_global_bound(certificate)]


def parts_of_the_gap(certificate: Certificate) -> str:
    """Return what the difference of cost and global bound consists of."""
    bound = certificate.bound
    if bound is None or bound.stage_gaps is None:
        return ""
    residuals = -bound.dynamics_term - bound.frequency_term + bound.stage_term
    return (
        f"Where the cost exceeds the {'global' if bound.kind == RIGOROUS else 'numerical'} lower bound. "
        f"The stages add up to {number(float(bound.stage_gaps.sum()), 2)}; "
        f"residuals of the constraints count {number(residuals, 2)}, "
        f"and rounding errors are allowed for with {number(bound.rounding, 2)}. "
        "Hollow triangles: too small for the axis, or negative."
    )


def stop_band_meaning(comparison: ComparisonOutcome) -> list[str]:
    """Say what is removed where, and what remains between the bins."""
    problem, sentences = comparison.problem, list[str]()
    bands = (problem.control_stop, problem.control_names), (problem.state_stop, problem.state_names)
    for of_states, (stopped, names) in enumerate(bands):
        if stopped.any():
            sentences.append(removed_bins(problem, stopped, names, problem.horizon + of_states))
            sentences.append(_between_the_bins(comparison, bool(of_states)))
    return sentences


def removed_bins(problem: OptimalControlProblem, stopped: Mask, names: tuple[str, ...], length: int) -> str:
    """Return which bins of which components are zero; components with the same bins are named together."""
    scale, sharing = frequency_scale(problem), dict[tuple[tuple[int, int], ...], list[str]]()
    for i, name in enumerate(names):
        runs = tuple(stopped_runs(stopped[:, i]))
        if runs:
            sharing.setdefault(runs, []).append(short_name(name))
    places = list[str]()
    for runs, components in sharing.items():
        spans = [tuple(number(scale.factor * 2 * np.pi * k / length, 4) for k in run) for run in runs]
        frequencies = listed([low if low == high else f"{low} to {high}" for low, high in spans])
        places.append(f"{runs_in_words(runs)} of {listed(components)} ({frequencies} {scale.unit})")
    return f"On a horizon of {length} samples, these DFT bins and their mirror images are zero: {'; '.join(places)}."


def _exceeded(entry: MeasuredTrajectory) -> list[str]:
    if entry.controls is None or entry.controls.passed.all():
        return []
    broken, controls = np.flatnonzero(~entry.controls.passed), controls_of(entry.problem)
    bounds = [
        f"the {short_name(controls[j].name)} bound by {quantity(float(entry.controls.values[j]), controls[j].name)} "
        f"({_peak(entry, controls[j])})"
        for j in broken[:NAMED]
    ]
    return [f"exceeds {listed(bounds)}{_others(len(broken), 'other control')}"]


def _peak(entry: MeasuredTrajectory, signal: Signal) -> str:
    times = entry.peak_times(signal)
    where = listed([f"t = {t}" for t in times]) if len(times) <= NAMED else f"first at t = {times[0]}"
    return f"peaks at {quantity(entry.largest(signal) or 0.0, signal.name)}, {where}"


def _broken(violation: Violation | None, names: Sequence[str], noun: str) -> tuple[list[tuple[str, str]], str]:
    """Return name and size of the first broken bounds, and the count of the others."""
    broken = [] if violation is None else [int(i) for i in np.flatnonzero(~violation.passed)]
    sizes = [] if violation is None else [quantity(float(violation.values[i]), names[i]) for i in broken[:NAMED]]
    named = [(short_name(names[i]), size) for i, size in zip(broken, sizes, strict=False)]
    return named, _others(len(broken), noun)


def _others(count: int, noun: str) -> str:
    """Count what a sentence does not name."""
    return f" (and {plural(count - NAMED, noun)})" if count > NAMED else ""


def _dearer(entry: MeasuredTrajectory, comparison: ComparisonOutcome) -> list[str]:
    """Say if a filtered control costs more than the constrained one, which is never its purpose."""
    own = None if entry.measures is None else entry.measures.cost
    best = comparison.constrained.cost
    if own is None or best is None or own <= best + DEARER * abs(best) or not comparison.constrained.primal:
        return []
    return [f"costs {number(own, 4)}, more than the {number(best, 4)} of the constrained solution"]


def _with_constraint(comparison: ComparisonOutcome) -> str:
    result = comparison.constrained
    if result.status == "infeasible":
        return (
            "no trajectory satisfies all constraints, which is proven; without those on frequencies there is a "
            "solution, so they are part of the conflict"
        )
    if result.cost is None:
        return f"no solution ({result.status.replace('_', ' ')}: {result.message})"
    return f"{_holds(comparison)}, {_extra_cost(comparison.classical.cost, result.cost)}, {_proven(result)}"


def _holds(comparison: ComparisonOutcome) -> str:
    """Say whether every constraint holds, and if the spectrum between the bins of a band is none the better for it."""
    result = comparison.constrained
    if not result.primal:
        return f"not every constraint holds ({result.message or result.status.replace('_', ' ')})"
    worse = list[str]()
    for what, field in (("control", "stopband_peak"), ("state", "state_stopband_peak")):
        free, own = (
            getattr(one, field, None) for one in (comparison.classical_measures, comparison.constrained_measures)
        )
        if own is not None and free is not None and own > (1 + SAME_PEAK) * free:
            worse.append(
                f"the spectrum of the {what} peaks at {number(own, 3)} between the bins of its band, above the "
                f"{number(free, 3)} without the constraint"
            )
    return f"every constraint holds at the bins, but {listed(worse)}" if worse else "everything holds"


def _without_constraint(result: Outcome) -> str:
    if result.cost is None:
        return f"no solution ({result.status.replace('_', ' ')}: {result.message})"
    return f"the cost is {number(result.cost)}, {_proven(result)}"


def _extra_cost(before: float | None, after: float) -> str:
    if before is None or before <= 0 or after > 2 * before:
        return f"for a cost of {number(after)} instead of {number(before)}"
    percent = 100 * (after / before - 1)
    return f"for {percent:.{1 if percent >= NOTABLE else 2}f} % more cost"


def _proven(result: Outcome) -> str:
    """Say what is proven of a solution, in the words of its status."""
    certificate = result.certificate
    if proven_optimal(result) and certificate is not None and certificate.gap is not None:
        return f"proven optimal within {number(abs(certificate.gap), 2)}"
    if certificate is None or certificate.gap is None or certificate.bound is None:
        gap = "without a bound on the optimal cost"
    else:
        kind = "" if certificate.bound.kind == RIGOROUS else " to a numerical bound"
        gap = f"not proven optimal (gap {number(certificate.gap, 2)}{kind})"
    if result.status not in ("optimal", "locally_optimal"):
        return f"{gap}; the solve ended with: {result.status.replace('_', ' ')}"
    if certificate is not None and certificate.pmp == "satisfied":
        return f"locally optimal as far as the maximum principle says, {gap}"
    return gap


def proven_optimal(result: Outcome) -> bool:
    """Whether status and certificate both say that no other trajectory is cheaper."""
    return result.status == "optimal" and result.certificate is not None and result.certificate.globally_optimal


def _global_bound(certificate: Certificate) -> list[str]:
    if certificate.bound is None or certificate.lower_bound is None or certificate.gap is None:
        if certificate.borders is not None:
            return ["There is no global lower bound: with modes, it takes a search over their sequences."]
        return ["There is no global lower bound: the cost is not convex, or the multipliers give none."]
    rigorous = certificate.bound.kind == RIGOROUS
    kind = "the bound is rigorous, with rounding errors counted in"
    if not rigorous:
        kind = "the bound is numerical: valid for trajectories of a similar size, and no proof for all others"
    sentence = (
        f"The cost {number(certificate.cost, 9)} is within {number(abs(certificate.gap), 2)} (relative) of the "
        f"{'global' if rigorous else 'numerical'} lower bound {number(certificate.lower_bound, 9)}; "
        f"{kind} (from {certificate.bound.sets})."
    )
    if certificate.globally_optimal and rigorous:
        return [sentence, "So no other trajectory that satisfies the constraints is noticeably cheaper."]
    return [sentence]


def _between_the_bins(comparison: ComparisonOutcome, of_states: bool) -> str:
    field, one = "state_stopband_peak" if of_states else "stopband_peak", comparison.shown_filter()
    measured = comparison.constrained_measures, comparison.classical_measures, one and one.replay.measures
    own, free, filtered = (None if found is None else getattr(found, field) for found in measured)
    parts = [] if comparison.constrained_measures is None else [f"{number(own, 3)} with the constraint"]
    parts.append(f"{number(free, 3)} without {'it' if parts else 'the constraint'}")
    parts += [] if filtered is None else [f"{number(filtered, 3)} after filtering"]
    return (
        "Zero at these bins is not zero between them: the zero-padded spectrum, which looks between, still peaks at "
        f"{listed(parts)}."
    )
