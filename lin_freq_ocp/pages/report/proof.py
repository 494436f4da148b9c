"""What is proven of a solution, in sentences: maximum principle, global bound, switching, search over modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.phrases import join_words, number, plural
from lin_freq_ocp.certificate.hybrid.clarke import Flip, SwitchingFacts, facts_where_modes_meet
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.trajectories import NO_MODE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.hybrid.modes import tree_of
from lin_freq_ocp.solving.outcome import Outcome

NAMED_TIMES = 4  # times that a text describes before it only counts the others
RIGOROUS = "rigorous"  # the kind of a bound that holds for every trajectory; any other says nothing global

ETA, XI, ALPHA = "\N{GREEK SMALL LETTER ETA}", "\N{GREEK SMALL LETTER XI}", "\N{GREEK SMALL LETTER ALPHA}"


def proven_optimal(result: Outcome) -> bool:
    """Whether status and certificate both say that no other trajectory is cheaper."""
    return result.status == "optimal" and result.certificate is not None and result.certificate.globally_optimal


def bound_kind(certificate: Certificate) -> str:
    """Return "global" for a rigorous bound, else "numerical"."""
    return "global" if certificate.bound is not None and certificate.bound.kind == RIGOROUS else "numerical"


def verdict(certificate: Certificate, problem: OptimalControlProblem | None = None) -> list[str]:
    """Return what a certificate, of that problem, proves: the maximum principle and the bound, which are two facts."""
    if certificate.pmp == "satisfied":
        kind = f"normal ({ETA}_C = 1)" if certificate.normal else "abnormal (no cost enters)"
        first = (
            f"The maximum principle is satisfied: every condition holds within its tolerance. The extremal is {kind}."
        )
    elif certificate.pmp == "violated":
        failed = join_words([f"{condition.label} ({condition.name})" for condition in certificate.failed])
        first = f"The maximum principle is violated. What does not hold: {failed}."
    elif certificate.borders is not None:
        first = "The maximum principle does not apply: it needs dynamics without jumps."
    else:
        first = "The maximum principle was not judged: there are no multipliers."
    borders = facts_where_modes_meet(certificate)
    switching = [] if borders is None else switching_sentences(borders)
    if problem is not None and not problem.dynamics.affine and certificate.bound is None:
        bound = ["There is no global lower bound: the dynamics are not affine, and none was found."]
    else:
        bound = _global_bound(certificate)
    return [first, *switching, *bound]


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
        f"{bound_kind(certificate)} lower bound {number(certificate.lower_bound, 9)}; {kind} "
        f"(from {certificate.bound.sets})."
    )
    if certificate.globally_optimal and rigorous:
        return [sentence, "So no other trajectory that satisfies the constraints is noticeably cheaper."]
    return [sentence]


def parts_of_the_gap(certificate: Certificate) -> str:
    """Return what the difference of cost and global bound consists of."""
    bound = certificate.bound
    if bound is None or bound.stage_gaps is None:
        return ""
    residuals = -bound.dynamics_term - bound.frequency_term + bound.stage_term
    return (
        f"Where the cost exceeds the {bound_kind(certificate)} lower bound. "
        f"The stages add up to {number(float(bound.stage_gaps.sum()), 2)}; "
        f"residuals of the constraints count {number(residuals, 2)}, "
        f"and rounding errors are allowed for with {number(bound.rounding, 2)}. "
        "Hollow triangles: too small for the axis, or negative."
    )


def switching_sentences(borders: SwitchingFacts) -> list[str]:
    """Return what the judge found where the dynamics have no single derivative."""
    sentences = list[str]()
    if borders.jumping is not None:
        first, second = (_quote(borders.mode_names[i]) for i in (borders.jumping.first, borders.jumping.second))
        sentences.append(
            f"The map jumps at the border between {first} and {second}, so the maximum principle makes no statement "
            "there; what follows was looked at all the same."
        )
    if borders.gaps:
        sentences.append(
            f"At {_times(borders.gaps)} the trajectory lies on the rim of a gap between the regions, where the "
            "dynamics are not defined, so the maximum principle makes no statement; what follows was looked at all the "
            "same."
        )
    if not borders.times and not borders.norms:
        what = "No two modes meet along this trajectory" if len(borders.mode_names) > 1 else "No kink lies on it"
        return [*sentences, f"{what}: the dynamics have one derivative at every step, and nothing had to be chosen."]
    places = list[str]()
    if borders.times:
        places.append(f"modes meet{' or end' if borders.gaps else ''} at {_times(borders.times)}")
    for norm in dict.fromkeys(one.norm for one in borders.norms):
        places.append(f"{norm} is zero at {_times([one.time for one in borders.norms if one.norm == norm])}")
    where = join_words(places)
    where = f"{where[0].upper() if borders.times else where[0]}{where[1:]}"
    chosen = "; ".join(_choices(borders))
    joint = (  # Clarke's joint inclusion, with the elements that were chosen
        "The necessary condition holds (joint inclusion, Clarke's rule): with one choice of the derivative for "
        f"states and controls alike, the adjoint equation and stationarity in u are satisfied, {chosen}."
    )
    if not borders.joint:
        joint = (
            "The necessary condition fails with these multipliers (joint inclusion, Clarke's rule): no one choice of "
            f"the derivative satisfies every condition. The nearest is, {chosen}."
        )
    function = f"\N{MINUS SIGN}<{ETA}, f>"
    holds = "holds, too" if borders.joint and borders.printed else "holds" if borders.printed else "does not hold"
    regular = "is" if borders.regular else "is not"
    printed = (
        f"The form that the paper prints, with one inclusion for the states and one for the controls, {holds}; it is "
        f"meant for {function} regular in Clarke's sense, which it {regular} here."
    )
    return [*sentences, f"{where}. There the dynamics have no single derivative.", joint, _flips(borders), printed]


def search_sentences(result: Outcome) -> list[str]:
    """Return what a search over mode sequences proves; nothing where there was none."""
    found = tree_of(result)
    if found is None:
        return []
    proof = found.bound
    leaves = "1 is a leaf" if proof.leaves == 1 else f"{proof.leaves} are leaves"
    size = f"{plural(len(found.tree.nodes), 'node')}, of which {leaves}"
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


def adjoint_caption(borders: SwitchingFacts) -> str:
    """Say what the bars are, with the weights or selections of each."""
    text = (
        f"{ETA} at t is the price of the state at t + 1: by how much, to first order, the cost falls per unit that "
        "something pushes it up there."
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
        f" Bars: all values that this component of D_x <{ETA}, f> takes {' and '.join(values)}. Diamonds: the value "
        "that the adjoint equation requires. It must lie within the bar, and for all components of x and u by the same "
        f"{' and '.join(choices)}: {'; '.join(_choices(borders))}."
    )


def _choices(borders: SwitchingFacts) -> list[str]:
    """Return the weights and the selections, time by time."""
    parts = list[str]()
    for t, alpha in zip(borders.times, borders.weights, strict=True):  # those that are not zero, with their modes
        used = [f"{number(float(alpha[i]), 3)} {_quote(borders.mode_names[i])}" for i in np.flatnonzero(alpha)]
        parts.append(f"at t = {t}: {ALPHA} = {join_words(used or ['0'])}")
    for kink in borders.norms:
        selection = ", ".join(number(part, 3) for part in kink.selection)
        parts.append(f"at t = {kink.time}, {kink.norm} = 0: {XI} = ({selection})")
    return [*parts[:NAMED_TIMES], *([f"{len(parts) - NAMED_TIMES} more"] if len(parts) > NAMED_TIMES else [])]


def _flips(borders: SwitchingFacts) -> str:
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


def _flip(flip: Flip, borders: SwitchingFacts) -> str:
    known = {
        True: ", and the cost does fall there, which was verified",
        False: ", where the cost does not fall: that sequence has other multipliers",
        None: "",
    }
    mode = _quote(borders.mode_names[flip.mode])
    return f"towards {mode} at t = {flip.time} (rate {number(flip.rate, 2)}{known[flip.improves]})"


def _quote(name: str) -> str:
    """Return a mode's name in quotation marks: it may have commas."""
    return f"\N{LEFT DOUBLE QUOTATION MARK}{name}\N{RIGHT DOUBLE QUOTATION MARK}"


def _times(times: Sequence[int]) -> str:
    return f"t = {join_words([str(t) for t in times])}" if len(times) <= 2 * NAMED_TIMES else plural(len(times), "time")
