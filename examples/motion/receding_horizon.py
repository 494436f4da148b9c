"""
Predictive control near a resonance
===================================

A cart carries a pendulum and a mode at 12 Hz that the controller's model does not have.

The controller brings the pendulum to rest with a force of at most 5 N. Without a
frequency limit it excites the mode. A low pass after the controller delays its force,
and the loop suffers. The third controller bounds the spectrum of every window of half a
second, over applied and planned samples, and so plans around the mode.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter

import lin_freq_ocp as lfo

STEPS, LATE, SEED = 120, 80, 1
RESONANCE_HZ, DAMPING = 12.0, 0.01
CUTOFF_HZ = 6.0  # of the filter after the plain controller
LIMIT = 0.2  # N: of |DFT| near the resonance, in every window: change this number


def problem() -> lfo.OptimalControlProblem:
    """Return the problem to bring the pendulum to rest, without a frequency limit."""
    cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
        [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
        [[0], [0], [0.38277512], [-0.65618592]],
        sampling_time=0.01,
        state_names=[
            "position [m]",
            "angle [rad]",
            "speed [m/s]",
            "angular speed [rad/s]",
        ],
        control_names=["force [N]"],
    )
    return lfo.OptimalControlProblem(
        cart,
        horizon=60,
        cost=lfo.QuadraticCost(
            Q=np.diag([10, 10, 0.1, 0.1]), R=0.01, P=np.diag([100, 100, 10, 10])
        ),
        control_set=lfo.Box(-5, 5),
        initial_state=[-0.15, 0.1, 0, 0],
        name="pendulum",
    )


class Plant:
    """The pendulum, with a lightly damped mode that the force excites."""

    def __init__(self, dynamics: lfo.LinearDynamics):
        omega = 2 * np.pi * RESONANCE_HZ
        mode = [[0.0, 1.0], [-(omega**2), -2 * DAMPING * omega]]
        self._mode = lfo.LinearDynamics.from_continuous(
            mode, [[0.0], [omega**2]], dynamics.sampling_time
        )
        self._dynamics, self._state = dynamics, np.zeros(2)
        self.motion: list[float] = []

    @property
    def vibration(self) -> float:
        """Return the amplitude of the mode over the last samples."""
        late = np.array(self.motion[-LATE:]) * np.hanning(LATE)
        wave = np.exp(
            -2j * np.pi * RESONANCE_HZ * self._dynamics.sampling_time * np.arange(LATE)
        )
        return float(2 * abs(late @ wave) / np.hanning(LATE).sum())

    def __call__(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the next state of the pendulum, and advance the mode."""
        self._state = self._mode.A @ self._state + self._mode.B @ u
        self.motion.append(float(self._state[0]))
        return self._dynamics.A @ x + self._dynamics.B @ u


def filtered_loop(
    base: lfo.OptimalControlProblem, plant: Plant, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return states and controls of the plain controller, followed by a low pass."""
    numerator, denominator = np.asarray(butter(2, CUTOFF_HZ, fs=1 / base.sampling_time))
    memory, x = np.zeros((2, 1)), base.initial_box.lower
    controller, states, controls, applied = lfo.RecedingHorizon(base), [x], [], None
    for k in range(STEPS):
        planned = controller.step(x, applied=applied)
        filtered = lfilter(numerator, denominator, planned[None], axis=0, zi=memory)
        applied, memory = filtered[0][0], filtered[1]
        x = plant(x, applied) + noise[k]
        states.append(x)
        controls.append(applied)
    return np.array(states), np.array(controls)


def row(name: str, states: np.ndarray, controls: np.ndarray, vibration: float) -> str:
    """Return a line of the table: angle and vibration at the end, largest force."""
    angle = np.degrees(np.sqrt(np.mean(states[-LATE:, 1] ** 2)))
    return (
        f"{name:28}{angle:10.3f} deg{vibration:12.3f} N{np.abs(controls).max():12.3f} N"
    )


def main() -> lfo.results.ClosedLoop:
    """Run the three loops with the same disturbance, and return the last."""
    base = problem()
    noise = np.random.default_rng(SEED).normal(
        scale=[0, 0, 1e-3, 3e-3], size=(STEPS, 4)
    )
    quiet = lfo.MagnitudeBound(
        LIMIT,
        band=lfo.spectrum.notch(centre_hz=RESONANCE_HZ, width_hz=7),
        window="hann",
    )
    at_rest = np.zeros(
        (50, 1)
    )  # no force before the first step: windows show its onset
    bounded = replace(
        base,
        control_spectrum=lfo.spectrum.Spectrogram(
            quiet, length=50, hop=5, past=at_rest
        ),
    )
    print(f"{'':28}{'angle (rms)':>14}{'vibration':>14}{'largest |u|':>14}")
    start = base.initial_box.lower
    plant = Plant(base.dynamics)
    plain = lfo.RecedingHorizon(base).run(start, STEPS, plant, disturbance=noise)
    print(row("plain", plain.states, plain.controls, plant.vibration))
    plant = Plant(base.dynamics)
    print(
        row(
            "followed by a low pass",
            *filtered_loop(base, plant, noise),
            plant.vibration,
        )
    )
    plant = Plant(base.dynamics)
    loop = lfo.RecedingHorizon(bounded, soft={"control_spectrum": 10.0}).run(
        start, STEPS, plant, disturbance=noise
    )
    print(row("with bounded windows", loop.states, loop.controls, plant.vibration))
    softened = sum(source == "softened problem" for source in loop.sources)
    median = 1e3 * np.median(loop.solve_seconds)
    print(f"{softened} of {STEPS} steps softened; median step {median:.3g} ms")
    return loop


if __name__ == "__main__":
    figure = main().plot()
    figure.savefig("receding_horizon.png")
    print("picture: receding_horizon.png, of the third loop")
