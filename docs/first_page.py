"""Contents of the first page: a live page with a solved sweep inside, and the explanation of an infeasible problem."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PATIENCE = ("--time-limit", "120")  # a busy machine may need more than the default for its explanation
COMMAND = ("solve", "double_integrator", "--set", "cutoff_hz=0.3")

if __name__ == "__main__":
    run = [sys.executable, "-m", "lin_freq_ocp", *COMMAND, *PATIENCE]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    if done.returncode != 1 or "repair" not in done.stdout:
        raise SystemExit(
            f"{' '.join(COMMAND)}: expected exit status 1, infeasible, and a repair; got {done.returncode}"
        )
    lines = [line for line in done.stdout.splitlines() if not line.startswith("time ")]
    text = "\n".join(["$ lin-freq-ocp " + " ".join(COMMAND), *lines])
    here = Path(__file__).parent
    (here / "_conflict.txt").write_text(text + "\n", encoding="utf-8")
    (here / "_extra").mkdir(exist_ok=True)
    page = ("explore", "pendulum", "--static", str(here / "_extra" / "explore_pendulum.html"))
    subprocess.run([sys.executable, "-m", "lin_freq_ocp", *page], check=True, stdout=subprocess.DEVNULL)
