"""CondensedSolver: the problem of the Fourier-domain method solved again and again in few unknowns."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, seal
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.condensed.native import FAMILIES, STATES, NativeKernel, library
from lin_freq_ocp.methods.condensed.tables import INFEASIBLE, LIMIT, SOLVED, CondensedTables, condense
from lin_freq_ocp.methods.condensed.windows import ControlWindows, WindowDuals
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits
from lin_freq_ocp.methods.spectral.recovery import LtiMultipliers, in_units
from lin_freq_ocp.methods.spectral.reductions import soft_sets
from lin_freq_ocp.methods.spectral.spaces import bin_multiplicity
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Extremals, Trajectory

KEPT_VIOLATION = 1e-6  # of a plan that counts as feasible, relative: as in the judge's conditions
CHANGES_BETWEEN_LOOKS = 25  # at the clock, of the working set: some 0.1 to 1 ms


@dataclass(frozen=True)
class Budget:
    """What a plan may take: changes of the working set, None for as many as ever help, and time until ``end``."""

    changes: int | None = None
    end: float = np.inf  # by ``clock.now``


UNLIMITED = Budget()


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan without a certificate: what the kernel found from an initial state.

    With eta_C = 0 there is none: the ``weights`` claim that the rows contradict each other.
    """

    tables: CondensedTables
    units: LtiUnits
    start: Array  # (n,), in the user's units
    control: Array  # u_0, (m,), in the user's units
    v: Array  # (T m,)
    weights: Array  # multipliers of the rows, (families, T+1)
    changes: int = 0  # of the working set
    settled: bool = True  # whether the working set is the optimal one; else v is where the budget ended
    eta_C: float = 1.0
    windows: ControlWindows | None = None
    duals: Callable[[], Sequence[WindowDuals]] = tuple  # of the windows, which are read when the plan is judged

    @property
    def rank(self) -> tuple[bool, float]:
        """Return what is less for the better plan: whether it is infeasible, and its cost, or else its violation."""
        violation, cost = self.tables.worth(self.start / self.units.x, self.v)
        return (False, cost) if violation <= KEPT_VIOLATION else (True, violation)

    def following(self, last: Trajectory) -> Plan:
        """Return the rest of the last plan from this state, with the feedback of the tables, its last v repeated."""
        v = last.u / self.units.u - (last.x[:-1] / self.units.x) @ self.tables.loop.K.T
        rest = np.concatenate([v[1:], v[-1:]]).ravel()
        return unsettled_plan(self.tables, self.units, self.start, rest, self.changes)

    @property
    def trajectory(self) -> Trajectory:
        """Return the states and controls of the plan, in the user's units."""
        loop, units = self.tables.loop, self.units
        x, u = loop.simulate((self.start / units.x)[None], loop.plans(self.v[:, None]), np.ones(1))
        return Trajectory(seal(x[:, 0] * units.x), seal(u[:, 0] * units.u))

    def candidate(self, problem: OptimalControlProblem) -> Candidate:
        """Return the plan with its multipliers, or the ray, for the judge of the problem that it solves."""
        tables, units, lti = self.tables, self.units, self.tables.loop.lti
        forces = np.zeros((tables.loop.shape[0], 1, tables.loop.shape[2]))
        for one, of_set in zip(self.windows.sets if self.windows else (), self.duals(), strict=False):
            forces[:, 0, one.component] += one.forces(of_set, len(forces))
        start, v = (self.start / units.x)[None], self.v[:, None]
        found = tables.recover(start, v, self.weights[..., None], self.eta_C, forces)
        none = np.zeros(lti.state_stop.shape, dtype=np.complex128)
        duals = LtiMultipliers(self.eta_C, found.eta[:, 0].T, found.on_rows[..., 0], found.band[:, 0].T, none)
        trajectory = Trajectory(seal(found.x[:, 0] * units.x), seal(found.u[:, 0] * units.u))
        multipliers = in_units(problem, lti, units, duals)
        if not self.eta_C:
            return Candidate(Status.INFEASIBLE, ray=multipliers, message="contradictory rows")
        return Candidate(Status.OPTIMAL, trajectory, multipliers)


