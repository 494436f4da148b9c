"""Numerical tolerances of the Fourier-domain method, in its own units of order 1."""

# Spaces of the bins (model.py, spaces.py)
LEAST_SIZE = 1e-4  # components that should be zero hold rounding: they are not measured more finely than this
WRONG_UNIT = 1e-5  # largest value of a component, in its unit, below which that unit was wrong
ROUNDED_COMPONENT = 1e-13  # largest value below which a component holds rounding only
MUCH_LARGER = 30.0  # factor between a component's stated size and other evidence of it from which the evidence counts
NEAR_RESOLVENT = 1e2  # size of the resolvent from which a bin is near an eigenvalue: dividing loses two digits
NEAR_RADIUS = 0.3  # distance to an eigenvalue beyond which a bin is far, however large the resolvent
# Relative singular value of F_k below which its direction may become a bordering unknown ...
SMALL_SINGULAR_VALUE = 1e-5
LEAST_DIVISOR = 1e-11  # ... and below which it always does: fewer than five digits of it are known
# ... unless the distance to every eigenvalue, times T, is above this: |1 - (lambda / z)^T| is then of order 1, or
# |lambda| is far from 1 in T steps, and a jump leaves a response of its own size. Few bins per eigenvalue are nearer.
RESOLVED_PHASE = 10.0
ZERO_SINGULAR_VALUE = 1e-13  # relative singular value that is rounding; as a number it would decide the answer
SMALL_HESSIAN = 1e-4  # cost of a null direction, relative to a control's, below which it may be a bordering unknown ...
LEAST_HESSIAN = 1e-10  # ... and below which it always does
SINGULAR_HESSIAN = 1e-13  # relative eigenvalue of N^*MN at which the cost does not see a direction: refused

# Bordered KKT system (kkt.py)
NULL_EQUATION = 1e-12  # relative singular value of the equations that is rounding of 0
EQUATION_ROUNDING = 1e-13  # relative eigenvalue of S_E that is rounding of 0
COMPLIANT_RESPONSE = 1e11  # response of a bordering unknown to a force, relative to a control's, from which it is kept
COMPLIANT_END = 1e8  # the same for free ends, which move all signals
HESSIAN_ROUNDING = 1e-15  # curvature of a bordering unknown, relative to the largest, that may be rounding
SHORTEST_PROXIMAL = 1e-16  # smallest proximal weight on compliant unknowns, relative to the curvature of a control

# Small QPs, scaled to order 1 (qp.py)
TINY = 1e-300  # keeps quotients of exact zeros finite
QP_RIDGE = 1e-13  # added to the diagonal: dependent rows and equations then share their multipliers
DECIDED_SOFT = 1e-13  # part of a soft row's own response left by the equations that is rounding of zero
PIVOTING_PIVOT = 1e-6  # Cholesky pivot below which rows are too dependent for block pivoting
WRONG_SLOPE = 1e-13  # slope below which a row without multiplier is wrong
INTERIOR_SOLVED = 1e-13  # defect and complementarity at which the interior point stops
INTERIOR_ACCURATE = 1e-8  # ... and up to which its answer is accurate
DIVERGED_ERROR = 1e3  # growth of that error over the best one at which it stops
INTERIOR_RIDGE = 1e-14  # added to its diagonal, which is near 1; a hundred times as much where a factorisation fails
LARGEST_RIDGE = 1e-8  # ridge at which it stops
HOLDING_DIAGONAL = 1e14  # diagonal that holds a row at zero in its polish
RANK_TOLERANCE = 3e-15  # pivot at which the rank of diag - A is exhausted
LOW_RANK_ERROR = 1e-10  # diagonal that a thin factor may miss; with more, diag - A has negative eigenvalues
BORDERED_SOLVED = 1e-12  # defects and complementarity at which the bordered interior point stops ...
# ... and complementarity alone, as the cost may be small at that scale. Further steps lose digits of the equations: at
# 1e-16, one of 900 random problems ends with residuals of 1e-6.
BORDERED_COMPLEMENTARY = 1e-14
BORDERED_ACCURATE = 1e-7  # error up to which its answer is accurate
SHORTEST_STEP = 1e-8  # step length at which it stops
ACTIVE_SIGN = 1e-11  # weight of an active row, relative to the largest, that may be negative by rounding
POLISHED_SLACK = 1e-10  # violation of a row up to which a polished answer counts
IDLE_WEIGHT = 1e-9  # weight, relative to slacks and weights, that it leaves on inactive rows

# Exchange (exchange.py)
VIOLATION_TOLERANCE = 1e-12  # relative violation of a bound at which it stops; rounding of the signals is near 1e-15
FINE_VIOLATION = 1e-9  # ... above which a round that adds a row improves, even if it does not halve the violation
ACCEPTED_VIOLATION = 1e-7  # ... that is accepted where it no longer improves
NEARLY_FEASIBLE = 1e-3  # ... below which longer steps are taken along directions without cost
EQUATION_TOLERANCE = 1e-9  # residual of the bordered system's equations, relative to the largest signal
EQUATION_CONFLICT = 1e-7  # ... from which the dependent equations are tested for infeasibility
SLOPE_TOLERANCE = 1e-10  # slope left in the bordering unknowns, relative to its terms
ACCEPTED_SLOPE = 1e-7  # ... that is accepted where it no longer improves
SLACK_TOLERANCE = 1e-9  # <multipliers, slacks> left, relative to the cost
ACCEPTED_SLACK = 1e-7  # ... that is accepted where it no longer improves
GAIN_TOLERANCE = 1e-15  # possible decrease of the cost along the bordering unknowns, relative to it
DECREASE_TOLERANCE = 1e-9  # ... by moves as large as the point: flat directions promise any gain by rounding
SMALL_COST = 1e-6  # least cost that decreases are relative to, as a part of that of states and controls of order 1
DIVERGING_WEIGHT = 1e6  # weight of a row from which the rows are tested for infeasibility
UNBOUNDED_SIZE = 1e10  # size of a bordering unknown at which the cost has no lower bound
SHORT_TOLERANCE, HOLD_TOLERANCE = 1e-6, 1e-4  # violations at which the cheaper problems of the first set stop

# Rays (structure.py)
RAY_TOLERANCE = 1e-6  # stationarity of a ray, relative to its multipliers
ACCEPTED_RAY = 1e-5  # ... that is accepted if the exchange no longer improves
RAY_VALUE = 100.0  # times that, its least value: less may be rounding
DECIDED_RESPONSE = 1e-11  # part of a row's own response left by the equations below which they alone decide the row
DECIDED_VIOLATION = 1e-8  # violation, relative to the bound, of a row that the equations decide
CONFLICT_TAU = 1e-4  # tau of the homogeneous dual (1: rows are consistent, 0: they conflict) below which they conflict
TINY_SQUARED = 1e-150  # keeps the scale of a violation of exactly zero finite when squared
