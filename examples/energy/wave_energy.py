"""
Wave energy: a plant known by its frequency response
====================================================

A buoy absorbs the most power from a wave, with a bounded force.

The plant is a buoy in heave, known only by a table of coefficients per frequency: from
them follow the complex responses from force [N] and from the wave [m] to velocity
[m/s]. The wave has 0.3 Hz and an amplitude of 62.5 mm, and the record of 20 s repeats.
The cost is minus the mean absorbed power [W]. The force is unlimited, or at most 2000 N
or 1000 N.
"""

from importlib.resources import files

import numpy as np

import lin_freq_ocp as lfo

amplitude = 0.0625  # of the wave, in m: change this number
mass, stiffness = 682.58651, 24462.9084  # of the hull, in kg and N/m
horizon, record = 400, 20.0  # samples, s
path = files("lin_freq_ocp.library") / "wavebot.csv"  # at 0.05, 0.10 .. 2.50 Hz
with path.open() as file:
    table = np.loadtxt(file, delimiter=",", skiprows=4)
w, added_mass, damping, real, imaginary = table.T
impedance = (
    1j * w * (mass + added_mass)
    + np.maximum(damping, 45)  # computed values below zero would give energy
    + stiffness / (1j * w)
)
bins = np.arange(1, len(w) + 1)  # the table has the harmonics 1 to 50 of the record
response = np.zeros(horizon // 2 + 1, dtype=complex)
response[bins] = 1 / impedance
by_wave = np.zeros_like(response)
wave = 6  # 0.3 Hz is the sixth harmonic of the record
by_wave[wave] = (real + 1j * imaginary)[wave - 1] * response[wave] * amplitude

buoy = lfo.FrequencyResponse(
    response,
    sampling_time=record / horizon,
    offset=by_wave * horizon / 2,  # as numpy.fft.rfft has it
    state_names=["velocity [m/s]"],
    control_names=["force [N]"],
)
for force in (None, 2000.0, 1000.0):
    problem = lfo.OptimalControlProblem(
        buoy,
        horizon,
        cost=lfo.QuadraticCost(S=[[1 / horizon]]),  # the mean of velocity times force
        control_set=None if force is None else lfo.Box(-force, force),
        control_spectrum=lfo.stop_band(bins=[0, *range(51, 201)]),  # not in the table
        name="wave energy",
    )
    result = lfo.solve(problem)
    bound = "free" if force is None else f"{force:g} N"
    print(f"force {bound:>7}: mean power {-result.cost:.5f} W, gap {result.gap:.0e}")
figure = result.plot()
figure.savefig("wave_energy.png")
print("picture: wave_energy.png, at most 1000 N")
