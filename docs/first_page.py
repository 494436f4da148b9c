"""What the first page shows: a live page with a solved sweep inside, and what is said of an infeasible problem."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

COMMAND = ("solve", "pendulum", "--set", "cutoff=0.35")

if __name__ == "__main__":
    done = subprocess.run([sys.executable, "-m", "lin_freq_ocp", *COMMAND], capture_output=True, text=True, check=False)
    if done.returncode != 1:
        raise SystemExit(f"{' '.join(COMMAND)}: expected exit status 1, infeasible; got {done.returncode}")
    lines = [line for line in done.stdout.splitlines() if not line.startswith("time ")]
    text = "\n".join(["$ lin-freq-ocp " + " ".join(COMMAND), *lines])
    here = Path(__file__).parent
    (here / "_conflict.txt").write_text(text + "\n", encoding="utf-8")
    (here / "_extra").mkdir(exist_ok=True)
    page = ("explore", "pendulum", "--static", str(here / "_extra" / "explore_pendulum.html"))
    subprocess.run([sys.executable, "-m", "lin_freq_ocp", *page], check=True, stdout=subprocess.DEVNULL)
