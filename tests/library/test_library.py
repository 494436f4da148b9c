"""The linear problems of the library against their physics, and their optima against CVXPY with Clarabel."""

from __future__ import annotations

import dataclasses

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from lin_freq_ocp import library
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.spectrum.bands import stop_band

OPTIMA = {  # cost with and without the frequency constraint
    "pendulum": (3199.18631986, 2852.70530277),  # both from two methods that share nothing
    "double_integrator": (6.38576233691, 6.00060024032),
    "two_mass_spring": (50.4862977331, 41.3177311758),
    "crane": (0.719207751701, 0.655514950858),
    "flexible_joint_arm": (984.752938389, 827.388038701),
    "flexible_satellite": (41.0797037435, 32.4357346488),
    "mass_chain": (56.64018380722854, 56.5029911564),
    "quadcopter": (29.6604499018, 28.065115242),
    "elliptic_rendezvous": (0.587739072184, 0.571568434291),
    "quarter_car": (6.85887326012, 4.91039276872),
    "scanner": (4.39154494386, 0.613200976605),
}
WITHOUT_BAND = {
    "pendulum": {"cutoff": None},
    "double_integrator": {"cutoff_hz": None},
    "two_mass_spring": {"notch_width_hz": None},
    "crane": {"notch_width_hz": None},
    "flexible_joint_arm": {"notch_width_hz": None},
    "flexible_satellite": {"notch_width_hz": None},
    "mass_chain": {"cutoffs_hz": None},
    "quadcopter": {"cutoff_hz": None},
    "elliptic_rendezvous": {"cutoff_hz": None},
    "quarter_car": {"stop_band_hz": None},
    "scanner": {"cutoff_hz": None, "notch_width_hz": None},
}


def solved(problem: OptimalControlProblem) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the optimal cost, x and u; this shares nothing with the package but the description of the problem."""
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.cost
    assert not any(term.any() for term in (cost.q, cost.r, cost.p))
    x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
    A, B, offset = zip(*(problem.dynamics.at(t) for t in range(T)), strict=True)
    successors = sp.block_diag(A) @ cp.vec(x[:-1], order="C") + sp.block_diag(B) @ cp.vec(u, order="C")
    constraints = [cp.vec(x[1:], order="C") == successors + np.concatenate(offset)]
    for signal, tube in ((x, problem.state_tube), (u, problem.control_tube)):
        fixed = tube.lower == tube.upper
        for sign, bound in ((1, tube.upper), (-1, -tube.lower)):
            bounded = np.isfinite(bound) & ~fixed
            if bounded.any():
                constraints.append(sign * signal[bounded] <= bound[bounded])
        if fixed.any():
            constraints.append(signal[fixed] == tube.lower[fixed])
    for signal, stop, length in ((x, problem.state_stop, T + 1), (u, problem.control_stop, T)):
        for j in np.flatnonzero(stop.any(axis=0)):
            phase = 2 * np.pi * np.outer(np.flatnonzero(stop[:, j]), np.arange(length)) / length
            rows = np.vstack([np.cos(phase), np.sin(phase)])
            rows = rows[np.linalg.norm(rows, axis=1) > 1e-6]  # bin 0 and the Nyquist bin have no sine
            constraints.append(rows @ signal[:, j] == 0)
    values, vectors = np.linalg.eigh(np.block([[cost.Q, cost.S], [cost.S.T, cost.R]]))
    root = vectors * np.sqrt(np.maximum(values, 0))
    deviation = cp.hstack([x - np.broadcast_to(cost.x_ref, x.shape), np.zeros((T + 1, m))])[:-1]
    deviation += cp.hstack([np.zeros((T, n)), u - np.broadcast_to(cost.u_ref, u.shape)])
    objective = cp.sum_squares(deviation @ root) / 2 + cp.quad_form(x[-1] - cost.x_ref.reshape(-1, n)[-1], cost.P) / 2
    program = cp.Problem(cp.Minimize(objective), constraints)
    program.solve(cp.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    assert program.status == "optimal"
    return float(program.value), x.value, u.value


def energy(x: np.ndarray, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return 1/2 v'M v + 1/2 q'K q for states (q, v)."""
    q, v = np.hsplit(x, 2)
    return np.einsum("ti,ij,tj->t", v, mass, v) / 2 + np.einsum("ti,ij,tj->t", q, stiffness, q) / 2


