"""The answers of a live page: a problem at the values of its sliders, re-solved and certified.

Changes of bounds and ends are solved by ``solving.resolver``; other changes build the problem again. The sliders
are the numbers that the problem lists of its limits (``transform.limits``), and its horizon.

The page draws plain data in the axes' units: signals over time, and their spectra. The spectrum of a signal v of N
samples is |V_k| = |sum_t v_t exp(-2 pi i k t / N)|, k = 0 .. N//2, as in limits on magnitudes.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError, ProblemError, UnsupportedError, suggestion
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.comparison.compare import PREFERRED_FILTER, ComparisonOutcome, Filtered
from lin_freq_ocp.comparison.filters import apply_filter, can_be_filtered, has_frequency_constraint
from lin_freq_ocp.comparison.moves import HIGHEST_LIMIT, frequencies_around, vibration
from lin_freq_ocp.comparison.trajectories import ProblemSignal, controls_of, outputs_of, replay_control, states_of
from lin_freq_ocp.pages.explorer.sliders import GROUP_OF, Slider, sliders_of_limits
from lin_freq_ocp.pages.report.findings import finding_of
from lin_freq_ocp.pages.report.proof import verdict
from lin_freq_ocp.pages.units import frequency_scale, time_scale
from lin_freq_ocp.problem.measures import stopped_runs
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.resolver import Resolver
from lin_freq_ocp.transform.limits import SPECTRA, changed_fields
from lin_freq_ocp.transform.reductions import Change
from lin_freq_ocp.transform.reformulations import semi_infinite_terms

HORIZON = "horizon"
HORIZON_NOTCHES = 60  # about so many between half and twice the problem's horizon

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
FOLDED = "state_bounds", "initial_state", "terminal_state"  # hidden until the user opens them
CACHED = "bounds", *FOLDED  # groups whose sliders leave the solver cache valid

Rebuild = Callable[[int], OptimalControlProblem]  # builds the same problem over another horizon

DIGITS = 4  # significant digits of drawn values
MOST_SIGNALS = 24  # drawn over time; controls come first

Data = dict[str, object]  # an object of JSON

SOLVE_SECONDS = 10.0  # time limit of one answer
CACHED_PROBLEMS, CACHED_ANSWERS = 8, 64  # the latest ones

Values = Mapping[str, float]  # the value of each slider, by its key
Moved = tuple[tuple[str, float], ...]  # the keys and values of moved sliders


def sliders_of(problem: OptimalControlProblem, rebuild: Rebuild | None) -> tuple[Slider, ...]:
    """Return the sliders of a problem, group by group; that of the horizon if the problem can be built over others."""
    sliders, T = list(sliders_of_limits(problem)), problem.horizon
    notch = max(1, T // HORIZON_NOTCHES)
    low, high = T - (T // 2 // notch) * notch, T + (T // notch) * notch
    if rebuild is not None and _can_be_built(rebuild, low) and _can_be_built(rebuild, high):
        sliders.append(Slider(HORIZON, "horizon", "horizon", "steps", low, high, notch, T, high))
    return tuple(sorted(sliders, key=lambda slider: list(GROUPS).index(slider.group)))


def _can_be_built(rebuild: Rebuild, horizon: int) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)
        try:
            return rebuild(horizon).horizon == horizon
        except (LinFreqOCPError, TypeError, ValueError):  # no such parameter, or data that fix the horizon
            return False


def checked_values(sliders: tuple[Slider, ...], values: object) -> dict[str, float]:
    """Return the value of every slider, that of the problem if none is given; raise ProblemError if one is wrong."""
    if not isinstance(values, Mapping):
        raise ProblemError("values", brief(values), "an object with the values of sliders")
    known = {slider.key: slider for slider in sliders}
    for key, value in values.items():
        if key not in known:
            expected = f"some of {', '.join(known)}"
            raise ProblemError(f"values.{key}", "no slider of that name", expected, suggestion(key, known))
        slider = known[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not slider.low <= value <= slider.high:
            expected = f"a number from {slider.low:.6g} to {slider.high:.6g} {slider.unit}".rstrip()
            raise ProblemError(f"values.{key}", brief(value), expected)
    return {key: float(values.get(key, slider.value)) for key, slider in known.items()}


def problem_at(
    problem: OptimalControlProblem, rebuild: Rebuild | None, moved: Values, classical: bool = False
) -> OptimalControlProblem:
    """Return the problem with these values, with or without its frequency constraints."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)  # the page shows which bins are stopped
        if HORIZON in moved and rebuild is not None:
            problem = rebuild(int(moved[HORIZON]))
        fields = changed_fields(problem, {key: value for key, value in moved.items() if key != HORIZON})
        if classical:
            fields |= dict.fromkeys(SPECTRA)
        return replace(problem, **fields) if fields else problem


