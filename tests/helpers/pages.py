"""Pages as a browser reads them, and a problem whose names must be escaped."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np

from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost
from lin_freq_ocp.problem import Band

STATES = ["position <p> [m]", "speed & co [m/s]"]


def double_integrator(
    horizon: int = 24,
    sampling_time: float | None = None,
    controls: int = 1,
    initial_state: object = (0.0, 0.0),
    control_spectrum: Band | list[Band] | None = None,
    state_spectrum: Band | None = None,
    terminal_state: object = (1.0, 0.0),
    state_set: object = None,
    name: str = "",
) -> OptimalControlProblem:
    """Two states, one or two controls; names that must be escaped."""
    B = np.array([[0.005, 0.1], [0.1, 0.0]])[:, :controls]
    return OptimalControlProblem(
        dynamics=LinearDynamics(
            [[1, 0.1], [0, 1]],
            B,
            sampling_time=sampling_time,
            state_names=STATES,
            control_names=["force $a$ [N]", "pull $b$"][:controls],
        ),
        horizon=horizon,
        cost=QuadraticCost(R=1.0),
        control_set=Box(-5, 5),
        state_set=state_set,
        initial_state=initial_state,
        terminal_state=terminal_state,
        control_spectrum=control_spectrum,
        state_spectrum=state_spectrum,
        name=name,
    )


class Page(HTMLParser):
    """Collects what a browser would see, would load, and would link to."""

    VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self):
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.references: list[str] = []
        self.identifiers: list[str] = []
        self.styles = ""
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        for key, value in attrs:
            if key in ("src", "href", "xlink:href", "srcset", "data", "action", "poster"):
                self.references.append(value or "")
            elif key == "id":
                self.identifiers.append(value or "")
            self.styles += f" {value}" if key in ("style", "clip-path", "fill", "stroke") else ""

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "style":
            self.styles += data
        else:
            self.text += f"{data} "


def parsed(html: str) -> Page:
    found = Page()
    found.feed(html)
    found.close()
    found.text = " ".join(found.text.split())
    return found
