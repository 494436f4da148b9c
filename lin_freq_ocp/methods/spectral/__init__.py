"""The Fourier-domain method for linear time-invariant problems, as docs/spectral.md derives it.

With y_t = (x_t, u_t), t < T, as one period of a signal with the bins y_k, the dynamics are F_k y_k = z w + d_k at
each bin: z = exp(2 pi i k / T), F_k = [z I - A, -B] with the columns of those controls that may use the bin, the jump
w = x_0 - x_T that closes the period, and the bins d_k of the offset. A round of the exchange solves the small QP,
transforms, and adds the rows that the signals violate:

    min 1/2 l'S l + delta'l over l >= 0      multipliers l of the working rows G y <= limit
    K_b (theta, zeta) = (-h, e) - C l        unknowns theta and multipliers zeta of equations, which couple bins
    y_k = c_k - N_k N_k^* g_k + Y_k theta    each bin responds to the forces g = G'l + E'zeta, in its null space N_k

K_b = [[H, E'], [E, -S_E]] has the curvature H and the equations E of theta, whose right-hand sides are -h and e; Y_k is
the response of a bin to theta, and S = S_W + C' K_b^-1 C that of the working rows to l. E acts on signals, too: E'zeta
are forces, and S_E is what they do to the equations.

Each file uses those above it, but for shortcuts and reductions, which are called here and there and may be left aside
at first: ``shortcuts`` saves time in the exchange, and ``reductions`` makes polyhedral sets and soft constraints such
as the method takes. Of ``model``, ``Lti``, ``Bounds`` and ``lti_problem`` are enough; units and changes of data follow.

``model``       the problem in units of order 1 (Lti), with time as the last axis
``spaces``      at every bin: N_k, and the responses to z w + d_k. Their kernels: how a force moves a row
``kkt``         the unknowns theta, the equations E, and K_b
``rows``        pointwise rows: how far they are violated, and the working set with C, limits and weights l
``qp``          the small QP; ``BorderedQp`` if some unknowns must not be eliminated
``structure``   Structure: all that does not depend on data. Data: y_k from theta, zeta and l; rays of infeasible data
``exchange``    the rounds: small QP, signals, new rows
``recovery``    multipliers of the maximum principle
``solver``      SpectralSolver

In the code, l is ``weights`` (``lam`` in ``qp``), delta ``d``, c_k ``Data.base``, and S_W and C are ``gram`` and
``coupling`` of the working set. A row is (t, f, sign): sign F_f y_t <= limit, and at t = T the component f of x_T. A
force on a row lowers it: kernels, S_W and S_E are these decreases.
"""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "exchange": "Exchange deadline first_working_set", "kkt": "LARGEST_BORDERED", "recovery": "recover",
    "model": "Lti LtiUnits lti_problem natural_units", "reductions": "SoftBounds priced_bounds row_form soft_bins",
    "qp": "BorderedQp PIVOTING_STEPS STEPS_OF_ALL block_pivoting bounded_qp interior_point predictor_corrector",
    "rows": "Rows Violations WorkingSet", "shortcuts": "MOST_VALUES NEIGHBOURHOOD_HORIZON WholeHorizon",
    "spaces": "BinSpaces CirculantKernels SMALL_TABLE", "structure": "Data Structure verified_ray",
})
