"""The description of a problem, from those of its parts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from operator import itemgetter
from textwrap import shorten

from lin_freq_ocp.base.phrases import interval, intervals, join_words, number, plural, runs_in_words, short_name
from lin_freq_ocp.problem.problem_data import ProblemData
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.base import entries_of

LONGEST_FACT = 300  # characters of a fact; names of any length could make it longer
Fact = tuple[str, str]  # a term, and its description


def problem_facts(problem: ProblemData, gap: str | None = None) -> list[Fact]:
    """Return the description of a problem as pairs of a term and its text; a term may occur more than once.

    ``gap`` is a place in the sets, as text, that the regions of all modes leave out, if there is one.
    """
    step, horizon, tube = problem.sampling_time, plural(problem.horizon, "step"), problem.control_tube
    if step is not None:
        horizon = f"{horizon} of {number(step)} s ({number(step * problem.horizon)} s)"
    facts = [
        ("horizon", horizon),
        *_cost(problem),
        *problem.dynamics.facts(_signals(problem)),
        *([("gap", f"no mode {gap}: infeasible there")] if gap and not _at_levels(problem) else []),
        *((f"control: {name}", _bounds(tube, i, problem.control_set)) for i, name in enumerate(problem.control_names)),
        *_states(problem),
        *_sets(problem),
        *[(f"rows: {rows.name}", rows.describe(_signals(problem))) for rows in problem.stage_rows],
        *_spectra(problem),
    ]
    return [(term, shorten(value, LONGEST_FACT, placeholder=" \N{HORIZONTAL ELLIPSIS}")) for term, value in facts]


def _cost(problem: ProblemData) -> list[Fact]:
    quadratic = problem.quadratic
    parts = [text for text in (quadratic.describe(), *(norm.describe() for norm in problem.cost.norms)) if text]
    if not parts:
        paid = [
            part.penalty
            for one in entries_of(problem.control_set)
            for part in one.parts(problem.control_dim)
            if not part.penalty.hard
        ]
        return [("minimise", "the costs of the control set" if paid else "nothing: any feasible point will do")]
    data = quadratic.describe_data()
    where = [
        ("where", join_words(data[at : at + 3])) for at in range(0, len(data), 3)
    ]  # each up to some sixty characters
    facts = [("minimise", parts[0]), *(("plus", part) for part in parts[1:])]
    return [facts[0], *where, *facts[1:]] if quadratic.describe() else facts


def _states(problem: ProblemData) -> list[Fact]:
    """Return bounds and ends of every state; what other sets say of them is a fact of its own."""
    boxes, facts = problem.state_boxes, list[Fact]()
    for i, name in enumerate(problem.state_names):
        words = [_bounds(boxes, i, problem.state_set)]
        for verb, what, given, box in (
            ("starts", "initial", problem.initial_state, problem.initial_box),
            ("ends", "terminal", problem.terminal_state, problem.terminal_box),
        ):
            text = interval(float(box.lower[i]), float(box.upper[i]))
            free = "anywhere" if not given.members else f"as the {what} set says"
            words.append(f"{verb} {free if text == 'no bound' else text}")
        if problem.dynamics.response(problem.horizon) is not None:
            words = [word for word in words if not word.endswith(" anywhere")]
        facts.append((f"state: {name}", "; ".join(words)))
    return facts


def _bounds(boxes: Box, i: int, given: object) -> str:
    """Return the bounds over time of component i of a set."""
    text = intervals(boxes.lower[:, i], boxes.upper[:, i])
    return f"{text} of its own" if text == "no bound" and _beyond_bounds(given) else text


def _beyond_bounds(given: object) -> bool:
    """Whether a set, or one of a list of them, is more than bounds on components."""
    return any(one.members for one in entries_of(given))


def _sets(problem: ProblemData) -> list[Fact]:
    """Return what is not bounds on components."""
    facts = list[Fact]()
    for term, given, names, signal in (
        ("state set", problem.state_set, problem.state_names, "x"),
        ("initial set", problem.initial_state, problem.state_names, "x"),
        ("terminal set", problem.terminal_state, problem.state_names, "x"),
        ("control set", problem.control_set, problem.control_names, "u"),
    ):
        if _beyond_bounds(given) and not (signal == "u" and _at_levels(problem)):
            facts.append((term, _over_time([one.describe(names, signal) for one in entries_of(given)])))
    return facts


def _at_levels(problem: ProblemData) -> bool:
    """Whether its modes are the levels of its controls, which the dynamics describe."""
    levels = any(len(one.levels_of(problem.control_dim)) for one in entries_of(problem.control_set))
    return levels and bool(problem.dynamics.mode_names)


def _over_time(words: Sequence[str]) -> str:
    """Return which set holds when; of many different ones, the first and the last."""
    if len(words) == 1:
        return words[0]
    runs = [[t for t, _ in run] for _, run in groupby(enumerate(words), key=itemgetter(1))]
    said = [f"t = {runs_in_words([(run[0], run[-1])])}: {words[run[0]]}" for run in runs]
    if len("; ".join(said)) <= LONGEST_FACT - 20:
        return "; ".join(said)
    if len(said[0]) + len(said[-1]) <= LONGEST_FACT - 60:
        return f"{said[0]}; {plural(len(said) - 2, 'other')} between; {said[-1]}"
    return f"{len(said)} sets, one after another"


def _spectra(problem: ProblemData) -> list[Fact]:
    facts = list[Fact]()
    for term, given, names in (
        ("control spectrum", problem.control_spectrum, problem.control_names),
        ("state spectrum", problem.state_spectrum, problem.state_names),
    ):
        facts += [(term, one.describe(names)) for one in entries_of(given)]
    for outputs in entries_of(problem.output_spectrum):
        facts.append(("outputs", outputs.describe(_signals(problem))))
        facts += [("output spectrum", one.describe(outputs.output_names)) for one in outputs.constraints]
    return facts


def _signals(problem: ProblemData) -> tuple[str, ...]:
    return (*(short_name(name) for name in problem.state_names), *problem.control_names)
