"""
Filter or solve: the pendulum of the paper
==========================================

The paper's pendulum: what filtering the classical control does, and what the frequency constraint costs.
"""

import lin_freq_ocp as lfo

comparison = lfo.compare(lfo.library.pendulum(), filters=["brickwall", "butterworth"])
for filtered in comparison.filtered:
    measures = filtered.replay.measures
    print(
        f"{filtered.name:12} peaks at {measures.max_control:.3f} N and misses the end by "
        f"{measures.terminal_errors[0]:.3f} m and {measures.terminal_errors[1]:.2f} rad"
    )
extra = comparison.constrained.cost / comparison.classical.cost - 1
print(f"constrained  {comparison.constrained_measures.max_control:.3f} N, meets the end, costs {extra:.1%} more")
print(f"proven: {comparison.constrained.certificate.pmp}, gap {comparison.constrained.gap:.1e}")
figure = comparison.plot()
