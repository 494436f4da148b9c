"""The site: pages in Markdown, a gallery that runs the examples, and a reference made of the docstrings."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from textwrap import indent

from matplotlib.figure import Figure
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from ascii_formulas import as_formulas, with_superscripts  # noqa: E402
from symbols import link_symbols  # noqa: E402

FIELDS = ("motion", "mri", "power", "space", "energy", "hybrid", "method")  # the gallery's sections, in this order
project, author, copyright = "lin_freq_ocp", "the lin_freq_ocp authors", "the lin_freq_ocp authors"
release = version = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_click",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_extra", "benchmarks/*", "ISSUE_TEMPLATE", "gallery/*/*.ipynb"]
html_theme, html_title = "furo", f"lin_freq_ocp {release}"
html_static_path, html_css_files = ["_static"], ["site.css"]
html_show_sphinx = False
html_context = {  # from build.sh; see _templates/sidebar/variant-selector.html
    "date": time.strftime("%-d %B %Y", time.gmtime(float(os.environ.get("SOURCE_DATE_EPOCH", time.time())))),
    "tag": os.environ.get("DOCS_TAG", ""),
    "tags": os.environ.get("DOCS_TAGS", "").split(),
}
html_extra_path = ["_extra"]  # the live page with a solved sweep, by first_page.py
myst_enable_extensions, myst_heading_anchors = ["dollarmath", "colon_fence"], 3
nb_execution_mode, nb_execution_raise_on_error, nb_execution_timeout = "force", True, 120
numpydoc_show_class_members, numpydoc_class_members_toctree = False, False
templates_path = ["_templates"]
autosummary_generate, autodoc_typehints = True, "none"
# Functions in this file are no values that a cache could hold; attributes of several classes share names.
suppress_warnings = ["config.cache", "ref.python"]


def save_figures(block: object, variables: dict[str, dict], settings: dict, **options: object) -> str:
    """Save each Figure that an example holds for the first time, and return the text that shows them.

    The first image of an example is its thumbnail, which no page shows: one panel of its first figure. The
    picture that the example itself saves in its folder goes.
    """
    Path(variables["src_file"]).with_suffix(".png").unlink(missing_ok=True)
    shown = variables["example_globals"].setdefault("_shown", [])
    paths = list[str]()
    for figure in _figures(variables["example_globals"]):
        if not any(figure is earlier for earlier in shown):
            thumbnail = None if shown else next(variables["image_path_iterator"])
            shown.append(figure)
            paths.append(next(variables["image_path_iterator"]))
            figure.savefig(paths[-1], dpi=110)
            if thumbnail is not None:
                save_thumbnail(figure, THUMBNAILS.get(Path(variables["src_file"]).stem, 0), thumbnail)
    return ".. container:: figures\n\n" + indent(figure_rst(paths, settings["src_dir"]), "    ") if paths else ""


def _figures(names: dict[str, object]) -> Iterator[Figure]:
    return (value for name, value in list(names.items()) if isinstance(value, Figure) and not name.startswith("_"))


THUMBNAILS = {  # the panel that shows what is special of an example, other than the first
    **dict.fromkeys(("pendulum", "first_steps", "gantry", "masked_pendulum", "minimum_time", "problem_files"), 1),
    **dict.fromkeys(("printer_move", "oscillating_mass", "receding_horizon", "satellite", "scanner"), 1),
    **dict.fromkeys(("suspension", "two_mass_drive", "oscillating_mass_in_c"), 1),
    **dict.fromkeys(("gusts", "kinks", "stepping_stones", "swing_up", "torque_map"), 2),
    **dict.fromkeys(("several_controls", "wall"), 3),
    "rendezvous": 4,
    "state_frequency_constraint": -1,
}


def save_thumbnail(figure: Figure, panel: int, path: str) -> None:
    """Keep one panel of a figure alone, and save it: all in the same size, with the same lines and letters."""
    axes = figure.axes[panel]
    for artist in [*figure.legends, *figure.texts, *(one for one in figure.axes if one is not axes)]:
        artist.set_visible(False)
    figure.set_layout_engine("none")
    figure.set_size_inches(4, 2.6)
    axes.set(position=(0.2, 0.2, 0.77, 0.74), aspect="auto", title="")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.87", linewidth=0.8)
    axes.set_axisbelow(True)
    for line in axes.get_lines():
        line.set_linewidth(1.8)
    for text in [axes.title, axes._left_title, axes._right_title, *axes.texts, *filter(None, [axes.get_legend()])]:
        text.set_visible(False)
    for text in (axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()):
        text.set_fontsize(9)
    figure.savefig(path, dpi=100)


SKETCHES = {  # of lin_freq_ocp/library/sketches, with the examples that have this plant
    "cart": ("first_steps", "gusts", "both_sides_of_a_kink", "problem_files", "certify_another_tool"),
    "cart_pendulum": (
        *("pendulum", "receding_horizon", "masked_pendulum", "price_of_bandwidth"),
        *("infeasible", "long_horizons", "many_initial_states"),
    ),
    "discs": ("obstacles",),
    "drive": ("two_mass_drive",),
    "gantry": ("gantry", "learned_cost"),
    "gradient_coil": ("minimum_time", "stimulation", "three_axes"),
    "inverter": ("inverter", "switching_angles", "patterns"),
    "mass_chain": ("several_controls",),
    "mass_on_a_spring": ("oscillating_mass", "oscillating_mass_in_c"),
    "motor_and_wheels": ("torque_map",),
    "point_absorber": ("wave_energy", "measured_buoy", "which_hull"),
    "printer": ("printer_move", "input_shaper", "shaper_from_a_test"),
    "quarter_car": ("suspension",),
    "rendezvous": ("rendezvous",),
    "satellite": ("satellite",),
    "scanner": ("scanner",),
    "stepping_stones": ("stepping_stones",),
    "swing_up": ("swing_up",),
    "tank": ("kinks",),
    "two_masses": ("state_frequency_constraint", "co_design"),
    "wall": ("wall",),
}
FIRST_BLOCK = ".. GENERATED FROM PYTHON SOURCE LINES"  # of sphinx-gallery, after the docstring

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "subsection_order": [f"../examples/{field}" for field in FIELDS],
    "filename_pattern": r"\.py$",
    "image_scrapers": (save_figures,),
    "within_subsection_order": "FileNameSortKey",
    "capture_repr": (),
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "thumbnail_size": (400, 260),
}


CODE = re.compile(r"(``[^`]*``)")
EXAMPLE = r"^ *>>>(?:.|\n)*?(?=\n *\n|\Z)"
HEADING = r"^ *\*?[\w.]+(?:, \*?[\w.]+)*(?: : [^\n]*)?$"  # of a parameter
AS_WRITTEN = re.compile(rf"(``[^`]*``|{EXAMPLE}|{HEADING})", re.MULTILINE)


def plain_text(app: Sphinx, kind: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Set the formulas of docstrings, and escape characters of the rest that are meant literally, such as | and *."""
    parts = AS_WRITTEN.split("\n".join(lines))
    for i, part in enumerate(parts):
        if i % 2 == 0:
            parts[i] = as_formulas(part, escape_markup)
        elif not part.lstrip().startswith((">>>", "``")):
            parts[i] = "".join(one if one.startswith("``") else escape_markup(one) for one in CODE.split(part))
    lines[:] = "".join(parts).split("\n")


