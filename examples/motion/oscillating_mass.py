"""
A quiet band of the applied force
=================================

A mass on a spring is held at rest against random pushes.

The force is at most 1 N. Its actuator has a resonance at 8 Hz that the controller's
model does not have, so that the force must stay below 0.06 N between 5.5 and 10.5 Hz.

A notch on each plan does not limit the applied force, because the loop applies only the
first sample of each plan. Windows over applied and planned samples limit it; without a
taper, the strong low frequencies leak into the band. ``lfo.spectrum.closed_loop``
chooses tapered windows.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

STEPS, SEED, SAMPLING = 300, 0, 0.02
BAND = lfo.spectrum.notch(centre_hz=8, width_hz=5)
AMPLITUDE = 0.06  # N, of a sinusoid in the band: change this number
LATE = 100  # samples at the end, whose vibration counts
REST = np.zeros(40)  # no force before the loop begins


def problem() -> lfo.OptimalControlProblem:
    """Return the mass of 1 kg on a spring of 4 N/m, without a frequency limit."""
    dynamics = lfo.LinearDynamics.from_continuous(
        [[0, 1], [-4.0, -0.1]],
        [[0], [1]],
        SAMPLING,
        state_names=["position [m]", "speed [m/s]"],
        control_names=["force [N]"],
    )
    cost = lfo.QuadraticCost(Q=np.diag([10.0, 1.0]), R=0.01, P=np.diag([50.0, 5.0]))
    return lfo.OptimalControlProblem(
        dynamics,
        50,
        cost,
        lfo.Box(-1, 1),
        initial_state=[0.2, 0.0],
        name="oscillating mass",
    )


def vibration(force: np.ndarray) -> float:
    """Return the amplitude at the end of an actuator with a resonance at 8 Hz."""
    omega, taper = 2 * np.pi * 8.0, np.hanning(LATE)
    mode = lfo.LinearDynamics.from_continuous(
        [[0.0, 1.0], [-(omega**2), -0.02 * omega]], [[0.0], [omega**2]], SAMPLING
    )
    state, motion = np.zeros(2), []
    for u in force:
        state = mode.A @ state + mode.B @ u
        motion.append(state[0])
    wave = np.exp(-1j * omega * SAMPLING * np.arange(LATE))
    return float(2 * abs((taper * motion[-LATE:]) @ wave) / taper.sum())


def main() -> lfo.results.ClosedLoop:
    """Run four loops with the same disturbance, and return the last."""
    base, limit = (
        problem(),
        lfo.spectrum.closed_loop(BAND, AMPLITUDE, SAMPLING, past=REST),
    )
    untapered = lfo.spectrum.Spectrogram(
        lfo.MagnitudeBound(amplitude=AMPLITUDE, band=BAND),
        length=limit.length,
        hop=limit.hop,
        past=REST,
    )
    noise = np.random.default_rng(SEED).normal(scale=[1e-3, 1e-2], size=(STEPS, 2))
    print(
        f"{'':26}{'position':>16}{'in the band':>14}{'vibration':>12}{'softened':>10}"
    )
    for name, spectrum in {
        "no limit": None,
        "notch of each plan": BAND,
        "windows without a taper": untapered,
        "closed_loop": limit,
    }.items():
        with warnings.catch_warnings():  # that a notch limits each plan only
            warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
            controller = lfo.RecedingHorizon(
                replace(base, control_spectrum=spectrum),
                soft={"control_spectrum": 100.0},
            )
        loop = controller.run(base.initial_box.lower, STEPS, disturbance=noise)
        (windows,) = loop.spectra(control_spectrum=limit)
        largest = windows.amplitude * windows.magnitudes[:, windows.bins].max()
        softened = sum(bool(step.excess) for step in loop.steps)
        print(
            f"{name:26}{1e3 * np.std(loop.states[:, 0]):13.1f} mm{largest:12.3f} N"
            f"{vibration(loop.controls):10.3f} N{softened:10}"
        )
    print(windows)
    return loop


if __name__ == "__main__":
    figure = main().plot()
    figure.savefig("oscillating_mass.png")
    print("picture: oscillating_mass.png, of the last loop")
