"""Wave energy by a frequency response: absorbed power within force limits, and a long record of irregular waves.

python scripts/benchmark.py wave_energy [samples] [--write]
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from lin_freq_ocp.library.waveforms import coefficients_at

PUBLISHED = {None: 140.007195, 2000.0: 98.11269, 1000.0: 58.75533}  # W; analytic, and computed independently
STEP = 0.05  # s
HEIGHT, PEAK = 0.1, 0.3  # significant wave height in m, peak frequency in Hz
LIMITS = (np.inf, 7500.0, 6500.0, 6000.0)  # N


def irregular(samples: int, force: float) -> lfo.OptimalControlProblem:
    """Return the converter in irregular waves of a Pierson-Moskowitz spectrum with random phases."""
    problem = lfo.library.wave_energy(force=force, record=samples * STEP, horizon=samples)
    frequency = np.arange(samples // 2 + 1) / (samples * STEP)
    known = coefficients_at(frequency, 45.0)
    f = np.maximum(frequency, frequency[1])
    density = 5 / 16 * HEIGHT**2 * PEAK**4 * f**-5 * np.exp(-1.25 * (PEAK / f) ** 4)
    phase = np.exp(2j * np.pi * np.random.default_rng(0).random(len(f)))
    amplitude = np.sqrt(2 * density / (samples * STEP)) * phase * np.where(known.valid, 1.0, 0.0)
    offset = amplitude * known.excitation * known.admittance * samples / 2
    dynamics = lfo.FrequencyResponse(known.admittance, STEP, offset)
    return replace(problem, dynamics=dynamics)


def measured(problem: lfo.OptimalControlProblem) -> tuple[float, float, int, float]:
    """Return the power, the gap, the number of samples with a multiplier, and the CPU time of solver and judge."""
    started = time.process_time()
    result = lfo.solve(problem)
    seconds = time.process_time() - started
    certificate, multipliers = result.certificate, result.multipliers
    assert certificate is not None
    assert certificate.gap is not None
    assert multipliers is not None
    return -certificate.cost, certificate.gap, int((multipliers.nu != 0).sum()), seconds


def main(arguments: Sequence[str]) -> None:
    """Print the powers of the regular wave, and those of the long record."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("samples", type=int, nargs="?", default=100_000)
    given = parser.parse_args(arguments)
    measured(lfo.library.wave_energy())  # loads what is loaded once
    with Record(given.write) as record:
        table = Table("force limit", "power [W]", "independent", "gap", "CPU", title="a regular wave")
        for force, power in PUBLISHED.items():
            found, gap, _, seconds = measured(lfo.library.wave_energy(force=force))
            limit = "none" if force is None else f"{force:g} N"
            table.add_row(limit, f"{found:.6f}", str(power), f"{gap:.0e}", f"{1e3 * seconds:.0f} ms")
        record.show(table)
        title = f"{given.samples} samples of irregular waves"
        table = Table("force limit", "active samples", "power [W]", "gap", "CPU", title=title)
        for force in LIMITS:
            found, gap, active, seconds = measured(irregular(given.samples, force))
            limit = "none" if np.isinf(force) else f"{force:g} N"
            table.add_row(limit, str(active), f"{found:.6f}", f"{gap:.0e}", f"{seconds:.2f} s")
        record.show(table)
