"""Tolerances of the judge. All are relative, and none depends on the units of a problem."""

import sys

# Satisfied conditions
CONDITION_TOLERANCE = 1e-6  # residual over scale: good solvers reach 1e-9, a wrong sign or row gives 1e-3 or more
PEAK_TOLERANCE = 5e-7  # |V|/l - 1 at every frequency: a violation of 1e-6 fails; exchange ends at 1e-9 to 4e-7
GAP_TOLERANCE = 1e-6  # (J - D)/S up to which a feasible point is called globally optimal
TRIVIALITY = 1e-9  # multipliers below this part of the largest of a set or row are rounding
MAXIMISATION_REACH = 10.0  # sizes of the controls within which the Hamiltonian, which is concave, is maximised

# Sizes and scales
SCALE_FLOOR = 1e-4  # part of the size of a component below which its values are rounding errors
INSIGNIFICANT_GAIN = 1e-14  # entries of a row of [A, B] below this part of its largest are rounding
ZERO_COMPONENT = 1e-20  # components that are nowhere larger are zero, as bounds of 1e20 and more are none
DATA_ROUNDING = (
    1e-12  # deviations, relative to sizes, that solvers and printed data leave; gaps below their cost do not count
)

COST_ROUNDING = 160 * sys.float_info.epsilon  # of J: ten times what a rigorous bound loses to rounding
HESSIAN_ROUNDING = 4 * sys.float_info.epsilon  # of entries of Q, R, S, P: these may be products of rounded data
STATE_ROUNDING = 4 * sys.float_info.epsilon  # of x and of A x + B u + d, relative to their terms

# Bounds
ARITHMETIC_ROUNDING = 16 * sys.float_info.epsilon  # of a few operations in double precision, relative to their terms
EIGENVALUE_ERROR = 1e-12  # by which a computed smallest eigenvalue of a correlation matrix may be too large
NUMERICAL_REACH = 10.0  # sizes of an unbounded component that a merely numerical bound covers
RADIUS_MARGIN = 1.0 + 1e-9  # factor by which computed radii are enlarged to cover their own rounding
INVERSE_TOLERANCE = 1e-9  # error of a left inverse that counts as one; RADIUS_MARGIN covers it
MOST_BENT = 0.5  # part of the curvature that rounding below zero elsewhere may take away; RADIUS_MARGIN covers its own
NEGLIGIBLE_SHARE = 1e-2  # part of a tolerance up to which residuals, or losses of stated bounds, need no closer look
MAX_STEPS = 20_000  # horizon up to which radii are computed step by step, at 0.1 ms each
MAX_UNKNOWN = 1000  # components whose radii are computed at once, by a dense matrix, in a second

# Interval arithmetic over modes
INFINITE = 1e100  # replaces infinity in intervals: its product with zero is zero
FINITE = 1e90  # larger interval ends stem from INFINITE
INTERVAL_ROUNDING = 1e-13  # of the absolute terms of a sum, by which intervals widen: 100 times that of 10 terms

# Printed trajectories
MAX_DECIMALS = 8  # numbers with more are not rounded
MIN_ROUNDED = 4  # nonzero values below which few decimals are chance
