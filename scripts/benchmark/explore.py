"""How long the live page takes from a move of a slider to the drawn answer, in Chromium without a window.

    python scripts/benchmark.py explore [NAME] [--moves 50] [--horizon 240] [--write]

The pendulum of the paper at T = 240: the cut-off is moved by one notch after another, each to a value not solved
before, when all of the answer before is drawn. Milliseconds from the input event to the end of the drawing, as the page
measures them; the server runs in a process of its own, as ``lin-freq-ocp explore`` does.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from statistics import median

from rich.table import Table
from selenium import webdriver

from benchmark.record import Record, build_parser

MOVES = """
const [moves, done] = arguments, form = document.getElementById("controls");
const slider = document.querySelector("[data-testid='cutoff']");
const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
(async () => {
  const found = [];
  for (let move = 0; move < moves; move++) {
    slider.value = Number(slider.value) - 1;
    slider.dispatchEvent(new Event("input"));
    while (form.dataset.order !== String(order)) await frame();
    found.push(form.dataset.drawn - form.dataset.moved);
    await pause(500);
  }
  done(found);
})();
"""


def main(arguments: Sequence[str]) -> None:
    """Print median, least and largest time."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("name", nargs="?", default="pendulum")
    parser.add_argument("--moves", type=int, default=50)
    parser.add_argument("--horizon", type=int, default=240)
    given = parser.parse_args(arguments)
    command = [sys.executable, "-m", "lin_freq_ocp", "explore", given.name, "--no-browser"]
    command += ["--set", f"horizon={given.horizon}"]
    with Record(given.write) as record, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            times = measured(server.stdout.readline().strip(), given.moves)
        finally:
            server.terminate()
        table = Table("problem", "T", "moves", "median [ms]", "least [ms]", "largest [ms]")
        figures = (f"{value:.0f}" for value in (median(times), min(times), max(times)))
        table.add_row(given.name, str(given.horizon), str(len(times)), *figures)
        record.show(table)


def measured(url: str, moves: int) -> list[float]:
    """Return the milliseconds of each move."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        browser.set_script_timeout(600)
        browser.get(url)
        browser.execute_async_script("const done = arguments[0]; setTimeout(done, 3000);")
        return browser.execute_async_script(MOVES, moves)
    finally:
        browser.quit()
