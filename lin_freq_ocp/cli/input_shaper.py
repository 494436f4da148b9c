"""The command lin-freq-ocp shaper: the shortest input shaper for bands of modes."""

from __future__ import annotations

from pathlib import Path

import click

from lin_freq_ocp import __version__
from lin_freq_ocp.api.shaper import Shaper, shaper
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import join_words, number
from lin_freq_ocp.cli import console
from lin_freq_ocp.cli.solve import save_figure
from lin_freq_ocp.files.calibration import read_calibration
from lin_freq_ocp.files.reading import FileTable

OTHER_SHARE = 0.2  # of the largest power: with fewer, narrower bands


@click.command("shaper")
@click.option("--band", "bands", nargs=2, type=float, multiple=True, metavar="LO HI", help="Natural frequencies in Hz.")
@click.option("--csv", "calibration", type=click.Path(path_type=Path), help="Bands from a test of resonances.")
@click.option("--share", type=float, default=0.05, show_default=True, help="With --csv: least, of the largest power.")
@click.option("--column", default="psd_xyz", show_default=True, help="With --csv: the power to read.")
@click.option("--damping", nargs=2, type=float, default=(0.1, 0.1), show_default=True, help="Damping ratios.")
@click.option("--vibration", type=float, default=0.05, show_default=True, help="Largest residual vibration (share).")
@click.option("--impulses", type=int, default=5, show_default=True, help="Most impulses of the shaper.")
@click.option("--plot", type=click.Path(path_type=Path), help="Draw the vibration over frequency.")
@console.json_option
def shaper_command(
    bands: tuple[tuple[float, float], ...],
    calibration: Path | None,
    share: float,
    column: str,
    damping: tuple[float, float],
    vibration: float,
    impulses: int,
    plot: Path | None,
    as_json: bool,
) -> int:
    """Find the shortest input shaper for bands of modes, and prove how much shorter another one can be."""
    if bool(bands) == (calibration is not None):
        raise ProblemError("--band", "none" if not bands else "--csv, too", "one or more --band LO HI, or --csv FILE")
    other = None
    if calibration is not None:
        bands = read_calibration(calibration, share, column)
        other = read_calibration(calibration, OTHER_SHARE, column)
    found = shaper(bands, damping, vibration, impulses)
    status = console.INTERRUPTED if found.interrupted else console.PROVEN
    if not as_json:  # before the second search
        console.print_lines(str(found))
    second = None
    if other is not None and other != bands and not found.interrupted:
        second = shaper(other, damping, vibration, impulses)
    if as_json:
        console.print_json(_summary(found) | ({} if second is None else {"other_bands": _summary(second)}))
    elif second is not None:
        named = join_words([f"{number(low)} to {number(high)}" for low, high in second.modes.bands])
        length = number(1e3 * second.duration, 6)
        console.say(f"Power above {100 * OTHER_SHARE:g} % of its largest: {named} Hz, {length} ms.")
    return console.write_files(status, *([] if plot is None else [lambda: save_figure(found.plot(), plot)]))


def _summary(found: Shaper) -> FileTable:
    """Return a shaper as the JSON object of the command."""
    known = {name: {"frequency": frequency, "duration": one.duration} for name, (frequency, one) in found.known.items()}
    return {
        "version": __version__,
        "A": found.amplitudes.tolist(),
        "T": found.times.tolist(),
        "duration": found.duration,
        "shortest": found.shortest,
        "bands": found.modes.bands,
        "damping": found.modes.damping,
        "limit": found.limit,
        "vibration": found.largest,
        "known": known,
    }
