"""A problem between other ends: what a solve begins with, as affine functions of the fixed end components.

With p = (x_0, x_T) where they are fixed, the spectrum without forces, the right-hand sides of the bordered system, and
all bounded values without multipliers are (value at p = 0) + (one response per component) p: no bin is solved again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray
from lin_freq_ocp.methods.spectral.algorithm.rays import Ray, verified
from lin_freq_ocp.methods.spectral.algorithm.structure import Data, Structure, Unforced, prepare, unforced
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.methods.spectral.rows.violations import Violations
from lin_freq_ocp.methods.spectral.rows.whole_horizon import WholeHorizon

LARGEST = 2500  # bounded values of which all responses are tabulated: 50 MB, in 0.1 s

KEPT_RAYS = 8  # of infeasible problems between other ends


class EndsModel:
    """Data and unforced values for any fixed ends of ``lti``; its bounds are measured by ``violations``."""

    def __init__(self, structure: Structure, lti: Lti, violations: Violations, whole: WholeHorizon):
        self.lti, self.violations, self.whole, self._structure = lti, violations, whole, structure
        self._rays = deque[Ray](maxlen=KEPT_RAYS)
        whole.tabulated = True
        self._fixed = ~np.isnan(np.concatenate([lti.start, lti.end]))
        count, n = int(self._fixed.sum()), lti.state_dim
        data, values = list[Data](), list[Unforced]()
        for p in np.vstack([np.zeros(count), np.eye(count)]):
            ends = np.full(2 * n, np.nan)
            ends[self._fixed] = p
            data.append(prepare(structure, lti.at_points(*np.split(ends, [n]))))
            values.append(unforced(structure, data[-1], violations, whole))
        self.linear = data[0].linear
        self._base = _affine([one.base.view(np.float64) for one in data])
        self._h, self._e = _affine([one.h for one in data]), _affine([one.e for one in data])
        self.step, self.values = _affine([one.step for one in values]), _affine([one.values for one in values])

    def at(self, lti: Lti) -> tuple[Data, Unforced] | None:
        """Return the data between other ends, and the unforced step and values; None if x_T has another set."""
        free = np.isnan(lti.end)
        if not all(
            np.array_equal(mine[free], other[free])
            for mine, other in ((self.lti.last_lower, lti.last_lower), (self.lti.last_upper, lti.last_upper))
        ):
            return None
        p = np.append(1.0, np.concatenate([lti.start, lti.end])[self._fixed])
        h, e, step, values = (p @ part for part in (self._h, self._e, self.step, self.values))
        return Data(lti, self.spectra(p), self.linear, h, e), Unforced(step, values)

    def parameters(self, starts: Array) -> Array:
        """Return (1, p) of initial states (N, n) with the end of ``lti``, (N, 1 + count)."""
        end = self.lti.end[~np.isnan(self.lti.end)]
        return np.hstack([np.ones((len(starts), 1)), starts, np.tile(end, (len(starts), 1))])

    def spectra(self, p: Array) -> ComplexArray:
        """Return the spectrum of y without forces and border variables, (..., n+m, bins), for (1, p)."""
        return np.tensordot(p, self._base, 1).view(np.complex128)

    def keep(self, ray: Ray) -> None:
        """Keep a ray of working rows: whether it proves that a problem is infeasible depends on its ends alone."""
        if len(ray.working):
            self._rays.appendleft(ray)

    def refuting(self, data: Data, known: Unforced) -> Ray | None:
        """Return a kept ray that proves that a problem is infeasible, with the rows' values without multipliers."""
        for ray in self._rays:
            if self._points_at(ray, known.values):
                found = verified(self._structure, data, ray.working, ray.multipliers)
                if found is not None:
                    return found
        return None

    def may_refute(self, values: Array) -> bool:
        """Whether a kept ray probably proves that a problem with these values without multipliers is infeasible."""
        return any(self._points_at(ray, values) for ray in self._rays)

    def _points_at(self, ray: Ray, values: Array) -> bool:
        rows = ray.working
        index = self.whole.flat_indices(rows.t, rows.f)
        return float(rows.weights @ (rows.limits(self.lti) - rows.sign * values[index])) < 0


def ends_model(structure: Structure, lti: Lti) -> EndsModel | None:
    """Return the model, or None where x_0 has free components, or values are many."""
    violations = Violations(lti)
    if np.isnan(lti.start).any() or len(violations.rows) * lti.horizon > LARGEST:
        return None
    whole = structure.whole_horizon(violations.rows)
    return None if whole is None else EndsModel(structure, lti, violations, whole)


def _affine(values: Sequence[Array]) -> Array:
    """Return the value at zero and the responses, (1 + count, ...), from the values at zero and at unit vectors."""
    return np.stack([values[0], *(value - values[0] for value in values[1:])])
