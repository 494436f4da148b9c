"""The answers of a live page: a problem at the values of its sliders, solved again and again and judged.

Bounds and ends leave the solver cache valid, which is kept between solves (``batch.repeated``); other values build the
problem again. What can be moved is what the problem lists of its limits (``problem.limits``), and its horizon.

The page draws plain data in the axes' units: signals over time, and their spectra. The spectrum of a signal v of N
samples is |V_k| = |sum_t v_t exp(-2 pi i k t / N)|, k = 0 .. N//2, as limits mean it.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError, ProblemError, UnsupportedError, suggestion
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.repeated import Repeated
from lin_freq_ocp.certificate.bound import NUMERICAL
from lin_freq_ocp.comparison.compare import PREFERRED_FILTER, ComparisonOutcome, Filtered
from lin_freq_ocp.comparison.filters import apply_filter, can_be_filtered, has_frequency_constraint
from lin_freq_ocp.comparison.moves import HIGHEST_LIMIT, frequencies_around, vibration
from lin_freq_ocp.comparison.trajectories import ProblemSignal, controls_of, outputs_of, replay_control, states_of
from lin_freq_ocp.pages.explorer.sliders import GROUP_OF, Slider, sliders_of_limits
from lin_freq_ocp.pages.report.findings import finding
from lin_freq_ocp.pages.report.proof import verdict
from lin_freq_ocp.pages.units import frequency_scale, time_scale
from lin_freq_ocp.problem.limits import SPECTRA, changed_fields
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.kept import Change
from lin_freq_ocp.solving.outcome import Outcome

HORIZON = "horizon"
HORIZON_NOTCHES = 60  # between half the problem's own horizon and its double, about

# The groups of sliders in the order of the page, with their headings.
GROUPS = {
    "frequency": "Frequency",
    "bounds": "Control bounds",
    "rows": "Joint limits",
    "horizon": "Horizon",
    "state_bounds": "State bounds",
    "initial_state": "Initial state",
    "terminal_state": "Terminal state",
}
FOLDED = "state_bounds", "initial_state", "terminal_state"  # shown when they are asked for
KEPT = "bounds", *FOLDED  # what they change leaves what is set up once as it is

Rebuild = Callable[[int], OptimalControlProblem]  # the same problem over another horizon

DIGITS = 4  # significant, of values that are drawn
MOST_SIGNALS = 24  # that are drawn over time; controls come first

Data = dict[str, object]  # as JSON has it

SOLVE_SECONDS = 10.0  # for one answer
KEPT_PROBLEMS, KEPT_ANSWERS = 8, 64  # the latest ones

Values = Mapping[str, float]  # the value of each slider, by its key
Item = TypeVar("Item")


def sliders_of(problem: OptimalControlProblem, rebuild: Rebuild | None) -> tuple[Slider, ...]:
    """Return the sliders of a problem, group by group."""
    found = [*_horizon_slider(problem, rebuild), *sliders_of_limits(problem)]
    return tuple(sorted(found, key=lambda slider: list(GROUPS).index(slider.group)))


def _horizon_slider(problem: OptimalControlProblem, rebuild: Rebuild | None) -> Iterator[Slider]:
    """Yield the horizon, if the problem can be built over others."""
    T = problem.horizon
    notch = max(1, T // HORIZON_NOTCHES)
    low, high = T - (T // 2 // notch) * notch, T + (T // notch) * notch
    if rebuild is not None and _can_be_built(rebuild, low) and _can_be_built(rebuild, high):
        yield Slider(HORIZON, "horizon", "horizon", "steps", low, high, notch, T, high)


def _can_be_built(rebuild: Rebuild, horizon: int) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)
        try:
            return rebuild(horizon).horizon == horizon
        except (LinFreqOCPError, TypeError, ValueError):  # no such parameter, or arrays over this horizon alone
            return False


def checked_values(sliders: tuple[Slider, ...], given: object) -> dict[str, float]:
    """Return the value of every slider, the problem's own where none is given; raise ProblemError if one is wrong."""
    if not isinstance(given, Mapping):
        raise ProblemError("values", brief(given), "an object with the values of sliders")
    known = {slider.key: slider for slider in sliders}
    for key, value in given.items():
        if key not in known:
            raise ProblemError(
                f"values.{key}", "no slider of that name", f"some of {', '.join(known)}", suggestion(key, known)
            )
        slider = known[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not slider.low <= value <= slider.high:
            expected = f"a number from {slider.low:.6g} to {slider.high:.6g} {slider.unit}".rstrip()
            raise ProblemError(f"values.{key}", brief(value), expected)
    return {key: float(given.get(key, slider.value)) for key, slider in known.items()}


def problem_at(problem: OptimalControlProblem, rebuild: Rebuild | None, moved: Values) -> OptimalControlProblem:
    """Return the problem with these values."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)  # the page shows which bins are stopped
        if HORIZON in moved and rebuild is not None:
            problem = rebuild(int(moved[HORIZON]))
        fields = changed_fields(problem, {key: value for key, value in moved.items() if key != HORIZON})
        return replace(problem, **fields) if fields else problem


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
        values = checked_values(self.sliders, given)
        try:
            return answer_data(self.outcome(values))
        except LinFreqOCPError as error:  # such as a problem file whose arrays do not fit this horizon
            return {"status": "error", "message": str(error)}

    def beside(self, given: object) -> Data:
        """Return the classical solution and what a filter makes of it, at these values; nothing without a band."""
        values = checked_values(self.sliders, given)
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
            control = apply_filter(PREFERRED_FILTER, problem, plan.u)
            replay = replay_control(PREFERRED_FILTER, problem, control.u, plan)
            entries = (Filtered(PREFERRED_FILTER, control.description, replay),)
        compared = ComparisonOutcome(problem, classical, constrained, entries)
        shown = [("classical", compared.classical_solution), *(("filtered", one.replay) for one in entries)]
        return {
            "finding": finding(compared).filtering,
            "trajectories": [
                {"name": name, "cost": number(one.measures.cost, 6), "meaningful": one.meaningful}
                | trajectory_data(problem, one.trajectory)
                for name, one in shown
            ],
        }

    def cure(self, given: object, key: object, wanted: Callable[[], bool] = lambda: True) -> Data:
        """Return the least move of one slider after which there is a solution, all others as they are; or none.

        By bisection over its notches; it ends early when the answer is not wanted any more.
        """
        values = checked_values(self.sliders, given)
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
        moved = {one.key: values[one.key] for one in self.sliders if values[one.key] != one.value}
        if classical:
            moved = self._values_of_groups(moved, lambda group: group != GROUP_OF["control_spectrum"])
        return self._outcomes.get((classical, *moved.items()), lambda: self._solve(moved, classical))

    def _values_of_groups(self, moved: Values, wanted: Callable[[str], bool]) -> dict[str, float]:
        """Return the moved values of some groups of sliders."""
        groups = {slider.key: slider.group for slider in self.sliders}
        return {key: value for key, value in moved.items() if wanted(groups[key])}

    def _solve(self, moved: dict[str, float], classical: bool) -> Outcome:
        structure = self._values_of_groups(moved, lambda group: group not in KEPT)

        def prepare() -> Repeated:
            problem = problem_at(self.problem, self.rebuild, structure)
            if classical:
                problem = replace(problem, **dict.fromkeys(SPECTRA))
            return Repeated(problem)

        repeated = self._repeated.get((classical, *structure.items()), prepare)
        fields: dict[str, Any] = changed_fields(
            repeated.problem, self._values_of_groups(moved, lambda group: group in KEPT)
        )
        ends = (fields.pop(field, None) for field in ("initial_state", "terminal_state"))
        change = Change(*ends, bounds=fields or None)
        return repeated.solve(change, SOLVE_SECONDS)


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
        "frame": frame_data(outcome.problem),
        "trajectory": None if trajectory is None else trajectory_data(outcome.problem, trajectory),
    }


def _theorem(outcome: Outcome) -> str:
    """Say what the judge found of the maximum principle."""
    certificate = outcome.certificate
    if certificate is None:
        return "no point to judge"
    if certificate.pmp != "satisfied":
        return certificate.pmp.replace("_", " ")
    return f"satisfied, {'normal' if certificate.normal else 'abnormal'}"


def frame_data(problem: OptimalControlProblem) -> Data:
    """Return what does not depend on a trajectory: axes, names, bounds, stopped bins and limits."""
    time, frequency = time_scale(problem), frequency_scale(problem)
    return {
        "horizon": problem.horizon,
        "time": {"step": time.factor, "label": time.label},
        "frequency": {"label": frequency.label},
        "signals": [
            {"name": signal.name, "state": signal.is_state}
            | {side: _bound_data(bound) for side, bound in zip(("lower", "upper"), signal.bounds, strict=True)}
            for signal in _time_signals(problem)
        ],
        "spectra": [_spectrum_data(signal, frequency.factor) for signal in _frequency_signals(problem)],
        "vibrations": [  # the axis of each, its box of natural frequencies, and its limit
            {
                "name": term.name,
                "at": round_values(frequencies_around(box)),
                "box": [float(box.low[0]), float(box.high[0])],
                "limit": box.limit,
                "top": HIGHEST_LIMIT * box.limit,
            }
            for term, box in everywhere_of(problem, PlantBox)
        ],
    }


def _bound_data(values: Array) -> list[float | None]:
    """Return a bound over time, as a single value where it is constant."""
    return round_values(values[:1] if (values == values[0]).all() else values)


def _time_signals(problem: OptimalControlProblem) -> list[ProblemSignal]:
    return [*controls_of(problem), *states_of(problem)][:MOST_SIGNALS]


def _spectrum_data(signal: ProblemSignal, factor: float) -> Data:
    per_bin = 2 * np.pi / signal.samples * factor
    runs = stopped_runs(signal.stop)
    last = signal.samples / 2
    edges: Iterable[tuple[float, float]] = ((max(a - 0.5, 0.0), min(b + 0.5, last)) for a, b in runs)
    return {
        "name": signal.name,
        "step": per_bin,
        "stopped": [[per_bin * low, per_bin * high] for low, high in edges],
        "limits": [
            {"at": round_values(factor * line.at), "values": round_values(line.values)} for line in signal.levels
        ],
    }


def _frequency_signals(problem: OptimalControlProblem) -> list[ProblemSignal]:
    """Return all controls, and the states and outputs with a limit on their spectrum."""
    limited = [state for state in states_of(problem) if state.stop.any()]
    return [*controls_of(problem), *limited, *outputs_of(problem)][:MOST_SIGNALS]


def trajectory_data(problem: OptimalControlProblem, trajectory: Trajectory) -> Data:
    """Return the values of all signals and spectra of a trajectory, in the order of the frame."""
    spectra = [signal.of(trajectory)[: signal.samples] for signal in _frequency_signals(problem)]
    return {
        "signals": [round_values(signal.of(trajectory)) for signal in _time_signals(problem)],
        "spectra": [round_values(np.abs(np.fft.rfft(values))) for values in spectra],
        "vibrations": [
            round_values(vibration(box, trajectory, frequencies_around(box)))
            for _, box in everywhere_of(problem, PlantBox)
        ],
    }


def round_values(values: Array) -> list[float | None]:
    """Return numbers with few digits; None for what is no number."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in map(float, values)]