def frequencies(problem: OptimalControlProblem) -> np.ndarray:
    """Return the natural frequencies of constant dynamics in rad/s, from the eigenvalues of the sampled A."""
    poles = np.log(np.linalg.eigvals(problem.dynamics.A).astype(complex)) / problem.sampling_time
    return np.sort(np.abs(poles[poles.imag > 1e-3]))


def removed(problem: OptimalControlProblem, component: int) -> list[int]:
    """Return the bins removed from a state."""
    return np.flatnonzero(problem.state_stop[:, component]).tolist()


def bins_around(frequency: float, width_hz: float, problem: OptimalControlProblem) -> list[int]:
    """Return the bins of the states within half the width of a frequency in rad/s."""
    hertz = np.fft.rfftfreq(problem.horizon + 1, problem.sampling_time)
    return np.flatnonzero(np.abs(hertz - frequency / (2 * np.pi)) < width_hz / 2).tolist()


# --- the library as a whole


@pytest.mark.parametrize("name", library.LINEAR)
def test_every_problem_is_known_by_the_name_of_its_function(name):
    problem = library.by_name(name)()
    assert library.PROBLEMS[name] is getattr(library, name)
    assert problem.name == name
    assert 20 <= len(library.by_name(name).__doc__.splitlines()[0]) <= 100


@pytest.mark.parametrize("name", library.LINEAR)
def test_controls_are_bounded_and_the_initial_state_is_a_point(name):
    problem = library.by_name(name)()
    assert np.isfinite(problem.control_tube.lower).all()
    assert np.isfinite(problem.control_tube.upper).all()
    assert problem.initial_state.fixed.all()


@pytest.mark.parametrize("name", library.LINEAR)
def test_frequency_constraint_is_there_by_default_and_absent_on_request(name):
    problem, free = library.by_name(name)(), library.by_name(name)(**WITHOUT_BAND[name])
    assert problem.control_stop.any() or problem.state_stop.any()
    assert not free.control_stop.any()
    assert not free.state_stop.any()


@pytest.mark.parametrize("name", library.LINEAR)
def test_optimum_agrees_with_cvxpy_and_the_frequency_constraint_costs_something(name):
    with_band, without_band = OPTIMA[name]
    problem = library.by_name(name)()
    cost, x, u = solved(problem)
    assert cost == pytest.approx(with_band, rel=1e-6)
    assert problem.cost.value(x, u) == pytest.approx(cost, rel=1e-6)
    free = library.by_name(name)(**WITHOUT_BAND[name])
    cost, x, u = solved(free)
    assert cost == pytest.approx(without_band, rel=1e-6)
    assert with_band > 1.002 * without_band
    stopped = np.abs(np.fft.rfft(x, axis=0))[problem.state_stop], np.abs(np.fft.rfft(u, axis=0))[problem.control_stop]
    assert max(part.max(initial=0) for part in stopped) > 0.1


@pytest.mark.parametrize("name", library.LINEAR)
def test_horizon_of_one_step_is_possible(name):
    assert library.by_name(name)(horizon=1, **WITHOUT_BAND[name]).horizon == 1


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(ProblemError, match=r"one of pendulum, .*Did you mean 'mass_chain'\?"):
        library.by_name("masschain")
    with pytest.raises(ProblemError, match=r"buck_converter\.$"):
        library.by_name("zzz")


@pytest.mark.parametrize("name", library.LINEAR)
@pytest.mark.parametrize(
    "wrong", [{"horizon": 0}, {"horizon": 2.5}, {"initial_state": (0.0,)}, {"terminal_state": (float("nan"), 0.0)}]
)
def test_wrong_arguments_are_problem_errors(name, wrong):
    with pytest.raises(ProblemError):
        library.by_name(name)(**wrong)