def skip_internals(app: Sphinx, kind: str, name: str, member: object, skip: bool, options: object) -> bool | None:
    """Skip members of a problem's parts that serve the package: those without sections that "Methods" does not list."""
    function = getattr(member, "fget", None) or getattr(member, "func", member)
    module = getattr(function, "__module__", None) or ""
    owner = getattr(function, "__qualname__", "").rpartition(".")[0]
    if not owner or not module.startswith("lin_freq_ocp.problem."):
        return None
    methods = (getattr(sys.modules[module], owner).__doc__ or "").partition("Methods\n")[2]
    listed = re.search(rf"^ *{name}\(", methods, re.MULTILINE) is not None
    return None if listed or "---" in (function.__doc__ or "") else True


def escape_markup(text: str) -> str:
    """Return a text whose bars, stars and quotes are no markup."""
    return re.sub(r"(?<!\\)([|*`])", r"\\\1", text)


def show_sketch(app: Sphinx, page: str, source: list[str]) -> None:
    """Show the plant of an example after its docstring, within the page, so that the sketch has the page's colours."""
    folders, example = page.split("/")[:-1], page.split("/")[-1]
    if folders[:1] == ["gallery"] and example != "index":
        (sketch,) = (name for name, examples in SKETCHES.items() if example in examples)
        docstring, blocks = source[0].split(FIRST_BLOCK, 1)
        path = f"../../../lin_freq_ocp/library/sketches/{sketch}.svg"
        source[0] = f"{with_superscripts(docstring)}.. raw:: html\n   :file: {path}\n\n{FIRST_BLOCK}{blocks}"


def setup(app: Sphinx) -> None:
    """Write the pages of the reference and the contents of the first page, and read docstrings as plain text."""
    for script in ("reference.py", "first_page.py"):
        subprocess.run([sys.executable, str(HERE / script)], check=True)
    app.add_lexer("mermaid", TextLexer)
    app.connect("source-read", show_sketch)
    app.connect("doctree-resolved", link_symbols)
    app.connect("autodoc-process-docstring", plain_text, priority=400)
    app.connect("autodoc-skip-member", skip_internals)
