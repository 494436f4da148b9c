"""Closed loops with disturbances: no step fails, and no bound is broken by more than the disturbance explains.

Part of scripts/verify.py. Every control must lie in its set, and every next state without the disturbance of its step
in the state set, unless the step was softened and says so; windows of applied controls must keep their mask where no
step was softened. In as many steps again, of the ten plants of the embedded controllers, every plan is judged later,
and must cost what the sparse program costs from the same state.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from benchmark.embedded_cases import PENALTY, PLANTS, disturbed_states
from benchmark.loop_cases import pendulum, random_plant, windowed
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.loop.step_problem import free_first_state, soften
from verify.seeded import check_all

STEPS = 100
"""Of a loop."""

NOISE = 5e-3
"""Largest disturbance of a step, relative to the size of each state."""

TOLERANCE = 1e-6
"""Excess over a bound that is allowed, relative to the sizes of the states, or to the bounds of the controls."""

GAP = 1e-8  # relative, of every plan of the four kinds that is not softened
APART = 1e-5  # of a control from that of the sparse program, relative to its bound
COMPARED = 25  # every so many steps
COST = 1e-8  # difference of costs, relative, beyond gap and worth of residuals that the judge leaves to that program
APART_CONVEX = 1e-4  # of a control in these plans: the accuracy of the program with its residuals

SOFT = {"state_set": 1e3, "control_spectrum": 1e2}


@dataclass(frozen=True)
class Case:
    """A loop: its problem, the sizes of its states, and its soft constraints."""

    kind: str
    problem: lfo.OptimalControlProblem
    sizes: np.ndarray


@dataclass(frozen=True)
class Findings:
    """The results of one loop; violations are relative."""

    kind: str
    steps: int
    softened: int
    control_excess: float
    state_excess: float
    window_excess: float
    gap: float
    apart: float
    stopped: str

    @property
    def passed(self) -> bool:
        """Whether it ran to its end within all bounds."""
        worst = max(self.control_excess, self.state_excess, self.window_excess)
        return not self.stopped and worst <= TOLERANCE and self.gap <= GAP and self.apart <= APART


def case_of(seed: int) -> Case:
    """Return the loop of a seed, of four kinds in turn."""
    if seed % 4 == 0:
        return Case("pendulum, bounds", pendulum(60), np.array([0.15, 0.1, 0.5, 0.5]))
    if seed % 4 == 1:
        return Case("pendulum, low pass", pendulum(60, low_pass=True), np.array([0.15, 0.1, 0.5, 0.5]))
    if seed % 4 == 2:
        return Case("windows", windowed(40), np.array([1.0, 0.5]))
    problem = random_plant(seed, 20)
    return Case("random plants", problem, problem.state_tube.upper[1] / 3)


def run(case: Case, seed: int) -> Findings:
    """Run a loop with its disturbance, and measure how far every bound is exceeded without it."""
    rng, problem = np.random.default_rng(seed), case.problem
    noise = NOISE * case.sizes * rng.uniform(-1, 1, (STEPS, problem.state_dim))
    start = problem.initial_box.lower * rng.uniform(0.3, 1.0)
    controller = lfo.RecedingHorizon(problem, soft=SOFT, certify="later")
    stopped = controller.run(start, STEPS, disturbance=noise)
    loop = replace(controller.certify(), final_state=stopped.final_state, stopped=stopped.stopped)
    planned = loop.states[1:] - noise[: len(loop.steps)]
    hard = np.array([source == "plan" for source in loop.sources], dtype=bool)
    controls, states = problem.control_tube, problem.state_boxes
    of_u = np.maximum(controls.lower[0] - loop.controls, loop.controls - controls.upper[0]) / controls.upper[0]
    of_x = np.maximum(states.lower[1] - planned, planned - states.upper[1])[hard] / case.sizes
    return Findings(
        case.kind,
        len(loop.steps),
        int((~hard).sum()),
        float(of_u.max(initial=0.0)),
        float(of_x.max(initial=0.0)),
        0.0 if case.kind != "windows" else window_excess(problem, loop.controls, hard),
        float(np.nan_to_num(loop.gaps, nan=np.inf)[hard].max(initial=0.0)),
        0.0 if case.kind == "windows" else difference(problem, loop, hard),
        loop.stopped,
    )


def difference(problem: lfo.OptimalControlProblem, loop: lfo.results.ClosedLoop, hard: np.ndarray) -> float:
    """Return the largest difference of some controls from those of the sparse program, relative to their bounds."""
    worst, free = 0.0, free_first_state(problem)
    for step in [step for step, own in zip(loop.steps, hard, strict=True) if own][::COMPARED]:
        control = lfo.solve(free.with_ends(step.state), "convex", throw=False).control
        if control is not None:
            worst = max(worst, float((np.abs(step.control - control[0]) / problem.control_tube.upper[0]).max()))
    return worst


def window_excess(problem: lfo.OptimalControlProblem, controls: np.ndarray, hard: np.ndarray) -> float:
    """Return the largest excess of a window that no softened step has decided, relative to its limit."""
    (given,) = problem.control_spectrum if isinstance(problem.control_spectrum, list) else (problem.control_spectrum,)
    whole = np.concatenate([given.past, controls])[:, 0]
    ended = np.concatenate([np.ones(len(given.past), dtype=bool), hard])
    bins = given.bound.band.at(given.length, None, "")
    weights, worst = given.bound.samples(given.length, ""), 0.0
    for begin in range(0, len(whole) - given.length + 1, given.hop):
        if ended[begin + given.length - 1]:
            spectrum = np.abs(np.fft.rfft(weights * whole[begin : begin + given.length]))[bins]
            worst = max(worst, float(spectrum.max() / given.bound.limit - 1))
    return worst


@dataclass(frozen=True)
class PlantFindings:
    """The results of one loop of a plant: steps by what they planned, and the largest differences."""

    kind: str
    planned: int
    softened: int
    unproven: int
    refuted: int
    gap: float
    cost: float
    apart: float

    @property
    def passed(self) -> bool:
        """Whether all plans are proven, with the gap that the judge allows, and cost what the sparse program costs."""
        proven = not self.unproven and not self.refuted
        return proven and self.cost <= COST and self.apart <= APART_CONVEX


def check_plant(seed: int) -> PlantFindings:
    """Run a disturbed loop of one of the ten plants, and solve each of its steps by the sparse program."""
    warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
    name = list(PLANTS)[seed % len(PLANTS)]
    case = PLANTS[name]()
    soft, hard = {"state_set": PENALTY} if case.hard else None, free_first_state(case.problem)
    softened, limit = soften(hard, soft or {}), np.abs(case.problem.control_tube.bounds).max(axis=(0, 1))
    controller = lfo.RecedingHorizon(case.problem, soft=soft, certify="later")
    disturbed_states(case, controller.step, STEPS, seed)
    refuted, cost, apart, log = 0, 0.0, 0.0, controller.certify()
    for step in log.steps:
        best = lfo.solve((hard if step.source == "plan" else softened).with_ends(step.state), "convex", throw=False)
        if step.source != "plan":
            refuted += lfo.solve(hard.with_ends(step.state), "convex", throw=False).trajectory is not None
        if best.control is not None and best.cost is not None and best.certificate is not None:
            judged, scale = best.certificate, max(abs(best.cost), 1e-12)
            allowed = abs(judged.gap or 0.0) * judged.cost_scale + judged.worth_of_residuals
            cost = max(cost, (abs(step.cost - best.cost) - allowed) / scale)
            apart = max(apart, float((np.abs(step.control - best.control[0]) / limit).max()))
    planned = sum(source == "plan" for source in log.sources)
    unproven = int((~log.satisfied).sum())
    gap = float(np.abs(log.gaps).max())
    return PlantFindings(name, planned, len(log.steps) - planned, unproven, refuted, gap, cost, apart)


def check(seed: int) -> Findings:
    """Run the loop of a seed."""
    return run(case_of(seed), seed)


def verify(console: Console, steps: range, processes: int) -> bool:
    """Run loops of so many steps in all, and print the results; return whether all passed."""
    loops = -(-len(steps) // STEPS)
    found = check_all(check, range(steps.start, steps.start + loops), processes, "closed loops")
    table = Table("loop", "loops", "steps", "softened", title="closed loops with disturbances")
    for column in ("control excess", "state excess", "window excess", "gap", "apart", "failed"):
        table.add_column(column, justify="right")
    for kind in [*dict.fromkeys(one.kind for one in found), "all"]:
        some = [one for one in found if kind in (one.kind, "all")]
        worst = [max(getattr(one, f"{what}_excess") for one in some) for what in ("control", "state", "window")]
        worst += [max(one.gap for one in some), max(one.apart for one in some)]
        counts = len(some), sum(one.steps for one in some), sum(one.softened for one in some)
        failed = sum(not one.passed for one in some)
        table.add_row(kind, *map(str, counts), *(f"{value:.1e}" for value in worst), str(failed))
    console.print(table)
    plants = check_all(check_plant, range(steps.start, steps.start + loops), processes, "closed loops of ten plants")
    table = Table("plant", "loops", "planned", "softened", "not proven", "refuted", title="every plan, solved twice")
    for column in ("gap", "cost, convex", "control, convex", "failed"):
        table.add_column(column, justify="right")
    for kind in [*dict.fromkeys(one.kind for one in plants), "all"]:
        some = [one for one in plants if kind in (one.kind, "all")]
        counts = [sum(getattr(one, part) for one in some) for part in ("planned", "softened", "unproven", "refuted")]
        worst = [max(getattr(one, part) for one in some) for part in ("gap", "cost", "apart")]
        failed = sum(not one.passed for one in some)
        table.add_row(kind, str(len(some)), *map(str, counts), *(f"{value:.1e}" for value in worst), str(failed))
    console.print(table)
    for one in (*found, *plants):
        if not one.passed:
            console.print(one)
    return all(one.passed for one in (*found, *plants))
