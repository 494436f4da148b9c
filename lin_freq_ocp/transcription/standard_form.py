"""What interior-point methods take: minimise 1/2 z'P z + q'z subject to A z + s = b with s in a product of cones."""

from __future__ import annotations

from dataclasses import dataclass

import scipy.sparse as sp

from lin_freq_ocp.arrays import Array


@dataclass(frozen=True, eq=False)
class StandardForm:
    """Rows in this order: equations (s = 0), inequalities (s >= 0), second-order cones (s_0 >= |(s_1, ...)|).

    Attributes
    ----------
    P : sparse (variables, variables), the upper triangle; q : (variables,)
    A : sparse (rows, variables); b : (rows,)
    equations, inequalities : int
        Numbers of rows.
    cones : tuple of int
        Numbers of rows of each cone.
    """

    P: sp.csc_matrix
    q: Array
    A: sp.csc_matrix
    b: Array
    equations: int
    inequalities: int
    cones: tuple[int, ...]
