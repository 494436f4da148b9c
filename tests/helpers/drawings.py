"""Drawings of figures without their layout and their images, which take most of the time."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from helpers.replacing import substitute
from lin_freq_ocp.pages import Drawing

DRAWN = Drawing.png
BLANK = b"\x89PNG\r\n\x1a\n"  # the beginning of an image, without the image
LAID_OUT = ConstrainedLayoutEngine.execute


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a test save pages of which only the words matter: figures are made, and not drawn."""

    def undrawn(name: str, title: str, caption: str, figure: Figure) -> Drawing:
        return Drawing(name, title, caption, "<svg></svg>", figure)

    substitute(monkeypatch, "pages.drawing_of", undrawn)


@pytest.fixture
def images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a test save pages with the images of their figures; those of other tests are blank."""
    monkeypatch.setattr(Drawing, "png", DRAWN)
