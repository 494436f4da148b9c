"""
A measured plant: limits that hold for every response within its error
======================================================================

A buoy whose response was measured keeps its stroke, whatever the true response is.

The buoy is known by 32 noisy records: an estimate of its response from force [N] to
velocity [m/s] at each frequency, and the coherence of the records. The coherence says
how far the true response may be from the estimate: a disc at each frequency, all of
them together with a probability of 95 %. The plan absorbs the most power that every
plant of the discs guarantees, and no plant moves the buoy by more than 145 mm.
"""

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.uncertainty import radius_of_coherence

stroke = 0.145  # m: change this number
true = lfo.library.wave_energy(
    force=2000.0, stroke=stroke
)  # its position is the second output
rng, bins, records = np.random.default_rng(1), np.arange(1, 51), 32
force, noise = 100 * rng.standard_normal((2, records, 50, 2)) @ [1, 1j]
velocity = true.dynamics.G[bins, 0, 0] * force + 2e-5 * noise
power, cross = (abs(force) ** 2).sum(0), (force.conj() * velocity).sum(0)
coherence = abs(cross) ** 2 / power / (abs(velocity) ** 2).sum(0)
estimate = cross / power
radius = radius_of_coherence(estimate, coherence, records, confidence=0.95, bins=50)

G, discs = np.zeros((201, 2, 1), complex), np.zeros((201, 2, 1))
integral = 1 / (2j * np.pi * bins / 20)  # of velocity, in a record of 20 s
G[bins, :, 0] = estimate[:, None] * np.column_stack([np.ones(50), integral])
G[bins, 0] = (
    np.maximum(G[bins, 0].real, 1e-6) + 1j * G[bins, 0].imag
)  # no plant gives energy
discs[bins, :, 0] = radius[:, None] * np.column_stack([np.ones(50), abs(integral)])
names = ["velocity [m/s]", "position [m]"]
waves = true.dynamics.offset  # the outputs without control
buoy = lfo.FrequencyResponse(
    G, 0.05, waves, state_names=names, control_names=["force [N]"]
)
problem = lfo.OptimalControlProblem(
    buoy,
    400,
    cost=true.cost,  # the mean of velocity times force
    control_set=true.control_set,
    state_set=lfo.Box([None, -stroke], [None, stroke]),
    control_spectrum=true.control_spectrum,  # harmonics 1 to 50 of the record
)
known = lfo.Discs(discs, cost="worst")
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
left.plot(bins / 20, abs(true.dynamics.G[bins, 0, 0]), "k", label="true response")
left.fill_between(
    bins / 20, abs(estimate) - radius, abs(estimate) + radius, alpha=0.3, label="discs"
)
left.set(xlabel="frequency [Hz]", ylabel="velocity per force [m/s/N]", yscale="log")
for label, plan in (
    ("estimate", lfo.solve(problem)),
    ("discs", lfo.solve(lfo.robust(problem, known))),
):
    worst = lfo.worst_case(problem, known, plan)["position, upper"]
    at_true = lfo.simulate(true, plan.trajectory.u)
    power = -true.value(at_true.x, at_true.u)
    largest = f"position of the worst plant {1e3 * worst.attained:.1f}"
    print(f"plan for the {label:8}: {power:.2f} W, {largest} of {1e3 * stroke:.0f} mm")
    right.plot(
        problem.times,
        worst.trajectory.x[:, 1],
        label=f"plan for the {label}, its worst plant",
    )
right.axhline(stroke, color="k", ls=":")
right.set(xlabel="time [s]", ylabel="position [m]", xlim=(0, 7))
left.legend()
right.legend(loc="lower left")
figure.savefig("measured_buoy.png")
print("picture: measured_buoy.png, discs and worst plants")
