"""Figures ready for pages and files of their own, and pages with their files in a folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from lin_freq_ocp.base.atomic import write_each, writing
from lin_freq_ocp.pages.figures.style import THEMED, THEMED_TINTS

PIXELS_PER_INCH = 150


@dataclass(frozen=True)
class Drawing:
    """A figure, ready for the page and for files of its own: ``name``.svg and ``name``.png."""

    name: str
    title: str
    caption: str
    svg: str
    png: bytes

    @property
    def inline(self) -> Markup:
        """Return the figure as an element of a page: no header, own ids, and the page's colours."""
        body = re.sub(r"<metadata>.*?</metadata>", "", self.svg[self.svg.index("<svg") :], flags=re.DOTALL)
        view_box = re.search(r'viewBox="[^"]*"', body)
        content = body[body.index(">") + 1 :].replace("xlink:href", "href")
        content = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{self.name}-", content)
        for color, variable in (THEMED | THEMED_TINTS).items():
            content = content.replace(color, f"var(--{variable})")
        view = Markup(view_box[0] if view_box else "")
        return Markup('<svg role="img" aria-label="{}" {}>').format(self.title, view) + Markup(content)


def drawing_of(name: str, title: str, caption: str, figure: Figure) -> Drawing:
    """Return a figure as text and as an image."""
    figure.set_dpi(PIXELS_PER_INCH)
    svg, png = BytesIO(), BytesIO()
    FigureCanvasAgg(figure).print_png(png)
    figure.set_layout_engine("none")  # keeps the layout that was found
    # Names of shapes do not change from run to run, and text looks the same on every machine.
    with mpl.rc_context({"svg.hashsalt": "lin-freq-ocp", "svg.fonttype": "path"}):
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None})
    return Drawing(name, title, caption, svg.getvalue().decode(), png.getvalue())


def rendered(template: str, **values: object) -> str:
    """Return a page from its template."""
    environment = Environment(
        loader=PackageLoader("lin_freq_ocp.pages.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def save_page(folder: Path, page: str, drawings: Sequence[Drawing]) -> Path:
    """Write index.html and its figures, each as .svg and .png, into a folder; return the page's path."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    contents = {folder / f"{drawing.name}.svg": drawing.svg.encode() for drawing in drawings}
    contents |= {folder / f"{drawing.name}.png": drawing.png for drawing in drawings}
    path = folder / "index.html"
    write_each(contents | {path: page.encode()})
    return path