def unsettled_plan(tables: CondensedTables, units: LtiUnits, start: Array, v: Array, changes: int) -> Plan:
    """Return the plan of v (T m,) from a state (n,), whose working set has not settled: it has no multipliers."""
    u_0 = v[: len(units.u)] + tables.loop.K @ (start / units.x)
    return Plan(tables, units, start, u_0 * units.u, v, np.zeros_like(tables.bounds[0]), changes, settled=False)


class CondensedSolver:
    """The tables and the kernel of a problem, with the multipliers of the last step.

    Parameters
    ----------
    lti, units
        The problem of the Fourier-domain method, whose initial state is fixed.
    windows
        Limits on the spectrum of the applied controls, for ``plan_windows``; ``kernel.apply`` follows each plan.

    Raises
    ------
    UnsupportedError
        With the reason, if the condensed method does not take the problem.
    """

    @one_blas_thread
    def __init__(self, lti: Lti, units: LtiUnits, windows: ControlWindows | None = None):
        self.units, self.windows, started = units, windows, now()
        self._set_up(condense(lti))
        self.setup_seconds = now() - started

    def _set_up(self, tables: CondensedTables) -> None:
        self._lock = threading.Lock()  # the kernel keeps the multipliers of its last step
        if len(tables.families) > FAMILIES or tables.loop.shape[1] > STATES:
            raise UnsupportedError(f"the condensed method takes up to {FAMILIES} kinds of rows and {STATES} states.")
        compiled = library()
        if compiled is None:
            raise UnsupportedError("the condensed method runs in C: it needs a C compiler, or the library of a wheel.")
        self.kernel = NativeKernel(tables, compiled, self.windows)

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs; the kernel is made anew."""
        kept = {name: getattr(self, name) for name in ("units", "windows", "setup_seconds")}
        return {**kept, "tables": self.kernel.tables}

    def __setstate__(self, state: dict[str, object]) -> None:
        tables = state.pop("tables")
        assert isinstance(tables, CondensedTables)
        self.__dict__.update(state)
        self._set_up(tables)

    def _take(self, lti: Lti) -> bool:
        """Take the ends, references, offsets and bounds of a problem; whether it differs in nothing else."""
        tables = self.kernel.tables
        old = tables.loop.lti
        if lti is old:
            return True
        same = all(getattr(lti, name) is getattr(old, name) for name in ("linear", "p", "offset", "prices"))
        same &= lti.bounds.lower is old.bounds.lower and lti.bounds.upper is old.bounds.upper
        ends = [(one.end, one.bounds.last_lower, one.bounds.last_upper) for one in (lti, old)]
        if same and all(np.array_equal(*pair, equal_nan=True) for pair in zip(*ends, strict=True)):
            return True
        if not np.array_equal(np.isnan(lti.end), np.isnan(old.end)):
            return False
        changed = tables.with_data(lti)
        if changed is not None:
            self.kernel.take(changed)
        return changed is not None

    def _run(self, x: Array, budget: Budget) -> tuple[int, int]:
        """Return the status of the kernel from an initial state, (n,), when it or the budget ends, and its changes."""
        status, made, most = LIMIT, 0, self.kernel.tables.most_changes if budget.changes is None else budget.changes
        at_once = most if budget.end == np.inf else CHANGES_BETWEEN_LOOKS
        while status == LIMIT and made < most and (made == 0 or now() < budget.end):
            status = self.kernel.step(x, min(most - made, at_once))
            made += self.kernel.changes or status == LIMIT  # rounding may stop it without a change
        return status, made

    def plan(self, start: Array, lti: Lti, budget: Budget = UNLIMITED) -> Plan | None:
        """Return the plan from an initial state, (n,), with the other data of lti in the same units.

        Or the claim, with eta_C = 0, that the rows contradict each other. None if the data differ in more than ends,
        references, offsets and bounds, or if the working set does not settle. Where a limited budget ends before, the
        plan is not ``settled``.
        """
        units, kernel = self.units, self.kernel
        with self._lock:
            if not self._take(lti):
                return None
            status, made = self._run(start / units.x, budget)
            control, ray = kernel.control * units.u, kernel.ray
            if status == SOLVED:
                return Plan(kernel.tables, units, start, control, kernel.plan, kernel.multipliers, made)
            if ray is not None:
                none = np.zeros(len(kernel.tables.V))
                return Plan(kernel.tables, units, start, control, none, ray, made, eta_C=0.0)
            if status != LIMIT or (budget.changes is None and now() < budget.end):
                return None
            return self._unsettled_plan(start, made)

    def plan_windows(self, start: Array, lti: Lti, budget: Budget) -> Plan:
        """Return the plan from an initial state, (n,), with windows; where it is not ``settled``, that of promise 4."""
        units, kernel = self.units, self.kernel
        if not self._take(lti):
            raise UnsupportedError("bounds: they bound other components than those of the problem.")
        status, made = self._run(start / units.x, budget)
        control, weights, settled = kernel.control * units.u, kernel.multipliers, status == SOLVED
        of_step = kernel.tables, units, start, control, kernel.plan, weights, made, settled, float(status != INFEASIBLE)
        return Plan(*of_step, self.windows, kernel.window_duals if settled else tuple)

    @one_blas_thread
    def _unsettled_plan(self, start: Array, changes: int) -> Plan:
        """Return the plan where the kernel ended."""
        tables, x = self.kernel.tables, start / self.units.x
        v = tables.W @ np.append(x, 1.0) + tables.V @ self.kernel.unknowns
        return unsettled_plan(tables, self.units, start, v, changes)

    def plan_batch(self, starts: Array, lti: Lti) -> tuple[dict[int, Plan], bool]:
        """Return the plans from initial states (N, n) by number, each from the multipliers of the one before.

        No plan where ``plan`` returns None; the second value says whether Ctrl-C ended it early.
        """
        plans, units = dict[int, Plan](), self.units
        with self._lock, interrupts_noted() as interrupt:
            kernel = self.kernel
            for i, start in enumerate(starts if self._take(lti) else ()):
                if kernel.step(start / units.x) == SOLVED:
                    control = kernel.control * units.u
                    plans[i] = Plan(kernel.tables, units, start, control, kernel.plan, kernel.multipliers)
                if interrupt.is_set():
                    break
        return plans, interrupt.is_set()


def extremals_of(problem: OptimalControlProblem, plans: Sequence[Plan]) -> Extremals:
    """Return plans of one solver, for a problem that differs in the initial state only, in the user's units."""
    tables, units = plans[0].tables, plans[0].units
    (T, n, m), of_y = tables.loop.shape, units.multipliers
    starts, v = np.array([plan.start for plan in plans]), np.array([plan.v for plan in plans]).T
    found = tables.recover(starts / units.x, v, np.array([plan.weights for plan in plans]).transpose(1, 2, 0))
    on_rows = found.on_rows.T
    forces = on_rows[..., : n + m] * of_y
    stage = {one.name: one.multipliers(forces, 1.0) for one in soft_sets(problem, starts) or ()}
    if problem.stage_rows:
        joint = on_rows[:, :-1, n + m :] * (units.cost / units.rows)
        splits = np.cumsum([rows.rows for rows in problem.stage_rows[:-1]])
        stage |= {one.name: part for one, part in zip(problem.stage_rows, np.split(joint, splits, axis=2), strict=True)}
    x, u, eta = (part.swapaxes(0, 1) for part in (found.x * units.x, found.u * units.u, found.eta * of_y[:n]))
    rho_u = (found.band * of_y[n:]).swapaxes(0, 1) * (bin_multiplicity(T)[:, None] / T)
    return Extremals(x, u, eta, forces[..., :n], forces[:, :-1, n:], rho_u, stage)
