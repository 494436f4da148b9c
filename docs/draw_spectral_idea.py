"""The idea of the Fourier-domain method in one picture, on the pendulum sampled so slowly that every bin can be seen.

    python docs/draw_spectral_idea.py [FILE]

Writes docs/spectral.png unless another file is named.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import lin_freq_ocp as lfo
from lin_freq_ocp.methods.spectral.model import lti_problem, natural_units
from lin_freq_ocp.methods.spectral.structure import Structure
from lin_freq_ocp.pages.figures.look import BAND, BOUND, COMPONENTS, GRID, INK, MUTED, Note, new_figure, style_axes

HORIZON, SAMPLING_TIME = 60, 0.1  # 31 bins, four eigenvalues well apart, and few samples at a bound
CONTROL, STATE = COMPONENTS[0], COMPONENTS[1]  # colours of the force and of the position; lines and markers differ too
POSITION, FORCE = 0, 4  # components of y = (x, u)
HEIGHT = 7.9
SIZE = 10.5  # inches; points of the words in the panels


def main(path: Path) -> None:
    """Solve, and draw two panels in frequency and two in time."""
    problem = lfo.library.pendulum(horizon=HORIZON, sampling_time=SAMPLING_TIME)
    solution = lfo.SpectralSolver(problem).solve()
    structure = Structure(lti_problem(problem, natural_units(problem)))
    figure = new_figure(HEIGHT)
    panels = figure.subplots(2, 2)
    draw_bins(panels[0, 0], problem, len(solution.active.t))
    draw_spectrum(panels[1, 0], problem, solution)
    draw_rows(panels[0, 1], problem, solution)
    draw_kernels(panels[1, 1], structure, solution)
    save(figure, path)


def draw_bins(ax: Axes, problem: lfo.OptimalControlProblem, rows: int) -> None:
    """Draw the points z_k of the bins in use on the unit circle, and the eigenvalues of A."""
    ties = f"x(0) = x_0 and the rows of (b), {problem.state_dim} + {rows} forces, tie them together"
    style_axes(ax, "(a) Every bin is a small system of its own", "", "", [Note(ties)])
    ax.grid(False)
    ax.set_axis_off()
    stopped = problem.control_stop[:, 0]
    z = np.exp(2j * np.pi * np.arange(len(stopped)) / problem.horizon)
    circle = np.exp(1j * np.linspace(0, np.pi, 400))
    ax.plot([-1.15, 1.75], [0, 0], color=GRID, linewidth=1.0, zorder=0)
    ax.plot(circle.real, circle.imag, color=BOUND, linewidth=0.8, zorder=1)
    edge = np.angle(z[stopped][0]) - np.pi / problem.horizon
    gap = np.exp(1j * np.linspace(edge, np.pi, 60))
    ring = np.concatenate([1.1 * gap, 0.9 * gap[::-1]])
    ax.fill(ring.real, ring.imag, color=BAND, linewidth=0, zorder=0)
    ax.scatter(z[~stopped].real, z[~stopped].imag, s=42, color=CONTROL, zorder=3)
    eigenvalues = np.sort(np.linalg.eigvals(problem.dynamics.A).real)
    ax.scatter(eigenvalues, 0 * eigenvalues, marker="x", s=75, linewidth=2.2, color=INK, zorder=4, clip_on=False)
    shown = z[8]
    ax.annotate(
        "bin k, at z = exp(2πik/T):\n(z I - A) x̂ = B û + z w",
        (shown.real, shown.imag),
        xytext=(1.1, 1.34),
        ha="center",
        va="center",
        fontsize=SIZE,
        color=CONTROL,
        arrowprops={"arrowstyle": "-", "color": CONTROL, "shrinkB": 5, "linewidth": 0.9},
    )
    ax.annotate("stop band:\nno unknowns", (-0.85, 0.08), fontsize=SIZE, color=INK, va="bottom")
    ax.annotate(
        "crosses: eigenvalues\nof A; only a bin next\nto one needs care",
        (0.08, 0.55),
        fontsize=SIZE,
        color=INK,
        ha="center",
        va="center",
    )
    words = {eigenvalues[0]: "stable", eigenvalues[1]: "cart", eigenvalues[-1]: "unstable"}
    for eigenvalue, word in words.items():
        ax.annotate(
            f"{eigenvalue:.3g}\n{word}",
            (eigenvalue, 0),
            xytext=(0, -9),
            textcoords="offset points",
            fontsize=SIZE,
            color=INK,
            ha="center",
            va="top",
        )
    ax.set(xlim=(-1.15, 1.8), ylim=(-0.42, 1.5), aspect="equal", anchor="N")


def draw_spectrum(ax: Axes, problem: lfo.OptimalControlProblem, solution: lfo.solvers.SpectralSolution) -> None:
    """Draw the amplitudes of the force at the bins in use; the others have none to draw."""
    style_axes(ax, "(c) The force in frequency", "bin k", "|DFT of force| [N]")
    stopped = problem.control_stop[:, 0]
    k, amplitude = np.arange(len(stopped)), np.abs(np.fft.rfft(solution.trajectory.u[:, 0]))
    first = k[stopped][0]
    ax.axvspan(first - 0.5, k[-1] + 0.5, color=BAND, linewidth=0)
    ax.vlines(k[~stopped], 0, amplitude[~stopped], color=CONTROL, linewidth=1.6)
    ax.plot(k[~stopped], amplitude[~stopped], "o", color=CONTROL, markersize=6)
    ax.annotate(
        f"bins {first} to {k[-1]}\nare not variables",
        ((first + k[-1]) / 2, 0.5 * amplitude.max()),
        rotation=90,
        fontsize=SIZE,
        color=INK,
        ha="center",
        va="center",
    )
    ax.set(xlim=(-0.8, k[-1] + 0.5), ylim=(0, 1.12 * amplitude.max()))


def draw_rows(ax: Axes, problem: lfo.OptimalControlProblem, solution: lfo.solvers.SpectralSolution) -> None:
    """Draw force and position as parts of their bounds, and the samples that are at one."""
    x, u, active = solution.trajectory.x, solution.trajectory.u, solution.active
    shares = {POSITION: x[:-1, 0] / problem.state_tube.upper[1, 0], FORCE: u[:, 0] / problem.control_tube.upper[0, 0]}
    bounded = problem.horizon * (problem.state_dim + problem.control_dim)
    style_axes(
        ax,
        f"(b) The working rows: {len(active.t)} of {bounded} samples",
        "time step t",
        "part of the bound",
        [Note("only samples at a bound enter the small dense QP")],
    )
    ax.axhline(1, color=BOUND, linewidth=1.4)
    ax.axhline(-1, color=BOUND, linewidth=1.4)
    t = np.arange(problem.horizon)
    ax.plot(t, shares[POSITION], color=STATE, linewidth=1.8, linestyle=(0, (5, 1.6)))
    ax.step(t, shares[FORCE], where="mid", color=CONTROL, linewidth=1.8)
    for f, color, marker in ((FORCE, CONTROL, "o"), (POSITION, STATE, "s")):
        mine = active.t[active.f == f]
        ax.plot(mine, shares[f][mine], marker, color=color, markersize=9, markeredgecolor=INK, zorder=5, clip_on=False)
    ax.annotate("force / 5 N", (42, 0.42), fontsize=SIZE, color=CONTROL)
    ax.annotate("position / 0.2 m", (25, 0.55), fontsize=SIZE, color=STATE)
    ax.annotate("bound", (29.5, 1.04), fontsize=SIZE, color=MUTED, ha="center")
    ax.set(xlim=(-1.5, problem.horizon + 0.5), ylim=(-1.3, 1.3))


def draw_kernels(ax: Axes, structure: Structure, solution: lfo.solvers.SpectralSolution) -> None:
    """Draw the response of force and position at t to a force on the control at time s, and where S is read off."""
    style_axes(
        ax,
        "(d) How one row acts on another: kernels",
        "t - s, modulo the horizon",
        "kernel / its largest value",
        [Note("decrease at t by a unit force on u at s; dots: entries of the QP")],
    )
    T = structure.kkt.lti.horizon
    lag = np.arange(-T // 2, T // 2 + 1)
    on_force = solution.active.t[solution.active.f == FORCE]
    styles = ((POSITION, STATE, "s", (0, (5, 1.6))), (FORCE, CONTROL, "o", "solid"))
    for f, color, marker, line in styles:
        kernel = structure.kernels.gram(lag % T, np.full(len(lag), f), np.array([0]), np.array([FORCE]))[:, 0]
        kernel = kernel / np.abs(kernel).max()
        ax.plot(lag, kernel, color=color, linestyle=line, linewidth=1.8)
        t = solution.active.t[solution.active.f == f]
        read = np.unique((t[:, None] - on_force + T // 2) % T)
        ax.plot(lag[read], kernel[read], marker, color=color, markersize=7, markeredgecolor=INK, zorder=5)
    ax.axhline(0, color=BOUND, linewidth=0.8)
    ax.annotate("on the force: narrow,\nringing at the band's edge", (2.5, 0.72), fontsize=SIZE, color=CONTROL)
    ax.annotate("on the position: wide,\nand before s as after it", (8.5, -0.72), fontsize=SIZE, color=STATE)
    ax.set(xlim=(-T / 2, T / 2), ylim=(-1.12, 1.12))


def save(figure: Figure, path: Path) -> None:
    """Write the picture."""
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("spectral.png"))
