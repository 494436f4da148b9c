"""The result of a solve: its outcome, with the methods that users call."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast, final

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.atomic import open_replacement
from lin_freq_ocp.base.errors import SolveError
from lin_freq_ocp.base.names import index_of_name
from lin_freq_ocp.base.phrases import html_table, term_rows
from lin_freq_ocp.derivatives.sensitivities import Sensitivities, sensitivities_of
from lin_freq_ocp.files.conversions import to_frame, to_time_response
from lin_freq_ocp.files.solution_files import save_csv, save_mat, save_trajectory
from lin_freq_ocp.files.summary import result_summary, save_json
from lin_freq_ocp.methods.fitted_multipliers import Uniqueness, uniqueness
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.enclosure import LONGEST_CHECK, Enclosure, require_checker
from lin_freq_ocp.solving.outcome import Outcome

if TYPE_CHECKING:
    from control import TimeResponseData
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from lin_freq_ocp.certificate.hybrid.tree import TreeBound
    from lin_freq_ocp.derivatives.derivatives import SolutionDerivatives
    from lin_freq_ocp.problem.hybrid.mode_tree import ModeTree
    from lin_freq_ocp.proof.proof import Proof
    from lin_freq_ocp.proof.train import TrainProof
    from lin_freq_ocp.solving.hybrid.modes import TreeEvidence


Face = TypeVar("Face")


def present_as(cls: type[Face], record: object) -> Face:
    """Return a record as ``cls``, the subclass of its class that adds the methods that users call.

    The subclass declares no field, so no field is named here; values that the record has cached stay cached.
    """
    face = object.__new__(cls)
    face.__dict__.update(vars(record))
    return face


@final
class Result(Outcome):
    """The outcome of a solve: the fields of ``Outcome``, and methods to draw, save and prove it.

    ``result["position"]`` is a signal by its name.

    Methods
    -------
    plot()
        A figure of the answer.
    save(path)
        Write .npz with the multipliers, or .csv or .mat, by the suffix.
    to_csv(path), to_mat(path), to_json(path), to_frame() (also to_pandas()), to_time_response()
        The trajectory for other tools.
    dump(path)
        Write the problem, the options and the answer to a file that ``lfo.load_run`` reads and solves again.
    write_proof(path)
        Write a proof of the answer that third parties can check without this package.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.to_frame().shape
    (201, 3)
    >>> result["acceleration"].shape
    (200,)
    """

    @property
    def sensitivities(self) -> Sensitivities:
        """Return the derivatives of the optimal cost by the data of the problem; SolveError if not solved."""
        if not self.status.solved or self.trajectory is None or self.multipliers is None:
            raise SolveError(f"Only an optimum has sensitivities; this solve ended as '{self.status}'.", self)
        return sensitivities_of(self.problem, self.trajectory, self.multipliers)

    @cached_property
    def derivatives(self) -> SolutionDerivatives:
        """The derivatives of the optimum by the data of the problem; their equations are solved once.

        Raises
        ------
        SolveError
            If the solve did not end with an optimum that has multipliers.
        UnsupportedError
            If the dynamics have modes or are smooth, a mask holds at every frequency, or the multipliers are abnormal.
        """
        if not self.status.solved or self.trajectory is None or self.multipliers is None:
            raise SolveError(f"Only an optimum has derivatives; this solve ended as '{self.status}'.", self)
        from lin_freq_ocp.derivatives.adjoint import derivatives_of  # other uses need none of it

        return derivatives_of(self.problem, self.trajectory, self.multipliers)

    @property
    def tree(self) -> ModeTree | None:
        """Return the nodes of a search over modes, with the multipliers that prove its leaves."""
        evidence = cast("TreeEvidence | None", self.evidence)  # isinstance would load the methods for modes
        return None if evidence is None else evidence.tree

    @property
    def tree_bound(self) -> TreeBound | None:
        """Return the lower bound that the judge computed from the tree."""
        evidence = cast("TreeEvidence | None", self.evidence)
        return None if evidence is None else evidence.bound

    @property
    def uniqueness(self) -> Uniqueness:
        """Return whether the multipliers are unique; SolveError if the solve ended without a trajectory."""
        from lin_freq_ocp.transform.hybrid.forms import linear_along  # it loads what has modes

        trajectory = self._require_trajectory()
        return uniqueness(linear_along(self.problem, trajectory), trajectory)

    def __repr__(self) -> str:
        figures = "no trajectory" if self.certificate is None else self.certificate.figures
        return f"Result({self.status} by {self.solver}, {figures})"

    def _repr_html_(self) -> str:
        head, *lines = str(self).splitlines()
        return html_table(head, term_rows(lines))

    def __getitem__(self, name: str) -> Array:
        """Return a state or an output, (T+1,), or a control, (T,), by its name, with or without its unit.

        Raises
        ------
        ProblemError
            If no signal of the problem has this name, or several have it.
        SolveError
            If there is no trajectory.
        """
        trajectory, families = self._require_trajectory(), entries_of(self.problem.output_spectrum)
        outputs = [(family.output_names, family.values(trajectory.x, trajectory.u)) for family in families]
        named = (self.problem.state_names, trajectory.x), (self.problem.control_names, trajectory.u), *outputs
        signals = [signal for _, values in named for signal in values.T]
        return signals[index_of_name("result", name, [label for names, _ in named for label in names])]

    @property
    def times(self) -> Array:
        """Return the times of the states, (T+1,): in seconds with a sampling time, else in steps."""
        return self.problem.times

    def plot(self) -> Figure:
        """Return a figure of controls, their spectra, phase portraits and states, and of all that is constrained.

        Joint rows such as rates, spectra of states and outputs, residual vibrations and spectra after a zero-order hold
        have panels of their own, with their limits; levels of a control are dotted lines.

        A notebook shows the figure if it is the last expression of a cell. In a script, call ``.savefig(path)``, or
        ``.show()`` for a window.
        """
        from lin_freq_ocp.pages.figures.figures import result_figure  # Matplotlib is slow to import

        return result_figure(self)

    def save(self, path: str | Path) -> None:
        """Write trajectory and multipliers to an .npz file, or the trajectory to a .csv or a .mat file."""
        save_trajectory(path, self.problem, self._require_trajectory(), self.multipliers, result_summary(self))

    def to_csv(self, path: str | Path) -> None:
        """Write the trajectory as a table, one row per time."""
        save_csv(path, self.problem, self._require_trajectory())

    def to_mat(self, path: str | Path) -> None:
        """Write the trajectory for MATLAB: x (T+1, n), u (T, m), t (T+1, 1), one row per time, and the names."""
        save_mat(path, self.problem, self._require_trajectory())

    def to_frame(self) -> DataFrame:
        """Return the trajectory as a ``pandas.DataFrame``: a row per time, states and controls under their names.

        Its index is the time, in seconds or in steps. There is no control at time T: its entries are NaN.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        SolveError
            If there is no trajectory.
        """
        return to_frame(self.problem, self._require_trajectory())

    to_pandas = to_frame

    def to_time_response(self) -> TimeResponseData:
        """Return the trajectory as a ``control.TimeResponseData``, whose outputs are the states."""
        return to_time_response(self.problem, self._require_trajectory())

    def dump(self, path: str | Path) -> None:
        """Write problem, options, result and versions to one .zip file, which ``lfo.load_run`` reads."""
        from lin_freq_ocp.files.run_file import dump_run  # slow to import

        dump_run(path, self.problem, self.options, self)

    @property
    def enclosure(self) -> Enclosure:
        """Return an interval that contains the optimal cost, confirmed by the checker of proofs; computed once.

        A Hessian that is semidefinite only up to rounding is raised before it is checked. The lower end of the interval
        is lowered by the amount that this adds to the cost (docs/proof.md).

        Raises
        ------
        MissingExtraError, UnsupportedError, SolveError
            As for ``write_proof``.
        """
        return self._proven[1]

    def write_proof(self, path: str | Path) -> None:
        """Write a proof of the interval ``enclosure``, or that no trajectory is feasible.

        ``lfo-check FILE`` checks it. The checker is one file of Python that imports nothing of this package
        (docs/proof.md). The proof is checked before it is written, except for linear problems with horizons above
        20000, where a check takes much longer than the solve. Hessians that are semidefinite only up to rounding are
        raised, and the claimed interval allows for it.

        Raises
        ------
        MissingExtraError
            If the extra ``proof`` is not installed.
        UnsupportedError
            If the format cannot state a part of the problem; the message names its field.
        SolveError
            If the solve ended without an answer, its multipliers prove no bound, or the certified cost lies outside of
            the proven interval.
        ProblemError
            If the file cannot be written.
        """
        checked = "_proven" in self.__dict__ or self.problem.mode_names
        if checked or self.problem.horizon <= LONGEST_CHECK:
            proof = self._proven[0]
        else:
            require_checker()
            from lin_freq_ocp.proof.proof import unchecked_proof  # imports an extra

            proof = unchecked_proof(self)
        with open_replacement(path) as stream:
            stream.writelines(text.encode() for text in proof.lines())

    @cached_property
    def _proven(self) -> tuple[Proof | TrainProof, Enclosure]:
        require_checker()
        from lin_freq_ocp.proof.proof import proof_of  # imports an extra

        return proof_of(self)

    def to_json(self, path: str | Path) -> None:
        """Write the JSON object that ``lin-freq-ocp solve --json`` prints."""
        save_json(path, result_summary(self))

    def _require_trajectory(self) -> Trajectory:
        if self.trajectory is None:
            raise SolveError(f"The solve ended without a trajectory ({self.status}).", self)
        return self.trajectory
