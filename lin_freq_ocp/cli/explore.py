"""The command lin-freq-ocp explore: a page whose sliders solve again, or the page with a solved sweep inside."""

from __future__ import annotations

import inspect
from pathlib import Path

import click

from lin_freq_ocp.base.atomic import write_text
from lin_freq_ocp.cli.console import PROVEN, problem_argument, progress, say, search_progress, settings_option
from lin_freq_ocp.cli.problems import ProblemFile, build, builder, is_file, parsed_settings, require_writable
from lin_freq_ocp.pages.explorer.session import HORIZON, Rebuild, Session


@click.command("explore")
@problem_argument
@settings_option
@click.option("--port", type=click.IntRange(1, 65535), help="Port, on this machine alone; default a free one.")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@click.option("--static", "file", type=click.Path(path_type=Path), help="Write the page with a solved sweep inside.")
def explore_command(
    problem: str, settings: tuple[str, ...], port: int | None, no_browser: bool, file: Path | None
) -> int:
    """Open a page with sliders: every move solves the problem again, and shows what is proven of the answer."""
    description = build(problem, settings)
    if file is not None:
        require_writable("--static", file, problem)
    with progress(f"preparing {description.name or problem}"):
        session = Session(description, _rebuild(problem, settings))
    from lin_freq_ocp.pages.explorer.server import ExploreServer, static_page

    if file is not None:
        with search_progress(f"solving {session.problem.name}") as tell:
            page = static_page(session, lambda done, count: tell and tell(f"{done} of {count} points"))
        write_text(file, page)
        say(f"wrote {file}")
        return PROVEN
    with ExploreServer(session, port or 0) as server:
        say(f"{server.url}\nCtrl-C ends it.")
        if not no_browser:
            click.launch(server.url)
        server.serve_until_interrupted()


def _rebuild(problem: str, settings: tuple[str, ...]) -> Rebuild | None:
    """Return what builds the same problem over another horizon; None where that is not a parameter."""
    given = parsed_settings(settings)
    if is_file(problem):
        file = ProblemFile.read(problem, given)
        return lambda horizon: file(horizon=horizon)
    built = builder(problem, given)
    if HORIZON not in inspect.signature(built).parameters:
        return None
    return lambda horizon: built(horizon=horizon)
