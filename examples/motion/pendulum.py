"""
Filter or solve: the pendulum of the paper
==========================================

Filtering the optimal force afterwards violates its bounds and misses the target.

A cart moves an inverted pendulum by 0.3 m within 2.4 s, with the least squared force.
The force is at most 5 N, and the actuator follows up to 40 Hz. A constraint on the
spectrum meets bounds and target, at a known extra cost.
"""

import lin_freq_ocp as lfo

problem = lfo.library.pendulum(control_bound=5.0)  # change this number
comparison = lfo.compare(problem, filters=["brickwall", "butterworth"])
for filtered in comparison.filtered:
    measures = filtered.replay.measures
    missed = measures.terminal_errors
    print(
        f"{filtered.name:12} peaks at {measures.max_control:.3f} N "
        f"and misses the end by {missed[0]:.3f} m and {missed[1]:.2f} rad"
    )
extra = comparison.constrained.cost / comparison.classical.cost - 1
largest = comparison.constrained_measures.max_control
print(f"constrained  {largest:.3f} N, meets the end, costs {extra:.1%} more")
print(f"maximum principle: {comparison.constrained.certificate.pmp}")
figure = comparison.plot()
figure.savefig("pendulum.png")
print("picture: pendulum.png")
