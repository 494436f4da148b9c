"""The commands lin-freq-ocp list, show and init: the library, the facts of a problem, and a problem file to start from.

show prints a problem before it is solved, and the parameters that --set can change.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click
from rich.text import Text

from lin_freq_ocp import library
from lin_freq_ocp.cli import console

LONGEST_VALUE = 50  # characters of a value that are shown


@click.command("list")
def list_command() -> int:
    """List the library's problems and what each shows."""
    console.print_terms((name, console.first_line_of(builder)) for name, builder in library.PROBLEMS.items())
    return console.PROVEN


@click.command("show")
@console.problem_argument
@console.settings_option
@console.json_option
@click.option("--toml", "as_toml_file", is_flag=True, help="Print the problem file of the problem, and nothing else.")
@click.option("--python", "as_python", is_flag=True, help="Print a Python script that builds and solves the problem.")
def show_command(problem: str, settings: tuple[str, ...], as_json: bool, as_toml_file: bool, as_python: bool) -> int:
    """Show what a library problem or a problem file is, and its parameters for --set with their defaults."""
    if as_json + as_toml_file + as_python > 1:
        raise click.UsageError("--json, --toml and --python exclude each other.")
    from lin_freq_ocp.cli.problems import build, is_file, parsed_settings  # here, for list, which needs no files
    from lin_freq_ocp.files import problem_file

    given = parsed_settings(settings)
    shown = build(problem, settings)
    if as_toml_file or as_python:
        from lin_freq_ocp.files.python_script import problem_script

        text = problem_script(shown) if as_python else problem_file.problem_text(shown)
        click.echo(text.removesuffix("\n"))
        return console.PROVEN
    if is_file(problem):
        about, parameters = "", problem_file.parameters_of_file(Path(problem), given)
    else:
        function = library.by_name(problem)
        about, parameters = problem_file.about_function(function), problem_file.parameters_of_function(function, given)
    summary = problem_file.description_summary(shown, about, parameters)
    if as_json:
        console.print_json(summary)
        return console.PROVEN
    console.print_lines(str(shown))
    console.out.print(Text(f"{about}\n" if about else ""))
    console.print_terms((fact["what"], fact["words"]) for fact in summary["facts"])
    console.out.print(Text("\nParameters with their defaults, changed by --set NAME=VALUE (TOML):\n"))
    rows = list[tuple[str, str]]()
    for parameter in parameters:  # with its default as it is written after --set, and the value that is set instead
        texts = [as_toml(value) for value in (parameter.default, parameter.value)]
        default, value = (text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..." for text in texts)
        rows.append(
            (f"{parameter.name} = {default}" + ("" if value == default else f" (set: {value})"), parameter.about)
        )
    console.print_terms(rows)
    return console.PROVEN


@click.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
def init_command(file: Path) -> int:
    """Write a commented problem file to start from."""
    from lin_freq_ocp.files.problem_file import init_problem_file

    init_problem_file(file)
    console.say(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return console.PROVEN


def as_toml(value: object) -> str:
    """Return a value as it is written after --set, in one line."""
    import tomli_w

    text = " ".join(tomli_w.dumps({"_": [[_without_null(value)]]}).split())  # nested, for inline tables
    return text.replace("[ ", "[").replace(", ]", "]").removeprefix("_ = [[").removesuffix("]]")


def _without_null(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_null(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_null(entry) for entry in value]
    return "none" if value is None else value
