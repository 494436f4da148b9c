"""Sets of states and controls at every time, hard or soft, and joint rows of both."""

from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.problem.hybrid.levels import FiniteSet
from lin_freq_ocp.problem.sets.base import Intersection
from lin_freq_ocp.problem.sets.box import Box, Everything, Point
from lin_freq_ocp.problem.sets.convex import Ball, Ellipsoid, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.sets.linked_ends import LinkedEnds, Periodic
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.sets.stage_rows import StageRows

# fmt: off
__all__ = [
    "Ball", "Box", "Ellipsoid", "Everything", "FiniteSet", "Intersection", "LinkedEnds", "PathConstraint", "Periodic",
    "Point", "Polyhedron", "SecondOrderCone", "Soft", "StageRows",
]
# fmt: on

answer_misspelt(globals())
