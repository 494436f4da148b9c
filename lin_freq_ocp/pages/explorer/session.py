"""The answers of a live page: a problem at the values of its sliders, solved again and again and judged.

What bounds and ends of a problem do not change is kept between solves (``comparison.many.repeated``).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Generic, TypeVar

from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.repeated import Repeated
from lin_freq_ocp.certificate.bound import NUMERICAL
from lin_freq_ocp.comparison.compare import PREFERRED_FILTER, ComparisonOutcome, Filtered
from lin_freq_ocp.comparison.filters import can_be_filtered, filtered, has_frequency_constraint
from lin_freq_ocp.comparison.trajectories import replayed
from lin_freq_ocp.pages.explorer.ends import ends_at
from lin_freq_ocp.pages.explorer.frequencies import GROUP as FREQUENCY
from lin_freq_ocp.pages.explorer.limits import sets_at
from lin_freq_ocp.pages.explorer.slider import Values
from lin_freq_ocp.pages.explorer.sliders import KEPT, Rebuild, changed, checked, problem_at, sliders_of
from lin_freq_ocp.pages.explorer.view import Data, drawn, frame
from lin_freq_ocp.pages.report.findings import finding
from lin_freq_ocp.pages.report.proof import verdict
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.kept import Change
from lin_freq_ocp.solving.outcome import Outcome

SOLVE_SECONDS = 10.0  # for one answer
KEPT_PROBLEMS, KEPT_ANSWERS = 8, 64  # the latest ones

Key = tuple[tuple[str, float], ...]
Item = TypeVar("Item")


class Latest(Generic[Item]):
    """The latest few of what was made, by their keys."""

    def __init__(self, most: int):
        self._most, self._items = most, OrderedDict[Hashable, Item]()

    def get(self, key: Hashable, make: Callable[[], Item]) -> Item:
        """Return what was made for a key, or make it."""
        found = self._items[key] if key in self._items else make()
        self._items[key] = found
        self._items.move_to_end(key)
        if len(self._items) > self._most:
            self._items.popitem(last=False)
        return found


class Session:
    """A problem with its sliders, and what was solved of it."""

    def __init__(self, problem: OptimalControlProblem, rebuild: Rebuild | None = None):
        if "convex" not in family_of(problem).shorthands or problem.dynamics.mode_names:
            raise UnsupportedError(
                f"explore: got {family_of(problem).kind} dynamics, where one answer can take minutes; expected linear "
                "dynamics or a frequency response. For such problems: 'sweep --grid', or 'compare' of one."
            )
        self.problem, self.rebuild = problem, rebuild
        self.sliders = sliders_of(problem, rebuild)
        self._repeated = Latest[Repeated](KEPT_PROBLEMS)
        self._outcomes = Latest[Outcome](KEPT_ANSWERS)

    def answer(self, given: object) -> Data:
        """Return status, cost, certificate and trajectory at these values of the sliders."""
        values = checked(self.sliders, given)
        try:
            return answer_data(self.outcome(values))
        except LinFreqOCPError as error:  # such as a problem file whose arrays do not fit this horizon
            return {"status": "error", "message": str(error)}

    def beside(self, given: object) -> Data:
        """Return the classical solution and what a filter makes of it, at these values; nothing without a band."""
        values = checked(self.sliders, given)
        constrained = self.outcome(values)
        problem = constrained.problem
        if not has_frequency_constraint(problem):
            return {"finding": "", "trajectories": []}
        classical = self.outcome(values, classical=True)
        plan = classical.trajectory
        if not classical.status.solved or plan is None:
            return {"finding": f"no classical solution, {classical.status}", "trajectories": []}
        entries = ()
        if can_be_filtered(problem):
            control = filtered(PREFERRED_FILTER, problem, plan.u)
            replay = replayed(PREFERRED_FILTER, problem, control.u, plan)
            entries = (Filtered(PREFERRED_FILTER, control.description, replay),)
        compared = ComparisonOutcome(problem, classical, constrained, entries)
        shown = [("classical", compared.classical_solution), *(("filtered", one.replay) for one in entries)]
        return {
            "finding": finding(compared).filtering,
            "trajectories": [
                {"name": name, "cost": number(one.measures.cost, 6), "meaningful": one.meaningful}
                | drawn(problem, one.trajectory)
                for name, one in shown
            ],
        }

    def cure(self, given: object, key: object, wanted: Callable[[], bool] = lambda: True) -> Data:
        """Return the least move of one slider after which there is a solution, all others as they are; or none.

        By bisection over its notches; it ends early when the answer is not wanted any more.
        """
        values = checked(self.sliders, given)
        slider = next((one for one in self.sliders if one.key == key), None)
        if slider is None:
            raise ProblemError("slider", repr(key), f"one of {', '.join(one.key for one in self.sliders)}")

        def suffices(n: int) -> bool:
            return self.outcome({**values, slider.key: slider.notch(n)}).status.solved

        least, most = (round((value - slider.value) / slider.step) for value in (values[slider.key], slider.relaxed))
        if least == most or not suffices(most):
            return {"key": slider.key, "value": None}
        while abs(most - least) > 1 and wanted():
            middle = (least + most) // 2
            least, most = (least, middle) if suffices(middle) else (middle, most)
        return {"key": slider.key, "value": slider.notch(most)}

    def outcome(self, values: Values, classical: bool = False) -> Outcome:
        """Return how the problem at these values ends, with or without its frequency constraints."""
        moved = changed(self.sliders, values)
        if classical:
            moved = self._of_groups(moved, lambda group: group != FREQUENCY)
        return self._outcomes.get((classical, *moved.items()), lambda: self._solved(moved, classical))

    def _of_groups(self, moved: Values, wanted: Callable[[str], bool]) -> dict[str, float]:
        """Return the moved values of some groups of sliders."""
        groups = {slider.key: slider.group for slider in self.sliders}
        return {key: value for key, value in moved.items() if wanted(groups[key])}

    def _solved(self, moved: dict[str, float], classical: bool) -> Outcome:
        structure = self._of_groups(moved, lambda group: group not in KEPT)
        repeated = self._repeated.get((classical, *structure.items()), lambda: self._prepared(structure, classical))
        sets, ends = sets_at(repeated.problem, moved), ends_at(repeated.problem, moved)
        change = Change(ends.get("initial_state"), ends.get("terminal_state"), bounds=sets or None)
        return repeated.solve(change, SOLVE_SECONDS)

    def _prepared(self, structure: dict[str, float], classical: bool) -> Repeated:
        problem = problem_at(self.problem, self.rebuild, structure)
        if classical:
            problem = replace(problem, control_spectrum=None, state_spectrum=None, output_spectrum=None)
        return Repeated(problem)


def answer_data(outcome: Outcome) -> Data:
    """Return an outcome as the page shows it."""
    certificate, trajectory = outcome.certificate, outcome.trajectory
    return {
        "status": outcome.status,
        "message": outcome.message,
        "practical": outcome.status == Status.INFEASIBLE and outcome.bound == NUMERICAL,
        "cost": outcome.cost,
        "words": {
            "cost": number(outcome.cost, 6),
            "gap": number(outcome.gap, 2),
            "bound": number(outcome.lower_bound, 6),
            "solver": outcome.solver,
            "seconds": number(1e3 * sum(outcome.seconds.values()), 2),
        },
        "gap": outcome.gap,
        "lower_bound": outcome.lower_bound,
        "theorem": _theorem(outcome),
        "proof": [] if certificate is None else verdict(certificate, outcome.problem),
        "conflict": [part.block for part in outcome.conflict or ()],
        "frame": frame(outcome.problem),
        "trajectory": None if trajectory is None else drawn(outcome.problem, trajectory),
    }


def _theorem(outcome: Outcome) -> str:
    """Say what the judge found of the maximum principle."""
    certificate = outcome.certificate
    if certificate is None:
        return "no point to judge"
    if certificate.pmp != "satisfied":
        return certificate.pmp.replace("_", " ")
    return f"satisfied, {'normal' if certificate.normal else 'abnormal'}"
