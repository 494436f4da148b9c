"""The bordered KKT system: the unknowns and equations that couple bins (docs/spectral.md, 4).

Bordering unknowns theta: the free components of x_0 and x_T, then real coordinates of the bordering directions, each
with a signal in time of unit amplitude. Equations: x(0) = x_0, other points that bounds fix, compatibility at singular
bins, state bands. They act on signals and on theta:

    E_y y + E_theta theta = e,    y = (signals without forces) - N N^* (E_y'zeta + ...) + Y theta

Their multipliers zeta are forces, E_y'zeta, which lower the equations by S_E zeta. So the KKT matrix of theta, zeta is

    K = [[H, E'], [E, -S_E]],     E = E_theta + E_y Y,     S_E = E_y N N^* E_y'.

E is therefore the total derivative of the equations; E_y is never a matrix, but a value of a signal (for points) or a
row of the DFT (``bands``). H is the Hessian in theta of the cost of Y theta.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.spectral.spaces import BinSpaces, CirculantKernels, times_columns
from lin_freq_ocp.program.program_rows import real_rows

EQUILIBRATIONS = 3  # passes of row scaling
LARGEST_BORDERED = 3000  # rows of the matrix; with more, its dense decomposition takes longer than the sparse program
NULL_EQUATION = 1e-12  # relative singular value of the equations that is rounding of 0
EQUATION_ROUNDING = 1e-13  # relative eigenvalue of S_E that is rounding of 0
# Response of a bordering unknown to a force, relative to a control's, from which it stays in the small QP: in the sum
# with S_W, fewer than five digits of S_W would be left.
COMPLIANT_RESPONSE = 1e11
COMPLIANT_END = 1e8  # the same for free ends, which move all signals
HESSIAN_ROUNDING = 1e-15  # curvature of a bordering unknown, relative to the largest, that may be rounding
SHORTEST_PROXIMAL = 1e-16  # smallest proximal weight on compliant unknowns, relative to the curvature of a control


class BorderingUnknowns:
    """The unknowns theta, ``size`` numbers, and their responses Y.

    First come the components free_start of x_0, at_start; then free_end of x_T, at_end: ``ends_count`` in all. They
    move the jump w = x_0 - x_T by ``end_jumps`` (n, ends_count), and y_k by ``end_responses`` (n+m, ends_count, bins).
    Then comes a coordinate j for each real or imaginary part of a bordering direction, the ``first`` of each direction
    being real. It moves y_k by amplitude[j] vectors[:, j] at the bin bins[j]. Periodic ends give none: w = 0.
    """

    def __init__(self, lti: Lti, spaces: BinSpaces):
        self.lti, self.spaces, T, n = lti, spaces, lti.horizon, lti.state_dim
        free = (~np.array([lti.periodic]) & np.isnan(part) for part in (lti.start, lti.end))
        self.free_start, self.free_end = map(np.flatnonzero, free)
        ends = len(self.free_start) + len(self.free_end)
        self.at_start, self.at_end = np.arange(len(self.free_start)), np.arange(len(self.free_start), ends)
        self.end_jumps = np.hstack([np.eye(n)[:, self.free_start], -np.eye(n)[:, self.free_end]])
        self.end_responses = np.zeros((len(lti.M), 0, len(spaces.z)), dtype=np.complex128)
        self.end_signals = np.zeros((len(lti.M), 0, T))
        if ends:
            self.end_responses = spaces.particular(spaces.z * self.end_jumps[:, :, None].astype(np.complex128))
            self.end_signals = np.fft.irfft(self.end_responses, T)
        # a direction has two real coordinates, one after the other; at the real bins 0 and T/2 it has one
        k, directions = spaces.bordering_bin, spaces.bordering_vector
        counts = spaces.multiplicity[k].astype(int)
        direction = np.repeat(np.arange(len(k)), counts)
        self.first, self.bins = ends + np.cumsum(counts) - counts, k[direction]
        self.ends_count, self.size = ends, ends + len(self.bins)
        self.vectors = directions[:, direction] * np.where(np.arange(ends, self.size) == self.first[direction], 1, 1j)
        self.amplitude = T / spaces.multiplicity[self.bins]  # of a spectrum whose signal has unit amplitude

    def hessian(self) -> Array:
        """Return H_ab = 1/T sum_k multiplicity_k Re(Y_a^* M Y_b), and P for the free end."""
        lti, ends, Y, vectors = self.lti, self.ends_count, self.end_responses, self.vectors
        H = np.zeros((self.size, self.size))
        if ends:
            MY, repeated = times_columns(lti.M, Y), Y.conj() * self.spaces.multiplicity
            H[:ends, :ends] = np.einsum("iak,ibk->ab", repeated, MY, optimize=True).real / lti.horizon
            H[ends:, :ends] = np.einsum("ij,iaj->ja", vectors.conj(), MY[:, :, self.bins]).real
            H[:ends, ends:] = H[ends:, :ends].T
        same = self.bins[:, None] == self.bins
        H[ends:, ends:] = np.where(same, (vectors.conj().T @ lti.M @ vectors).real * self.amplitude, 0.0)
        H[self.at_end[:, None], self.at_end] += lti.P[self.free_end[:, None], self.free_end]
        return H

    def signals(self) -> Array:
        """Return the signals of all unknowns at 1, (n+m, size, T)."""
        T = self.lti.horizon
        phase = np.exp((2j * np.pi / T) * np.arange(T))[np.outer(self.bins, np.arange(T)) % T]
        return np.concatenate([self.end_signals, (self.vectors[:, :, None] * phase).real], axis=1)

    def gradient(self, spectrum: ComplexArray) -> Array:
        """Return the derivative in theta of a cost whose gradient in y has this spectrum (n+m, bins)."""
        over_bins = np.einsum("iak,ik->a", self.end_responses.conj(), spectrum * self.spaces.multiplicity).real
        at_bins = (self.vectors.conj() * spectrum[:, self.bins]).sum(0).real
        return np.concatenate([over_bins / self.lti.horizon, at_bins])

    def derivatives(self, t: Indices, f: Indices) -> Array:
        """Return d (F_f y_t) / d theta, shape (size, len(t)), for t < T."""
        rows, T = self.lti.F[f], self.lti.horizon
        at_ends = np.einsum("ri,iar->ra", rows, self.end_signals[:, :, t])
        phase = np.exp((2j * np.pi / T) * (t[:, None] * self.bins % T))
        return np.hstack([at_ends, ((rows @ self.vectors) * phase).real]).T

    def add(self, theta: Array, spectrum: ComplexArray) -> None:
        """Add Y_k theta to the spectrum (n+m, bins), in place."""
        for a in range(self.ends_count):
            spectrum += theta[a] * self.end_responses[:, a]
        along = self.amplitude * theta[self.ends_count :]
        np.add.at(spectrum.T, self.bins, along[:, None] * self.vectors.T)


class BorderedSystem:
    """Equations of the bordering unknowns and the signals, and the pseudo-inverse of K.

    The equations are, in this order:
        values F_f y_t at (point_t, point_f): x(0) = x_0 but for periodic ends, then those that bounds fix;
        compatibility, scaled by compatibility_scale;
        rows ``bands`` (count, T+1) of the DFT, of states ``band_component`` (count,); their spectra are ``band_hat``.
    """

    def __init__(self, lti: Lti, spaces: BinSpaces, kernels: CirculantKernels):
        self.lti, self.spaces, self.kernels = lti, spaces, kernels
        self.unknowns = unknowns = BorderingUnknowns(lti, spaces)
        self.size = unknowns.size
        fixed, bands = len(lti.fixed_points[0]), 2 * int(lti.state_stop.sum())
        compatibility = int(sum(spaces.multiplicity[equation.k] for equation in spaces.compatibility))
        equations = lti.state_dim + fixed + compatibility + bands
        if self.size + equations > LARGEST_BORDERED:  # before any matrix of this size is made
            raise UnsupportedError(
                f"method 'spectral': {self.size} bordering unknowns and {equations} equations that fix points "
                f"({fixed} by bounds) or bins of states; it takes {LARGEST_BORDERED} together. Use method 'convex'."
            )
        self.H = unknowns.hessian()
        # x(0) = x_0, with its free components on the left side, and values that bounds fix
        n, (t, f) = lti.start_points, lti.fixed_points
        self.point_t, self.point_f = np.concatenate([np.zeros(n, int), t]), np.concatenate([np.arange(n), f])
        point_rows = unknowns.derivatives(self.point_t, self.point_f).T
        point_rows[unknowns.free_start, unknowns.at_start] -= 1.0
        self._set_compatibility_rows()
        self._set_band_rows()
        self.E = np.vstack([point_rows, self.compatibility_rows, self.band_rows])
        self._decompose()

    def _set_compatibility_rows(self) -> None:
        """Rows (T/multiplicity) sigma (theta_re + i theta_im) - U_j^* z end_jumps theta, Re and Im, scaled to 1."""
        spaces, unknowns, rows = self.spaces, self.unknowns, list[Array]()
        self.compatibility_scale = np.ones(len(spaces.compatibility))
        for j, equation in enumerate(spaces.compatibility):
            row = np.zeros(self.size, dtype=np.complex128)
            row[: unknowns.ends_count] = -spaces.z[equation.k] * (equation.left.conj() @ unknowns.end_jumps)
            column, amplitude = unknowns.first[equation.direction], self.lti.horizon / spaces.multiplicity[equation.k]
            row[column] = equation.sigma * amplitude
            if spaces.multiplicity[equation.k] == 2:
                row[column + 1] = 1j * equation.sigma * amplitude
            self.compatibility_scale[j] = 1 / max(1.0, float(np.abs(row).max()))
            rows.append(self.compatibility_scale[j] * self._real_and_imaginary(equation.k, row))
        self.compatibility_rows = np.vstack([*rows, np.zeros((0, self.size))])

    def _real_and_imaginary(self, k: int, values: ComplexArray) -> Array:
        """Return the real and imaginary part of a complex equation at bin k; only the real one at real bins."""
        return values.real[None] if self.spaces.multiplicity[k] == 1 else np.stack([values.real, values.imag])

    def _set_band_rows(self) -> None:
        """State bands: rows of the DFT of length T+1, whose last entry acts on x_T; of T with periodic ends."""
        stop, T = self.lti.state_stop, self.lti.horizon
        samples = self.lti.state_samples
        padding = (0, 0), (0, T + 1 - samples)
        parts = [(int(i), np.pad(real_rows(samples, stop[:, i]), padding)) for i in np.flatnonzero(stop.any(0))]
        self.band_component = np.concatenate([np.full(len(rows), i) for i, rows in parts] + [np.zeros(0, int)])
        self.band_components = tuple(i for i, _ in parts)
        self.bands = np.vstack([*[rows for _, rows in parts], np.zeros((0, T + 1))])
        count = len(self.bands)
        self.band_hat = np.fft.rfft(self.bands[:, :T]) if count else np.zeros((0, len(self.spaces.z)), complex)
        # decrease of y_t by a unit force on each band row, (n+m, rows, T)
        self.band_responses, self.band_rows = np.zeros((len(self.lti.M), 0, T)), np.zeros((count, self.size))
        if count:
            force = np.zeros((len(self.lti.M), count, len(self.spaces.z)), dtype=np.complex128)
            force[self.band_component, np.arange(count)] = self.band_hat
            self.band_responses = np.fft.irfft(self.spaces.project(force), T)
            signals = self.unknowns.signals()
            for i, rows in parts:
                self.band_rows[self.band_component == i] = rows[:, :T] @ signals[i].T
            at_free = self.unknowns.free_end[:, None] == self.band_component
            self.band_rows[:, self.unknowns.at_end] += (at_free * self.bands[:, -1]).T

    def _decompose(self) -> None:
        """Set K (``matrix``), its ``inverse``, and a basis of the ``dependent`` equations; see ``compliant`` below."""
        points, first_band = len(self.point_t), len(self.point_t) + len(self.compatibility_rows)
        S_E = np.zeros((len(self.E), len(self.E)))
        S_E[:, :points] = self.responses(self.point_t, self.point_f)
        S_E[:points, first_band:] = S_E[first_band:, :points].T
        for i in self.band_components:
            of_component = np.flatnonzero(self.band_component == i)
            S_E[first_band:, first_band + of_component] = self.band_responses[i] @ self.bands[of_component, :-1].T
        self.matrix = np.empty((self.size + len(S_E), self.size + len(S_E)))
        self.matrix[: self.size, : self.size], self.matrix[: self.size, self.size :] = self.H, self.E.T
        self.matrix[self.size :, : self.size], self.matrix[self.size :, self.size :] = self.E, -(S_E + S_E.T) / 2
        self.dependent = _null_space(self.E.T, S_E)
        unit, stiffest = self.lti.curvature_unit, float(np.abs(self.H).max(initial=0.0))
        self.least_proximal = max(SHORTEST_PROXIMAL * unit, HESSIAN_ROUNDING * stiffest)
        self.inverse = self.inverse_of(self.matrix)
        # compliant: the response of an unknown to a force is NaN, or so large that digits of other responses are lost.
        # It then stays in the small QP, and the inverse has the least proximal weight.
        response = np.abs(self.inverse.diagonal()[: self.size])
        of_ends = response[: self.unknowns.ends_count].max(initial=0.0)
        of_directions = response[self.unknowns.ends_count :].max(initial=0.0)
        stiff_ends = of_ends <= min(COMPLIANT_END / unit, 0.1 / self.least_proximal)
        self.compliant = not (stiff_ends and of_directions <= COMPLIANT_RESPONSE / unit)
        if self.compliant:
            self.inverse = self.inverse_of(self.proximal_matrix(self.least_proximal))

    def proximal_matrix(self, proximal: float) -> Array:
        """Return K with a proximal weight on theta, which shortens steps where H is nearly 0."""
        matrix, diagonal = self.matrix.copy(), np.arange(self.size)
        matrix[diagonal, diagonal] += proximal
        return matrix

    @cached_property
    def regularised(self) -> Array:
        """The inverse of K with a unit Hessian in place of H."""
        matrix = self.matrix.copy()
        matrix[: self.size, : self.size] = self.lti.curvature_unit * np.eye(self.size)
        return self.inverse_of(matrix)

    def inverse_of(self, matrix: Array) -> Array:
        """Return the inverse of K, perhaps with another Hessian; dependent equations have no multiplier.

        It is NaN if the matrix is exactly singular: the exchange fails.
        """
        matrix = matrix.copy()
        zeta, onto = slice(self.size, None), self.dependent @ self.dependent.T
        matrix[zeta, zeta] -= onto / self.lti.curvature_unit
        scale = equilibration(matrix)
        try:
            inverse = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
        except np.linalg.LinAlgError:
            return np.full_like(matrix, np.nan)
        inverse[zeta, zeta] += self.lti.curvature_unit * onto
        return (inverse + inverse.T) / 2

    def right_hand_side(self, lti: Lti, jump: ComplexArray) -> Array:
        """Return e, (equations,), for the data of ``lti``, with z w + d_k of the fixed ends, (n, bins)."""
        spaces, n, (start, end) = self.spaces, lti.start_points, lti.ends
        points = start[:n], lti.bounds.lower[self.point_f[n:], self.point_t[n:]]
        compatibility = [
            scale * self._real_and_imaginary(equation.k, np.array([equation.left.conj() @ jump[:, equation.k]]))[:, 0]
            for scale, equation in zip(self.compatibility_scale, spaces.compatibility, strict=True)
        ]
        return np.concatenate([*points, *compatibility, -self.bands[:, -1] * end[self.band_component]])

    def coupling_at_all_times(self, rows: Indices) -> Array:
        """Return the ``coupling`` of F_f y_t at all t < T: (size + equations, len(rows), T)."""
        F = self.lti.F[rows]
        response = np.zeros((len(rows), len(self.matrix), self.lti.horizon))
        if self.size:
            response[:, : self.size] = np.tensordot(F, self.unknowns.signals(), 1)
        by_points = self.kernels.table[rows[:, None], self.point_f]  # unit forces at t = 0, (len(rows), points, T) ...
        for i in np.flatnonzero(self.point_t):  # ... which act later at the other points
            by_points[:, i] = np.roll(by_points[:, i], self.point_t[i], axis=-1)
        response[:, self.size : self.size + len(self.point_t)] = -by_points
        if len(self.bands):
            response[:, -len(self.bands) :] = -np.tensordot(F, self.band_responses, 1)
        return response.swapaxes(0, 1)

    def coupling(self, t: Indices, f: Indices) -> Array:
        """Return C, (size + equations, len(t)), of F_f y_t, and of component f of x_T at t = T: see WorkingSet."""
        inner, last = t < self.lti.horizon, np.flatnonzero(t == self.lti.horizon)
        columns = np.zeros((len(self.matrix), len(t)))
        columns[: self.size, inner] = self.unknowns.derivatives(t[inner], f[inner])
        columns[self.size :, inner] = -self.responses(t[inner], f[inner])
        columns[self.unknowns.at_end[np.searchsorted(self.unknowns.free_end, f[last])], last] = 1.0
        return columns

    def responses(self, t: Indices, f: Indices) -> Array:
        """Return the decrease of the equations by unit forces on F_f y_t, (equations, len(t)), for t < T."""
        at_points = self.kernels.gram(self.point_t, self.point_f, t, f)
        at_bands = np.einsum("ri,idr->dr", self.lti.F[f], self.band_responses[:, :, t])
        return np.vstack([at_points, np.zeros((len(self.compatibility_rows), len(t))), at_bands])


def _null_space(rows: Array, gram: Array) -> Array:
    """Return an orthonormal basis of the null space of both the rows and the positive semidefinite gram."""
    rounding = EQUATION_ROUNDING * float(np.abs(gram).max(initial=0.0))
    if not len(gram) or np.linalg.eigvalsh(gram)[0] > rounding:
        return np.zeros((len(gram), 0))
    _, singular, V = np.linalg.svd(rows)
    rank = int((singular > NULL_EQUATION * max(1.0, singular.max(initial=0.0))).sum())
    basis = V[rank:].T
    eigenvalues, vectors = np.linalg.eigh(basis.T @ gram @ basis)
    return basis @ vectors[:, eigenvalues <= rounding]


def equilibration(matrix: Array) -> Array:
    """Return a scale s for rows and columns such that the largest entries of s_i s_j |matrix_ij| are near 1."""
    scale = np.ones(len(matrix))
    for _ in range(EQUILIBRATIONS):
        largest = np.abs(matrix * scale[:, None] * scale).max(1, initial=0.0)
        scale /= np.sqrt(np.where(largest > 0, largest, 1.0))
    return scale
