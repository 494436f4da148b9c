"""Piecewise-affine dynamics: x_{t+1} = A_i x_t + B_i u_t + d_i, mode i, where G_i x_t + H_i u_t <= h_i.

The signs of guards G x_t + H u_t - d can also define the modes, a pattern of signs for each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, assign, brief, positive_integer, real_array, with_columns
from lin_freq_ocp.base.errors import NumericalError, ProblemError, located_at, rename_field
from lin_freq_ocp.base.phrases import AT_MOST
from lin_freq_ocp.base.polyhedra import THICKNESS, has_interior
from lin_freq_ocp.formulas.text import Formulas
from lin_freq_ocp.problem.dynamics.base import (
    StandardDynamics,
    Step,
    dimension_words,
    mode_facts,
    mode_labels,
    mode_sequence,
    signal_labels,
    unique_names,
)
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import (
    MODE,
    REGION,
    SIMULATION_ROUNDING,
    AffineMode,
    ModeArrays,
    SmoothPiece,
    linearised_modes,
)
from lin_freq_ocp.problem.hybrid.formula_modes import modes_of
from lin_freq_ocp.problem.hybrid.regions import CheckedRegions, SwitchingFacet, switching_facets
from lin_freq_ocp.problem.sets.stage_rows import StageRows, StageSets

SIGNS = {"+": -1.0, "-": 1.0}  # factors that make a row <= 0 of G x + H u - d
ANY = "*"
GIVEN_AS = {"dynamics.C": "dynamics.G", "dynamics.D": "dynamics.H", "dynamics.e": "dynamics.h"}  # the rows of a region


@dataclass(frozen=True, eq=False)
class _Guards:
    """G (guards, n), H (guards, m) and d (guards,), with time as the first axis if they depend on it."""

    G: Array
    H: Array
    d: Array

    @property
    def count(self) -> int:
        return self.d.shape[-1]

    def region(self, pattern: str) -> dict[str, Array]:
        """Return G, H and h of the region G x + H u <= h of a pattern; nothing if the pattern has no signs."""
        signed = [k for k, sign in enumerate(pattern) if sign != ANY]
        factors = np.array([SIGNS[pattern[k]] for k in signed])
        if not signed:
            return {}
        return {
            "G": factors[:, None] * self.G[..., signed, :] + 0.0,  # and no -0
            "H": factors[:, None] * self.H[..., signed, :] + 0.0,
            "h": factors * self.d[..., signed] + 0.0,
        }

    def occurs(self, pattern: str) -> bool:
        """Whether the points with these signs have an interior at some time."""
        region = self.region(pattern)
        if not region:
            return True
        G, H, h = region["G"], region["H"], region["h"][..., None]
        times = np.broadcast_shapes(*(part.shape[:-2] for part in (G, H, h)))
        rows = np.concatenate([np.broadcast_to(part, (*times, *part.shape[-2:])) for part in (G, H, h)], axis=-1)
        return any(has_interior(at[:, :-1], at[:, -1], THICKNESS) for at in rows.reshape(-1, *rows.shape[-2:]))


def guarded_modes(G: ArrayLike | None, H: ArrayLike | None, d: ArrayLike | None, modes: object) -> list[AffineMode]:
    """Return the modes of ``PiecewiseAffineDynamics.from_guards``: one with its region for every pattern with a map."""
    if not isinstance(modes, Mapping) or not any(mode is not None for mode in modes.values()):
        expected = 'a mapping from signs such as "+-" to modes, of which one at least is not None'
        raise ProblemError("guards.modes", brief(modes), expected)
    maps = {pattern: _map_of_pattern(pattern, stated) for pattern, stated in modes.items()}
    first = next(mode for mode in maps.values() if mode is not None)
    sizes = first.linear.state_dim, first.linear.control_dim
    for pattern, mode in maps.items():
        got = sizes if mode is None else (mode.linear.state_dim, mode.linear.control_dim)
        if got != sizes:
            expected = f"{sizes[0]} and {sizes[1]}, as in the first"
            raise ProblemError(f"guards.modes[{pattern!r}]", dimension_words(*got), expected)
    guards = _guards(G, H, d, *sizes)
    patterns = list(maps)
    for pattern in patterns:
        if not isinstance(pattern, str) or len(pattern) != guards.count or set(pattern) - {*SIGNS, ANY}:
            expected = f'{guards.count} characters "+", "-" or "*", one for each guard'
            raise ProblemError("guards.modes", brief(pattern), expected)
    for first, second in combinations(patterns, 2):  # all signs that occur have exactly one pattern
        pairs = list(zip(first, second, strict=True))
        disjoint = maps[first] is maps[second] or any({*pair} == {*SIGNS} for pair in pairs)
        if not disjoint and guards.occurs("".join(b if a == ANY else a for a, b in pairs)):
            got = f"a pattern that holds together with {first!r}"
            raise ProblemError(f"guards.modes[{second!r}]", got, "one of the two")
    for signs in _without_pattern("", patterns, guards.count):
        if guards.occurs(signs):
            got, expected = f"no pattern for the signs {signs!r}", "a mode for all signs that occur"
            advice = "If they do not occur within the sets of the problem, state None for them."
            raise ProblemError("guards.modes", got, expected, advice)
    modes_with_map = {pattern: mode for pattern, mode in maps.items() if mode is not None}
    names = unique_names([mode.name for mode in modes_with_map.values()])
    return [
        AffineMode(mode.linear.A, mode.linear.B, mode.linear.offset, **guards.region(pattern), name=name)
        for (pattern, mode), name in zip(modes_with_map.items(), names, strict=True)
    ]


def _map_of_pattern(pattern: object, stated: object) -> AffineMode | None:
    """Return the map of a pattern of signs as a named mode without a region."""
    location = f"guards.modes[{pattern!r}]"
    if stated is None:
        return None
    if isinstance(stated, AffineMode):
        if not stated.everywhere:
            raise ProblemError(location, "a mode with its own region", "a mode without one: the signs are its region")
        linear = stated.linear
        return AffineMode(linear.A, linear.B, linear.offset, name=stated.name or str(pattern))
    if not isinstance(stated, (tuple, list)) or len(stated) not in (2, 3):
        raise ProblemError(location, brief(stated), "an AffineMode, (A, B), (A, B, offset), or None")
    with located_at(location, MODE):
        return AffineMode(*stated, name=str(pattern))


def _guards(G: ArrayLike | None, H: ArrayLike | None, d: ArrayLike | None, n: int, m: int) -> _Guards:
    stated = {"G": G, "H": H, "d": d}
    arrays = {field: real_array(f"guards.{field}", value) for field, value in stated.items() if value is not None}
    if not arrays.keys() & {"G", "H"}:
        raise ProblemError("guards.G", "neither G nor H", "at least one of them")
    lead = arrays["G" if "G" in arrays else "H"]
    count = lead.shape[-2] if lead.ndim > 1 else 0
    expected = {"G": (count, n), "H": (count, m), "d": (count,)}
    for field, array in arrays.items():
        shape = expected[field]
        if not count or array.ndim not in (len(shape), len(shape) + 1) or array.shape[-len(shape) :] != shape:
            right = ", ".join(map(str, shape)) if count else f"guards, {shape[-1]}"
            advice = "A single guard is a matrix with one row: [[g_1, g_2, ...]]." if field != "d" else ""
            wanted = f"shape ({right}), one row per guard, or (T, {right}) with one per time"
            raise ProblemError(f"guards.{field}", f"shape {array.shape}", wanted, advice)
    times = {field: len(array) for field, array in arrays.items() if array.ndim > len(expected[field])}
    most = max(times.values(), default=0)
    for field, T in times.items():
        if T != most:
            raise ProblemError(f"guards.{field}", f"{T} times", f"{most}, as many as the longest of G, H, d")
    return _Guards(*(arrays.get(field, np.zeros(shape)) for field, shape in expected.items()))


def _without_pattern(signs: str, patterns: Sequence[str], count: int) -> Iterator[str]:
    """Yield the patterns that begin with these signs and are disjoint from all of ``patterns``."""
    if not patterns:
        yield signs + ANY * (count - len(signs))
    elif not any(set(pattern[len(signs) :]) <= {ANY} for pattern in patterns):
        for sign in SIGNS:
            matching = [pattern for pattern in patterns if pattern[len(signs)] in (sign, ANY)]
            yield from _without_pattern(signs + sign, matching, count)


@dataclass(frozen=True, eq=False, init=False)
class PiecewiseAffineDynamics(StandardDynamics):
    """x_{t+1} = A_i x_t + B_i u_t + d_i in the region of mode i.

    Regions may overlap on switching boundaries only, which a problem checks. They may leave gaps: a trajectory outside
    all regions is infeasible, and ``problem.gap`` is a point of a gap. On a switching boundary where the map jumps, an
    optimiser may choose either mode, and a simulation takes the first one.

    Parameters
    ----------
    modes : sequence of AffineMode
        At least one, with the same numbers of states and controls.
    sampling_time : float, optional
        Seconds per step. Needed wherever a frequency is given in Hz.
    state_names, control_names : sequences of str, optional
        One name per component, with its unit in brackets: ``"position [m]"``.

    Raises
    ------
    ProblemError
        If there is no mode, or their dimensions differ.

    Methods
    -------
    from_guards(...)
        Modes from the signs of guards.
    from_formulas(...)
        Modes from maxima and minima of affine functions.
    sequence_of(x, u)
        The mode of every time along a trajectory.
    along(sequence)
        The linear dynamics of one mode sequence.

    Examples
    --------
    >>> right, left = (lfo.AffineMode([[a]], [[1.0]], G=[[g]], h=[0.0]) for a, g in ((0.5, -1.0), (-0.5, 1.0)))
    >>> len(lfo.PiecewiseAffineDynamics([right, left]).modes)
    2
    """

    modes: tuple[AffineMode, ...]
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]

    def __init__(
        self,
        modes: Sequence[AffineMode],
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ):
        if not isinstance(modes, Sequence) or not modes:
            raise ProblemError("dynamics.modes", brief(modes), "a list of at least one AffineMode")
        for i, mode in enumerate(modes):
            if not isinstance(mode, AffineMode):
                raise ProblemError(f"dynamics.modes[{i}]", brief(mode), "an AffineMode")
        n, m = modes[0].linear.state_dim, modes[0].linear.control_dim
        for i, mode in enumerate(modes):
            got = mode.linear.state_dim, mode.linear.control_dim
            if got != (n, m):
                raise ProblemError(f"dynamics.modes[{i}]", dimension_words(*got), f"{n} and {m}, as in the first")
        assign(self, modes=tuple(modes), **signal_labels(n, m, sampling_time, state_names, control_names))
        _ = self.mode_names  # all different

    @classmethod
    def from_formulas(
        cls,
        f: Formulas,
        state_dim: int,
        control_dim: int,
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> PiecewiseAffineDynamics:
        """Make the modes of x_{t+1} = f(x_t, u_t) with maxima and minima of affine functions, one a choice.

        Parameters
        ----------
        f : sequence of Formula, or function
            A formula for each state, made of ``signals(n, m)`` by sums, multiples, ``abs``, ``maximum`` and
            ``minimum``; a number is a constant. Or a function of (x, u) that returns them.
        state_dim, control_dim : int
            n and m.
        sampling_time, state_names, control_names
            As for the class.

        Returns
        -------
        PiecewiseAffineDynamics
            A continuous map; regions have no redundant rows. Choices with the same map whose union is a polyhedron are
            one mode.

        Raises
        ------
        ProblemError
            If a formula is not affine within a mode, the number of formulas is not n, or there are more than
            ``MOST_PIECES`` (256) choices.
        """
        dimensions = positive_integer("state_dim", state_dim), positive_integer("control_dim", control_dim)
        return cls(modes_of(f, dimensions, state_names, control_names), sampling_time, state_names, control_names)

    @classmethod
    def from_guards(
        cls,
        G: ArrayLike | None,
        H: ArrayLike | None,
        d: ArrayLike | None,
        modes: Mapping[str, object],
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> PiecewiseAffineDynamics:
        """Make the modes from the signs of guards G x_t + H u_t - d; at zero both signs hold.

        Parameters
        ----------
        G : (guards, n) or (T, guards, n), H : (guards, m) or (T, guards, m), d : (guards,) or (T, guards)
            One of G and H may be None, and d may be None: zeros.
        modes : mapping from str to AffineMode, (A, B), (A, B, offset), or None
            A mode for each pattern of signs, which has a character per guard: "+" (zero or above), "-" (zero or below)
            or "*" (any). The first is mode 0. An AffineMode has a name and no region; other modes get their pattern as
            a name. None: no mode, a gap between the regions.
        sampling_time, state_names, control_names
            As for the class.

        Raises
        ------
        ProblemError
            If shapes do not match, a pattern has other characters, two patterns overlap, or signs that occur have none.
        """
        return cls(guarded_modes(G, H, d, modes), sampling_time, state_names, control_names)

    @classmethod
    def linearised(
        cls,
        pieces: Sequence[SmoothPiece],
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> PiecewiseAffineDynamics:
        """Linearise nonlinear models, each at its own point and with its own region: one mode for each.

        The linearised map may jump where the models are continuous: ``problem.borders`` says by how much. It is
        continuous across a switching boundary if both models are linearised at the same point of it, agree there, and
        the facet is tangent to the surface on which they agree. The mode at the start of a period holds over it.

        Parameters
        ----------
        pieces : sequence of SmoothPiece
        sampling_time : float, optional
            Seconds per step; required for continuous models. It must agree with that of discrete ones.
        state_names, control_names : sequences of str, optional
            Default: the labels of the first model.

        Raises
        ------
        ProblemError
            If shapes or sampling times do not match, or a model has no value or derivatives at its point.
        """
        modes, first = linearised_modes(pieces, sampling_time)
        names = state_names or first.state_names, control_names or first.control_names
        return cls(modes, first.sampling_time, *names)

    @property
    def mode_names(self) -> tuple[str, ...]:
        """Return the name of every mode."""
        return mode_labels(mode.name for mode in self.modes)

    @cached_property
    def time_varying(self) -> bool:
        """Whether any map or region depends on time."""
        maps_vary = any(mode.linear.time_varying or mode.linear.offset.ndim > 1 for mode in self.modes)
        return maps_vary or self.regions_vary

    @cached_property
    def regions_vary(self) -> bool:
        """Whether any region depends on time."""
        return any(mode.region.time_varying or mode.region.e.ndim > 1 for mode in self.modes)

    @cached_property
    def _regions_within_sets(self) -> CheckedRegions:
        """The faults of the regions within sets that are known so far."""
        return CheckedRegions(self.mode_names, not self.regions_vary)

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the number of modes, their names, and that they are affine."""
        return mode_facts(self.mode_names, f"an affine map in each, where G x + H u {AT_MOST} h")

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless data per time have ``horizon`` steps."""
        for i, mode in enumerate(self.modes):
            with located_at(f"dynamics.modes[{i}]", "dynamics"), rename_field(lambda field: GIVEN_AS.get(field, field)):
                mode.linear.require_horizon(horizon)
                mode.region.at_dimensions(self.state_dim, self.control_dim, horizon, "dynamics")

    def require_sets(self, sets: StageSets) -> None:
        """Raise ProblemError unless the regions overlap on switching boundaries only within the sets."""
        if REGION in sets.names:
            raise ProblemError("stage_rows", f"rows named {REGION!r}", "another name: modes have rows of that name")
        self._regions_within_sets.require_apart(self.arrays(sets.horizon), sets)

    def gap(self, sets: StageSets) -> str | None:
        """Return a point of the sets outside all regions, in words; None if the regions cover the sets."""
        return self._regions_within_sets.gap(self.arrays(sets.horizon), sets)

    def borders(self, sets: StageSets) -> tuple[SwitchingFacet, ...]:
        """Return the switching boundaries within the sets."""
        return switching_facets(self.arrays(sets.horizon), sets, self.time_varying)

    @cached_property
    def _arrays_of_horizons(self) -> dict[int, ModeArrays]:
        """The modes at all times that are known so far: a search, the judge and each step of a loop ask for them."""
        return {}

    def arrays(self, horizon: int) -> ModeArrays:
        """Return all modes at all times; constant data are stored once."""
        if horizon in self._arrays_of_horizons:
            return self._arrays_of_horizons[horizon]
        n, m = self.state_dim, self.control_dim
        regions = [mode.region.at_dimensions(n, m, horizon, "dynamics") for mode in self.modes]
        most = max(region.rows for region in regions)

        def stack_modes(parts: Sequence[Array], ndim: int) -> Array:
            per_time = [part if part.ndim > ndim else part[None] for part in parts]
            times = max(len(part) for part in per_time)
            once = np.stack([np.broadcast_to(part, (times, *part.shape[1:])) for part in per_time], axis=1)
            return np.broadcast_to(once, (horizon, *once.shape[1:]))

        def pad_rows(part: Array, axis: int, value: float) -> Array:
            width = [(0, 0)] * part.ndim
            width[axis] = (0, most - part.shape[axis])
            return np.pad(part, width, constant_values=value)

        arrays = self._arrays_of_horizons[horizon] = ModeArrays(
            A=stack_modes([mode.linear.A for mode in self.modes], 2),
            B=stack_modes([mode.linear.B for mode in self.modes], 2),
            offset=stack_modes([mode.linear.offset for mode in self.modes], 1),
            G=stack_modes([pad_rows(region.C, -2, 0.0) for region in regions], 2),
            H=stack_modes([pad_rows(region.D, -2, 0.0) for region in regions], 2),
            h=stack_modes([pad_rows(region.e, -1, np.inf) for region in regions], 1),
            least=(np.zeros(n), np.zeros(m)),
        )
        return arrays

    def gains(self) -> tuple[Array, Array, Array]:
        """Return the largest |A| (n, n), |B| (n, m) and |d| (n,) over modes and times."""
        parts = [mode.linear.gains() for mode in self.modes]
        A, B, d = (np.max([part[k] for part in parts], axis=0) for k in range(3))
        return A, B, d

    def along(self, sequence: Indices) -> LinearDynamics:
        """Return the time-varying linear dynamics of a mode sequence (T,)."""
        arrays, times = self.arrays(len(sequence)), np.arange(len(sequence))
        A, B, offset = (part[times, sequence] for part in (arrays.A, arrays.B, arrays.offset))
        return LinearDynamics(A, B, offset, self.sampling_time, self.state_names, self.control_names)

    def with_modes(self, sequence: ArrayLike, horizon: int) -> tuple[LinearDynamics, StageRows]:
        """Return the linear dynamics of a mode sequence (T,), checked, and the rows of its regions."""
        modes = mode_sequence("sequence", sequence, horizon, len(self.modes))
        return self.along(modes), self.region_rows(modes)

    def linear_at(self, x: Array, u: Array) -> LinearDynamics:
        """Return the linear dynamics of the modes along a trajectory."""
        return self.along(self.sequence_of(x, u))

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> PiecewiseAffineDynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t."""
        modes = list[AffineMode]()
        for mode in self.modes:
            linear, region = mode.linear.augmented(A, B, names, horizon), mode.region
            G = with_columns(region.C, len(A))
            modes.append(AffineMode(linear.A, linear.B, linear.offset, G, region.D, region.e, mode.name))
        return PiecewiseAffineDynamics(modes, self.sampling_time, [*self.state_names, *names], self.control_names)

    def translated(self, origin: Array, horizon: int) -> PiecewiseAffineDynamics:
        """Return the dynamics of x - origin, with the same modes."""
        return replace(self, modes=[mode.translated(origin, horizon) for mode in self.modes])

    def averaged(self, weights: Array) -> LinearDynamics:
        """Return sum_i alpha_{t,i} (A_i, B_i, d_i), the element of Clarke's Jacobian with the weights (T, modes)."""
        arrays = self.arrays(len(weights))
        A, B = (np.einsum("tk,tkij->tij", weights, part) for part in (arrays.A, arrays.B))
        offset = np.einsum("tk,tki->ti", weights, arrays.offset)
        return LinearDynamics(A, B, offset, self.sampling_time, self.state_names, self.control_names)

    def region_rows(self, sequence: Indices) -> StageRows:
        """Return the rows G x_t + H u_t <= h of the regions of a mode sequence (T,)."""
        arrays, times = self.arrays(len(sequence)), np.arange(len(sequence))
        G, H, h = (part[times, sequence] for part in (arrays.G, arrays.H, arrays.h))
        return StageRows(G, H, h, REGION)

    def sequence_of(self, x: Array, u: Array) -> Indices:
        """Return the mode at every time, (T,): of the modes that hold, the one with the image nearest to x_{t+1}.

        If no mode holds, the one with the nearest region; x is (T+1, n), u is (T, m). See ``ModeArrays.sequence``.
        """
        return self.arrays(len(u)).sequence(x, u)

    def stepper(self, horizon: int) -> Step:
        """Return the function from t, x_t (n,) and u_t (m,) to x_{t+1}, by the first mode that holds there.

        It raises NumericalError outside all regions; after a state that is not finite it returns NaN.
        """
        arrays = self.arrays(horizon)
        limits = np.where(np.isfinite(arrays.h), np.abs(arrays.h), 0.0)

        def step(t: int, x: Array, u: Array) -> Array:
            excess = arrays.G[t] @ x + arrays.H[t] @ u - arrays.h[t]
            size = np.abs(arrays.G[t]) @ np.abs(x) + np.abs(arrays.H[t]) @ np.abs(u) + limits[t]
            holds = (excess <= SIMULATION_ROUNDING * size).all(axis=1)
            if not np.isfinite(x).all():
                return np.full_like(x, np.nan)
            if not holds.any():
                raise NumericalError(
                    f"No mode of the dynamics holds at t = {t}, x = {brief(x.tolist())}, u = {brief(u.tolist())}: "
                    "it lies outside all regions."
                )
            i = int(np.argmax(holds))
            return arrays.A[t, i] @ x + arrays.B[t, i] @ u + arrays.offset[t, i]

        return step
