"""Linear dynamics x_{t+1} = A_t x_t + B_t u_t + d_t (paper, eq. (sys_dynamics))."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    assign,
    brief,
    largest_over_time,
    positive_number,
    real_array,
    times_vectors,
    to_long_double,
    with_columns,
    with_fields,
    with_products,
    with_rows,
)
from lin_freq_ocp.base.errors import ProblemError, located_at
from lin_freq_ocp.base.names import index_of_name
from lin_freq_ocp.base.phrases import datum, plural
from lin_freq_ocp.problem.dynamics.base import Dynamics, StateEquations, Step, signal_labels
from lin_freq_ocp.problem.dynamics.linearisation import ControlSystem, Labels, clock, linearisation, state_equation
from lin_freq_ocp.problem.dynamics.measured import plant_in_mat
from lin_freq_ocp.problem.dynamics.plant import ContinuousPlant


@dataclass(frozen=True, eq=False, init=False)
class LinearDynamics(StateEquations):
    """Linear dynamics x_{t+1} = A_t x_t + B_t u_t + d_t, t = 0 .. T-1.

    Parameters
    ----------
    A : (n, n) or (T, n, n)
        State matrix, or one per time.
    B : (n, m) or (T, n, m)
        Control matrix, or one per time.
    offset : (n,) or (T, n), optional
        The known term d_t.
    sampling_time : float, optional
        Seconds per step. Needed wherever a frequency is given in Hz.
    state_names, control_names : sequences of str, optional
        One name per component, with its unit in brackets: ``"position [m]"``.
    plant : ContinuousPlant, optional
        The continuous model of the first states, as ``from_continuous`` and ``from_statespace`` keep it. It becomes
        None unless its zero-order hold over the sampling time gives A, B and the offset.
    known_states : sequence of str, optional
        Names of states that a control loop computes from the controls alone, although they have dynamics of their own,
        such as those of ``filtered_control``.

    Raises
    ------
    ProblemError
        If shapes do not match, entries are not finite, or names are repeated.

    Methods
    -------
    from_continuous(A, B, sampling_time)
        Sample a continuous model.
    from_mat(path)
        Read a plant that MATLAB saved.
    from_statespace(plant)
        Take a linear model of python-control or scipy.signal.
    linearised(system, x, u)
        Linearise a nonlinear model at a point or along a trajectory.
    at(t)
        A_t, B_t and d_t.
    successors(x, u)
        The next state of every time.

    Examples
    --------
    >>> lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]], sampling_time=0.1).state_dim
    2
    """

    A: Array
    B: Array
    offset: Array
    sampling_time: float | None
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    plant: ContinuousPlant | None = field(default=None, compare=False, repr=False)
    known_states: tuple[str, ...] | None = None
    _offset_given_as: ClassVar[str] = "offset"  # in errors

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        offset: ArrayLike | None = None,
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
        plant: ContinuousPlant | None = None,
        known_states: Sequence[str] | None = None,
    ):
        matrix_A, matrix_B = real_array("dynamics.A", A), real_array("dynamics.B", B)
        if matrix_A.ndim not in (2, 3) or matrix_A.shape[-1] != matrix_A.shape[-2] or matrix_A.shape[-1] == 0:
            expected = "a square matrix (n, n), or (T, n, n) with one per time"
            raise ProblemError("dynamics.A", f"shape {matrix_A.shape}", expected)
        n = matrix_A.shape[-1]
        if matrix_B.ndim not in (2, 3) or matrix_B.shape[-2] != n or matrix_B.shape[-1] == 0:
            expected = f"a matrix ({n}, m), or (T, {n}, m) with one per time"
            advice = "A single control is a matrix with one column: [[b_1], [b_2], ...]."
            raise ProblemError("dynamics.B", f"shape {matrix_B.shape}", expected, advice)
        drift = real_array("dynamics.offset", np.zeros(n) if offset is None else offset)
        if drift.ndim not in (1, 2) or drift.shape[-1] != n:
            expected = f"shape ({n},), or (T, {n}) with one per time"
            raise ProblemError("dynamics.offset", f"shape {drift.shape}", expected)
        labels = signal_labels(n, matrix_B.shape[-1], sampling_time, state_names, control_names)
        known = plant if plant and plant.agrees(matrix_A, matrix_B, drift, sampling_time) else None
        assign(self, A=matrix_A, B=matrix_B, offset=drift, plant=known, **labels)
        field, stated = "dynamics.known_states", [known_states] if isinstance(known_states, str) else known_states or ()
        of_controls = np.isin(np.arange(n), [index_of_name(field, name, self.state_names) for name in stated])
        if matrix_A[..., of_controls, :][..., ~of_controls].any():
            raise ProblemError(field, brief(stated), "states that depend on controls and on each other alone")
        assign(self, known_states=tuple(np.array(self.state_names)[of_controls].tolist()) or None)

    @classmethod
    def from_continuous(
        cls,
        A: ArrayLike,
        B: ArrayLike,
        sampling_time: float,
        offset: ArrayLike | None = None,
        *,
        disturbance: ArrayLike | None = None,
        d: ArrayLike | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> LinearDynamics:
        """Sample dx/dt = A x + B u + E d + offset by a zero-order hold: u and d are held constant over each period.

        Parameters
        ----------
        A, B, offset : (n, n), (n, m), (n,)
            The continuous model.
        sampling_time : float
            Seconds per step.
        disturbance : (n, k), optional
            E: how known inputs, such as the weather or the voltage of a grid, act on the states. The sampled E is the B
            of ``from_continuous(A, E, sampling_time)``.
        d : (T, k), (T,) of one input, or (k,) if constant
            Their values. With one per time, the model keeps no continuous plant.
        state_names, control_names : sequences of str, optional
            As for ``LinearDynamics``.

        Examples
        --------
        >>> outside = [[5.0], [4.0], [3.0]]  # degrees, each hour
        >>> room = lfo.LinearDynamics.from_continuous(
        ...     [[-1 / 7200]], [[1e-3]], 3600.0, disturbance=[[1 / 7200]], d=outside, state_names=["T [degC]"]
        ... )
        >>> room.offset.shape
        (3, 1)
        """
        Ac, Bc = real_array("dynamics.A", A), real_array("dynamics.B", B)
        step = positive_number("dynamics.sampling_time", sampling_time)
        if Ac.ndim != 2 or Bc.ndim != 2 or Ac.shape != (Bc.shape[0], Bc.shape[0]):
            raise ProblemError("dynamics.A, B", f"shapes {Ac.shape} and {Bc.shape}", "shapes (n, n) and (n, m)")
        n = len(Bc)
        drift = np.zeros(n) if offset is None else real_array("dynamics.offset", offset)
        if drift.shape != (n,):
            raise ProblemError("dynamics.offset", f"shape {drift.shape}", f"shape ({n},)")
        if (disturbance is None) != (d is None):
            missing = "d" if d is None else "disturbance"
            raise ProblemError(f"dynamics.{missing}", "nothing", "both disturbance=E, (n, k), and d=, its values")
        if disturbance is None:
            return cls._sample_plant(ContinuousPlant(Ac, Bc, drift), step, state_names, control_names)
        E, values = real_array("dynamics.disturbance", disturbance), real_array("dynamics.d", d)
        if E.ndim != 2 or len(E) != n or E.shape[1] == 0:
            raise ProblemError("dynamics.disturbance", f"shape {E.shape}", f"shape ({n}, k): E of dx/dt = ... + E d")
        k = E.shape[1]
        values = values[:, None] if values.ndim == k == 1 and len(values) > 1 else values
        if values.ndim not in (1, 2) or values.shape[-1] != k:
            raise ProblemError("dynamics.d", f"shape {values.shape}", f"shape (T, {k}), one row per time, or ({k},)")
        if values.ndim == 1:
            return cls._sample_plant(ContinuousPlant(Ac, Bc, drift + E @ values), step, state_names, control_names)
        plain, acting, known = ContinuousPlant(Ac, np.hstack([Bc, E]), drift).sampled(step)
        controls, inputs = np.split(acting, [Bc.shape[1]], axis=1)
        sampled = cls(plain, controls, known + values @ inputs.T, step, state_names, control_names)
        assign(sampled, _offset_given_as="d")
        return sampled

    @classmethod
    def _sample_plant(
        cls, plant: ContinuousPlant, step: float, state_names: Sequence[str] | None, control_names: Sequence[str] | None
    ) -> LinearDynamics:
        """Return a continuous plant sampled, which keeps the plant."""
        dynamics = cls(*plant.sampled(step), step, state_names, control_names)
        assign(dynamics, plant=plant)
        return dynamics

    @classmethod
    def from_mat(
        cls,
        path: str | PathLike[str],
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> LinearDynamics:
        """Read a linear plant from a .mat file: A, B and Ts, or a structure with these fields; outputs are not used.

        MATLAB does not write objects in a form that others read. ``s = struct('A', sys.A, 'B', sys.B, 'Ts', sys.Ts,
        'StateName', {sys.StateName}, 'InputName', {sys.InputName}); save plant.mat s -v7`` writes the fields.

        Parameters
        ----------
        path : path
            Of version 5 or 7. Ts is 0 for a continuous plant, which is sampled here by a zero-order hold.
        sampling_time : float, optional
            Seconds per step; required for a continuous plant. It must agree with the sampling time of a discrete plant.
        state_names, control_names : sequences of str, optional
            Default: StateName and InputName of the file, with StateUnit and InputUnit.

        Raises
        ------
        ProblemError
            If it is no such file, has no such plant or several, or sampling times do not agree.
        """
        A, B, dt, *labels = plant_in_mat(Path(path))
        with located_at(Path(path).name, "dynamics"):
            return cls._of_plant(A, B, dt, sampling_time, state_names or labels[0], control_names or labels[1])

    @classmethod
    def _of_plant(
        cls, A: Array, B: Array, dt: float | None, sampling_time: float | None, states: Labels, controls: Labels
    ) -> LinearDynamics:
        """Return a plant with the sampling time dt, 0 if it is continuous."""
        continuous, step = clock("plant", dt, sampling_time)
        if continuous and step is not None:
            return cls.from_continuous(A, B, step, state_names=states or None, control_names=controls or None)
        return cls(A, B, None, step, states or None, controls or None)

    @classmethod
    def from_statespace(
        cls,
        plant: object,
        sampling_time: float | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> LinearDynamics:
        """Take the state equation of a linear plant of python-control or scipy.signal; its outputs are not used.

        Parameters
        ----------
        plant : control.StateSpace, control.TransferFunction, scipy.signal.lti or scipy.signal.dlti
            Continuous (sampled here by a zero-order hold) or discrete. The states of a transfer function are those of a
            realisation, which have no physical unit.
        sampling_time : float, optional
            Seconds per step; required for a continuous plant. It must agree with the sampling time of a discrete plant.
        state_names, control_names : sequences of str, optional
            Default: the labels of the plant.

        Raises
        ------
        ProblemError
            If it is no linear plant, a transfer function has no realisation, or sampling times do not agree.
        """
        A, B, dt, *labels = state_equation(plant)
        return cls._of_plant(A, B, dt, sampling_time, state_names or labels[0], control_names or labels[1])

    @classmethod
    def linearised(
        cls,
        system: ControlSystem,
        x: ArrayLike,
        u: ArrayLike,
        sampling_time: float | None = None,
        params: Mapping[str, object] | None = None,
        *,
        state_scale: ArrayLike | None = None,
        control_scale: ArrayLike | None = None,
        integrator: str = "DOP853",
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
    ) -> LinearDynamics:
        """Linearise a nonlinear model at a point, or along a trajectory: A_t, B_t and d_t with one per time.

        At (x_t, u_t) the linear model has the value and the derivatives of the nonlinear map over one period, whether
        or not x is a solution. The map is the update equation of a discrete model; of a continuous one, it is the
        integral with a zero-order hold of u (rtol ``INTEGRATION_TOLERANCE``, 1e-12). Derivatives are fourth-order
        central differences.

        Parameters
        ----------
        system : control.NonlinearIOSystem
            Continuous or discrete, from ``control.nlsys``; its outputs are not used. Period t begins at the time
            t times sampling_time.
        x, u : (n,) and (m,), or (T+1, n) and (T, m)
            The point or the trajectory. The last state, x_T, plays no part and may be missing.
        sampling_time : float, optional
            Seconds per step; required for a continuous model, and must agree with a discrete one's own.
        params : dict, optional
            Parameters of the model.
        state_scale, control_scale : float, (n,) or (m,), optional
            Natural sizes of the components; the steps of the differences are ``RELATIVE_STEP`` (1/1024) times these.
            Default: the square root of the largest absolute value along the trajectory, at least 1. State them if the
            model bends within a few steps, such as lengths of micrometres in metres: curvature asks for smaller steps,
            rounding for larger ones.
        integrator : {"DOP853", "Radau"}
            The method of ``scipy.integrate.solve_ivp`` for continuous models; "Radau" for stiff ones.
        state_names, control_names : sequences of str, optional
            Default: the labels of the model.

        Raises
        ------
        ProblemError
            If shapes or sampling times do not fit, or the model has no finite value, no integral or no derivatives at
            some (x_t, u_t): at a kink they depend on the step, or on the side of the point.
        """
        import control  # here, because it takes seconds to import and only its users need it

        if not isinstance(system, control.NonlinearIOSystem):
            raise ProblemError("system", type(system).__name__, "a control.NonlinearIOSystem", "See control.nlsys.")
        sizes = state_scale, control_scale
        A, B, offset, step = linearisation(system, x, u, sampling_time, params, sizes, integrator)
        states, controls = state_names or system.state_labels or None, control_names or system.input_labels or None
        return cls(A, B, offset, step, states, controls)

    @property
    def time_varying(self) -> bool:
        """Whether A or B depends on time."""
        return self.A.ndim == 3 or self.B.ndim == 3

    def facts(self, labels: Sequence[str]) -> list[tuple[str, str]]:
        """Return the map as a formula, the matrices that depend on time, and the offset."""
        known = " + d" if self.offset.any() else ""
        text = f"linear: A x + B u{known}, {plural(self.state_dim, 'state')}, {plural(self.control_dim, 'control')}"
        matrices = {"A": self.A, "B": self.B}
        varying = [f"{name} depends on time" for name, M in matrices.items() if M.ndim == 3 and (M != M[0]).any()]
        return [("dynamics", "; ".join([text, *varying, *([datum("d", self.offset, 1)] if known else [])]))]

    def require_horizon(self, horizon: int) -> None:
        """Raise ProblemError unless everything given per time is given for ``horizon`` steps."""
        for name, array, constant_ndim in (("A", self.A, 2), ("B", self.B, 2), (self._offset_given_as, self.offset, 1)):
            if array.ndim > constant_ndim and len(array) != horizon:
                expected = f"one for each of the {horizon} steps of the horizon"
                raise ProblemError(f"dynamics.{name}", f"{len(array)} times", expected)

    def at(self, t: int) -> tuple[Array, Array, Array]:
        """Return A_t (n, n), B_t (n, m) and d_t (n,)."""
        return (
            self.A if self.A.ndim == 2 else self.A[t],
            self.B if self.B.ndim == 2 else self.B[t],
            self.offset if self.offset.ndim == 1 else self.offset[t],
        )

    def successors(self, x: Array, u: Array) -> Array:
        """Return f_t(x_t, u_t) for all t < T; x is (..., T+1, n) or (..., T, n), u is (..., T, m)."""
        return times_vectors(self._gain, np.concatenate([x[..., : u.shape[-2], :], u], axis=-1)) + self.offset

    def pull_back(self, eta: Array) -> Array:
        """Return (A_t' eta_t, B_t' eta_t), (T, n + m), for an adjoint eta (T, n)."""
        return times_vectors(np.swapaxes(self._gain, -1, -2), eta)

    @cached_property
    def _gain(self) -> Array:
        """[A B], with one per time if A or B has."""
        times = (len(self.A),) if self.A.ndim == 3 else (len(self.B),) if self.B.ndim == 3 else ()
        return np.concatenate([np.broadcast_to(M, (*times, *M.shape[-2:])) for M in (self.A, self.B)], axis=-1)

    def successor_sizes(self, x: Array, u: Array) -> Array:
        """Return the sums of the absolute values of the terms of f_t."""
        return self.magnitudes.successors(np.abs(x), np.abs(u))

    def motion_sizes(self, x: Array, u: Array) -> Array:
        """Return the larger of |x_t| and the change by B and d in a step; terms of A x that cancel play no part."""
        moved = times_vectors(self.magnitudes.B, np.abs(u)) + self.magnitudes.offset
        return np.maximum(largest_over_time(np.abs(x)), largest_over_time(moved))

    def pulled_sizes(self, eta: Array) -> Array:
        """Return the sums of the absolute values of the terms of ``pull_back``."""
        return self.magnitudes.pull_back(np.abs(eta))

    def stepper(self, horizon: int) -> Step:
        """Return the function from t, x_t (n,) and u_t (m,) to x_{t+1}."""

        def step(t: int, x: Array, u: Array) -> Array:
            A, B, d = self.at(t)
            return A @ x + B @ u + d

        return step

    def gains(self) -> tuple[Array, Array, Array]:
        """Return the largest |A| (n, n), |B| (n, m) and |d| (n,) over times."""
        plain = self.magnitudes
        A, B, d = plain.A, plain.B, plain.offset
        return A if A.ndim == 2 else A.max(0), B if B.ndim == 2 else B.max(0), d if d.ndim == 1 else d.max(0)

    def translated(self, origin: Array, horizon: int) -> LinearDynamics:
        """Return the dynamics of x - origin, whose offset is d + (A - I) origin."""
        growth = to_long_double(self.A) - np.eye(self.state_dim)
        plant = self.plant and self.plant.translated(origin)
        return replace(self, offset=with_products(self.offset, (growth, origin)), plant=plant)

    def disturbed(self, disturbance: Array) -> LinearDynamics:
        """Return the dynamics with a disturbance, (n,) or (T, n), added to the coming states."""
        return replace(self, offset=self.offset + disturbance)

    def stacked(self, plants: Sequence[Dynamics], names: Sequence[str], horizon: int) -> LinearDynamics:
        """Return the dynamics of the states of several plants under the same controls, with these names."""
        parts = list(
            zip(cast("Sequence[LinearDynamics]", plants), np.split(np.eye(len(names)), len(plants)), strict=True)
        )
        A, B = sum(at.T @ one.A @ at for one, at in parts), sum(at.T @ one.B for one, at in parts)
        offset = sum(one.offset @ at for one, at in parts)
        return LinearDynamics(A, B, offset, self.sampling_time, names, self.control_names)

    def augmented(self, A: Array, B: Array, names: Sequence[str], horizon: int) -> LinearDynamics:
        """Return the dynamics of (x, w) with w_{t+1} = A w_t + B u_t."""
        k = len(A)
        block = with_rows(with_columns(self.A, k), np.hstack([np.zeros((k, self.state_dim)), A]))
        labels = self.sampling_time, [*self.state_names, *names], self.control_names
        known = self.plant, [*(self.known_states or ()), *(names if A.any() else ())]
        return LinearDynamics(block, with_rows(self.B, B), with_columns(self.offset, k), *labels, *known)

    @cached_property
    def magnitudes(self) -> LinearDynamics:
        """The dynamics of |A|, |B| and |d|, which bound the sum of the absolute values of all terms."""
        A, B, offset, gain = map(np.abs, (self.A, self.B, self.offset, self._gain))
        return with_fields(self, A=A, B=B, offset=offset, plant=None, _gain=gain)
