"""The proof of a solution in sentences: maximum principle, global bound, switching, search over modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.phrases import join_words, number, plural
from lin_freq_ocp.certificate.hybrid.clarke import SwitchingFacts, facts_where_modes_meet
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.trajectories import NO_MODE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.hybrid.modes import tree_of
from lin_freq_ocp.solving.outcome import Outcome

NAMED_TIMES = 4  # times that a text describes; it counts the others
RIGOROUS = "rigorous"  # the kind of a bound that holds for every trajectory; no other kind is global

ETA, XI, ALPHA = "\N{GREEK SMALL LETTER ETA}", "\N{GREEK SMALL LETTER XI}", "\N{GREEK SMALL LETTER ALPHA}"


def proven_optimal(result: Outcome) -> bool:
    """Whether status and certificate both say that no other trajectory is cheaper."""
    return result.status == "optimal" and result.certificate is not None and result.certificate.globally_optimal


def bound_kind(certificate: Certificate) -> str:
    """Return "global" for a rigorous bound, else "numerical"."""
    return "global" if certificate.bound is not None and certificate.bound.kind == RIGOROUS else "numerical"


def verdict(certificate: Certificate, problem: OptimalControlProblem | None = None) -> list[str]:
    """Return what a certificate of the problem proves: the maximum principle and, separately, the bound."""
    if certificate.pmp == "satisfied":
        kind = f"normal ({ETA}_C = 1)" if certificate.normal else "abnormal (no cost enters)"
        first = (
            f"The maximum principle is satisfied: every condition holds within its tolerance. The extremal is {kind}."
        )
    elif certificate.pmp == "violated":
        failed = join_words([f"{condition.label} ({condition.name})" for condition in certificate.failed])
        first = f"The maximum principle is violated. Violated conditions: {failed}."
    elif certificate.borders is not None:
        first = "The maximum principle does not apply: it needs dynamics without jumps."
    else:
        first = "The maximum principle was not checked: there are no multipliers."
    borders = facts_where_modes_meet(certificate)
    switching = [] if borders is None else switching_sentences(borders)
    if problem is not None and not problem.form.affine and certificate.bound is None:
        bound = ["There is no global lower bound: the dynamics are not affine, and none was found."]
    else:
        bound = _bound_in_words(certificate)
    return [first, *switching, *bound]


def _bound_in_words(certificate: Certificate) -> list[str]:
    if certificate.bound is None or certificate.lower_bound is None or certificate.gap is None:
        if certificate.borders is not None:
            return ["There is no global lower bound: with modes, it needs a search over their sequences."]
        return ["There is no global lower bound: the cost is not convex, or the multipliers give none."]
    rigorous = certificate.bound.kind == RIGOROUS
    kind = "the bound is rigorous and includes rounding errors"
    if not rigorous:
        kind = "the bound is numerical: it holds for trajectories of a similar size, and proves nothing about others"
    sentence = (
        f"The cost {number(certificate.cost, 9)} is within {number(abs(certificate.gap), 2)} (relative) of the "
        f"{bound_kind(certificate)} lower bound {number(certificate.lower_bound, 9)}; {kind} "
        f"(from {certificate.bound.sets})."
    )
    if certificate.globally_optimal and rigorous:
        return [sentence, "So no other trajectory that satisfies the constraints is noticeably cheaper."]
    return [sentence]


def parts_of_the_gap(certificate: Certificate) -> str:
    """Return the parts of the difference between cost and global bound."""
    bound = certificate.bound
    if bound is None or bound.stage_gaps is None:
        return ""
    residuals = -bound.dynamics_term - bound.frequency_term + bound.stage_term
    return (
        f"Parts of the gap between the cost and the {bound_kind(certificate)} lower bound. "
        f"The stages add up to {number(float(bound.stage_gaps.sum()), 2)}, "
        f"residuals of the constraints to {number(residuals, 2)}; "
        f"the allowance for rounding errors is {number(bound.rounding, 2)}. "
        "Hollow triangles: too small for the axis, or negative."
    )


def switching_sentences(borders: SwitchingFacts) -> list[str]:
    """Return the facts that the judge verified where the dynamics have no single derivative."""
    sentences = list[str]()
    if borders.jumping is not None:
        first, second = (_quote(borders.mode_names[i]) for i in (borders.jumping.first, borders.jumping.second))
        sentences.append(
            f"The map jumps at the switching boundary between {first} and {second}, so the maximum principle makes no "
            "statement there; the following was checked nevertheless."
        )
    if borders.gaps:
        sentences.append(
            f"At {_times(borders.gaps)} the trajectory lies at the edge of a gap between the regions, where the "
            "dynamics are not defined, so the maximum principle makes no statement; the following was checked "
            "nevertheless."
        )
    if not borders.times and not borders.norms:
        fact = "No two modes meet along this trajectory" if len(borders.mode_names) > 1 else "No kink lies on it"
        return [*sentences, f"{fact}: the dynamics have a unique derivative at every step."]
    places = list[str]()
    if borders.times:
        places.append(f"modes meet{' or end' if borders.gaps else ''} at {_times(borders.times)}")
    for norm in dict.fromkeys(kink.norm for kink in borders.norms):
        places.append(f"{norm} is zero at {_times([kink.time for kink in borders.norms if kink.norm == norm])}")
    where = join_words(places)
    where = f"{where[0].upper() if borders.times else where[0]}{where[1:]}"
    chosen = "; ".join(_choices(borders))
    joint = (  # Clarke's joint inclusion, with the elements that were chosen
        "The necessary condition holds (joint inclusion, Clarke's rule): one choice of the derivative for states and "
        f"controls together satisfies the adjoint equation and stationarity in u, {chosen}."
    )
    if not borders.joint:
        joint = (
            "The necessary condition fails with these multipliers (joint inclusion, Clarke's rule): no choice of the "
            f"derivative satisfies every condition. The nearest choice is, {chosen}."
        )
    function = f"\N{MINUS SIGN}<{ETA}, f>"
    holds = "holds, too" if borders.joint and borders.printed else "holds" if borders.printed else "does not hold"
    regular = "is" if borders.regular else "is not"
    printed = (
        f"The form in the paper, with one inclusion for the states and one for the controls, {holds}; it requires "
        f"{function} to be regular in Clarke's sense, which it {regular} here."
    )
    return [
        *sentences,
        f"{where}. There the dynamics have no single derivative.",
        joint,
        _flips_in_words(borders),
        printed,
    ]


def search_sentences(result: Outcome) -> list[str]:
    """Return what a search over mode sequences proves; nothing without a search."""
    evidence = tree_of(result)
    if evidence is None:
        return []
    proof = evidence.bound
    leaves = "1 is a leaf" if proof.leaves == 1 else f"{proof.leaves} are leaves"
    size = f"{plural(len(evidence.tree.nodes), 'node')}; {leaves}"
    if not proof.covers:
        return [f"The search over mode sequences has {size}. They do not cover all sequences, so there is no bound."]
    if np.isposinf(proof.value):
        bound = "no leaf can contain a trajectory"
    elif np.isneginf(proof.value):
        bound = "but not every leaf has a bound"
    else:
        bound = f"the least of their bounds is {number(proof.value, 9)}"
    return [
        f"The search over mode sequences has {size}. The leaves cover all sequences, and the multipliers of each were "
        f"checked independently of the search: {bound}."
    ]


def modes_caption(rows: Sequence[tuple[str, Indices | None]], main: str) -> str:
    """Describe the strips; the modes of the trajectory ``main`` tint the panels."""
    whose = "these" if len(rows) == 1 else f"those of the {main} trajectory"
    text = f"The mode at t is active from t to t + 1. The tints of the panels over time are {whose}."
    if any(sequence is not None and (sequence == NO_MODE).any() for _, sequence in rows):
        text += " Dashed: outside the regions of all modes."
    return text


def adjoint_caption(borders: SwitchingFacts) -> str:
    """Describe the bars, with the weights or selections of each."""
    text = (
        f"{ETA} at t is the price of the state at t + 1: the first-order decrease of the cost per unit by which the "
        "state is pushed up there."
    )
    values, choices = list[str](), list[str]()
    if borders.times:
        values.append("over the modes that meet")
        choices.append(f"weights {ALPHA}")
    if borders.norms:
        ball = f"|{XI}| \N{LESS-THAN OR EQUAL TO} 1"
        values.append(f"over all {XI} with {ball} where a norm of some q is zero, whose slope is {XI}' Dq")
        choices.append(f"selection {XI}")
    if not values:
        return text
    return text + (
        f" Bars: all values of this component of D_x <{ETA}, f> {' and '.join(values)}. Diamonds: the value that the "
        "adjoint equation requires. It must lie within the bar, with the same "
        f"{' and '.join(choices)} for all components of x and u: {'; '.join(_choices(borders))}."
    )


def _choices(borders: SwitchingFacts) -> list[str]:
    """Return the weights and selections at each time."""
    parts = list[str]()
    for t, alpha in zip(borders.times, borders.weights, strict=True):  # nonzero weights with their modes
        used = [f"{number(float(alpha[i]), 3)} {_quote(borders.mode_names[i])}" for i in np.flatnonzero(alpha)]
        parts.append(f"at t = {t}: {ALPHA} = {join_words(used or ['0'])}")
    for kink in borders.norms:
        selection = ", ".join(number(part, 3) for part in kink.selection)
        parts.append(f"at t = {kink.time}, {kink.norm} = 0: {XI} = ({selection})")
    return [*parts[:NAMED_TIMES], *([f"{len(parts) - NAMED_TIMES} more"] if len(parts) > NAMED_TIMES else [])]


def _flips_in_words(borders: SwitchingFacts) -> str:
    if borders.flip_stationary:
        return (
            "The trajectory is flip-stationary: to first order, a switch to another mode that meets there, or a step "
            "away from the kink, does not reduce the cost."
        )
    rising = [kink for kink in borders.norms if kink.rate > 0]
    flips = borders.flips if borders.elsewhere else tuple(flip for flip in borders.flips if flip.improves)
    if not flips and not rising:
        return "It is open whether another mode at a switching boundary would be better (not flip-stationary)."
    effects = {
        True: ", and the cost does fall there, which was verified",
        False: ", where the cost does not fall: that sequence has other multipliers",
        None: "",
    }
    parts = list[str]()
    for flip in flips[:NAMED_TIMES]:
        rate = f"(rate {number(flip.rate, 2)}{effects[flip.improves]})"
        parts.append(f"towards {_quote(borders.mode_names[flip.mode])} at t = {flip.time} {rate}")
    for kink in rising[:NAMED_TIMES]:
        parts.append(f"away from {kink.norm} = 0 at t = {kink.time} (rate {number(kink.rate, 2)})")
    hidden = max(len(flips) - NAMED_TIMES, 0) + max(len(rising) - NAMED_TIMES, 0)
    more = f", and {hidden} more" if hidden else ""
    text = f"It is not flip-stationary: with these multipliers the Hamiltonian rises {', '.join(parts)}{more}."
    if not any(flip.improves for flip in flips):
        text += " This alone does not prove that the cost can fall: there may be other multipliers."
    return text


def _quote(name: str) -> str:
    """Return a mode's name in quotation marks, as it may contain commas."""
    return f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}"


def _times(times: Sequence[int]) -> str:
    return f"t = {join_words([str(t) for t in times])}" if len(times) <= 2 * NAMED_TIMES else plural(len(times), "time")
