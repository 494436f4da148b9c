"""
A notch in the spectrum of a state
==================================

Move two masses joined by a spring without exciting the frequency of the spring.

A force of at most 1 N on the first of two unit masses moves them by 9 m in 10 s, with the
least squared force. The constraint acts on the spectrum of a *state*, the deflection of
the spring of 1 N/m: its bins within 0.1 Hz of the resonance at 0.225 Hz are zero.
"""

import numpy as np

import lin_freq_ocp as lfo

problem = lfo.library.two_mass_spring()
result = lfo.solve(problem)
free = lfo.solve(lfo.library.two_mass_spring(notch_width_hz=None))

stopped = problem.state_stop.any(axis=1)
for name, answer in (("without", free), ("with", result)):
    deflection = np.abs(np.fft.rfft(answer.trajectory.x[:, 1]))
    largest = deflection[stopped].max()
    print(f"{name:8} notch: cost {answer.cost:.4f}, largest notched bin {largest:.2e}")
price = np.abs(result.multipliers.rho_x).max()
print(f"largest multiplier of a removed bin: {price:.4f} per unit of its DFT")
print(f"maximum principle: {result.certificate.pmp}; global gap {result.gap:.1e}")
figure = result.plot()
