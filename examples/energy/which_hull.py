"""
Which hull would absorb more
============================

At each frequency, what a heavier or softer hull would add to the absorbed power.

A buoy absorbs power from an irregular sea, with a force of at most 1500 N. The
derivative of the optimal power by the plant's response at each bin,
``result.sensitivities.response``, needs no solve. With the chain rule through the
impedance it says at which frequencies a heavier or a softer hull would pay: below its
resonance near 0.67 Hz, where the sea is.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

force = 1500.0  # the largest, in N: change this number
mass, stiffness = 682.58651, 24462.9084  # of the hull, in kg and N/m
N, record = 400, 20.0  # samples, s
path = files("lin_freq_ocp.library") / "wavebot.csv"  # at 0.05, 0.10 .. 2.50 Hz
with path.open() as file:
    w, added, damping, real, imaginary = np.loadtxt(file, delimiter=",", skiprows=4).T
bins, rng = np.arange(1, len(w) + 1), np.random.default_rng(4)
hertz = bins / record
# wave heights around 0.3 Hz, in m, of random phases
sea = 0.04 * np.exp(-(((hertz - 0.35) / 0.12) ** 2))
sea = sea * np.exp(2j * np.pi * rng.random(len(w)))


def absorbed(mass, stiffness):
    """Return the optimum of a hull, and its response at the bins of the table."""
    losses = np.maximum(damping, 45)
    G = np.zeros(N // 2 + 1, dtype=complex)
    G[bins] = 1 / (1j * w * (mass + added) + losses + stiffness / (1j * w))
    by_wave = np.zeros_like(G)
    by_wave[bins] = (real + 1j * imaginary) * sea * G[bins] * N / 2
    hull = lfo.FrequencyResponse(
        G,
        sampling_time=record / N,
        offset=by_wave,
        state_names=["velocity [m/s]"],
        control_names=["force [N]"],
    )
    problem = lfo.OptimalControlProblem(
        hull,
        N,
        cost=lfo.QuadraticCost(S=[[1 / N]]),  # minus the power is the mean of v f
        control_set=lfo.Box(-force, force),
        control_spectrum=lfo.stop_band(bins=[0, *range(51, 201)]),
    )
    return lfo.solve(problem), G[bins], by_wave[bins]


found, G, by_wave = absorbed(mass, stiffness)
price = found.sensitivities  # of the cost, which is minus the power
slope = price.response[bins, 0, 0]
wave_slope = 2 / N * np.fft.rfft(np.roll(price.offset[:, 0], 1))[bins]  # at t + 1
gained = {}  # in W, at each frequency
for name, step, change in (
    ("100 kg heavier", 100.0, 1j * w),
    ("2 kN/m softer", -2000.0, 1 / (1j * w)),
):
    moved = -step * change * G  # of the logarithm of both responses
    gradient = np.conj(slope) * G + np.conj(wave_slope) * by_wave
    gained[name] = -np.real(gradient * moved)
softer = absorbed(mass, stiffness - 20.0)[0].cost - found.cost
print(f"mean power {-found.cost:.3f} W")
print(", ".join(f"{name}: {each.sum():+.2f} W" for name, each in gained.items()))
exact = gained["2 kN/m softer"].sum() / 100
print(
    f"20 N/m softer: {exact:.5f} W by the derivative, {-softer:.5f} W by another solve"
)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for (name, each), side in zip(gained.items(), (-0.2, 0.2), strict=True):
    left.bar((bins + side) / record, each, 0.4 / record, label=name)
left.set(xlim=(0, 1.2), xlabel="frequency [Hz]", ylabel="power gained [W]")
left.legend()
several = np.linspace(0.7, 1.3, 9)
power = [-absorbed(mass, part * stiffness)[0].cost for part in several]
right.plot(several * stiffness / 1000, power, label="optimal power")
tangent = -found.cost + gained["2 kN/m softer"].sum() * (1 - several) * stiffness / 2e3
right.plot(several * stiffness / 1000, tangent, "--", label="its derivative")
right.set(xlabel="stiffness [kN/m]", ylabel="mean power [W]")
right.legend()
figure.savefig("which_hull.png", dpi=150)
print("picture: which_hull.png, by frequency and by stiffness")
