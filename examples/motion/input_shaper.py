"""
An input shaper for two resonances
==================================

Find the impulses that a printer convolves its moves with, for two resonances.

The head resonates at 35 Hz, known to 5 %, and the frame at 60 Hz, known to 5 %. After
the last impulse at most 5 % of a vibration may be left, for every mode of both bands.
``lfo.shaper`` finds the shortest impulses at any times, bounds their vibration with a
proof, and proves how much shorter another shaper can be. Shapers of the literature have
one frequency, and have to span both bands.
"""

import lin_freq_ocp as lfo

resonances_hz = 35.0, 60.0  # change these numbers to those of your machine
bands = [(0.95 * f, 1.05 * f) for f in resonances_hz]
print("The search takes some seconds.")
shaper = lfo.shaper(bands, damping=0.1, vibration=0.05, impulses=5)
print(shaper)
figure = shaper.plot()
figure.savefig("input_shaper.png")
print("picture: input_shaper.png")
