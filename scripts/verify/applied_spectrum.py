"""Random controllers in C with limits on the applied spectrum: sanitizers, hostile steps, every window by a sum.

Part of scripts/verify.py. States jump by ten orders of magnitude and are none at times; every window of what was
applied must keep its level at every status, and every control its bounds and rate limit.
"""

from __future__ import annotations

import subprocess
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from helpers.generated import SANITIZERS, CompiledController, compile_command
from lin_freq_ocp.problem.spectrum.base import entries_of
from verify.seeded import check_all

STEPS = 60
"""Of a controller."""

ALLOWED = {"double": 1e-6, "float": 1e-3}  # excess of a level, relative


@dataclass(frozen=True)
class Findings:
    """The results of a controller: largest amplitude and limits of its controls, relative; its steps by status."""

    kind: str
    windows: float
    limits: float
    statuses: tuple[int, ...]
    sound: bool

    @property
    def passed(self) -> bool:
        """Whether the sanitizers are silent, and all limits hold."""
        return self.sound and self.windows <= 1 + ALLOWED[self.kind.split(",")[0]] and self.limits <= 1 + 1e-6


def check(seed: int) -> Findings:
    """Generate the controller of a seed, and let it run."""
    warnings.simplefilter("ignore", lfo.errors.ClosedLoopWarning)
    rng = np.random.default_rng(seed)
    n, m, horizon = int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(3, 16))
    length = int(rng.integers(8, 30))
    hop, delay, real = int(rng.integers(1, length + 1)), int(rng.integers(2)), str(rng.choice(list(ALLOWED)))
    low, width = np.sort(rng.uniform(0.1, 3.0, 2))
    band = lfo.spectrum.notch((low + width) / 2, max(width - low, 4.1 * np.pi / length))
    bounds, rate = rng.uniform(0.3, 2.0, m), float(rng.uniform(0.1, 1.0)) if m == 1 and rng.random() < 0.5 else None
    amplitude, past = float(rng.uniform(0.02, 0.5) * bounds.min()), np.zeros((length - 1, m))
    turn, growth = np.linalg.qr(rng.standard_normal((n, n)))[0], rng.uniform(0.7, 1.1)
    plant = lfo.LinearDynamics(growth * turn, rng.standard_normal((n, m)))
    problem = lfo.OptimalControlProblem(
        plant,
        horizon,
        lfo.QuadraticCost(Q=np.eye(n), R=10.0 ** rng.uniform(-2, 0) * np.eye(m)),
        lfo.Box(-bounds, bounds),
        lfo.sets.Soft(lfo.Box(-0.5, 0.5), 10.0) if rng.random() < 0.5 else None,
        initial_state=np.zeros(n),
        control_spectrum=lfo.spectrum.closed_loop(band, amplitude, length=length, hop=hop, past=past),
    )
    problem = problem if rate is None else lfo.rate_limited(problem, rate, previous=0.0)
    bound = entries_of(problem.control_spectrum)[0].bound
    points = 2 * np.pi * bound.bins(length, None, "") / (bound.oversampling * length)
    cap = None if rng.random() < 0.3 else int(rng.integers(8))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lfo.generate(lfo.RecedingHorizon(problem, delay=delay), folder, real, changes=cap)
        command = compile_command("-O1", *SANITIZERS, "test_controller.c", "-o", "test_controller")
        subprocess.run([*command, "-lm"], cwd=folder, check=True)
        done = subprocess.run(["./test_controller"], cwd=folder, capture_output=True, text=True)
        step = CompiledController(folder, real, problem.state_dim, m, horizon)
        found, statuses = [np.zeros(m)] * delay, list[int]()
        for _ in range(STEPS):
            x = 10.0 ** rng.uniform(-4, 6) * rng.standard_normal(n)
            x[0] = rng.choice([np.nan, np.inf, 1e30]) if rng.random() < 0.1 else x[0]
            status, u = step.step(x)
            statuses.append(status)
            found.append(u)
    u = np.array(found)
    whole, taper = np.vstack([past, u]), np.hanning(length)
    waves = taper * np.exp(-1j * np.outer(points, np.arange(length)))
    values = [2 * np.abs(waves @ whole[b : b + length]) for b in range(0, len(whole) - length + 1, hop)]
    largest = float(np.max(values, initial=0.0)) / taper.sum() / amplitude
    limits = float((np.abs(u) / bounds).max())
    if rate is not None:
        limits = max(limits, float(np.abs(np.diff(u, axis=0, prepend=0.0)).max()) / rate)
    kind = f"{real}, {'rate limit' if rate else 'bounds'}"
    return Findings(kind, largest, limits, tuple(statuses), done.returncode == 0 and not done.stderr)


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check so many controllers, and print the results; return whether all passed."""
    found = check_all(check, seeds, processes, "controllers with windows")
    table = Table("kind", "controllers", "steps by status", title="limits on the applied spectrum in C")
    for column in ("windows", "bounds and rates", "failed"):
        table.add_column(column, justify="right")
    for kind in [*dict.fromkeys(one.kind for one in found), ""]:
        some = [one for one in found if one.kind.startswith(kind)]
        counts = " ".join(str(sum(one.statuses.count(status) for one in some)) for status in range(5))
        worst = [f"{max(getattr(one, part) for one in some):.7f}" for part in ("windows", "limits")]
        table.add_row(kind or "all", str(len(some)), counts, *worst, str(sum(not one.passed for one in some)))
    console.print(table)
    return all(one.passed for one in found)
