"""What solve writes into files beside its answer: --save, --csv, --plot and --dump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import click

from lin_freq_ocp.api.result import Result
from lin_freq_ocp.atomic import replacing
from lin_freq_ocp.cli.console import complain
from lin_freq_ocp.cli.problems import require_writable
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.results.solution_file import kind_of_file

HELP = {
    "save": "Write the trajectory to this .npz (with its multipliers), .csv or .mat file.",
    "csv": "Write the trajectory to this file as a table, one row per time.",
    "plot": "Draw the answer into this file: .png, .svg, .pdf.",
    "dump": "Write the whole run to this .zip file; see rerun.",
}


@dataclass(frozen=True)
class Outputs:
    """The files to write, by their options; None where one is not wanted."""

    save: Path | None = None
    csv: Path | None = None
    plot: Path | None = None
    dump: Path | None = None

    @property
    def wanted(self) -> dict[str, Path]:
        """Return the files that are wanted, by their options."""
        named = {one.name: getattr(self, one.name) for one in fields(self)}
        return {name: file for name, file in named.items() if file is not None}

    def require_writable(self, problem: str) -> None:
        """Raise ProblemError, before anything is solved, unless all can be written, each to a file of its own."""
        taken: dict[Path, str] = {}
        for name, file in self.wanted.items():
            require_writable(f"--{name}", file, problem)
            if file.absolute() in taken:
                raise ProblemError(f"--{name} {file}", f"the file of --{taken[file.absolute()]}", "another file")
            taken[file.absolute()] = name
        if self.save is not None:
            kind_of_file(self.save, f"--save {self.save}")
        if self.plot is not None:
            _require_picture(self.plot)

    def writes(self, result: Result) -> list[Callable[[], None]]:
        """Return what writes each file, and say which have nothing to hold."""
        writers: dict[str, Callable[[Path], None]] = {
            "save": result.save,
            "csv": result.to_csv,
            "plot": lambda file: _draw(result, file),
            "dump": result.dump,
        }
        writes: list[Callable[[], None]] = []
        for name, file in self.wanted.items():
            if name == "dump" or result.trajectory is not None:
                writes.append(partial(writers[name], file))
            else:
                done = "drawn" if name == "plot" else "saved"
                complain(f"nothing {done} to {file}: there is no trajectory.")
        return writes


def output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of all outputs to a command."""
    for name, words in reversed(HELP.items()):
        command = click.option(f"--{name}", type=click.Path(path_type=Path), help=words)(command)
    return command


def _draw(result: Result, file: Path) -> None:
    figure = result.plot()
    with replacing(file) as stream:
        figure.savefig(stream, dpi=150, format=file.suffix.lower().removeprefix("."))


def _require_picture(file: Path) -> None:
    from matplotlib.figure import Figure  # here, because it takes long to import

    kinds = Figure().canvas.get_supported_filetypes()
    if file.suffix.lower().removeprefix(".") not in kinds:
        got = f"a name that ends in {file.suffix}" if file.suffix else "a name without a suffix"
        raise ProblemError(f"--plot {file}", got, f"one that ends in .{', .'.join(kinds)}")
