"""A loop that solves a problem at every step: plans, memory, delay, softening, plants, and how they fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.compilers import needs_kernel
from helpers.seeds import expensive
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.errors import ProblemError

A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
DYNAMICS = lfo.LinearDynamics(A, B, sampling_time=0.1, control_names=["force [N]"])
COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.1, P=np.diag([10.0, 5.0]))


def problem(**fields) -> lfo.OptimalControlProblem:
    given = {"dynamics": DYNAMICS, "horizon": 15, "cost": COST, "initial_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(**(given | {"control_set": lfo.Box(-1, 1)} | fields))


def by_hand(base: lfo.OptimalControlProblem, x: np.ndarray, steps: int) -> np.ndarray:
    controls = []
    for _ in range(steps):
        controls.append(lfo.solve(base.with_ends(x)).control[0])
        x = A @ x + B @ controls[-1]
    return np.array(controls)


@expensive
@pytest.mark.parametrize("method", ["auto", "spectral", "structured", "convex", lfo.solvers.Convex(backend="osqp")])
def test_the_loop_is_a_solve_from_every_state(method):
    loop = lfo.RecedingHorizon(problem(), method).run([0.2, 0.1], 5)
    np.testing.assert_allclose(loop.controls, by_hand(problem(), np.array([0.2, 0.1]), 5), atol=2e-5)
    np.testing.assert_allclose(loop.states[-1], A @ loop.states[-2] + B @ loop.controls[-1])
    assert set(loop.statuses) == {"optimal"}
    assert set(loop.sources) == {"plan"}
    assert loop.satisfied.all()
    assert (loop.gaps <= 1e-6).all()
    assert loop.states.shape == (6, 2)


def test_without_disturbance_a_plan_that_ends_at_rest_is_followed():
    base = problem(terminal_state=[0.0, 0.0], horizon=30)
    plan = lfo.solve(base)
    controller = lfo.RecedingHorizon(base)
    x = np.array([1.0, 0.0])
    spent = 0.0
    for _ in range(5):
        u = controller.step(x)
        spent += float(x @ np.diag([0.5, 0.05]) @ x + 0.05 * u @ u)
        x = A @ x + B @ u
    costs = controller.log.costs
    assert (np.diff(costs) < 0).all()  # the optimal cost decreases along the loop
    assert costs[0] == pytest.approx(plan.cost)
    assert spent < plan.cost


@expensive
def test_a_measured_state_may_lie_outside_the_state_set():
    base = problem(state_set=lfo.Box([-0.5, -2.0], [0.5, 2.0]), control_set=lfo.Box(-50, 50))
    with pytest.raises(lfo.errors.InfeasibleError):
        lfo.solve(base.with_ends([0.51, 0.0]))
    loop = lfo.RecedingHorizon(base).run([0.51, 0.0], 3)
    assert not loop.stopped
    assert (np.abs(loop.states[1:, 0]) <= 0.5 + 1e-7).all()


@expensive
def test_every_window_of_the_loop_keeps_its_mask():
    mask = lfo.MagnitudeBound(0.3, band=lfo.low_pass(1.2))
    base = problem(control_spectrum=lfo.spectrum.Spectrogram(mask, length=8, hop=2))
    loop = lfo.RecedingHorizon(base).run([1.0, 0.0], 20)
    assert not loop.stopped
    bins = 2 * np.pi * np.arange(5) / 8 > 1.2

    def largest(controls: np.ndarray) -> float:
        return max(np.abs(np.fft.rfft(controls[s : s + 8, 0]))[bins].max() for s in range(0, 13, 2))

    assert largest(loop.controls) <= 0.3 + 1e-6
    assert largest(by_hand(problem(), np.array([1.0, 0.0]), 20)) > 0.4  # without the mask


def test_a_delay_is_predicted():
    controller = lfo.RecedingHorizon(problem(), delay=1)
    loop = controller.run([0.2, 0.1], 4)  # so near that no control is at its bound
    assert np.abs(loop.controls).max() < 1
    x, acting = np.array([0.2, 0.1]), np.zeros(1)
    for k in range(4):
        np.testing.assert_allclose(loop.states[k], x)
        next_state = A @ x + B @ acting
        np.testing.assert_allclose(loop.controls[k], lfo.solve(problem().with_ends(next_state)).control[0], atol=1e-6)
        x, acting = next_state, loop.controls[k]


@expensive
def test_a_delayed_loop_remembers_what_acts_now():
    mask = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.3, band=lfo.low_pass(1.2)), length=8, hop=2)
    loop = lfo.RecedingHorizon(problem(control_spectrum=mask), delay=1).run([1.0, 0.0], 20)
    acted = np.concatenate([np.zeros((1, 1)), loop.controls])
    bins = 2 * np.pi * np.arange(5) / 8 > 1.2
    assert max(np.abs(np.fft.rfft(acted[s : s + 8, 0]))[bins].max() for s in range(0, 13, 2)) <= 0.3 + 1e-6


@needs_kernel
def test_what_was_applied_counts_in_place_of_what_was_planned():
    spectrogram = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.3, bins=[2]), length=4, hop=4)
    controller = lfo.RecedingHorizon(problem(control_spectrum=spectrogram))
    controller.step([1.0, 0.0])
    rest = controller.log.steps[-1].planned.u[1:4, 0]
    controller.step([1.0, 0.0], applied=[0.05])
    of_rest, of_plan = (abs(0.05 - u[0] + u[1] - u[2]) for u in (rest, controller.log.steps[-1].planned.u[:, 0]))
    assert of_rest > 0.31  # bin 2 of the first window
    assert of_plan <= of_rest + 1e-6  # the level is raised to what the rest of the last plan makes of it
    assert controller.log.steps[-1].raised


@expensive
def test_steps_without_a_solution_are_softened_and_say_so():
    base = problem(state_set=lfo.Box([-0.5, -2.0], [0.5, 2.0]), terminal_state=[0.0, 0.0])
    with pytest.raises(lfo.errors.InfeasibleError, match="conflict"):
        lfo.RecedingHorizon(base).step([1.0, 0.0])
    loop = lfo.RecedingHorizon(base, soft={"state_set": 1e3, "terminal_state": 1e3}).run([1.0, 0.0], 30)
    assert not loop.stopped
    assert loop.statuses[0] == "infeasible"
    assert loop.sources[0] == "softened problem"
    assert loop.steps[0].excess["state set"] > 0.1
    assert loop.sources[-1] == "plan"
    assert not loop.steps[-1].excess
    assert abs(loop.states[-1, 0]) < 0.5


def test_previews_shift_with_the_loop():
    reference = np.zeros((40, 2))
    reference[12:, 0] = 0.5
    loop = lfo.RecedingHorizon(problem(cost=COST)).run([0.0, 0.0], 20, references={"x_ref": reference})
    assert abs(loop.controls[0, 0]) > 1e-4  # it is seen at the end of the first horizon
    assert loop.states[-1, 0] == pytest.approx(0.5, abs=0.1)
    seen = replace(problem(), cost=replace(COST, x_ref=reference[3:19])).with_ends(loop.states[3])
    np.testing.assert_allclose(loop.controls[3], lfo.solve(seen).control[0], atol=1e-6)


def test_known_disturbances_and_bounds_are_planned_for():
    wind = np.array([0.0, 0.02])
    known = lfo.RecedingHorizon(problem()).step([0.0, 0.0], disturbance=wind)
    same = lfo.solve(problem(dynamics=replace(DYNAMICS, offset=wind), initial_state=[0.0, 0.0])).control[0]
    np.testing.assert_allclose(known, same, atol=1e-6)
    tight = lfo.RecedingHorizon(problem()).step([1.0, 0.0], bounds={"control_set": lfo.Box(-0.2, 0.2)})
    assert tight == pytest.approx([-0.2], abs=1e-7)


def test_previews_beside_norms_in_the_cost_and_first_states_outside():
    base = problem(cost=COST + lfo.costs.L1Cost(u=0.05), state_set=lfo.Box(-9, 9))
    reference = np.linspace(0, 1, 16)[:, None] * [1.0, 0.0]
    bounds = {"state_set": lfo.Box([-0.2, -9.0], [0.2, 9.0]), "control_set": lfo.Box(-50, 50)}
    given = lfo.RecedingHorizon(base).step([0.3, 0.0], {"x_ref": reference}, bounds)
    lower, upper = np.tile([[-0.2, -9.0]], (16, 1)), np.tile([[0.2, 9.0]], (16, 1))
    lower[0], upper[0] = -np.inf, np.inf
    cost = lfo.QuadraticCost(Q=COST.Q, R=COST.R, P=COST.P, x_ref=reference) + lfo.costs.L1Cost(u=0.05)
    same = replace(base, cost=cost, state_set=lfo.Box(lower, upper), control_set=bounds["control_set"])
    np.testing.assert_allclose(given, lfo.solve(same.with_ends([0.3, 0.0])).control[0], atol=1e-5)


BAD_PREVIEWS = {
    "references.x": {"references": {"x": [0, 0]}},
    "bounds.u": {"bounds": {"u": lfo.Box(0, 1)}},
    "disturbance": {"disturbance": [1.0]},
    "cost.x_ref": {"references": {"x_ref": [1.0, 2.0, 3.0]}},
}


@pytest.mark.parametrize("field", BAD_PREVIEWS)
@pytest.mark.parametrize("method", ["auto", "convex"])
def test_a_bad_preview_is_refused_by_its_field(field, method):
    controller = lfo.RecedingHorizon(problem(), method)
    with pytest.raises(ProblemError) as caught:
        controller.step([1.0, 0.0], **BAD_PREVIEWS[field])
    assert caught.value.field == field
    assert not controller.log.steps


def plants():
    import control

    yield "function", lambda x, u: A @ x + B @ u
    yield "function of the step", lambda k, x, u: A @ x + B @ u
    yield "function of control and state", lambda u, x: A @ x + B @ u
    yield "function with the step at last", lambda x, u, k: A @ x + B @ u + 0 * k
    yield "function with an option", lambda x, u, gain=1.0: A @ x + gain * B @ u
    yield "dynamics", DYNAMICS
    yield "discrete model", control.ss(A, B, np.eye(2), 0, 0.1)
    yield "continuous model", control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0)


@pytest.mark.parametrize("plant", [pytest.param(one, id=name) for name, one in plants()])
def test_the_same_plant_in_every_form(plant):
    loop = lfo.RecedingHorizon(problem()).run([0.2, 0.1], 4, plant)
    np.testing.assert_allclose(loop.controls, lfo.RecedingHorizon(problem()).run([0.2, 0.1], 4).controls, atol=1e-7)


def fails(k, x, u):
    if k == 2:
        raise RuntimeError("the valve is stuck")
    return A @ x + B @ u


@pytest.mark.parametrize(
    ("plant", "why"),
    [(fails, "at step 2 it raised RuntimeError: the valve is stuck"), (lambda x, u: x * np.nan, "finite")],
)
def test_a_plant_that_fails_keeps_the_steps_before(plant, why):
    loop = lfo.RecedingHorizon(problem()).run([1.0, 0.0], 6, plant)
    assert why in loop.stopped
    assert len(loop.steps) == (3 if plant is fails else 1)
    assert loop.states.shape == (len(loop.steps) + 1, 2)


def test_ctrl_c_keeps_the_steps_before():
    def interrupts(k, x, u):
        if k == 3:
            raise KeyboardInterrupt
        return A @ x + B @ u

    loop = lfo.RecedingHorizon(problem()).run([1.0, 0.0], 6, interrupts)
    assert (loop.stopped, len(loop.steps)) == ("interrupted", 4)


@pytest.mark.parametrize("state", [[np.nan, 0.0], [1.0], [[1.0, 0.0]], "far"])
def test_a_bad_measurement_is_refused_and_nothing_is_lost(state):
    controller = lfo.RecedingHorizon(problem())
    before = controller.step([1.0, 0.0])
    with pytest.raises(ProblemError, match="state"):
        controller.step(state)
    assert len(controller.log.steps) == 1
    assert np.isfinite(controller.step(A @ [1.0, 0.0] + B @ before)).all()


BAD = {
    "problem": (lambda: lfo.RecedingHorizon("pendulum"), "problem"),
    "delay": (lambda: lfo.RecedingHorizon(problem(), delay=2), "delay"),
    "soft": (lambda: lfo.RecedingHorizon(problem(), soft={"control_set": 1.0}), "soft.control_set"),
    "plant": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, "plant"), "plant"),
    "plant of the state alone": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, lambda x: x), "plant"),
    "plant's size": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, lfo.LinearDynamics([[1]], [[1]])), "plant"),
    "plant per time": (
        lambda: lfo.RecedingHorizon(problem(dynamics=replace(DYNAMICS, A=[A] * 15))).run([1, 0], 2),
        "problem.dynamics",
    ),
    "steps": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 0), "steps"),
    "noise": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, disturbance=[0, 0]), "disturbance"),
    "reference": (
        lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, references={"x_ref": np.zeros((9, 2))}),
        "references.x_ref",
    ),
    "no reference": (lambda: lfo.RecedingHorizon(problem()).run([1, 0], 2, references={"x": [1]}), "references.x"),
    "start": (lambda: lfo.RecedingHorizon(problem()).run([1, 0, 0], 2), "initial_state"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_by_the_field(case):
    make, field = BAD[case]
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


def test_an_unknown_method_is_refused_at_once():
    with pytest.raises(lfo.errors.UnsupportedError, match="method"):
        lfo.RecedingHorizon(problem(), "magic")


def test_without_time_the_last_plan_goes_on():
    """The clock stands still during the first step; in the second, every look at it takes longer than the limit."""
    clock = Clock()
    with use_clock(clock):
        controller = lfo.RecedingHorizon(problem(), "structured", time_limit=1.0)
        controller.step([1.0, 0.0])
        plan = controller.log.steps[-1].plan
        clock.per_look = 2.0
        late = controller.step(plan.x[1])
        np.testing.assert_allclose(late, plan.u[1])
        assert controller.log.sources == ("plan", "previous plan")
        assert controller.log.statuses == ("optimal", "limit")
        with pytest.raises(lfo.errors.LimitError):
            lfo.RecedingHorizon(problem(), "structured", time_limit=1.0).step([1.0, 0.0])


def test_dynamics_with_modes_run_in_a_loop():
    base = lfo.library.pendulum_with_wall(horizon=8)
    loop = lfo.RecedingHorizon(base).run(base.initial_box.lower, 2)
    assert not loop.stopped
    assert set(loop.statuses) == {"optimal"}


@expensive
def test_a_loop_is_shown_saved_and_tabulated(images, tmp_path):
    base = problem(state_set=lfo.Box([-0.5, -2.0], [0.5, 2.0]))
    loop = lfo.RecedingHorizon(base, soft={"state_set": 1e3}).run([0.8, 0.0], 12)
    page = loop.save(tmp_path / "loop").read_text(encoding="utf-8")
    assert "12 steps" in page
    assert "Relaxed constraints" in page
    assert "infeasible" in page
    assert (tmp_path / "loop" / "loop.png").stat().st_size > 10_000
    assert "://" not in page
    loop.to_csv(tmp_path / "loop.csv")
    rows = (tmp_path / "loop.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 13
    assert "force [N]" in rows[0]
    formula = replace(base, dynamics=replace(base.linear, control_names=["=1+1"]))
    replace(loop, problem=formula).to_csv(tmp_path / "loop.csv")
    assert ",'=1+1," in (tmp_path / "loop.csv").read_text(encoding="utf-8").splitlines()[0]
    assert len(loop.plot().axes) == 7  # control, spectrogram and its scale, two states, times, gaps
    assert repr(loop) == "ClosedLoop(12 steps of a problem)"


@expensive
def test_a_loop_that_stops_at_its_first_step_has_a_report(tmp_path):
    loop = lfo.RecedingHorizon(lfo.library.double_integrator(horizon=40)).run([0.0, 0.0], 3)
    assert len(loop.steps) == 0
    assert "satisfies all constraints" in loop.stopped
    assert "0 steps" in loop.save(tmp_path / "loop").read_text(encoding="utf-8")
    assert len(loop.plot().axes) == 6  # a spectrogram of no samples has no scale
