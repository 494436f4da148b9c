"""Shortest moves of an axis at the same residual vibration: input shapers, and the proven least horizon.

    python scripts/benchmark_shapers.py

A move of 20 mm at 0.5 m/s and 10 m/s^2, samples of 5 ms, a resonance at 20 Hz known to 10 %, damping 0.02 to 0.1. A
shaper's impulses, half a period apart, stand on the same grid; the shortest profile is taken whose shaped acceleration
leaves at most the limit, proven over the box. References: Singer and Seering 1990 (ZV, ZVD), Singhose 1997 (EI).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.peaks.proven import proven_peak

SAMPLING_TIME = 0.005
HALF_PERIOD = 5  # samples
LIMIT = 0.5  # m/s^2: 5 % of the bound on the acceleration
LONGEST = 60
MEAN_DAMPING = 0.06
CALM = lfo.ResidualVibration(frequency=(18.0, 22.0), damping=(0.02, 0.1), limit=LIMIT)


def move(horizon: int, calm: bool) -> lfo.OptimalControlProblem:
    """Return the move over a horizon, with or without the bound on its residual vibration."""
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [1]], SAMPLING_TIME),
        horizon,
        lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-10, 10),
        state_set=lfo.Box([-1, -0.5], [1, 0.5]),
        initial_state=[0.0, 0.0],
        terminal_state=[0.02, 0.0],
        control_spectrum=CALM if calm else None,
    )


def shapers() -> dict[str, Array]:
    """Return the impulses of every shaper."""
    K = float(np.exp(-MEAN_DAMPING * np.pi / np.sqrt(1 - MEAN_DAMPING**2)))
    V = LIMIT / 10.0
    impulses = {"ZV": [1, K], "ZVD": [1, 2 * K, K**2], "EI": [(1 + V) / 4, (1 - V) / 2 * K, (1 + V) / 4 * K**2]}
    return {name: np.array(given) / sum(given) for name, given in impulses.items()}


def shaped_length(impulses: Array, shortest: int) -> int | None:
    """Return the samples of the shortest shaped profile that is calm enough, if any."""
    everywhere = move(shortest, calm=True).terms[0].everywhere
    assert everywhere is not None
    on_grid = np.zeros(HALF_PERIOD * (len(impulses) - 1) + 1)
    on_grid[::HALF_PERIOD] = impulses
    for horizon in range(shortest, LONGEST):
        trajectory = lfo.solve(move(horizon, calm=False)).trajectory
        assert trajectory is not None
        shaped = np.convolve(trajectory.u[:, 0], on_grid)
        of_its_length = replace(everywhere, map=replace(everywhere.map, window=np.ones(len(shaped))))
        if proven_peak(of_its_length, shaped).ratio <= 1:
            return len(shaped)
    return None


def main() -> None:
    """Print the samples of every move."""
    unshaped = lfo.minimum_time(move(LONGEST, calm=False), horizons=(1, LONGEST)).horizon
    ours = lfo.minimum_time(move(LONGEST, calm=True), horizons=(1, LONGEST)).horizon
    print(f"unshaped, rings: {unshaped} samples")
    for name, impulses in shapers().items():
        print(f"{name}: {shaped_length(impulses, unshaped or 1)} samples")
    print(f"ResidualVibration: {ours} samples, and one less is proven infeasible")


if __name__ == "__main__":
    main()
