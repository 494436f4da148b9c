"""Drawings of figures without their layout, which takes half of the time."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine


class UnmovedPanels(ConstrainedLayoutEngine):
    """A layout that leaves panels where they are."""

    def execute(self, fig: Figure) -> None:
        """Move nothing."""
