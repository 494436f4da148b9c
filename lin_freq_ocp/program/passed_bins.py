"""The program of a frequency response in fewer variables: the coefficients of passed bins of controls, and slacks.

Each output depends on all controls. All points that satisfy the dynamics, the links of the ends that follow, and the
stop bands of controls are z = z_0 + N w, with a basis N of what the passed bins of controls do. The multipliers of
these equations follow from the conditions on the signals that they determine. No row of the dynamics is formed, so that
records may be long, and rows of single times are used where they are chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.program.program_rows import ProgramRows, real_rows

BYTES_OF_BASIS = 40.0  # of the basis at the peak: as a matrix, as rows of the program, and scaled


@dataclass(frozen=True, eq=False)
class PassedBins:
    """The program of a frequency response in w, of all rows or of chosen ones, in given units."""

    linear: LinearProgram
    response: Response
    units: Array  # (variables,)
    start: Array  # z_0, (variables,), in the units
    basis: Array  # N, (signals, fewer), in the units

    @cached_property
    def split_rows(self) -> tuple[list[ProgramRows], list[ProgramRows]]:
        """The rows that do not hold for every w, and the links of ends that follow from the dynamics."""
        links = list[ProgramRows]()
        kept = [rows for rows in self.linear.rows if rows.block not in (Block.CONTROL_SPECTRUM, Block.TERMS)]
        for term, rows in zip(self.linear.problem.terms, self.linear.of_terms, strict=True):
            (links if term.kind is TermKind.LINKED_ENDS and term.source is None else kept).append(rows)
        return kept, links

    @cached_property
    def rows(self) -> tuple[sp.csr_array, Array, Array, Array]:
        """All kept rows in the units: their matrix, their limits, and their own units."""
        kept, _ = self.split_rows
        A = sp.csr_array(self.linear.matrix(kept) * self.units)
        size = np.asarray(abs(A).max(axis=1).todense()).ravel()
        for cone in self.cones:
            size[cone] = size[cone].max()
        size = np.where(size > 0, size, 1.0)
        A.data /= np.repeat(size, np.diff(A.indptr))
        drift = A @ self.start
        lower, upper = (np.concatenate([getattr(rows, side) for rows in kept]) for side in ("lower", "upper"))
        return A, (lower / size - drift).astype(np.float64), (upper / size - drift).astype(np.float64), size

    @cached_property
    def cones(self) -> list[slice]:
        """The rows of each second-order cone."""
        firsts = np.cumsum([0, *(len(rows.lower) for rows in self.split_rows[0])]).tolist()
        pairs = zip(firsts, self.split_rows[0], strict=False)
        return [slice(first + int(a), first + int(b)) for first, rows in pairs for a, b in rows.cones]

    @cached_property
    def single(self) -> Mask:
        """Which rows are inequalities that stand alone."""
        A, lower, upper, _ = self.rows
        single = lower < upper
        for cone in self.cones:
            single[cone] = False
        return single & (np.diff(A[:, : self.linear.signals].indptr) > 0)

    @cached_property
    def cost(self) -> tuple[sp.csc_array, Array, float]:
        """P and q in w, and their unit."""
        linear, start, N, n = self.linear, self.start, self.basis, self.linear.signals
        P, slope = linear.hessian, linear.gradient
        moved = N.T @ (self.units * (slope + P @ (self.units * start)))[:n]
        curved = N.T @ (self.units[:n, None] * (P[:n, :n] @ (self.units[:n, None] * N)))
        q = np.append(moved, (self.units * slope)[n:])
        unit = max(float(np.abs(part).max(initial=0.0)) for part in (q, curved)) or 1.0
        k = len(q) - len(curved)
        return sp.csc_array(sp.block_diag((curved / unit, sp.csc_array((k, k))))), q / unit, unit

    def program(self, chosen: Mask) -> Program:
        """Return the program of some rows, all of those in cones among them."""
        (A, lower, upper, _), (P, q, _), n = self.rows, self.cost, self.linear.signals
        first, A = np.append(0, np.cumsum(chosen)), A[chosen]
        of_w = sp.hstack([sp.csr_array(A[:, :n] @ self.basis), A[:, n:]])
        cones = tuple(slice(int(first[cone.start]), int(first[cone.stop])) for cone in self.cones)
        return Program(P, q, sp.csc_array(of_w), lower[chosen], upper[chosen], cones=cones)

    def change(self, w: Array) -> Array:
        """Return N w with the slacks, (variables,), in the units."""
        fewer = self.basis.shape[1]
        return np.append(self.basis @ w[:fewer], w[fewer:])

    def violations(self, w: Array) -> Array:
        """Return by how much each row that stands alone is violated; negative inside."""
        A, lower, upper, _ = self.rows
        values = A @ self.change(w)
        return np.where(self.single, np.maximum(lower - values, values - upper), -np.inf)

    def point(self, w: Array) -> Array:
        """Return the point of the program in its own units."""
        return self.units * (self.start + self.change(w))

    def multipliers(self, y: Array, z: Array | None) -> Multipliers:
        """Return the multipliers of duals of all kept rows, at a point in its own units; None: those of a ray."""
        linear, problem = self.linear, self.linear.problem
        n, stop, (kept, links) = linear.signals, problem.control_stop, self.split_rows
        duals = y / self.rows[3] * (1.0 if z is None else self.cost[2])
        slope = (linear.matrix(kept).T @ duals)[:n]
        if z is not None:
            slope += (linear.hessian @ z + linear.gradient)[:n]
        ends, p = linear.matrix(links)[:, :n], problem.state_dim
        of_links = np.linalg.solve(ends[:, :p].toarray().T, -slope[:p])  # nothing else determines x_0
        of_x, of_u = linear.split_signals(slope + ends.T @ of_links)
        eta = -of_x[1:]
        of_u = of_u - self.response.pull_back(np.concatenate([np.zeros((1, p)), eta]))
        rho = -np.fft.rfft(of_u, axis=0) * (2.0 / len(of_u))
        rho[0] /= 2
        rho[-1] /= 2 if len(of_u) % 2 == 0 else 1
        all_rows = [*kept, *links]
        weights = [np.ones(len(rows.lower)) if rows.weights is None else rows.weights for rows in all_rows]
        values = np.concatenate(weights) * np.append(duals, of_links)
        targets = np.concatenate([rows.targets for rows in all_rows])
        found = linear.layout.multipliers(eta, targets, values, 0.0 if z is None else 1.0)
        return replace(found, rho_u=np.where(stop, rho, 0.0))


def passed_bins_of(linear: LinearProgram, response: Response, units: Array) -> PassedBins:
    """Return the program in the passed bins of the controls; slacks get larger units than these, if rows need them."""
    signals, T = linear.signals, linear.problem.horizon
    count = 2 * int((~linear.problem.control_stop).sum())
    require_memory(
        f"{count} coefficients of the bins that controls pass, over {T} samples of {signals // T} signals,",
        BYTES_OF_BASIS * count * (signals + count),
        "Choose a shorter record, a longer sampling time, or a stop band that removes more bins of the controls.",
    )
    start, N = response_basis(linear, units[:signals])
    bins = PassedBins(linear, response, units, np.append(start, np.zeros(len(linear.prices))), N)
    # a spectrum of signals of order 1 sums up many samples: its slacks have that size, and others keep their units
    A, moved = bins.rows[0], np.zeros(len(bins.single))
    moved[~bins.single] = np.abs(A[~bins.single][:, :signals] @ N).max(axis=1, initial=0.0)
    for cone in bins.cones:
        moved[cone] = moved[cone].max()
    beside = sp.coo_array(A[:, signals:])
    largest = np.ones(len(linear.prices))
    np.maximum.at(largest, beside.col, moved[beside.row] / np.abs(beside.data))
    return replace(bins, units=np.append(units[:signals], largest * units[signals:]))


def response_basis(linear: LinearProgram, units: Array) -> tuple[Array, Array]:
    """Return z_0, (signals,), and N, (signals, fewer), without slacks, in these units: N has entries of at most 1."""
    problem, origin = linear.problem, linear.origin
    response, (T, m) = problem.response, origin.u.shape
    assert response is not None
    passed = np.fft.rfft(origin.u, axis=0)
    passed[problem.control_stop] = 0.0
    u = np.fft.irfft(passed, n=T, axis=0)
    waves = [real_rows(T, ~stop).T for stop in problem.control_stop.T]
    of_u, last = np.zeros((T, m, sum(part.shape[1] for part in waves))), 0
    for j, part in enumerate(waves):
        of_u[:, j, last : last + part.shape[1]] = part
        last += part.shape[1]
    of_x = np.zeros(((T + 1) * response.base.shape[1], last))
    for k in range(last):
        of_x[:, k] = response.linear(of_u[..., k]).ravel()
    N = np.vstack([of_x, of_u.reshape(T * m, -1)]) / units[:, None]
    return np.append(response.states(u) - origin.x, u - origin.u) / units, N / np.abs(N).max(axis=0)
