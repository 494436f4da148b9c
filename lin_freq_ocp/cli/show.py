"""The commands lin-freq-ocp list, show, init and schema: the library, a problem in words, formats of files."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

import click
from rich.text import Text

from lin_freq_ocp import library
from lin_freq_ocp.cli import console

SCHEMAS = ("problem", "result", "show", "sweep", "minimum-time")  # of problem files, and of objects of --json
LONGEST_VALUE = 50  # characters of a value; a longer one is cut off


@click.command("list")
def list_command() -> int:
    """List the library's problems by field, one line each; show describes a problem in full."""
    fields = {field: names.split() for field, names in library.FIELDS.items()}
    fields["Other"] = [name for name in library.PROBLEMS if name not in " ".join(library.FIELDS.values()).split()]
    rows = list[tuple[str, str]]()
    for field, names in fields.items():
        if names:
            rows.append((field, ""))
            lines = [console.first_line_of(library.PROBLEMS[name]).rstrip(".") for name in names]
            rows += [(f"  {name}", line.partition(":")[0]) for name, line in zip(names, lines, strict=True)]
    console.print_terms(rows)
    return console.PROVEN


@click.command("show")
@console.problem_argument
@console.settings_option
@console.json_option
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), help="Write an HTML page with a sketch into this folder."
)
@click.option("--toml", "as_toml_file", is_flag=True, help="Print the problem file of the problem, and nothing else.")
def show_command(
    problem: str, settings: tuple[str, ...], as_json: bool, folder: Path | None, as_toml_file: bool
) -> int:
    """Describe a library problem or a problem file, with its parameters for --set and their defaults."""
    if as_json + as_toml_file + (folder is not None) > 1:
        raise click.UsageError("--json, --toml and --out exclude each other.")
    from lin_freq_ocp.cli.problems import build, is_file, parse_settings, require_folder  # here: list needs no files
    from lin_freq_ocp.files import problem_file

    if folder is not None:
        require_folder(folder)
    values = parse_settings(settings)
    description = build(problem, settings)
    if as_toml_file:
        click.echo(problem_file.problem_text(description).removesuffix("\n"))
        return console.PROVEN
    if is_file(problem):
        about, parameters = "", problem_file.parameters_of_file(Path(problem), values)
    else:
        function = library.by_name(problem)
        about, parameters = problem_file.about_function(function), problem_file.parameters_of_function(function, values)
    summary = problem_file.description_summary(description, about, parameters)
    if as_json:
        console.print_json(summary)
        return console.PROVEN
    rows = list[tuple[str, str]]()
    for one in parameters:  # default and value as they are written after --set
        texts = [as_toml(value) for value in (one.default, one.value)]
        default, value = (text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..." for text in texts)
        rows.append((f"{one.name} = {default}" + ("" if value == default else f" (set: {value})"), one.about))
    facts = [(fact["what"], fact["words"]) for fact in summary["facts"]]
    if folder is not None:
        from lin_freq_ocp.pages.report.page import save_problem_page  # Matplotlib is slow to import

        title = description.name or Path(problem).stem
        console.say(f"page: {save_problem_page(title, about or str(description), rows, facts, folder)}")
        return console.PROVEN
    console.print_lines(str(description))
    console.out.print(Text(f"{about}\n" if about else ""))
    console.print_terms(facts)
    console.out.print(Text("\nParameters with their defaults, changed by --set NAME=VALUE (TOML):\n"))
    console.print_terms(rows)
    return console.PROVEN


@click.command("schema")
@click.argument("name", type=click.Choice(SCHEMAS))
def schema_command(name: str) -> int:
    """Print the JSON Schema of problem files ("problem") or of an object of --json."""
    console.say((files("lin_freq_ocp.files") / "schemas" / f"{name}.schema.json").read_text(encoding="utf-8").rstrip())
    return console.PROVEN


@click.command("init")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.toml")
@click.option("--plant", type=click.Path(path_type=Path), metavar="PLANT.mat", help="A, B and Ts that MATLAB saved.")
@click.option("--response", type=click.Path(path_type=Path), metavar="FRF.csv", help="A measured frequency response.")
@click.option(
    "--sampling-time", type=float, metavar="SECONDS", help="Of a continuous plant, or of the response's record."
)
def init_command(file: Path, plant: Path | None, response: Path | None, sampling_time: float | None) -> int:
    """Write a template of a problem file, with comments, or a problem with a plant of yours."""
    from lin_freq_ocp.files.problem_file import init_problem_file

    init_problem_file(file, plant, response, sampling_time)
    console.say(f"wrote {file}; next: lin-freq-ocp solve {file}")
    return console.PROVEN


def as_toml(value: object) -> str:
    """Return a value as one line of TOML, as it is written after --set."""
    import tomli_w

    text = " ".join(tomli_w.dumps({"_": [[_without_null(value)]]}).split())  # nested, for inline tables
    return text.replace("[ ", "[").replace(", ]", "]").removeprefix("_ = [[").removesuffix("]]")


def _without_null(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_null(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_null(entry) for entry in value]
    return "none" if value is None else value
