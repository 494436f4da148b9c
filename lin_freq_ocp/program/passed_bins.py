"""The program of a frequency response in fewer variables: the coefficients of passed bins of controls, and slacks.

The dynamics of a response are dense rows: each output depends on all controls. All points that satisfy these, the
links of the ends that follow, and the stop bands of controls are z = z_0 + N w, with a basis N of what the passed bins
of controls do. The duals of these equations follow from the conditions on the variables that they determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.program.backends.base import Claim, Solution
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.program_rows import real_rows


@dataclass(frozen=True, eq=False)
class PassedBins:
    """A program of a frequency response in given units, and the same in w."""

    given: Program
    states: int  # the first variables
    start: Array  # z_0, (variables,)
    basis: sp.csc_array  # N, (variables, fewer)
    of_states: Indices  # rows of the dynamics and of the links of ends: they determine the states
    of_bins: Indices  # rows of stopped bins of controls

    @cached_property
    def kept(self) -> Mask:
        """Which rows do not hold for every w."""
        kept = np.ones(len(self.given.lower), dtype=bool)
        kept[self.of_states] = kept[self.of_bins] = False
        return kept

    @cached_property
    def program(self) -> Program:
        """The program in w."""
        given, N, kept = self.given, self.basis, np.flatnonzero(self.kept)
        values, rows = (given.A @ self.start)[kept], np.append(0, np.cumsum(self.kept))
        return Program(
            sp.csc_array(N.T @ (given.P @ N)),
            N.T @ (given.q + given.P @ self.start),
            sp.csc_array(sp.csr_array(given.A)[kept] @ N),
            given.lower[kept] - values,
            given.upper[kept] - values,
            given.objective(self.start),
            cones=tuple(slice(int(rows[cone.start]), int(rows[cone.stop])) for cone in given.cones),
        )

    def recover(self, solution: Solution) -> Solution:
        """Return the solution of the given program."""
        given, z, slope = self.given, solution.z, np.zeros(len(self.start))
        if z is not None:
            z = self.basis @ z
            if solution.claim is not Claim.UNBOUNDED:
                z, slope = z + self.start, given.P @ (z + self.start) + given.q
        if solution.y is None:
            return replace(solution, z=z)
        duals = np.zeros(len(given.lower))
        duals[self.kept] = solution.y
        slope += given.A.T @ duals
        of_states = splu(sp.csc_array(given.A[self.of_states][:, : self.states].T))
        duals[self.of_states] = of_states.solve(-slope[: self.states])
        slope += given.A[self.of_states].T @ duals[self.of_states]
        if len(self.of_bins):
            bands = given.A[self.of_bins].toarray()
            duals[self.of_bins] = -cho_solve(cho_factor(bands @ bands.T), bands @ slope)
        return replace(solution, z=z, y=duals)


def passed_bins(linear: LinearProgram, program: Program, scaling: Scaling) -> PassedBins:
    """Return the program of a frequency response, which is ``linear`` in the units of ``scaling``, in w."""
    rows, columns, slacks = program.rows, scaling.columns, len(linear.prices)
    start, signals = response_basis(linear, columns[: linear.signals])
    first, links = rows[Block.TERMS].start, list[Indices]()
    for term, own in zip(linear.problem.terms, linear.of_terms, strict=True):
        if term.kind is TermKind.LINKED_ENDS and term.source is None:  # follows from the dynamics
            links.append(np.arange(first, first + len(own.lower)))
        first += len(own.lower)
    dynamics, bins = (np.arange(*rows[block].indices(first)[:2]) for block in (Block.DYNAMICS, Block.CONTROL_SPECTRUM))
    return PassedBins(
        program,
        linear.states,
        np.append(start, np.zeros(slacks)),
        sp.csc_array(sp.block_diag((sp.csc_array(signals), sp.eye_array(slacks)), format="csc")),
        np.concatenate([dynamics, *links]),
        bins,
    )


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
    of_u = of_u.reshape(T * m, -1)
    N = np.vstack([response.matrix @ of_u, of_u]) / units[:, None]
    return np.append(response.states(u) - origin.x, u - origin.u) / units, N / np.abs(N).max(axis=0)