@pytest.mark.parametrize("name", [name for name in library.LINEAR if name != "quadcopter"])  # published sampled
def test_sampling_time_below_zero_is_a_problem_error(name):
    with pytest.raises(ProblemError):
        library.by_name(name)(sampling_time=-0.1)


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("pendulum", {"parameters": "other"}, "'paper' or 'physical'"),
        ("double_integrator", {"speed_bound": -1.0}, "speed_bound"),
        ("double_integrator", {"cutoff_hz": 30.0}, "Nyquist"),
        ("two_mass_spring", {"stiffness": 0.0}, "stiffness"),
        ("two_mass_spring", {"notch_width_hz": 0.0}, "width"),
        ("crane", {"cable_length": 0.0}, "cable_length"),
        ("crane", {"swing_bound": -0.1}, "swing_bound"),
        ("crane", {"acceleration_bound": -1.0}, "acceleration_bound"),
        ("flexible_joint_arm", {"stiffness_ratio": 0.0}, "stiffness_ratio"),
        ("flexible_joint_arm", {"torsion_bound": -0.1}, "torsion_bound"),
        ("flexible_satellite", {"torque_bound": -1.0}, "torque_bound"),
        ("mass_chain", {"cutoffs_hz": (4.0,)}, "cutoffs_hz"),
        ("mass_chain", {"cutoffs_hz": 4.0}, "cutoffs_hz"),
        ("mass_chain", {"stiffness": -1.0}, "stiffness"),
        ("mass_chain", {"damping": "much"}, "damping"),
        ("quadcopter", {"reference": (0.0, 0.0, 1.0)}, "reference"),
        ("quadcopter", {"tilt_bound": -0.1}, "tilt_bound"),
        ("quadcopter", {"lowest_height": "low"}, "lowest_height"),
        ("quadcopter", {"rotor_bounds": 13.0}, "rotor_bounds"),
        ("elliptic_rendezvous", {"eccentricity": 1.0}, "eccentricity"),
        ("elliptic_rendezvous", {"eccentricity": (0.1, 0.2)}, "eccentricity"),
        ("elliptic_rendezvous", {"perigee_radius": 0.0}, "perigee_radius"),
        ("elliptic_rendezvous", {"first_anomaly": None}, "first_anomaly"),
        ("quarter_car", {"bump_height": (0.1, 0.1)}, "bump_height"),
        ("quarter_car", {"stop_band_hz": 4.0}, "stop_band_hz"),
        ("quarter_car", {"stop_band_hz": (8.0, 4.0)}, "width"),
        ("scanner", {"resonance_hz": -1.0}, "resonance_hz"),
    ],
)
def test_wrong_physics_is_refused_by_name(name, wrong, message):
    with pytest.raises(ProblemError, match=message):
        library.by_name(name)(**wrong)


# --- double integrator


