"""The Fourier-domain method for linear time-invariant problems, as docs/spectral.md derives it.

With y_t = (x_t, u_t), t < T, as one period of a signal, the dynamics are one small linear system at each bin k. What
couples bins and times (ends, bounds) acts on it by few forces. A round of the exchange solves the small QP, transforms,
and adds the rows that the signals violate:

    min 1/2 l'S l + delta'l over l >= 0              multipliers l of the working rows G y <= limit
    K (theta, zeta) = (-h_theta, e - E_y c) - C l    unknowns theta and multipliers zeta of the equations
    y_k = c_k - N_k N_k^* g_k + Y_k theta            each bin responds to the forces g = G'l + E_y'zeta

Letters mean the same in all files:

t, k              times 0 .. T, and bins 0 .. T/2 of the DFT; z = exp(2 pi i k / T)
n, m, w           numbers of states and controls; the jump x_0 - x_T, which closes the period
A, B, d           dynamics x_{t+1} = A x_t + B u_t + d_t
M, h; P, p        Hessian and linear terms of the stage cost in y_t; of the end's in x_T
F, f              matrix of the bounds and joint rows on y_t; a row of it: (t, f) is the value F_f y_t, and at t = T the
                  component f of x_T
D_k, N_k, D_k^+   [z I - A, -B_passed]: the dynamics are D_k y_k = z w + d_k; its null space, with N_k^* M N_k = I, and
                  its particular response; D_k = U diag(sigma) V^*
c_k               the signals without forces and theta, D_k^+ (z w + d_k) - N_k N_k^* h_k (``Data.base``)
kappa_fg          kernel: decrease of F_f y_t by a unit force on F_g y_s, as a function of t - s
theta, Y_k        bordering unknowns (free ends, directions of near bins); the signals that they add
E_y, E, e, zeta   equations E_y y + E_theta theta = e; E = E_theta + E_y Y, and their multipliers
H, h_theta        Hessian and gradient of the cost in theta
G, l              working rows G y <= limit, each sign F_f y_t, and their multipliers (``weights`` in the code)
S_E, S_W          decrease of the equations by unit forces on them, E_y N N^* E_y'; of the working rows, G N N^* G'
K, C              the bordered KKT matrix [[H, E'], [E, -S_E]]; the coupling of the working rows to theta and zeta
S, delta          S_W + C'K^{-1} C, the decrease with theta and zeta eliminated; the slacks are S l + delta
mu, nu, eta, rho  multipliers of the maximum principle; mu = sign l

A Lagrange multiplier is a force on the signals. A unit force lowers the value that it acts on: kernels, S_E and S_W
are decreases, and K has -S_E.

The main line, each file on those above it. Comments say where a first reader may stop in a file:

``model``       the problem in units of order 1 (Lti), with time as the last axis
``spaces``      at every bin N_k, and D_k^+; the kernels
``kkt``         theta, the equations E, and K
``rows``        pointwise rows: how far they are violated, and the working set with C, limits and l
``qp``          the small QP
``structure``   Structure: all that does not depend on data. Data: y_k from theta, zeta and l; rays of infeasible data
``exchange``    the rounds: small QP, signals, new rows
``recovery``    multipliers of the maximum principle
``solver``      SpectralSolver

Two may be left aside at first: ``shortcuts`` saves time in the exchange, and ``reductions`` makes problems with
polyhedral sets and soft constraints such as ``model`` takes.
"""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "exchange": "Exchange deadline first_working_set", "kkt": "LARGEST_BORDERED", "recovery": "recover",
    "model": "Lti LtiUnits lti_problem natural_units", "reductions": "SoftBounds priced_bounds row_form soft_bins",
    "qp": "BorderedQp PIVOTING_STEPS RowQp STEPS_OF_ALL block_pivoting bounded_qp interior_point predictor_corrector",
    "rows": "Rows Violations WorkingSet", "spaces": "BinSpaces CirculantKernels SMALL_TABLE",
    "shortcuts": "NEIGHBOURHOOD_HORIZON", "structure": "Data MOST_VALUES Structure WholeHorizon verified_ray",
})
