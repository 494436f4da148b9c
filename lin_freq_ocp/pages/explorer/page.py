"""The page as one HTML file: live, asking its server, or with a solved sweep inside, which works from disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import version
from itertools import product

from jinja2 import Environment, PackageLoader, StrictUndefined

from lin_freq_ocp.pages.explorer.frequencies import CUTOFF
from lin_freq_ocp.pages.explorer.session import Session
from lin_freq_ocp.pages.explorer.slider import Slider
from lin_freq_ocp.pages.explorer.sliders import FOLDED, GROUPS
from lin_freq_ocp.pages.explorer.view import Data
from lin_freq_ocp.problem.description import problem_facts

# Points of a solved sweep along each slider, the own value among them: all pairs of two, the others alone.
PAIRED, ALONE = 7, 5
PAIR = "frequency", "bounds"  # groups of which the first sliders are moved together


def page(session: Session) -> str:
    """Return the page that asks its server."""
    return _rendered(session, None)


def static_page(session: Session, progress: Callable[[int, int], object] = lambda done, count: None) -> str:
    """Return the page with a solved sweep inside; ``progress`` is told how many points are solved, and of how many."""
    grid = points(session.sliders)
    solved = list[Data]()
    for values in grid:
        solved.append({"values": values, "answer": session.answer(values), "beside": session.beside(values)})
        progress(len(solved), len(grid))
    return _rendered(session, solved)


def points(sliders: tuple[Slider, ...]) -> list[dict[str, float]]:
    """Return the values at the points of a sweep: of the sliders that are moved."""
    firsts = [[one for one in sliders if one.group == group][:1] for group in PAIR]
    paired = [one for first in firsts for one in first]
    moved = [dict(pair) for pair in product(*([(one.key, v) for v in _along(one, PAIRED)] for one in paired))]
    moved += [{one.key: value} for one in sliders if one not in paired for value in _along(one, ALONE)]
    own = {one.key: one.value for one in sliders}
    unique = {tuple({**own, **values}.items()): None for values in moved}
    return [dict(values) for values in unique] or [own]


def _along(slider: Slider, count: int) -> Iterator[float]:
    """Yield values from end to end, on notches, the problem's own among them."""
    first, last = (round((end - slider.value) / slider.step) for end in (slider.low, slider.high))
    notches = {round(first + (last - first) * i / (count - 1)) for i in range(count)} | {0}
    yield from (slider.notch(n) for n in sorted(notches))


def _rendered(session: Session, solved: list[Data] | None) -> str:
    data: Data = {"sliders": [slider.data for slider in session.sliders], "points": solved}
    return (
        _environment()
        .get_template("explore.html.jinja")
        .render(
            title=session.problem.name or "Optimal control problem",
            facts=problem_facts(session.problem),
            cutoff=any(slider.key == CUTOFF for slider in session.sliders),
            live=solved is None,
            groups=[(key, heading) for key, heading in GROUPS.items() if key not in FOLDED],
            folded=[(key, GROUPS[key]) for key in FOLDED],
            version=version("lin-freq-ocp"),
            data=data,
        )
    )


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("lin_freq_ocp.pages.explorer"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
