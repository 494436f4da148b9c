"""Modes, and what holds where they meet, in sentences for an engineer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.certificate.modes.clarke import BorderFacts, Flip
from lin_freq_ocp.comparison.trajectories import NO_MODE
from lin_freq_ocp.phrases import listed, number, plural
from lin_freq_ocp.solving.outcome import Outcome

NAMED_TIMES = 4
"""Times of which a text names what is special to each before it only counts the others."""

ETA, XI, ALPHA = "\N{GREEK SMALL LETTER ETA}", "\N{GREEK SMALL LETTER XI}", "\N{GREEK SMALL LETTER ALPHA}"


def border_sentences(borders: BorderFacts) -> list[str]:
    """Return what the judge found where the dynamics have no single derivative."""
    sentences = list[str]()
    if borders.jumping is not None:
        first, second = (_quoted(borders.mode_names[i]) for i in (borders.jumping.first, borders.jumping.second))
        sentences.append(
            f"The map jumps at the border between {first} and {second}, so the maximum principle makes no statement "
            "there; what follows was looked at all the same."
        )
    if not borders.times and not borders.norms:
        what = "No two modes meet along this trajectory" if len(borders.mode_names) > 1 else "No kink lies on it"
        return [*sentences, f"{what}: the dynamics have one derivative at every step, and nothing had to be chosen."]
    sentences.append(f"{_where(borders)}. There the dynamics have no single derivative.")
    sentences.append(_joint(borders))
    sentences.append(_flips(borders))
    sentences.append(_printed(borders))
    return sentences


def search_sentences(result: Outcome) -> list[str]:
    """Return what a search over mode sequences proves; nothing where there was none."""
    proof = result.tree_bound
    if result.tree is None or proof is None:
        return []
    size = f"{plural(len(result.tree.nodes), 'node')}, of which {_count(proof.leaves, 'is a leaf', 'are leaves')}"
    if not proof.covers:
        return [f"The search over mode sequences has {size}. They do not cover all sequences, so nothing is bounded."]
    if np.isposinf(proof.value):
        bound = "no leaf can contain a trajectory"
    elif np.isneginf(proof.value):
        bound = "but not every leaf has a bound"
    else:
        bound = f"the least of their bounds is {number(proof.value, 9)}"
    return [
        f"The search over mode sequences has {size}. The leaves cover all sequences, and the multipliers of each were "
        f"checked apart from the search: {bound}."
    ]


def modes_caption(rows: Sequence[tuple[str, Indices | None]], main: str) -> str:
    """Say what the strips show; ``main`` is the trajectory whose modes are behind the panels."""
    whose = "these" if len(rows) == 1 else f"those of the {main} trajectory"
    text = f"The mode at t holds from t to t + 1. The tints behind the panels in time are {whose}."
    if any(sequence is not None and (sequence == NO_MODE).any() for _, sequence in rows):
        text += " Dashed: outside the regions of all modes."
    return text


def adjoint_caption(borders: BorderFacts) -> str:
    """Say what the bars are, with the weights or selections of each."""
    text = (
        f"{ETA} at t is the price of the state at t + 1: by how much, to first order, the cost falls per unit that "
        "something pushes it up there."
    )
    if not borders.times and not borders.norms:
        return text
    text += (
        f" Bars: all values that this component of D_x <{ETA}, f> takes {_range(borders)}. Diamonds: the value that "
        "the adjoint equation requires. It must lie within the bar, and for all components of x and u by the same "
        f"{_choice(borders)}: {'; '.join(_choices(borders))}."
    )
    return text


def _range(borders: BorderFacts) -> str:
    ball = f"|{XI}| \N{LESS-THAN OR EQUAL TO} 1"
    of_norms = f"over all {XI} with {ball} where a norm of some q is zero, whose slope is {XI}' Dq"
    parts = (["over the modes that meet"] if borders.times else []) + ([of_norms] if borders.norms else [])
    return " and ".join(parts)


def _choice(borders: BorderFacts) -> str:
    parts = ([f"weights {ALPHA}"] if borders.times else []) + ([f"selection {XI}"] if borders.norms else [])
    return " and ".join(parts)


def _choices(borders: BorderFacts) -> list[str]:
    """Return the weights and the selections, time by time."""
    parts = [
        f"at t = {t}: {ALPHA} = {_weights(alpha, borders.mode_names)}"
        for t, alpha in zip(borders.times, borders.weights, strict=True)
    ]
    parts += [f"at t = {one.time}, {one.norm} = 0: {XI} = {_vector(one.selection)}" for one in borders.norms]
    return [*parts[:NAMED_TIMES], *([f"{len(parts) - NAMED_TIMES} more"] if len(parts) > NAMED_TIMES else [])]


def _where(borders: BorderFacts) -> str:
    parts = list[str]()
    if borders.times:
        parts.append(f"modes meet at {_times(borders.times)}")
    for norm in dict.fromkeys(one.norm for one in borders.norms):
        parts.append(f"{norm} is zero at {_times([one.time for one in borders.norms if one.norm == norm])}")
    text = listed(parts)
    return f"{text[0].upper() if borders.times else text[0]}{text[1:]}"


def _joint(borders: BorderFacts) -> str:
    """Clarke's rule, with what was chosen."""
    chosen = "; ".join(_choices(borders))
    if borders.joint:
        return (
            "The necessary condition holds (joint inclusion, Clarke's rule): with one choice of the derivative for "
            f"states and controls alike, the adjoint equation and stationarity in u are satisfied, {chosen}."
        )
    return (
        "The necessary condition fails with these multipliers (joint inclusion, Clarke's rule): no one choice of the "
        f"derivative satisfies every condition. The nearest is, {chosen}."
    )


