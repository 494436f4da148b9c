"""The figure of an input shaper: what it leaves of a vibration, over the natural frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.comparison.shapers import Impulses, Modes, eigenvalues_of
from lin_freq_ocp.pages.figures import look

HEIGHT = 1.3 * look.ROW_HEIGHT
DRAWN_FREQUENCIES = 801
BEYOND = 1.6  # times the highest frequency: the end of the axis
SHOWN = 5.0  # limits that fit into the picture


def shaper_figure(impulses: Impulses, modes: Modes, limit: float) -> Figure:
    """Return the vibration after the last impulse, relative to one impulse then, a line for each damping ratio."""
    figure = look.new_figure(HEIGHT)
    ax = figure.add_subplot()
    frequencies = np.linspace(0.0, BEYOND * modes.bands[-1][1], DRAWN_FREQUENCIES)
    for k, (low, high) in enumerate(modes.bands):
        ax.axvspan(low, high, color=look.BAND, linewidth=0, zorder=0)
        ax.hlines(100 * limit, low, high, color=look.BOUND, linewidth=2.0, zorder=4, label="" if k else "limit")
    least, largest = modes.damping
    for damping, color in zip(dict.fromkeys((least, (least + largest) / 2, largest)), look.COMPONENTS, strict=False):
        values = 100 * np.abs(impulses.response(eigenvalues_of(frequencies, np.full(DRAWN_FREQUENCIES, damping))))
        ax.plot(frequencies, values, color=color, linewidth=1.4, label=f"damping ratio {number(damping)}")
    ax.set_xlim(0, frequencies[-1])
    ax.set_ylim(0, 100 * min(SHOWN * limit, 1.0))
    look.style_axes(ax, "Residual vibration", "natural frequency [Hz]", "vibration [%]")
    handles, _ = ax.get_legend_handles_labels()
    look.legend_above(figure, handles)
    return figure
