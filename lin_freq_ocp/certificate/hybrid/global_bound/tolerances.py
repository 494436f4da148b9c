"""Tolerances and sizes of the global bound; only the first group enters what is proven."""

import numpy as np

ROUNDING = 64 * float(
    np.finfo(np.float64).eps
)  # of the absolute terms of a bound, subtracted; boxes widen by this part
FLATNESS = 1e-12  # curvature over the largest, or slope over all of it, below which a direction is flat
SHADOW_WIDENING = 1e-6  # part by which bounds that follow from the cost are widened: far above their rounding errors
FINEST_CELL = 1e-12  # width over the largest state at which a cell is not halved: it consists of rounding errors

MAX_STATES = 3  # the number of cells grows with this power: four states would need hours
MAX_LATTICE = 4_000_000  # entries of a lattice that fit into memory
FIRST_CELLS = {1: 50, 2: 8, 3: 4}  # cells of each state on the first level, by the number of states
FIRST_BOXES = 16  # boxes of the controls of a cell on the first level; the root of it for each of two
CUTOFF_MARGIN = 5e-2  # part of the cost by which the first estimate of the cost-to-come may be too large
FIRST_LOSS = 1e-2  # part of the cost that the first level is expected to lose
STEP_SHARE = 0.25  # part of the gap of a level that all steps together may lose in the search for the least

ROUNDS = 10  # bisections at one time of a level; boxes that are still weak are the next level's work
SMALL_BATCH = 2000  # boxes that are bounded in the time a round needs to start: fewer are cut into four
BOXES_PER_CELL = 100  # boxes bounded at one time of a level, beside SMALL_BATCH
MAX_SPAN = {1: 12, 2: 12, 3: 5}  # cells along a state that an image may meet to be bounded by each, by states
MAX_PAIRS = 400_000  # pairs of boxes and cells bounded at once: some hundred megabytes

ARRIVAL_SAMPLES = 256  # controls at which the cost-to-come is estimated
SAMPLES = 128  # controls at which slopes are estimated
ZOOM_SAMPLES = 25  # controls around the best sample, each time closer
ZOOMS, ZOOMS_TO_END = 2, 5  # refinements; more where a state is met exactly, until its distance is negligible
ARRIVAL_SPREAD = 5  # cells around a sample that count as reached, beside a fortieth of all of them
FIXED_PRICE = 20.0  # multiple of what a stage costs per change of a state, for the distance to where it is fixed
SIDES = {
    1: (-0.999, 0.999),
    2: (0.0,),
    3: (0.0,),
}  # parts of half a cell at which slopes are sampled: kinks in 1-D only
MAX_SLOPE = {
    1: 20.0,
    2: 4.0,
    3: 4.0,
}  # multiple of the median slope, by states: slopes next to infeasible states are poor
RIDGE = 1e-12  # of the squares of all columns: combinations of slopes with less effect stay as they are
