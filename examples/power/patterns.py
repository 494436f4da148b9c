"""
A table of optimal pulse patterns with proven gaps
==================================================

How little distortion can an inverter with five levels have, by the number of switches?

The published class: exactly k switches in a period, at least 0.01 pi apart, no level
below zero in the first half of the period, and a third harmonic of at most 0.01. Each
pattern is proven: none of the class has a distortion below the printed bound.
"""

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

modulations = 0.3, 0.5, 0.7, 0.9  # amplitudes of the fundamental: change these numbers
switches = 8, 12, 16, 20
print("   M   k   distortion [%]   bound [%]   gap")
table = np.zeros((len(switches), len(modulations)))
for i, k in enumerate(switches):
    for j, M in enumerate(modulations):
        problem = lfo.library.pulse_pattern(
            kind="opp",
            modulation=M,
            switches=k,
            least_dwell=0.01 * np.pi,
            unipolar=True,
            exactly=True,
        )
        result = lfo.solve(problem)
        table[i, j] = 100 * result.cost**0.5
        bound, gap = 100 * result.lower_bound**0.5, result.gap
        print(f"{M:4.1f}{k:4d}{table[i, j]:17.5f}{bound:12.5f}   {gap:.1e}")

# %%
# ``result.write_proof`` writes a file from which ``lfo-check`` proves such a bound.

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for j, M in enumerate(modulations):
    axes.semilogy(switches, table[:, j], marker="o", label=f"M = {M:g}")
axes.set(xlabel="switches in a period", ylabel="least distortion [%]", xticks=switches)
axes.legend()
figure.savefig("patterns.png")
print("picture: patterns.png")
