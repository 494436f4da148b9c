"""The Fourier-domain method for linear time-invariant problems, as docs/spectral.md derives it.

``model``      the problem in units of order 1, its null spaces at every bin, and kernels of pointwise rows
``kkt``        the bordered KKT system, and the small QPs with it
``rows``       the working set, violated rows, and responses of nearby or of all values without FFTs
``algorithm``  what is kept between solves (``structure``), the first working set, the exchange, rays, multipliers
``solver``     SpectralSolver, which puts these together
"""

from lin_freq_ocp.methods.spectral.reductions import row_form
from lin_freq_ocp.methods.spectral.solver import SpectralSolution, SpectralSolver

__all__ = ["SpectralSolution", "SpectralSolver", "row_form"]
