"""
Problem files
=============

Write a problem as TOML, read and solve it, save the answer, and certify the saved answer.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import lin_freq_ocp as lfo

with TemporaryDirectory() as folder:
    file, answer = Path(folder) / "cart.toml", Path(folder) / "cart.npz"
    lfo.write_problem(lfo.library.double_integrator(), file)
    print(file.read_text())
    problem = lfo.read_problem(file)
    result = lfo.solve(problem)
    result.save(answer)
    saved = lfo.load(answer)
    certificate = lfo.certify(problem, saved.trajectory, saved.multipliers)
    print(f"saved answer: {certificate.pmp}, gap {certificate.gap:.1e}")
figure = result.plot()