class Session:
    """A problem with its sliders and its latest answers."""

    def __init__(self, problem: OptimalControlProblem, rebuild: Rebuild | None = None):
        if "convex" not in family_of(problem).shorthands or problem.mode_names:
            raise UnsupportedError(
                f"explore: got {family_of(problem).kind} dynamics, for which one answer can take minutes; expected "
                "linear dynamics or a frequency response. For such problems, use 'sweep --grid' or 'compare'."
            )
        self.problem, self.rebuild = problem, rebuild
        self.sliders = sliders_of(problem, rebuild)
        self._resolver = lru_cache(CACHED_PROBLEMS)(
            lambda moved, classical: Resolver(problem_at(problem, rebuild, dict(moved), classical))
        )
        self._outcome = lru_cache(CACHED_ANSWERS)(self._solve)

    def answer(self, values: object) -> Data:
        """Return status, cost, certificate and trajectory at these values of the sliders."""
        checked = checked_values(self.sliders, values)
        try:
            return answer_data(self.outcome(checked))
        except LinFreqOCPError as error:  # such as a problem file whose arrays do not fit this horizon
            return {"status": "error", "message": str(error)}

    def compare(self, values: object) -> Data:
        """Return the classical and the filtered trajectory at these values; none without a frequency constraint."""
        checked = checked_values(self.sliders, values)
        constrained = self.outcome(checked)
        problem = constrained.problem
        if not has_frequency_constraint(problem):
            return {"finding": "", "trajectories": []}
        classical = self.outcome(checked, classical=True)
        plan = classical.trajectory
        if not classical.status.solved or plan is None:
            return {"finding": f"no classical solution, {classical.status}", "trajectories": []}
        entries = ()
        if can_be_filtered(problem):
            control = apply_filter(PREFERRED_FILTER, problem, plan.u)
            replay = replay_control(PREFERRED_FILTER, problem, control.u, plan)
            entries = (Filtered(PREFERRED_FILTER, control.description, replay),)
        comparison = ComparisonOutcome(problem, classical, constrained, entries)
        measured = [("classical", comparison.classical_solution), *(("filtered", entry.replay) for entry in entries)]
        return {
            "finding": finding_of(comparison).filtering,
            "trajectories": [
                {"name": name, "cost": number(solution.measures.cost, 6), "meaningful": solution.meaningful}
                | trajectory_data(problem, solution.trajectory)
                for name, solution in measured
            ],
        }

    def cure(self, values: object, key: object, is_wanted: Callable[[], bool] = lambda: True) -> Data:
        """Return the smallest move of one slider that restores feasibility, others unchanged; None without one.

        By bisection over its notches, which ends early when the answer is no longer wanted.
        """
        checked, sliders = checked_values(self.sliders, values), {slider.key: slider for slider in self.sliders}
        if not isinstance(key, str) or key not in sliders:
            raise ProblemError("slider", repr(key), f"one of {', '.join(sliders)}")
        slider = sliders[key]

        def is_feasible(n: int) -> bool:
            return self.outcome({**checked, key: slider.notch(n)}).status.solved

        least, most = (round((value - slider.value) / slider.step) for value in (checked[key], slider.relaxed))
        if least == most or not is_feasible(most):
            return {"key": key, "value": None}
        while abs(most - least) > 1 and is_wanted():
            middle = (least + most) // 2
            least, most = (least, middle) if is_feasible(middle) else (middle, most)
        return {"key": key, "value": slider.notch(most)}

    def outcome(self, values: Values, classical: bool = False) -> Outcome:
        """Return the outcome at these values, with or without the frequency constraints."""
        moved = [slider for slider in self.sliders if values[slider.key] != slider.value]
        if classical:
            moved = [slider for slider in moved if slider.group != GROUP_OF["control_spectrum"]]
        kept, others = (
            tuple((slider.key, values[slider.key]) for slider in moved if (slider.group in CACHED) is cached)
            for cached in (True, False)
        )
        return self._outcome(kept, others, classical)

    def _solve(self, kept: Moved, others: Moved, classical: bool) -> Outcome:
        """Solve at values that keep the solver cache valid, and others."""
        resolver = self._resolver(others, classical)
        fields: dict[str, Any] = changed_fields(resolver.problem, dict(kept))
        ends = (fields.pop(field, None) for field in ("initial_state", "terminal_state"))
        return resolver.solve(Change(*ends, bounds=fields or None), SOLVE_SECONDS)