def _flips(borders: BorderFacts) -> str:
    if borders.flip_stationary:
        return (
            "The trajectory is flip-stationary: to first order, nothing is gained by passing to any other mode that "
            "meets there, or by leaving the kink."
        )
    rising = [one for one in borders.norms if one.rate > 0]
    flips = borders.flips if borders.elsewhere else tuple(flip for flip in borders.flips if flip.improves)
    if not flips and not rising:
        return "Whether another mode at a border would be better was not established (not flip-stationary)."
    parts = [_flip(flip, borders) for flip in flips[:NAMED_TIMES]]
    parts += [
        f"away from {one.norm} = 0 at t = {one.time} (rate {number(one.rate, 2)})" for one in rising[:NAMED_TIMES]
    ]
    hidden = max(len(flips) - NAMED_TIMES, 0) + max(len(rising) - NAMED_TIMES, 0)
    more = f", and {hidden} more" if hidden else ""
    text = f"It is not flip-stationary: with these multipliers the Hamiltonian rises {', '.join(parts)}{more}."
    if not any(flip.improves for flip in flips):
        text += " This alone does not prove that the cost can fall: there may be other multipliers."
    return text


def _flip(flip: Flip, borders: BorderFacts) -> str:
    known = {
        True: ", and the cost does fall there, which was verified",
        False: ", where the cost does not fall: that sequence has other multipliers",
        None: "",
    }
    mode = _quoted(borders.mode_names[flip.mode])
    return f"towards {mode} at t = {flip.time} (rate {number(flip.rate, 2)}{known[flip.improves]})"


def _printed(borders: BorderFacts) -> str:
    function = f"\N{MINUS SIGN}<{ETA}, f>"
    holds = "holds, too" if borders.joint and borders.printed else "holds" if borders.printed else "does not hold"
    regular = "is" if borders.regular else "is not"
    return (
        f"The form that the paper prints, with one inclusion for the states and one for the controls, {holds}; it is "
        f"meant for {function} regular in Clarke's sense, which it {regular} here."
    )


def _weights(alpha: Array, names: Sequence[str]) -> str:
    """Return the weights that are not zero, with the modes they belong to."""
    used = [int(i) for i in np.flatnonzero(alpha)]
    return listed([f"{number(float(alpha[i]), 3)} {_quoted(names[i])}" for i in used] or ["0"])


def _quoted(name: str) -> str:
    """Return a mode's name in quotation marks: it may have commas."""
    return f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}"


def _vector(parts: Sequence[float]) -> str:
    return f"({', '.join(number(part, 3) for part in parts)})"


def _times(times: Sequence[int]) -> str:
    return f"t = {listed([str(t) for t in times])}" if len(times) <= 2 * NAMED_TIMES else plural(len(times), "time")


def _count(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"
