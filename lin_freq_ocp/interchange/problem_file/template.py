"""The commented problem file to start from."""

from __future__ import annotations

from importlib.resources import files
from os import PathLike
from pathlib import Path

from lin_freq_ocp.atomic import writing
from lin_freq_ocp.errors import ProblemError


def template() -> str:
    """Return the text of a complete problem file, a cart with a speed limit and a low pass; comments explain it."""
    return files("lin_freq_ocp.interchange").joinpath("template.toml").read_text(encoding="utf-8")


def init_problem_file(path: str | PathLike[str]) -> None:
    """Write the template to a new file.

    Raises
    ------
    ProblemError
        If there is a file already (it is left as it is), or none can be written there.
    """
    path = Path(path)
    with writing(path):
        try:
            stream = path.open("x", encoding="utf-8", newline="\n")
        except FileExistsError:
            raise ProblemError(str(path), "a file that exists already", "a new name", "It is left as it is.") from None
        try:
            with stream:
                stream.write(template())
        except OSError:
            path.unlink()  # half a file would be in the way of the next attempt
            raise
