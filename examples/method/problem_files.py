"""
Problem files
=============

Write a problem as TOML, read and solve it, save the answer, and certify the saved
answer.

A cart moves 1 m in 4 s with a speed of at most 0.3 m/s. Its acceleration is at most
1 m/s^2, without frequencies above 5 Hz.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import lin_freq_ocp as lfo

cart = lfo.LinearDynamics.from_continuous(
    [[0, 1], [0, 0]],
    [[0], [1]],
    sampling_time=0.02,
    state_names=["position [m]", "speed [m/s]"],
    control_names=["acceleration [m/s^2]"],
)
stated = lfo.OptimalControlProblem(
    cart,
    horizon=200,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-1, 1),
    state_set=lfo.Box({"speed": (-0.3, 0.3)}),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=5),  # change this number
    name="cart",
)
with TemporaryDirectory() as folder:
    file, answer = Path(folder) / "cart.toml", Path(folder) / "cart.npz"
    lfo.write_problem(stated, file)
    print(file.read_text())
    problem = lfo.read_problem(file)
    result = lfo.solve(problem)
    result.save(answer)
    saved = lfo.load(answer)
    certificate = lfo.certify(problem, saved.trajectory, saved.multipliers)
    print(f"saved answer: {certificate.pmp}, gap {certificate.gap:.1e}")
figure = result.plot()
figure.savefig("problem_files.png")
print("picture: problem_files.png")