def answer_data(outcome: Outcome) -> Data:
    """Return an outcome in the form that the page shows."""
    certificate, trajectory = outcome.certificate, outcome.trajectory
    theorem = "no point to certify"
    if certificate is not None:
        theorem = certificate.pmp.replace("_", " ")
        theorem += f", {'normal' if certificate.normal else 'abnormal'}" if theorem == "satisfied" else ""
    return {
        "status": outcome.status,
        "message": outcome.message,
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
        "theorem": theorem,
        "proof": [] if certificate is None else verdict(certificate, outcome.problem),
        "conflict": [part.block for part in outcome.conflict or ()],
        "frame": frame_data(outcome.problem),
        "trajectory": None if trajectory is None else trajectory_data(outcome.problem, trajectory),
    }


def frame_data(problem: OptimalControlProblem) -> Data:
    """Return the parts of the picture that do not depend on a trajectory: axes, names, bounds, stopped bins, limits."""
    time, frequency = time_scale(problem), frequency_scale(problem)
    signals, spectra = list[Data](), list[Data]()
    for signal in _time_signals(problem):
        # A constant bound is a single value.
        bounds = [bound[:1] if (bound == bound[0]).all() else bound for bound in signal.bounds]
        sides = {side: round_values(bound) for side, bound in zip(("lower", "upper"), bounds, strict=True)}
        signals.append({"name": signal.name, "state": signal.is_state, **sides})
    for signal in _frequency_signals(problem):
        step, last = 2 * np.pi / signal.samples * frequency.factor, signal.samples / 2
        stopped = [[step * max(a - 0.5, 0.0), step * min(b + 0.5, last)] for a, b in stopped_runs(signal.stop)]
        limits = [
            {"at": round_values(frequency.factor * line.at), "values": round_values(line.values)}
            for line in signal.levels
        ]
        label = signal.axis.label
        spectra.append({"name": signal.name, "label": label, "step": step, "stopped": stopped, "limits": limits})
    return {
        "horizon": problem.horizon,
        "time": {"step": time.factor, "label": time.label},
        "frequency": {"label": frequency.label},
        "signals": signals,
        "spectra": spectra,
        "vibrations": [  # the axis of each, its box of natural frequencies, and its limit
            {
                "name": term.name,
                "at": round_values(frequencies_around(box)),
                "box": [float(box.low[0]), float(box.high[0])],
                "limit": box.limit,
                "top": HIGHEST_LIMIT * box.limit,
            }
            for term, box in semi_infinite_terms(problem, VibrationLimit)
        ],
    }


def _time_signals(problem: OptimalControlProblem) -> list[ProblemSignal]:
    return [*controls_of(problem), *states_of(problem)][:MOST_SIGNALS]


def _frequency_signals(problem: OptimalControlProblem) -> list[ProblemSignal]:
    """Return all controls, and the states and outputs whose spectrum is constrained."""
    limited = [state for state in states_of(problem) if state.stop.any()]
    return [*controls_of(problem), *limited, *outputs_of(problem)][:MOST_SIGNALS]


def trajectory_data(problem: OptimalControlProblem, trajectory: Trajectory) -> Data:
    """Return the values of all signals and spectra of a trajectory, in the order of the frame."""
    spectra = list[Array]()
    for signal in _frequency_signals(problem):
        w = 2 * np.pi * np.arange(signal.samples // 2 + 1) / signal.samples
        sums = np.abs(np.fft.rfft(signal.drawn_samples(trajectory)))
        spectra.append(signal.axis.of_sums(w, sums))
    return {
        "signals": [round_values(signal.of(trajectory)) for signal in _time_signals(problem)],
        "spectra": [round_values(values) for values in spectra],
        "vibrations": [
            round_values(vibration(box, trajectory, frequencies_around(box)))
            for _, box in semi_infinite_terms(problem, VibrationLimit)
        ],
    }


def round_values(values: Array) -> list[float | None]:
    """Return numbers with few digits; None for values that are not finite."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in map(float, values)]
