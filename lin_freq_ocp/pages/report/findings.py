"""The finding of a comparison in sentences, made from its numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.phrases import join_words, number, plural, runs_in_words, short_name
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import filter_limits, has_frequency_constraint
from lin_freq_ocp.comparison.trajectories import SAME_PEAK, MeasuredTrajectory, Violation, controls_of
from lin_freq_ocp.pages.report.proof import RIGOROUS, proven_optimal
from lin_freq_ocp.pages.report.tables import moves_sentence, stop_band_figures
from lin_freq_ocp.pages.units import frequency_scale, quantity, rough
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.solving.outcome import Outcome

FILTERING = "Filtering afterwards"
NAMED = 2  # components that a sentence names; it counts the others
MORE_EXPENSIVE = 1e-2  # smallest relative extra cost of a filtered control that is mentioned
NOTABLE = 1.0  # percent; a smaller difference of two costs has two digits


@dataclass(frozen=True)
class Finding:
    """The result of filtering (empty without a filter) and of the constraint, without full stops."""

    filtering: str
    setting: str
    solution: str

    def __str__(self) -> str:
        filtering = f"{FILTERING}: {self.filtering}. " if self.filtering else ""
        return f"{filtering}{self.setting}: {self.solution}."


def finding_of(comparison: ComparisonOutcome) -> Finding:
    """Return the effects of filtering afterwards and of the constraint in the problem."""
    result, shown = comparison.constrained, comparison.shown_filter
    if not has_frequency_constraint(comparison.problem):
        solution = _without_solution(result) or f"the cost is {number(result.cost)}, {_proof_in_words(result)}"
        return Finding("", "No frequency constraint, so nothing to filter", solution)
    filtering, limits = "", filter_limits(comparison.problem)
    if shown is None and limits:
        filtering = f"does not apply: {limits}"
        filtering += "" if comparison.moves is None else f"; {moves_sentence(comparison.moves)}"
        filtering += comparison.shaper_obstacle and f"; input shapers do not apply: {comparison.shaper_obstacle}"
    if shown is not None:
        replay = shown.replay
        filtering = ", ".join(faults(replay, comparison))
        if not filtering and not replay.between_levels:
            filtering = f"breaks no constraint{'' if replay.meaningful else ' on the controls'}"
        if replay.stopped:
            filtering += (
                f"{'; ' if filtering else ''}its {replay.why_stopped}, so that they cannot be simulated to the end"
            )
        elif not replay.meaningful:
            filtering += (
                "; the states cannot be simulated: over this horizon the dynamics amplify rounding errors "
                f"{rough(comparison.classical_measures.amplification)}-fold"
            )
        filtering += f". Note: {limits}" if limits else ""
    return Finding(filtering, "With the constraint in the problem", _with_constraint(comparison))


def faults(replay: MeasuredTrajectory, comparison: ComparisonOutcome) -> list[str]:
    """Return in words the constraints that a filtered control violates, and its extra cost."""
    problem, controls = replay.problem, controls_of(replay.problem)
    names, hard = problem.state_names, [term for term in problem.terms if term.hard]

    def bound_text(name: str, size: str, j: int) -> str:
        times = replay.peak_times(controls[j])
        where = join_words([f"t = {t}" for t in times]) if len(times) <= NAMED else f"first at t = {times[0]}"
        peak = quantity(replay.largest(controls[j]), controls[j].name)
        return f"the {name} bound by {size} (peaks at {peak}, {where})"

    def term_text(name: str, size: str, i: int) -> str:
        readings = hard[i].readings(replay.trajectory.x, replay.trajectory.u)
        worst = max(readings, key=lambda reading: reading.ratio, default=None)
        return f"{name} by {size}" if worst is None else f"{name} ({worst})"

    sentences = [
        *_violations("exceeds", replay.controls, problem.control_names, "other control", bound_text),
        *_violations("leaves the bounds on", replay.states, names, "other state", lambda name, size, i: name),
        *_violations("violates", replay.terms, [term.name for term in hard], "other constraint", term_text),
        *_violations("misses the end by", replay.end, names, "other state", lambda name, size, i: f"{size} in {name}"),
    ]
    measures, best = replay.measures, comparison.constrained.cost
    for of_states, kind in ((False, "control"), (True, "state")):
        if replay.empties_band(of_states) is False:
            energy = stop_band_figures(measures, of_states)[0]
            sentences.append(f"leaves an energy of {number(energy, 3)} at the bins of the {kind} stop band")
    if best is not None and measures.cost is not None and comparison.constrained.primal:
        if measures.cost > best + MORE_EXPENSIVE * abs(best):
            sentences.append(
                f"costs {number(measures.cost, 4)}, more than the {number(best, 4)} of the constrained solution"
            )
    return sentences


def _violations(
    verb: str, violation: Violation | None, names: Sequence[str], noun: str, text: Callable[[str, str, int], str]
) -> list[str]:
    """Return a sentence with the ``text`` of name, size and index of each violated bound; none without a violation."""
    if violation is None or violation.passed.all():
        return []
    violated = np.flatnonzero(~violation.passed).tolist()
    parts = [text(short_name(names[i]), quantity(float(violation.values[i]), names[i]), i) for i in violated[:NAMED]]
    others = f" (and {plural(len(violated) - NAMED, noun)})" if len(violated) > NAMED else ""
    return [f"{verb} {join_words(parts)}{others}"]


def _with_constraint(comparison: ComparisonOutcome) -> str:
    result, before, after = comparison.constrained, comparison.classical.cost, comparison.constrained.cost
    if result.status == "infeasible":
        return (
            "no trajectory satisfies all constraints, which is proven; without those on frequencies there is a "
            "solution, so they are part of the conflict"
        )
    if after is None:
        return _without_solution(result)
    if before is None or before <= 0 or after > 2 * before:
        extra = f"for a cost of {number(after)} instead of {number(before)}"
    else:
        percent = 100 * (after / before - 1)
        size = f"{abs(percent):.{1 if abs(percent) >= NOTABLE else 2}f}"
        extra = f"for {size} % {'more' if percent > 0 else 'less'} cost" if float(size) else "at the same cost"
    return f"{_constraints_in_words(comparison)}, {extra}, {_proof_in_words(result)}"


def _without_solution(result: Outcome) -> str:
    if result.cost is not None:
        return ""
    if result.status == Status.LIMIT:
        return f"no point found ({result.message})"
    return f"no solution ({result.status.replace('_', ' ')}: {result.message})"


def _constraints_in_words(comparison: ComparisonOutcome) -> str:
    """Say whether every constraint holds, and whether a spectrum between bins is larger than without the constraint."""
    result, constrained = comparison.constrained, comparison.constrained_measures
    if not result.primal:
        return f"not every constraint holds ({result.message or result.status.replace('_', ' ')})"
    both, larger = (constrained, comparison.classical_measures), list[str]()
    for of_states, kind in ((False, "control"), (True, "state")):
        peak, before = (measures and stop_band_figures(measures, of_states)[1] for measures in both)
        if peak is not None and before is not None and peak > (1 + SAME_PEAK) * before:
            larger.append(
                f"the spectrum of the {kind} peaks at {number(peak, 3)} between the bins of its band, above the "
                f"{number(before, 3)} without the constraint"
            )
    between = result.between_samples
    samples = "" if between is None or between.holds else f" at the samples (between them {between})"
    if larger:
        return f"every constraint holds at the bins, but {join_words(larger)}"
    return f"all constraints hold{samples}"


def _proof_in_words(result: Outcome) -> str:
    """Say what is proven of a solution, in accordance with its status."""
    certificate = result.certificate
    if certificate is None or certificate.gap is None or certificate.bound is None:
        gap = "without a bound on the optimal cost"
    elif proven_optimal(result):
        return f"proven optimal within {number(abs(certificate.gap), 2)}"
    else:
        kind = "" if certificate.bound.kind == RIGOROUS else " to a numerical bound"
        gap = f"not proven optimal (gap {number(certificate.gap, 2)}{kind})"
    if result.status == "extremal":
        return f"a saddle that satisfies the maximum principle, but along a direction the cost falls, {gap}"
    if not Status(result.status).solved:
        return f"{gap}; the solve ended with: {result.status.replace('_', ' ')}"
    if certificate is not None and certificate.pmp == "satisfied":
        return f"locally optimal as far as the maximum principle says, {gap}"
    return gap


def stop_band_meaning(comparison: ComparisonOutcome) -> list[str]:
    """Say which bins are zero, for components with the same bins together, and which peak remains between them."""
    problem, sentences, scale = comparison.problem, list[str](), frequency_scale(comparison.problem)
    for stopped, names, length, field in (
        (problem.control_stop, problem.control_names, problem.horizon, "stopband_peak"),
        (problem.state_stop, problem.state_names, problem.state_samples, "state_stopband_peak"),
    ):
        sharing = dict[tuple[tuple[int, int], ...], list[str]]()
        for i, name in enumerate(names):
            runs = tuple(stopped_runs(stopped[:, i]))
            if runs:
                sharing.setdefault(runs, []).append(short_name(name))
        parts = list[str]()
        for runs, components in sharing.items():
            spans = [tuple(number(scale.factor * 2 * np.pi * k / length, 4) for k in run) for run in runs]
            frequencies = join_words([low if low == high else f"{low} to {high}" for low, high in spans])
            parts.append(f"{runs_in_words(runs)} of {join_words(components)} ({frequencies} {scale.unit})")
        if not parts:
            continue
        sentences.append(
            f"On a horizon of {length} samples, these DFT bins and their mirror images are zero: {'; '.join(parts)}."
        )
        shown, constrained = comparison.shown_filter, comparison.constrained_measures
        filtered = None if shown is None else getattr(shown.replay.measures, field)
        peaks = [] if constrained is None else [f"{number(getattr(constrained, field), 3)} with the constraint"]
        without = number(getattr(comparison.classical_measures, field), 3)
        peaks.append(f"{without} without {'it' if peaks else 'the constraint'}")
        peaks += [] if filtered is None else [f"{number(filtered, 3)} after filtering"]
        sentences.append(
            "Zero at these bins does not mean zero between them: the zero-padded spectrum between the bins still peaks "
            f"at {join_words(peaks)}."
        )
    return sentences
