"""Runs in files: what a solve was given and ended with, to be repeated anywhere."""

from __future__ import annotations

from dataclasses import fields
from os import PathLike
from typing import final

from lin_freq_ocp.api.result import Result
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.interchange.runs.run_file import RunRecord, read_run


@final
class SavedRun(RunRecord):
    """A run, as it was dumped: the fields of ``RunRecord``.

    Methods
    -------
    solve()
        Solve it again.
    """

    def solve(self, throw: bool = False) -> Result:
        """Solve the same problem with the same options, here and now; ``throw`` as for ``lfo.solve``."""
        return solve(self.problem, **self.options, throw=throw)


def load_run(path: str | PathLike[str]) -> SavedRun:
    """Read what ``result.dump`` or ``lin-freq-ocp solve --dump`` wrote; nothing in it is executed.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    SavedRun

    Raises
    ------
    ProblemError
        If it is no such file; the field names it, the file within, and the place there.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).dump("run.zip")
    >>> lfo.load_run("run.zip").solve().status
    'optimal'
    """
    run = read_run(path)
    return SavedRun(**{one.name: getattr(run, one.name) for one in fields(RunRecord)})
