"""
3-D printing: a move that does not ring
=======================================

The shortest move of a printer's axis that does not ring, beside input shapers of the same robustness.
"""

import lin_freq_ocp as lfo

comparison = lfo.compare(lfo.library.printer_move())
for move in comparison.moves.all:
    print(f"{move.name:9} {move}")
shortest = comparison.moves.ours.samples
print(f"{shortest - 1} samples are {'proven' if comparison.moves.proof else 'not known'} to be too few")
figure = comparison.plot()  # the vibration that each leaves over the natural frequency
