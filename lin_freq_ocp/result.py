"""What a solve ends with: why it stopped, the best point, and everything that is proven of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from lin_freq_ocp.analysis.mode_tree import ModeTree
from lin_freq_ocp.analysis.sensitivities import Sensitivities, sensitivities
from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.certificate.conflict import Conflict
from lin_freq_ocp.certificate.directions import Direction
from lin_freq_ocp.certificate.modes.bound import TreeBound
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.html import html_table
from lin_freq_ocp.methods.multipliers import Uniqueness, uniqueness
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure
    from pandas import DataFrame

    from lin_freq_ocp.explain import Explanation


@dataclass(frozen=True, eq=False)
class Result:
    """What a solve ended with; everything that does not exist is None.

    Attributes
    ----------
    problem : OptimalControlProblem
    status : str
        "optimal" (feasible, and its gap to a rigorous bound is proven), "locally_optimal" (the maximum principle is
        satisfied, and nothing more is proven), "infeasible", "unbounded", "limit" or "numerical_error".
    method : str
        What was used.
    backend : str or None
        The solver of the methods "convex", "miqp" and "minlp"; others need none.
    seconds : dict
        Wall time of "setup" (transcription, scaling), "solve" (the backend) and "certify".
    trajectory, multipliers, certificate : or None
        The best point found, whatever the status, and what is proven of it.
    conflict : tuple of Conflict or None
        If infeasible: the blocks of constraints that the proof rests on.
    ray : Multipliers or None
        If infeasible: the verified multipliers with eta_C = 0.
    message : str
        In words, how it ended.
    interrupted : bool
        Whether Ctrl-C was pressed; what was found until then is here, be it complete or not.
    direction : Direction or None
        If unbounded: the verified direction along which every constraint holds and the cost falls for ever.
    explanation : Explanation or None
        If an InfeasibleError was raised: what it says of the family in conflict and of cures. Else ``lfo.explain``.
    options : dict
        What solve was given: "method", "backend", "time_limit", "tolerance", and "node_limit" if it was.
    sequence : (T,) integers or None
        With modes: the mode at every time.
    tree : ModeTree or None
        With modes: what the search split and left out, with the multipliers that prove it.
    tree_bound : TreeBound or None
        What the judge finds proven by the tree.
    claimed_bound : float or None
        Of the method "minlp": the lower bound by the solver's own word, unproven; infinite where it says that there is
        no trajectory, minus infinite where it says that the cost is unbounded.

    Methods
    -------
    plot()
        A figure of the answer.
    save(path)
        Write .npz with the multipliers, or .csv or .mat, by the end of the name.
    to_csv(path), to_mat(path), to_json(path), to_time_response()
        The trajectory for other tools.
    dump(path)
        Write the whole run, to be repeated anywhere.
    """

    problem: OptimalControlProblem
    status: str
    method: str
    backend: str | None
    seconds: dict[str, float]
    trajectory: Trajectory | None = None
    multipliers: Multipliers | None = None
    certificate: Certificate | None = None
    conflict: tuple[Conflict, ...] | None = None
    ray: Multipliers | None = None
    message: str = ""
    interrupted: bool = False
    explanation: Explanation | None = None
    direction: Direction | None = None
    options: dict[str, Any] = field(default_factory=dict[str, Any])
    sequence: Indices | None = None
    tree: ModeTree | None = None
    tree_bound: TreeBound | None = None
    claimed_bound: float | None = None

    @property
    def primal(self) -> bool:
        """Whether there is a point that satisfies every constraint, within the judge's tolerance."""
        return self.certificate is not None and self.certificate.feasible

    @property
    def dual(self) -> bool:
        """Whether there is a proof: a lower bound on the cost, or a verified ray of infeasibility or descent."""
        intervals = self.method in ("nonsmooth", "minlp") and self.claimed_bound is None
        without = self.status == "infeasible" and (self.tree_bound is not None or intervals)
        return without or self.ray is not None or self.direction is not None or self.lower_bound is not None

    @property
    def cost(self) -> float | None:
        """Return J of the trajectory."""
        return None if self.certificate is None else self.certificate.cost

    @property
    def lower_bound(self) -> float | None:
        """Return the judge's bound on the optimal cost."""
        if self.certificate is None and self.tree_bound is not None and np.isfinite(self.tree_bound.value):
            return self.tree_bound.value
        return None if self.certificate is None else self.certificate.lower_bound

    @property
    def gap(self) -> float | None:
        """Return (cost - lower_bound) / S, S what the terms of the cost add up to."""
        return None if self.certificate is None else self.certificate.gap

    @property
    def solver(self) -> str:
        """Return the method, with its backend if it has one."""
        return self.method if self.backend is None else f"{self.method}, {self.backend}"

    @property
    def control(self) -> Array | None:
        """Return u, shape (T, m)."""
        return None if self.trajectory is None else self.trajectory.u

    @property
    def sensitivities(self) -> Sensitivities:
        """Return the derivatives of the optimal cost by bounds, ends, bins and offsets; SolveError if there is none."""
        if self.status not in ("optimal", "locally_optimal") or self.multipliers is None:
            raise SolveError(f"Only an optimum has sensitivities; this solve ended as '{self.status}'.", self)
        return sensitivities(self.problem, self.multipliers)

    @property
    def uniqueness(self) -> Uniqueness:
        """Return whether the multipliers are the only ones; SolveError if the solve ended without a trajectory."""
        return uniqueness(self.problem, self._require_trajectory())

    def __str__(self) -> str:
        lines = [f"status    {self.status}" + (f": {self.message}" if self.message else "")]
        lines += [] if self.certificate is None else [str(self.certificate)]
        if self.tree is not None and self.tree_bound is not None:
            lines.append(f"tree      {len(self.tree.nodes)} nodes, {self.tree_bound.leaves} leaves, each checked")
        lines.append(f"method    {self.solver}")
        lines.append("time      " + ", ".join(f"{what} {seconds:.3g} s" for what, seconds in self.seconds.items()))
        return "\n".join([str(self.problem), *lines])

    def __repr__(self) -> str:
        figures = "no trajectory" if self.certificate is None else self.certificate.figures
        return f"Result({self.status} by {self.solver}, {figures})"

    def _repr_html_(self) -> str:
        head, *lines = str(self).splitlines()
        rows = [(term, text.strip()) for term, text in (line.partition(" ")[::2] for line in lines)]
        return html_table(head, rows)

    @property
    def times(self) -> Array:
        """Return the times of the states, (T+1,): in seconds with a sampling time, else in steps."""
        return self.problem.times

    def plot(self) -> Figure:
        """Return a figure of controls, their spectra, phase portraits and all states over time.

        A notebook shows it where it is the last expression. In a script: ``.savefig(path)``, or ``.show()`` for a
        window.
        """
        from lin_freq_ocp.report.figures.figures import result_figure

        return result_figure(self)

    def save(self, path: str | Path) -> None:
        """Write trajectory and multipliers to an .npz file, or the trajectory to a .csv or a .mat file."""
        from lin_freq_ocp.interchange.results.summary import result_summary
        from lin_freq_ocp.interchange.results.trajectory_file import save_trajectory

        save_trajectory(path, self.problem, self._require_trajectory(), self.multipliers, result_summary(self))

    def to_csv(self, path: str | Path) -> None:
        """Write the trajectory as a table, one row per time."""
        from lin_freq_ocp.interchange.results.solution_file import save_csv

        save_csv(path, self.problem, self._require_trajectory())

    def to_mat(self, path: str | Path) -> None:
        """Write the trajectory for MATLAB: x (T+1, n), u (T, m), t (T+1, 1), one row per time, and the names."""
        from lin_freq_ocp.interchange.results.mat_file import save_mat

        save_mat(path, self.problem, self._require_trajectory())

    def to_frame(self) -> DataFrame:
        """Return the trajectory as a ``pandas.DataFrame``: a row per time, states and controls under their names.

        Its index is the time, in seconds or in steps; controls at T, where there is none, are not a number.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        SolveError
            If there is no trajectory.
        """
        from lin_freq_ocp.interchange.results.frame import to_frame

        return to_frame(self.problem, self._require_trajectory())

    def to_time_response(self) -> Any:
        """Return the trajectory as a ``control.TimeResponseData``; the states are its outputs, too."""
        from lin_freq_ocp.interchange.results.time_response import to_time_response

        return to_time_response(self.problem, self._require_trajectory())

    def dump(self, path: str | Path) -> None:
        """Write problem, options, result and versions to one .zip file; ``lfo.load_run`` reads it."""
        from lin_freq_ocp.interchange.runs.run_file import dump_run

        dump_run(path, self.problem, self.options, self)

    def to_json(self, path: str | Path) -> None:
        """Write the object that ``lin-freq-ocp solve --json`` prints."""
        from lin_freq_ocp.interchange.results.summary import result_summary, save_json

        save_json(path, result_summary(self))

    def _require_trajectory(self) -> Trajectory:
        if self.trajectory is None:
            raise SolveError(f"The solve ended without a trajectory ({self.status}).", self)
        return self.trajectory
