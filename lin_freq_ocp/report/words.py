"""What was found, in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.analysis.measures import stopped_runs
from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import filter_limits
from lin_freq_ocp.phrases import listed, number, plural, runs_in_words, short_name
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.report.entries import Entry, Excess, filtered_entry, has_frequency_constraint, shown_filter
from lin_freq_ocp.report.figures.scales import frequency_scale
from lin_freq_ocp.report.modes.spans import STOPPED
from lin_freq_ocp.report.modes.words import border_sentences
from lin_freq_ocp.report.numbers import quantity, rough
from lin_freq_ocp.solving.outcome import Outcome

NAMED = 2
"""How many components a sentence names before it only counts the others."""

FILTERING = "Filtering afterwards"

RIGOROUS = "rigorous"
"""The kind of a bound that holds for every trajectory; any other says nothing global."""

SAME_PEAK = 1e-2
"""Peaks that differ by less than this fraction are named together."""

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
    result, one = comparison.constrained, shown_filter(comparison)
    if not has_frequency_constraint(comparison.problem):
        return Finding("", "No frequency constraint, so nothing to filter", _without_constraint(result))
    filtering, limits = "", filter_limits(comparison.problem)
    if one is None and limits and comparison.filtered:
        filtering = f"does not apply: {limits}"
    if one is not None:
        entry = filtered_entry(comparison.problem, one)
        filtering = (
            ", ".join(faults(entry, comparison))
            or f"breaks no constraint{'' if entry.replayed else ' on the controls'}"
        )
        if not entry.replayed:
            growth = comparison.classical_measures.amplification
            filtering += f"; {stopped_replay() if one.replay.stopped else not_replayed(growth)}"
        filtering += f". Note: {limits}" if limits else ""
    return Finding(filtering, "With the constraint in the problem", _with_constraint(comparison))


def faults(entry: Entry, comparison: ComparisonOutcome) -> list[str]:
    """Return in words everything that a filtered control does and should not."""
    problem, words = entry.problem, list[str]()
    if entry.trajectory is None or entry.measures is None:
        return words
    words += _exceeded(entry.controls, problem.control_names, entry.trajectory.u)
    if entry.replayed:
        words += _left(entry.states, problem.state_names)
        words += _violated(entry.rows, [term.name for term in problem.terms if term.hard])
        words += _missed(entry.end, problem.state_names)
    for of_states, what in ((False, "control"), (True, "state")):
        if entry.leaves_band_empty(of_states) is False:
            energy = entry.measures.state_stopband_energy if of_states else entry.measures.stopband_energy
            words.append(f"leaves an energy of {number(energy, 3)} at the bins of the {what} stop band")
    return [*words, *_dearer(entry, comparison)]


def not_replayed(amplification: float) -> str:
    """Say why a replay would mean nothing."""
    return (
        "what the states would do cannot be replayed: over this horizon the dynamics amplify rounding errors "
        f"{rough(amplification)}-fold"
    )


def stopped_replay() -> str:
    """Say why a replay came to no end."""
    return f"its states {STOPPED}, so that they cannot be replayed to the end"


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
    if problem is not None and not problem.dynamics.affine and certificate.bound is None:
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
    for of_states, stopped, names in (
        (False, problem.control_stop, problem.control_names),
        (True, problem.state_stop, problem.state_names),
    ):
        if stopped.any():
            length = problem.horizon + 1 if of_states else problem.horizon
            sentences.append(removed_bins(problem, stopped, names, length))
            sentences.append(_between_the_bins(comparison, of_states))
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


def conflict_in_words(result: Outcome) -> list[str]:
    """Return the blocks of constraints that an infeasibility proof rests on."""
    return [str(one) for one in result.conflict or ()]


def _exceeded(excess: Excess | None, names: tuple[str, ...], u: Array) -> list[str]:
    if excess is None or excess.passed.all():
        return []
    broken = np.flatnonzero(~excess.passed)
    bounds = [
        f"the {short_name(names[j])} bound by {quantity(float(excess.values[j]), names[j])} "
        f"({_peak(u[:, j], names[j])})"
        for j in broken[:NAMED]
    ]
    return [f"exceeds {listed(bounds)}{_others(len(broken), 'other control')}"]


def _left(excess: Excess | None, names: tuple[str, ...]) -> list[str]:
    if excess is None or excess.passed.all():
        return []
    broken = np.flatnonzero(~excess.passed)
    states = listed([short_name(names[i]) for i in broken[:NAMED]])
    return [f"leaves the bounds on {states}{_others(len(broken), 'other state')}"]


def _violated(excess: Excess | None, names: Sequence[str]) -> list[str]:
    if excess is None or excess.passed.all():
        return []
    broken = np.flatnonzero(~excess.passed)
    words = list[str]()
    for i in map(int, broken[:NAMED]):
        words.append(f"{short_name(names[i])} by {quantity(float(excess.values[i]), names[i])}")
    return [f"violates {listed(words)}{_others(len(broken), 'other constraint')}"]


def _peak(signal: Array, name: str) -> str:
    size = np.abs(signal)
    times = np.flatnonzero(size >= (1 - SAME_PEAK) * size.max())
    where = listed([f"t = {t}" for t in times]) if len(times) <= NAMED else f"first at t = {times[0]}"
    return f"peaks at {quantity(float(size.max()), name)}, {where}"


def _missed(excess: Excess | None, names: tuple[str, ...]) -> list[str]:
    if excess is None or excess.passed.all():
        return []
    missed = np.flatnonzero(~excess.passed)
    words = [f"{quantity(float(excess.values[i]), names[i])} in {short_name(names[i])}" for i in missed[:NAMED]]
    return [f"misses the end by {listed(words)}{_others(len(missed), 'other state')}"]


def _others(count: int, noun: str) -> str:
    """Count what a sentence does not name."""
    return f" (and {plural(count - NAMED, noun)})" if count > NAMED else ""


def _dearer(entry: Entry, comparison: ComparisonOutcome) -> list[str]:
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
    worse = [
        f"the spectrum of the {what} peaks at {number(own, 3)} between the bins of its band, above the "
        f"{number(free, 3)} without the constraint"
        for what, free, own in _peaks(comparison)
        if own is not None and free is not None and own > (1 + SAME_PEAK) * free
    ]
    return f"every constraint holds at the bins, but {listed(worse)}" if worse else "everything holds"


def _peaks(comparison: ComparisonOutcome) -> list[tuple[str, float | None, float | None]]:
    """Return of controls and states the peak between the bins of their bands, without and with the constraint."""
    free, own = comparison.classical_measures, comparison.constrained_measures
    if own is None:
        return []
    return [
        ("control", free.stopband_peak, own.stopband_peak),
        ("state", free.state_stopband_peak, own.state_stopband_peak),
    ]


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
    field = "state_stopband_peak" if of_states else "stopband_peak"
    free = number(getattr(comparison.classical_measures, field), 3)
    if comparison.constrained_measures is None:
        parts = [f"{free} without the constraint"]
    else:
        parts = [
            f"{number(getattr(comparison.constrained_measures, field), 3)} with the constraint",
            f"{free} without it",
        ]
    one = shown_filter(comparison)
    filtered = None if one is None else getattr(one.replay.measures, field)
    if filtered is not None:
        parts.append(f"{number(filtered, 3)} after filtering")
    return (
        "Zero at these bins is not zero between them: the zero-padded spectrum, which looks between, still peaks at "
        f"{listed(parts)}."
    )