def test_double_integrator_has_the_textbook_map():
    h = 0.3
    dynamics = library.double_integrator(sampling_time=h, cutoff_hz=None).dynamics
    np.testing.assert_allclose(dynamics.A, [[1, h], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(dynamics.B, [[h**2 / 2], [h]], atol=1e-15)


def test_double_integrator_rests_on_its_speed_limit_only_without_the_low_pass():
    touches = {}
    for cutoff in (None, 5.0):
        problem = library.double_integrator(cutoff_hz=cutoff)
        speed = solved(problem)[1][:, 1]
        touches[cutoff] = np.diff(np.flatnonzero(speed > 0.3 - 1e-6))
    assert len(touches[None]) > 90
    assert (touches[None] == 1).all()
    assert 10 < len(touches[5.0]) < 50
    assert (touches[5.0] > 1).any()


# --- two masses and a spring


def test_two_masses_move_as_newton_says():
    problem = library.two_mass_spring(stiffness=0.7)
    u = np.random.default_rng(1).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(t, state):
        position_1, position_2, speed_1, speed_2 = state
        force = u[min(int(t / 0.05 + 1e-9), len(u) - 1), 0]
        spring = 0.7 * (position_2 - position_1)
        return [speed_1, speed_2, force + spring, -spring]

    state = np.zeros(4)
    for t in range(20):
        state = solve_ivp(newton, (0.05 * t, 0.05 * (t + 1) - 1e-12), state, rtol=1e-11, atol=1e-13).y[:, -1]
    expected = state[0], state[1] - state[0], state[2], state[3] - state[2]
    np.testing.assert_allclose(x[20], expected, atol=1e-9)


def test_two_masses_swing_at_their_flexible_frequency_and_keep_energy():
    problem = library.two_mass_spring()
    np.testing.assert_allclose(frequencies(problem), [np.sqrt(2)], rtol=1e-12)
    assert removed(problem, 1) == bins_around(np.sqrt(2), 0.2, problem)
    x = simulate(problem, np.zeros((problem.horizon, 1)), [0.0, 0.3, 0.1, -0.2]).x
    q = np.column_stack([x[:, 0], x[:, 0] + x[:, 1], x[:, 2], x[:, 2] + x[:, 3]])
    total = energy(q, np.eye(2), np.array([[1.0, -1.0], [-1.0, 1.0]]))
    np.testing.assert_allclose(total, total[0], rtol=1e-12)


# --- crane


def test_crane_follows_the_nonlinear_pendulum_at_small_angles():
    problem = library.crane(cable_length=4.0)
    u = np.random.default_rng(5).uniform(-0.15, 0.15, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(_, state, k):
        _, speed, swing, rate = state
        return [speed, u[k, 0], rate, -(9.81 * np.sin(swing) + u[k, 0] * np.cos(swing)) / 4.0]

    state = np.zeros(4)
    for k in range(50):
        state = solve_ivp(newton, (0.1 * k, 0.1 * (k + 1)), state, args=(k,), rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(x[k + 1], state, atol=1e-5)
    assert np.abs(x[:51, 2]).max() > 0.005


def test_crane_loses_the_bins_around_its_pendulums_frequency():
    for length in (4.0, 5.0):
        problem = library.crane(cable_length=length)
        np.testing.assert_allclose(frequencies(problem), [np.sqrt(9.81 / length)], rtol=1e-12)
        hertz = np.fft.rfftfreq(problem.horizon, 0.1)
        near = np.abs(hertz - np.sqrt(9.81 / length) / (2 * np.pi)) < 0.05
        assert (problem.control_stop[:, 0] == near).all()
        assert near.any()


def test_crane_is_at_rest_with_its_own_cable_anyway_and_with_others_thanks_to_the_band():
    band = solved(library.crane())[2]
    free = solved(library.crane(notch_width_hz=None))[2]

    def swing(u, length):  # amplitude after the move
        last = simulate(library.crane(cable_length=length, notch_width_hz=None), u).x[-1]
        return np.hypot(last[2], last[3] / np.sqrt(9.81 / length))

    for u in (band, free):
        assert swing(u, 5.0) < 1e-7
        transform = u[:, 0] @ np.exp(-1j * np.sqrt(9.81 / 5.0) * 0.1 * np.arange(len(u)))
        assert abs(transform) < 1e-5
    for length in (4.0, 4.5, 5.5, 6.0):
        assert swing(band, length) < swing(free, length) / 3.5


# --- flexible joint arm


def test_arm_moves_as_its_two_inertias_say():
    problem = library.flexible_joint_arm(stiffness_ratio=1.3)
    u = np.random.default_rng(6).uniform(-6, 6, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(_, state, k):
        motor, link, motor_speed, link_speed = state
        torsion = 1.3 * (motor - link)
        return [motor_speed, link_speed, u[k, 0] - 1.25 * motor_speed - 48.6 * torsion, 19.5 * torsion]

    state = np.zeros(4)
    for k in range(40):
        state = solve_ivp(newton, (0.02 * k, 0.02 * (k + 1)), state, args=(k,), rtol=1e-11, atol=1e-13).y[:, -1]
        motor, link, motor_speed, link_speed = state
        np.testing.assert_allclose(x[k + 1], [link, motor - link, link_speed, motor_speed - link_speed], atol=1e-9)


def test_arm_without_torque_loses_energy_and_coasts_to_a_stop_where_its_momentum_says():
    problem = library.flexible_joint_arm(horizon=1500)
    x = simulate(problem, np.zeros((problem.horizon, 1)), [0.2, 0.1, 0.5, -0.3]).x
    motor = x[:, [0, 2]] + x[:, [1, 3]]
    total = energy(
        np.column_stack([motor[:, 0], x[:, 0], motor[:, 1], x[:, 2]]),
        np.diag([1, 48.6 / 19.5]),  # inertias of motor and link, over that of the motor
        48.6 * np.array([[1, -1], [-1, 1]]),
    )
    assert (np.diff(total) < 0).all()
    momentum = motor[:, 1] + 48.6 / 19.5 * x[:, 2] + 1.25 * motor[:, 0]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)
    np.testing.assert_allclose(x[-1], [momentum[0] / 1.25, 0, 0, 0], atol=1e-4)


def test_arm_loses_the_bins_around_its_resonance():
    problem = library.flexible_joint_arm()
    resonance = np.sqrt(48.6 + 19.5)
    np.testing.assert_allclose(frequencies(problem), [resonance], rtol=0.01)  # friction changes it a little
    hertz = np.fft.rfftfreq(problem.horizon, 0.02)
    near = np.abs(hertz - resonance / (2 * np.pi)) < 0.5
    assert (problem.control_stop[:, 0] == near).all()
    assert near.sum() == 3


def test_arm_uses_all_its_torque_and_torsion_and_vibrates_less_where_its_stiffness_is_not_known():
    answers = {width: solved(library.flexible_joint_arm(notch_width_hz=width)) for width in (1.0, None)}
    for _, x, u in answers.values():
        assert np.abs(u).max() == pytest.approx(6.3, rel=1e-6)
        assert np.abs(x[:, 1]).max() == pytest.approx(np.radians(5), rel=1e-6)

    def vibration(u, ratio):  # amplitude of the torsion after the move
        last = simulate(library.flexible_joint_arm(stiffness_ratio=ratio, notch_width_hz=None), u).x[-1]
        return np.hypot(last[1], last[3] / np.sqrt(ratio * (48.6 + 19.5)))

    for ratio in (0.8, 0.9, 1.1, 1.2):
        assert vibration(answers[1.0][2], ratio) < 0.75 * vibration(answers[None][2], ratio)


# --- flexible satellite


def test_satellite_loses_the_bins_around_its_free_hub_frequencies():
    problem = library.flexible_satellite()

    def characteristic(frequency):  # of the undamped satellite: the inertia that the torque feels
        modes = ((6.45637, 0.7681), (-1.25819, 1.1038))
        return 350 + sum(c**2 * frequency**2 / (held**2 - frequency**2) for c, held in modes)

    free = [brentq(characteristic, low, high) for low, high in ((0.7682, 1.1037), (1.1039, 2.0))]
    np.testing.assert_allclose(frequencies(problem), free, rtol=1e-4)  # damping adds its square
    for mode, frequency in enumerate(free, start=1):
        assert removed(problem, mode) == bins_around(frequency, 0.05, problem)
    assert not problem.state_stop[:, [0, 3, 4, 5]].any()


def test_satellite_keeps_angular_momentum_and_loses_energy():
    problem = library.flexible_satellite()
    mass = np.array([[350, 6.45637, -1.25819], [6.45637, 1, 0], [-1.25819, 0, 1]])
    u = np.random.default_rng(2).uniform(-1, 1, (problem.horizon, 1))
    momentum = simulate(problem, u).x[:, 3:] @ mass[0]
    np.testing.assert_allclose(momentum[1:], problem.sampling_time * np.cumsum(u), atol=1e-11)
    x = simulate(problem, 0 * u, [0.1, 0.2, -0.1, 0.01, 0.0, 0.05]).x
    total = energy(x, mass, np.diag([0, 0.7681**2, 1.1038**2]))
    assert (np.diff(total) < 0).all()


# --- mass chain


def test_mass_chain_is_the_reference_instance():
    dynamics = library.mass_chain().dynamics
    for (i, j), value in {
        (0, 0): 0.9752329835968522,
        (0, 1): 0.012313890524584481,
        (0, 2): 4.6280001562353116e-05,
        (0, 4): 0.04933825548659111,
        (1, 1): 0.9752792635984145,
        (1, 5): 0.049339234050821607,
        (4, 0): -0.983471102246856,
        (7, 7): 0.9653982725743836,
    }.items():
        assert dynamics.A[i, j] == pytest.approx(value, rel=1e-12)
    for (i, j), value in {(0, 0): 0.0012406747076181789, (1, 0): 4.6477749215747014e-06}.items():
        assert dynamics.B[i, j] == pytest.approx(value, rel=1e-12)
    stop = library.mass_chain().control_stop
    assert [np.flatnonzero(column)[[0, -1]].tolist() for column in stop.T] == [[80, 200], [120, 200]]


def test_mass_chain_with_a_free_end_reaches_the_other_reference_optimum():
    chain = library.mass_chain(cutoffs_hz=None, terminal_state=None, force_bound=0.8, terminal_weight=1.0)
    notched = dataclasses.replace(chain, control_spectrum=stop_band(bins=range(18, 25)))
    assert solved(notched)[0] == pytest.approx(64.48606688009046, rel=1e-8)


def test_undamped_mass_chain_keeps_energy_and_has_the_frequencies_of_a_chain():
    problem = library.mass_chain(damping=0.0)
    x = simulate(problem, np.zeros((problem.horizon, 2))).x
    stiffness = 10 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    total = energy(x, np.eye(4), stiffness)
    np.testing.assert_allclose(total, total[0], rtol=1e-11)
    np.testing.assert_allclose(frequencies(problem), 2 * np.sqrt(10) * np.sin(np.arange(1, 5) * np.pi / 10), rtol=1e-11)


# --- quadcopter


def test_quadcopter_is_a_rigid_body_with_drag_under_gravity_to_the_printed_decimals():
    dynamics = library.quadcopter().dynamics
    h, drag = 0.1, -np.log(0.9846) / 0.1
    tilting, yawing, lift = 14.512, 3.049, 0.2107 * drag / (1 - 0.9846)  # accelerations by one unit of a rotor
    torques = np.array([[0, -tilting, 0, tilting], [-tilting, 0, tilting, 0], [-yawing, yawing, -yawing, yawing]])

    def newton(_, state):
        angles, _, rates, speeds, rotors = np.split(state, [3, 6, 9, 12])
        thrust = np.array([9.81 * angles[0], -9.81 * angles[1], lift * rotors.sum()])
        return np.concatenate([rates, speeds, torques @ rotors, thrust - drag * speeds, np.zeros(4)])

    flow = [solve_ivp(newton, (0, h), start, rtol=1e-10, atol=1e-12).y[:12, -1] for start in np.eye(16)]
    np.testing.assert_allclose(np.hstack([dynamics.A, dynamics.B]), np.transpose(flow), atol=0.5001e-4)
    assert dynamics.sampling_time == h


def test_quadcopter_pays_as_the_source_does_and_keeps_its_bounds():
    problem = library.quadcopter()
    rng = np.random.default_rng(7)
    x, u = rng.normal(size=(61, 12)), rng.normal(size=(60, 4))
    paid = 10 * ((x[:, 2] - 1) ** 2 + (x[:, 3:6] ** 2).sum(axis=1)) + 5 * (x[:, 9:] ** 2).sum(axis=1)
    assert problem.cost.value(x, u) == pytest.approx(paid.sum() + 0.1 * (u**2).sum(), rel=1e-12)
    hover, tube = 10.5916, problem.state_tube
    np.testing.assert_allclose(problem.control_tube.lower, 9.6 - hover)
    np.testing.assert_allclose(problem.control_tube.upper, 13 - hover)
    assert tube.lower[1].tolist() == [-np.pi / 6] * 2 + [-np.inf] * 3 + [-1] + [-np.inf] * 6
    assert tube.upper[1].tolist() == [np.pi / 6] * 2 + [np.inf] * 10


def test_quadcopter_turns_sooner_and_climbs_higher_where_its_rotors_are_free():
    x, u = solved(library.quadcopter())[1:]
    free_x, free_u = solved(library.quadcopter(cutoff_hz=None))[1:]
    for rotors in (u, free_u):
        assert rotors.min() == pytest.approx(9.6 - 10.5916, rel=1e-6)
    np.testing.assert_allclose(x[:, [0, 1, 3, 4]], 0, atol=1e-6)  # it turns where it is
    assert x[:, 5].max() < 0.51 * free_x[:, 5].max()
    assert free_u.max() > 1.5 * u.max()
    assert (free_x[1:6, 2] > x[1:6, 2]).sum() >= 4
    assert np.abs(free_u[-10:]).max() < 0.01 < np.abs(u[-10:]).max()


def test_quadcopter_tilts_to_its_bound_to_reach_a_place():
    place = (0.0, 0.0, 1.0, 1.0, -1.0, 0.5, *(0.0,) * 6)
    _, x, _ = solved(library.quadcopter(reference=place))
    assert x[:, 0].max() == pytest.approx(np.pi / 6, rel=1e-6)
    assert (np.abs(x).max(axis=0) > 0.1).all()
    np.testing.assert_allclose(x[40, 2:6], place[2:6], atol=0.05)


# --- elliptic rendezvous

MU = 3.986004418e14  # m^3/s^2


def inertial_target(anomaly: float, eccentricity: float, perigee: float) -> np.ndarray:
    """Return position [m] and velocity [m/s] on the orbit, perigee on the first axis."""
    p = perigee * (1 + eccentricity)
    radius = p / (1 + eccentricity * np.cos(anomaly))
    speed = np.sqrt(MU / p)
    return np.array(
        [
            radius * np.cos(anomaly),
            radius * np.sin(anomaly),
            -speed * np.sin(anomaly),
            speed * (eccentricity + np.cos(anomaly)),
        ]
    )


def frame(target: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the radial and along-track directions as rows, and the rate at which they turn."""
    radial = target[:2] / np.linalg.norm(target[:2])
    rate = (target[0] * target[3] - target[1] * target[2]) / (target[:2] @ target[:2])
    return np.array([radial, [-radial[1], radial[0]]]), rate


def chased(target: np.ndarray, relative: np.ndarray, u: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the target and the relative state [km, m/s] one step on, by Newton's law of gravity in inertial axes."""
    axes, rate = frame(target)
    turn = rate * np.array([[0, -1], [1, 0]])
    place, speed = 1e3 * relative[:2], relative[2:]
    chaser = target + np.concatenate([axes.T @ place, axes.T @ (speed + turn @ place)])

    def fall(_, both):
        target, chaser = both[:4], both[4:]
        thrust = frame(target)[0].T @ (1e-3 * u)
        pull = [-MU * body[:2] / np.linalg.norm(body[:2]) ** 3 for body in (target, chaser)]
        return np.concatenate([target[2:], pull[0], chaser[2:], pull[1] + thrust])

    both = solve_ivp(fall, (0, step), np.concatenate([target, chaser]), method="DOP853", rtol=1e-13, atol=1e-7).y[:, -1]
    target, gap = both[:4], both[4:] - both[:4]
    axes, rate = frame(target)
    place = axes @ gap[:2]
    speed = axes @ gap[2:] - rate * np.array([[0, -1], [1, 0]]) @ place
    return target, np.concatenate([1e-3 * place, speed])


def test_rendezvous_follows_two_bodies_in_kepler_motion():
    problem = library.elliptic_rendezvous(first_anomaly=-0.2)
    dynamics, size = problem.dynamics, 0.1
    target = inertial_target(-0.2, 0.7, 6.9e6)
    for t in range(4):  # across the perigee, where the matrices change most
        A, B, _ = dynamics.at(t)
        for column in range(6):
            direction = np.zeros(6)
            direction[column] = size
            ahead = chased(target, direction[:4], direction[4:], problem.sampling_time)[1]
            behind = chased(target, -direction[:4], -direction[4:], problem.sampling_time)[1]
            expected = (ahead - behind) / (2 * size)  # the even part of gravity cancels
            np.testing.assert_allclose(np.hstack([A, B])[:, column], expected, atol=2e-6)
        target = chased(target, np.zeros(4), np.zeros(2), problem.sampling_time)[0]


def test_rendezvous_on_the_same_orbit_ahead_in_time_repeats_every_period():
    period = 2 * np.pi * np.sqrt((6.9e6 / 0.7) ** 3 / MU)
    orbit = library.elliptic_rendezvous(
        horizon=101, sampling_time=period / 100, eccentricity=0.3, first_anomaly=1.0, cutoff_hz=None
    ).dynamics
    np.testing.assert_allclose(orbit.A[100], orbit.A[0], atol=1e-9)
    target = inertial_target(1.0, 0.3, 6.9e6)
    axes, rate = frame(target)
    place = axes @ target[2:]  # the chaser is where the target will be one second later
    speed = axes @ (-MU * target[:2] / np.linalg.norm(target[:2]) ** 3) - rate * np.array([-place[1], place[0]])
    x = start = np.concatenate([1e-3 * place, speed])
    for t in range(100):
        x = orbit.A[t] @ x
    np.testing.assert_allclose(x, start, atol=1e-7)


def test_rendezvous_on_a_circle_is_clohessy_wiltshire():
    problem = library.elliptic_rendezvous(10, 60.0, eccentricity=0.0, perigee_radius=7e6, cutoff_hz=None)
    n, h = np.sqrt(MU / 7e6**3), 60.0
    c, s = np.cos(n * h), np.sin(n * h)
    A = np.array(
        [
            [4 - 3 * c, 0, s / n, 2 * (1 - c) / n],
            [6 * (s - n * h), 1, 2 * (c - 1) / n, (4 * s - 3 * n * h) / n],
            [3 * n * s, 0, c, 2 * s],
            [6 * n * (c - 1), 0, -2 * s, 4 * c - 3],
        ]
    )
    km = np.diag([1e-3, 1e-3, 1, 1])
    for t in range(10):
        np.testing.assert_allclose(problem.dynamics.A[t], km @ A @ np.linalg.inv(km), atol=1e-10)


# --- quarter car


def test_quarter_car_follows_newton_over_the_bump():
    problem = library.quarter_car()
    u = np.random.default_rng(3).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x
    t = 0.01 * np.arange(301)
    road = np.where((t > 0.5) & (t < 0.75), 0.04 * (1 - np.cos(8 * np.pi * t)), 0)

    def newton(time, state, k):
        body, wheel, body_speed, wheel_speed = state
        ground = np.interp(time, t, road)
        suspension = 16812 * (body - wheel) + 1000 * (body_speed - wheel_speed) - 1000 * u[k, 0]
        return [body_speed, wheel_speed, -suspension / 290, (suspension - 190000 * (wheel - ground)) / 59]

    state = np.zeros(4)
    for k in range(80):
        state = solve_ivp(newton, (t[k], t[k + 1]), state, args=(k,), rtol=1e-10, atol=1e-12).y[:, -1]
        body, wheel, body_speed, wheel_speed = state
        np.testing.assert_allclose(x[k + 1], [body - wheel, body_speed, wheel - road[k + 1], wheel_speed], atol=1e-8)


def test_quarter_car_pays_for_acceleration_tyre_and_force():
    problem = library.quarter_car()
    u = np.random.default_rng(4).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x
    travel, body_speed, tyre, wheel_speed = x[:-1].T
    acceleration = (1000 * u[:, 0] - 16812 * travel - 1000 * (body_speed - wheel_speed)) / 290
    paid = (acceleration**2 + 1000 * tyre**2 + 0.1 * u[:, 0] ** 2).sum() / 2
    assert problem.cost.value(x, u) == pytest.approx(paid, rel=1e-12)


def test_quarter_car_loses_the_bins_from_4_to_8_hz_of_the_body_speed_alone():
    stop = library.quarter_car().state_stop
    assert stop.any(axis=0).tolist() == [False, True, False, False]
    removed = np.flatnonzero(stop[:, 1]) / 3.01  # Hz
    assert removed.min() - 1 / 3.01 < 4 < removed.min()
    assert removed.max() < 8 < removed.max() + 1 / 3.01


# --- scanner


def test_scanner_resonates_where_it_says_and_stands_where_it_is_driven():
    problem = library.scanner(resonance_hz=900.0)
    np.testing.assert_allclose(frequencies(problem), [2 * np.pi * 900], rtol=1e-10)
    np.testing.assert_allclose(problem.dynamics.A @ [3.0, 0.0] + problem.dynamics.B @ [3.0], [3.0, 0.0], atol=1e-12)


def test_scanner_follows_one_period_of_a_triangle():
    reference = library.scanner().cost.x_ref[:, 0]
    assert reference[[0, 125, 250]].tolist() == [-5, 5, -5]
    slopes = np.diff(reference) * 10  # um per 0.1 ms is 10 mm/s
    np.testing.assert_allclose(np.abs(slopes), 0.8, rtol=1e-12)
    spectrum = np.abs(np.fft.rfft(reference[:-1]))
    np.testing.assert_allclose(spectrum[::2], 0, atol=1e-10)  # odd harmonics only


def test_scanner_unites_its_two_bands():
    united = library.scanner().control_stop
    parts = library.scanner(cutoff_hz=None).control_stop, library.scanner(notch_width_hz=None).control_stop
    assert (united == parts[0] | parts[1]).all()
    assert parts[0].any()
    assert parts[1].any()
    assert not (parts[0] & parts[1]).any()
