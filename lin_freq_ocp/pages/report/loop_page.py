"""The report page of a control loop."""

from __future__ import annotations

from collections import Counter
from importlib.metadata import version
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.phrases import number, plural
from lin_freq_ocp.loop.record import LoopRecord
from lin_freq_ocp.pages.figures.loop import loop_figure
from lin_freq_ocp.pages.report.drawing import drawing_of, rendered, save_page
from lin_freq_ocp.problem.description import problem_facts

CAPTION = (
    "Spectrograms show the magnitude of the DFT of short windows over the time of their middle. Crosses mark steps "
    "whose problem had no solution, or no plan in time."
)


def save_loop_report(loop: LoopRecord, folder: Path) -> Path:
    """Write index.html and its figure, as .svg and .png, into a folder; return the page's path."""
    drawing = drawing_of("loop", "States, controls, their spectra over time, and the steps", CAPTION, loop_figure(loop))
    page = rendered(
        "loop.html.jinja",
        title=loop.problem.name or "Control loop",
        finding=_finding(loop),
        tiles=_tiles(loop),
        drawing=drawing,
        counts=_counts(loop),
        excess=_excess(loop),
        facts=problem_facts(loop.problem, loop.problem.gap),
        problem=loop.problem,
        version=version("lin-freq-ocp"),
    )
    return save_page(folder, page, [drawing])


def _finding(loop: LoopRecord) -> str:
    steps = len(loop.steps)
    proven = int(loop.satisfied.sum())
    text = f"{plural(steps, 'step')}; the plans of {proven} satisfy the maximum principle"
    known = loop.gaps[np.isfinite(loop.gaps)]
    text += f", with gaps of at most {number(float(known.max()), 2)}." if len(known) else "."
    return text + (f" The loop stopped before its end: {loop.stopped}" if loop.stopped else "")


def _tiles(loop: LoopRecord) -> list[tuple[str, str, str]]:
    """Return label, number and remark of the headline's figures."""
    if not loop.steps:
        return [("steps", "0", "")]
    solve, certify = 1e3 * loop.solve_seconds, 1e3 * loop.certify_seconds
    return [
        ("steps", str(len(loop.steps)), ""),
        ("time of a step", f"{number(float(np.median(solve)), 3)} ms", f"at most {number(float(solve.max()), 3)} ms"),
        ("its certificate", f"{number(float(np.median(certify)), 3)} ms", "apart"),
        ("steps softened", str(sum(bool(step.excess) for step in loop.steps)), ""),
    ]


def _counts(loop: LoopRecord) -> list[tuple[str, str, str, int]]:
    """Return status, source and method of the steps, with how many there are of each."""
    found = Counter((str(step.status), str(step.source), step.method) for step in loop.steps)
    return [(*key, count) for key, count in found.most_common()]


def _excess(loop: LoopRecord) -> list[tuple[str, str, int]]:
    """Return the largest excess of each softened constraint, and at how many steps there was one."""
    names = dict.fromkeys(name for step in loop.steps for name in step.excess)
    rows: list[tuple[str, str, int]] = []
    for name in names:
        amounts = [step.excess.get(name, 0.0) for step in loop.steps]
        rows.append((name, number(max(amounts), 3), sum(amount > 0 for amount in amounts)))
    return rows
