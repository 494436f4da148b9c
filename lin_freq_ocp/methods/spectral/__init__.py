"""The Fourier-domain method for linear time-invariant problems, as docs/spectral.md derives it.

With y_t = (x_t, u_t) and one system of equations F_k y_k = z w + d_k at each bin, w = x_0 - x_T, a round of the
exchange solves the small QP, transforms, and adds the rows that the signals violate:

    min 1/2 l'S l + d'l over l >= 0          multipliers l of the working rows G y <= limit
    K_b (theta, zeta) = (-h, e) - C l        unknowns theta, and equations, of no single bin
    y_k = c_k - N_k N_k^* g_k + Y_k theta    each bin responds to the forces g = G'l + E'zeta, in its null space N_k

In reading order:

``reductions``  polyhedral sets, soft sets and soft stop bands as constraints that the method takes
``model``       the problem in units of order 1, with time as the last axis
``spaces``      null spaces and particular responses at every bin, and kernels of pointwise rows
``kkt``         the bordered KKT system of theta and zeta
``rows``        pointwise rows: which are violated, which form the working set, how they act on each other
``qp``          the small quadratic programs over the working rows
``structure``   all that depends on the problem, then on its data; points from multipliers; rays of infeasible data
``exchange``    from the first working set to the optimum
``recovery``    multipliers of the maximum principle
``solver``      SpectralSolver, which puts these together; ``tolerances`` are those of all files
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
