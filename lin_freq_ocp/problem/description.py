"""The description of a problem, from those of its parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from textwrap import shorten

import numpy as np

from lin_freq_ocp.base.errors import BandWarning, warn_user
from lin_freq_ocp.base.phrases import interval, intervals, join_words, number, plural, runs_in_words, short_name
from lin_freq_ocp.problem.problem_data import ProblemData, frequency_constraints
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import band_remarks
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.terms.term import Term

LONGEST_FACT = 300  # characters of a fact; names of any length could make it longer
Fact = tuple[str, str]  # a term, and its description


def problem_facts(problem: ProblemData, gap: str | None = None) -> list[Fact]:
    """Return the description of a problem as pairs of a term and its text; a term may occur more than once.

    ``gap`` describes a point of the sets outside all regions, if there is one.
    """
    step, horizon, tube = problem.sampling_time, plural(problem.horizon, "step"), problem.control_tube
    if step is not None:
        horizon = f"{horizon} of {number(step)} s ({number(step * problem.horizon)} s)"
    signals = *(short_name(name) for name in problem.state_names), *problem.control_names
    facts = [("horizon", horizon), *_cost(problem), *problem.dynamics.facts(signals)]
    choices, at_levels = problem.form.choices, problem.form.choices is not None
    if choices is not None:
        words = [one.describe(problem.control_names, "u") for one in entries_of(problem.control_set)]
        facts.append(("levels", f"{words[0]}; {plural(len(choices), 'mode')}"))
    if gap and not at_levels:
        facts.append(("gap", f"no mode {gap}: infeasible there"))
    for i, name in enumerate(problem.control_names):
        facts.append((f"control: {name}", _bounds(tube, i, problem.control_set)))
    facts += _states(problem)
    for term, convex_set, names, signal in (
        ("state set", problem.state_set, problem.state_names, "x"),
        ("initial set", problem.initial_state, problem.state_names, "x"),
        ("terminal set", problem.terminal_state, problem.state_names, "x"),
        ("control set", problem.control_set, problem.control_names, "u"),
    ):
        if _exceeds_bounds(convex_set) and not (signal == "u" and at_levels):
            facts.append((term, _over_time([part.describe(names, signal) for part in entries_of(convex_set)])))
    facts += [(f"rows: {rows.name}", rows.describe(signals)) for rows in problem.stage_rows]
    for term, spectrum, names in (
        ("control spectrum", problem.control_spectrum, problem.control_names),
        ("state spectrum", problem.state_spectrum, problem.state_names),
    ):
        facts += [(term, constraint.describe(names)) for constraint in entries_of(spectrum)]
    for outputs in entries_of(problem.output_spectrum):
        facts.append(("outputs", outputs.describe(signals)))
        facts += [("output spectrum", constraint.describe(outputs.output_names)) for constraint in outputs.constraints]
    return [(term, shorten(text, LONGEST_FACT, placeholder=" \N{HORIZONTAL ELLIPSIS}")) for term, text in facts]


def problem_remarks(problem: ProblemData, terms: Sequence[Term]) -> list[str]:
    """Return what limits nothing, or everything, and which references lie outside the bounds of their signals."""
    quadratic, remarks = problem.quadratic, [text.removesuffix(".") for text in _band_remarks(problem)]
    levels = [(where, one.levels) for _, where, one, _ in frequency_constraints(problem)]
    remarks += [f"{where}: its limit is infinite" for where, at in levels if at is not None and np.isposinf(at).all()]
    references = quadratic.x_ref, quadratic.u_ref
    weighed = [np.where(weighs, reference, 0.0) for weighs, reference in zip(quadratic.weighs, references, strict=True)]
    boxes, names = (problem.state_boxes, problem.control_tube), (problem.state_names, problem.control_names)
    for field, reference, box, signals in zip(("x_ref", "u_ref"), weighed, boxes, names, strict=True):
        outside = ((box.violation(reference) > 0) & (reference != 0)).sum(axis=0)
        parts = [f"{short_name(signals[i])} at {plural(outside[i], 'time')}" for i in np.flatnonzero(outside)]
        remarks += [f"cost.{field} lies outside the bounds: {', '.join(parts)}"] if parts else []
    return [remark for remark in (*remarks, *_limits_never_reached(problem, terms)) if remark]


def warn_of_bands(problem: ProblemData) -> None:
    """Warn of bands that remove or bound no bin, or remove every bin."""
    for text in _band_remarks(problem):
        warn_user(text, BandWarning)


def _band_remarks(problem: ProblemData) -> Iterator[str]:
    """Yield the remarks on the bands of each signal: those of one signal belong together."""
    for signal, entries in groupby(frequency_constraints(problem), key=itemgetter(3)):
        named = ((where, one) for _, where, one, _ in entries)
        yield from band_remarks(named, signal.length, signal.names, signal.sampling_time)


def _limits_never_reached(problem: ProblemData, terms: Sequence[Term]) -> Iterator[str]:
    """Yield which limits no signal within its bounds exceeds: |uhat_k| <= sqrt(N) |w u|, by Cauchy-Schwarz."""
    sizes = [np.maximum(np.abs(box.lower), np.abs(box.upper)) for box in (problem.state_boxes, problem.control_tube)]
    unbounded, bounded = [1.0 * np.isinf(size) for size in sizes], [np.nan_to_num(size, posinf=0.0) for size in sizes]
    for term in terms:
        spectrum, limits = term.map.spectrum, term.penalty.bounds(term.shape)[1]
        if term.statement and not term.semi_infinite and spectrum and not spectrum.sizes(*unbounded).any():
            most = np.sqrt(spectrum.samples * len(spectrum.real) / len(limits)) * spectrum.sizes(*bounded)
            if (most <= limits).all() and np.isfinite(limits).any():
                yield f"{term.name} limits nothing: the bounds of its signal keep the spectrum below it"


def _cost(problem: ProblemData) -> list[Fact]:
    """Return the terms of the cost as formulas, and the values of their letters."""
    quadratic = problem.quadratic
    parts = [text for text in (quadratic.describe(), *(norm.describe() for norm in problem.cost.norms)) if text]
    if not parts:
        sets, m = entries_of(problem.control_set), problem.control_dim
        priced = any(not part.penalty.hard for convex_set in sets for part in convex_set.parts(m))
        return [("minimise", "the costs of the control set" if priced else "nothing: any feasible point will do")]
    facts = [("minimise", parts[0]), *(("plus", part) for part in parts[1:])]
    if quadratic.describe():
        data = quadratic.describe_data()
        facts[1:1] = [("where", join_words(data[i : i + 3])) for i in range(0, len(data), 3)]  # some 60 characters each
    return facts


def _states(problem: ProblemData) -> list[Fact]:
    """Return bounds and ends of every state; other sets of states have facts of their own."""
    boxes, facts = problem.state_boxes, list[Fact]()
    for i, name in enumerate(problem.state_names):
        words = [_bounds(boxes, i, problem.state_set)]
        for verb, end, convex_set, box in (
            ("starts", "initial", problem.initial_state, problem.initial_box),
            ("ends", "terminal", problem.terminal_state, problem.terminal_box),
        ):
            text = interval(float(box.lower[i]), float(box.upper[i]))
            free = "anywhere" if not convex_set.members else f"as the {end} set says"
            words.append(f"{verb} {free if text == 'no bound' else text}")
        if problem.response is not None:
            words = [word for word in words if not word.endswith(" anywhere")]
        facts.append((f"state: {name}", "; ".join(words)))
    return facts


def _bounds(boxes: Box, i: int, convex_set: object) -> str:
    """Return the bounds over time of component i of a set."""
    text = intervals(boxes.lower[:, i], boxes.upper[:, i])
    return f"{text} of its own" if text == "no bound" and _exceeds_bounds(convex_set) else text


def _exceeds_bounds(convex_set: object) -> bool:
    """Whether a set, or one of a list of them, is more than bounds on components."""
    return any(part.members for part in entries_of(convex_set))


def _over_time(words: Sequence[str]) -> str:
    """Return which set holds at which times; of many different ones, the first and the last."""
    if len(words) == 1:
        return words[0]
    runs = [[t for t, _ in run] for _, run in groupby(enumerate(words), key=itemgetter(1))]
    parts = [f"t = {runs_in_words([(run[0], run[-1])])}: {words[run[0]]}" for run in runs]
    if len("; ".join(parts)) <= LONGEST_FACT - 20:
        return "; ".join(parts)
    if len(parts[0]) + len(parts[-1]) <= LONGEST_FACT - 60:
        return f"{parts[0]}; {plural(len(parts) - 2, 'other')} between; {parts[-1]}"
    return f"{len(parts)} sets, one after another"
