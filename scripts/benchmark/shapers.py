"""Shortest moves of a printer's axis at the same residual vibration: input shapers, and the proven least horizon.

    python scripts/benchmark.py shapers [--write]

``library.printer_move`` (20 mm at 10 m/s^2, samples of 5 ms, a resonance at 20 Hz), for several uncertainties of the
resonance and limits of its vibration. Shapers and their moves are those of ``lfo.compare``: of every shaper, the
shortest move that is calm enough, proven over the box of modes, under the same bounds.

Then shapers alone: the shortest impulses of ``lfo.shaper`` that leave 5 %, the proven bound on all others, and the
shapers of the literature at the frequency where each is shortest.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from numpy.typing import ArrayLike
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from lin_freq_ocp.comparison.moves import Move
from lin_freq_ocp.comparison.shapers import SHAPERS

CASES = ((0.1, 0.5), (0.1, 0.2), (0.2, 0.5), (0.05, 0.5), (0.05, 0.2))  # uncertainty, and limit in m/s^2
BANDS = (((35, 60), 0.0), ((35, 60), 0.1), ((35, 60), (0.05, 0.2)), (((33.25, 36.75), (57, 63)), 0.1))  # Hz, damping
HORIZON = 60  # samples: long enough for all cases


def samples(move: Move) -> str:
    """Return the length of a move in words."""
    return str(move.samples) if move.measured is not None else f"> {move.samples}"


def row(uncertainty: float, limit: float) -> list[str]:
    """Return the samples of every move of a case."""
    begin = time.process_time()
    problem = lfo.library.printer_move(HORIZON, uncertainty=uncertainty, vibration_bound=limit)
    moves = lfo.compare(problem, ["ZV", "ZVD", "EI"]).moves
    assert moves is not None
    best = min(move.samples for move in moves.shaped if move.measured is not None)
    shorter = f"{100 * (1 - moves.ours.samples / best):.0f} %"
    own = [str(moves.ours.samples), "yes" if moves.proof else "no"]
    lengths = [samples(move) for move in (moves.unshaped, *moves.shaped)]
    seconds = f"{time.process_time() - begin:.1f} s"
    return [f"{100 * uncertainty:g} %", f"{limit:g}", *lengths, *own, shorter, seconds]


def row_of_shaper(bands: ArrayLike, damping: ArrayLike) -> list[str]:
    """Return the durations of a shaper and of others for the same modes."""
    begin = time.process_time()
    found = lfo.shaper(bands, damping)
    seconds = f"{time.process_time() - begin:.1f} s"
    best = min(one.duration for _, one in found.known.values())
    of_known = [found.known[name][1].duration if name in found.known else None for name in SHAPERS]
    durations = [found.duration, found.shortest, *of_known]
    shown = ["-" if value is None else f"{1e3 * value:.2f}" for value in durations]
    gain = f"{100 * (1 - found.duration / best):.0f} %"
    return [str(found.modes), str(len(found.times)), *shown, f"{100 * found.largest:.4f} %", gain, seconds]


def main(arguments: Sequence[str]) -> None:
    """Print the samples of every move."""
    given = build_parser(__name__, __doc__).parse_args(arguments)
    table = Table(title="samples of the shortest moves: uncertainty of the resonance, and limit of the vibration")
    for heading in ("+-", "m/s^2", "unshaped", "ZV", "ZVD", "EI", "optimal", "proven", "shorter", "CPU"):
        table.add_column(heading, justify="right")
    with Record(given.write) as record:
        for case in CASES:
            table.add_row(*row(*case))
        record.show(table)
        table = Table(title="durations of shapers in ms that leave 5 % of a vibration; -: at no frequency")
        for heading in ("modes", "impulses", "optimal", "none below", *SHAPERS, "vibration", "shorter", "CPU"):
            table.add_column(heading, justify="left" if heading == "modes" else "right")
        for bands, damping in BANDS:
            table.add_row(*row_of_shaper(bands, damping))
        record.show(table)
