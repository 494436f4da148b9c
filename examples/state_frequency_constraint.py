"""
Vibration: a constraint on a state's spectrum
=============================================

A constraint on a *state's* spectrum: move two masses joined by a spring without exciting the spring's frequency.
"""

import numpy as np

import lin_freq_ocp as lfo

problem = lfo.library.two_mass_spring()
result = lfo.solve(problem)
free = lfo.solve(lfo.library.two_mass_spring(notch_width_hz=None))

stopped = problem.state_stop.any(axis=1)
for name, one in (("without", free), ("with", result)):
    deflection = np.abs(np.fft.rfft(one.trajectory.x[:, 1]))
    print(f"{name:8} the constraint: cost {one.cost:.4f}, largest removed bin {deflection[stopped].max():.2e}")
print(f"price of the dearest bin: {np.abs(result.multipliers.rho_x).max():.4f} per unit of its DFT")
print(f"maximum principle: {result.certificate.pmp}; global gap {result.gap:.1e}")
figure = result.plot()
