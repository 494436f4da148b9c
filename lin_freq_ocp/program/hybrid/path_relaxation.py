"""Path relaxations (paths.py) of a problem, and the way back from their solutions to trajectories and multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.hybrid.mode_reach import UNBOUNDED, Reach
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, PathMultipliers
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.path_bounds import PathBounds, PathDuals
from lin_freq_ocp.program.hybrid.paths import PathModel, PathProgram, path_program
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import symmetric_roots

# With more modes, nodes with more edges per time than these are solved by shares of modes: that takes less time
MOST_MODES, MOST_EDGES = 4, 8


@dataclass(frozen=True, eq=False)
class PathMember:
    """The path relaxation of one reach: its edges (T, modes, modes), boxes (T+1, modes, k), and the program, if any."""

    reach: Reach
    pairs: Mask
    low: Array
    high: Array
    program: PathProgram | None


class PathRelaxation(ModeRelaxation):
    """The relaxations of one problem as paths; those of its base where that is not possible."""

    images = True  # whether the image of an edge has to lie in the box of the mode that follows

    @cached_property
    def _paths(self) -> tuple[PathModel, PathBounds] | None:
        parts, stages = self._lagrangian, self._stages
        T, _, n, k = stages.maps.shape
        if parts is None:
            return None
        hessians = np.zeros((T + 1, k, k))
        hessians[:-1], hessians[-1, :n, :n] = parts.hessians, parts.last

        def with_end(part: Array, filled: float = 0.0) -> Array:
            return np.concatenate([part, np.full((1, *part.shape[1:]), filled)])

        model = PathModel(
            maps=with_end(stages.maps),
            offsets=with_end(stages.offsets),
            rows=with_end(stages.rows),
            limits=with_end(stages.limits, np.inf),
            roots=symmetric_roots(hessians),
            price=parts.price,
            coupled=parts.rows,
            right=parts.right,
            images=self.images,
        )
        return model, PathBounds(model, hessians)

    def path_member(self, reach: Reach) -> PathMember | None:
        """Return the path relaxation of a reach; None where ``member`` has to do."""
        found = None if self._paths is None else self._boxes(reach)
        if self._paths is None or found is None:
            return None
        pairs, low, high = found
        (T, modes), edges = reach.allowed.shape, np.count_nonzero(pairs)
        if modes > MOST_MODES and edges > MOST_EDGES * T:
            return None
        return PathMember(reach, pairs, low, high, path_program(self._paths[0], pairs, low, high))

    def _boxes(self, reach: Reach) -> tuple[Mask, Array, Array] | None:
        """Return the edges (T, modes, modes) and boxes (T+1, modes, k) of a reach; None where a box has no end."""
        taken = reach.allowed[..., None]
        unbounded = taken & ((reach.mode_lower <= -UNBOUNDED) | (reach.mode_upper >= UNBOUNDED))
        if self._paths is None or unbounded.any():
            return None
        (T, modes), (n, stages) = reach.allowed.shape, (self._n, self._stages)
        allowed = np.zeros((T + 1, modes), dtype=bool)
        allowed[:-1], allowed[-1, 0] = reach.allowed, True
        low, high = np.zeros((2, T + 1, modes, len(stages.units)))
        for part, inner, last in ((low, reach.mode_lower, reach.lower), (high, reach.mode_upper, reach.upper)):
            part[:-1] = np.where(taken, stages.scaled(inner), 0.0)
            part[-1, 0, :n] = (last[-1] - stages.last_reference) / stages.units[:n]
        if (np.abs(low) >= UNBOUNDED).any() or (np.abs(high) >= UNBOUNDED).any():
            return None
        return self._paths[0].pairs(allowed, low, high), low, high

    def later(self, duals: PathDuals) -> PathDuals:
        """Return duals moved to the time before, for the problem that begins one time later."""
        assert self._paths is not None
        return self._paths[1].later(duals)

    def proven_by(self, reach: Reach, duals: PathDuals) -> float:
        """Return what any duals prove of a reach: as a bound on the cost, inf if that it has no trajectory."""
        found = self._boxes(reach)
        if self._paths is None or found is None:
            return -np.inf
        bound = self._paths[1].bound(*found, duals)
        if duals.eta_C:
            return self.cost(bound)
        return np.inf if bound > 0 else -np.inf

    def path_duals(self, program: PathProgram, p: Array, z: Array, w: Array | None) -> PathDuals:
        """Return the duals of C w = b and of linear rows, (E, R), with the weights of w (E, W), or those of a ray."""
        T, modes = self._stages.limits.shape[:2]
        (edges, k), n = program.middle.shape, self._n
        t, i, j = program.t[:-1], program.i[:-1], program.j[:-1]
        of_edges = p[program.places[:-1, n + 1 : -1]]
        weights = np.ones(edges - 1) if w is None else np.maximum(w[:-1, -2], 0.0)
        vertices, adjoint, total = np.zeros((T, modes, n)), np.zeros((T, n)), np.zeros(T)
        vertices[t, j] = of_edges
        np.add.at(adjoint, t, weights[:, None] * of_edges)
        np.add.at(total, t, weights)
        of_rows = np.where(program.present, np.maximum(z, 0.0) / program.sizes, 0.0)
        regions, images = np.zeros((T, modes, modes, self._stages.limits.shape[2])), np.zeros((T, modes, modes, n))
        regions[t, i, j] = of_rows[:-1, 2 * k : -2 * n]
        images[t, i, j] = of_rows[:-1, -n:] - of_rows[:-1, -2 * n : -n]
        adjoint /= np.where(total > 0, total, 1.0)[:, None]
        return PathDuals(vertices, regions, images, p[program.vertex_rows :], adjoint, 0.0 if w is None else 1.0)

    def no_path(self) -> PathDuals:
        """Return the duals of modes that no path leads through."""
        T, modes, n, _ = self._stages.maps.shape
        parts = self._lagrangian
        return PathDuals(
            vertices=np.zeros((T, modes, n)),
            regions=np.zeros((T, modes, *self._stages.limits.shape[1:])),
            images=np.zeros((T, modes, modes, n)),
            coupled=np.zeros(0 if parts is None else len(parts.right)),
            adjoint=np.zeros((T, n)),
            eta_C=0.0,
        )

    def path_bound(self, member: PathMember, duals: PathDuals) -> float:
        """Return what duals prove: a bound on the cost; above zero, for eta_C = 0, that there is no trajectory."""
        assert self._paths is not None
        found = self._paths[1].bound(member.pairs, member.low, member.high, duals)
        return self.cost(found) if duals.eta_C else found

    def path_point(self, program: PathProgram, w: Array) -> tuple[Trajectory, Array]:
        """Return (x, u) and the weights of modes, (T, modes), of variables (E, W)."""
        T, modes = self._stages.limits.shape[:2]
        y, weights = np.zeros((T + 1, program.middle.shape[1])), np.zeros((T + 1, modes))
        np.add.at(y, program.t, program.middle * w[:, -2:-1] + program.half * w[:, :-2])
        np.add.at(weights, (program.t, program.i), w[:, -2])
        y *= self._stages.units
        y[:-1] += self._stages.references
        x = np.vstack([y[:-1, : self._n], y[-1:, : self._n] + self._stages.last_reference])
        return Trajectory(x, y[:-1, self._n :]), weights[:-1]

    def path_multipliers(self, duals: PathDuals) -> ModeMultipliers:
        """Return the multipliers of the duals of a path member."""
        sides = np.zeros(len(self._sides.b))
        sides[: len(duals.coupled)] = duals.coupled
        own = self._own_multipliers(sides, duals.adjoint, duals.eta_C)
        moved = duals.vertices - duals.adjoint[:, None]
        moved[-1] = 0.0  # a single vertex: its adjoint is the average
        units = self._adjoint_units
        region = duals.regions / self._stages.norms[:, :, None] / self._scaling.cost
        return ModeMultipliers(
            own, region, PathMultipliers(moved * units[:, None], duals.images * units[:, None, None])
        )

    def path_adjoint(self, duals: PathDuals) -> Array:
        """Return eta alone, (T, n)."""
        return duals.adjoint * self._adjoint_units
