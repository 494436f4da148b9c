"""The command lin-freq-ocp explore: a live page whose sliders re-solve the problem, or a page with a solved sweep."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.atomic import write_text
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.cli.console import PROVEN, problem_argument, say, settings_option
from lin_freq_ocp.cli.problems import build, read_source, require_writable
from lin_freq_ocp.pages.explorer.session import Session


@click.command("explore")
@problem_argument
@settings_option
@click.option("--port", type=click.IntRange(1, 65535), help="Port on this machine; default: any free one.")
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@click.option(
    "--static", "file", type=click.Path(path_type=Path), help="Write a page with a solved sweep to this file."
)
def explore_command(
    problem: str, settings: tuple[str, ...], port: int | None, no_browser: bool, file: Path | None
) -> int:
    """Open a page with sliders: every slider change re-solves the problem and re-certifies the answer."""
    description = build(problem, settings)
    if file is not None:
        require_writable("--static", file, problem)
    source = read_source(problem, settings)
    with activity("preparing the page"):
        session = Session(description, lambda horizon: source(horizon=horizon))
    from lin_freq_ocp.pages.explorer.server import ExploreServer, points, static_page

    if file is not None:
        write_text(file, static_page(session))
        say(f"wrote {file} with {plural(len(points(session.sliders)), 'solved point')}")
        return PROVEN
    with ExploreServer(session, port or 0) as server:
        say(f"{server.url}\nCtrl-C ends it.")
        if not no_browser:
            click.launch(server.url)
        server.serve_until_interrupted()
