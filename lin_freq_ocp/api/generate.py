"""generate() and certify_log() as users call them: a controller as C, and its log judged afterwards."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from lin_freq_ocp.api.receding_horizon import RecedingHorizon
from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.arrays import brief, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.loop import embedded, log
from lin_freq_ocp.loop.embedded import GeneratedController
from lin_freq_ocp.loop.log import CertifiedLog


@activity("generating C")
def generate(
    controller: RecedingHorizon,
    folder: str | PathLike[str],
    real: str = "double",
    changes: int | None = None,
    memory: int | str | None = None,
    references: bool = False,
) -> GeneratedController:
    """Write a controller as portable C99 without heap and recursion, with a test, a Makefile and a README.

    The folder has one function for a step, with a status. Constraints that the controller may soften are soft from the
    beginning. docs/embedded.md says how to use the files, and what a step costs.

    Parameters
    ----------
    controller : RecedingHorizon
        Linear time-invariant dynamics, a quadratic cost that is strictly convex in the free controls, bounds, joint
        rows and rate limits, hard or soft, stop bands of controls, free or fixed ends; delay 0 or 1.
    folder : path
        It is made if it does not exist. Files that ``generate`` wrote there before are replaced, and what else has
        come to be beside them, such as logs, stays. A folder with other files alone is refused.
    real : {"double", "float"}
        The numbers of the controller.
    changes : int, optional
        Most changes of the working set in a step, which bounds its time. A step that needs more continues the plan
        before. Default: a cap that hardly any step reaches.
    memory : int or str, optional
        Most bytes of RAM, stack included, such as 65536 or "64k".
    references : bool
        Whether a step takes a reference of the measured states, constant over the horizon, in place of that of the
        problem.

    Returns
    -------
    GeneratedController
        Sizes, and counts of operations.

    Raises
    ------
    ProblemError
        If an option is invalid, the memory does not suffice, or a file cannot be written.
    UnsupportedError
        If the problem is not of this class; with its field and the reason.

    References
    ----------
    Goldfarb and Idnani, Mathematical Programming 27, 1983.

    Examples
    --------
    >>> import tempfile
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator(horizon=20, cutoff_hz=None, terminal_state=None))
    >>> lfo.generate(controller, tempfile.mkdtemp(), real="float", memory="64k").unknowns
    20
    """
    given = _require_controller(controller, "folder", folder)
    return embedded.generate(given.problem, given.soft, given.delay, Path(folder), real, changes, memory, references)


@activity("certifying the log")
def certify_log(controller: RecedingHorizon, path: str | PathLike[str], tolerance: float = 0.01) -> CertifiedLog:
    """Judge the log of a generated controller: which of its controls begin a plan that is proven optimal.

    Every step is planned again in double, and each plan is judged from the data of the problem, as by ``lfo.solve``.
    The logged control is compared with it.

    Parameters
    ----------
    controller : RecedingHorizon
        The controller that was generated.
    path : path
        A CSV file with a line per step: the measured states x1, x2, ..., with ``references=True`` their references r1,
        r2, ..., the controls u1, u2, ... as returned, or those which acted in their place, and the status.
    tolerance : float
        Largest difference from the optimal control that counts as the same, relative to the largest control of the
        plan, or to the bound on that side if it is smaller. Controllers in double differ by 1e-6 at most, those in
        float usually by 1e-5, and by 5e-3 at worst.

    Returns
    -------
    CertifiedLog

    Raises
    ------
    ProblemError
        If the file is no log of this controller; with the line.

    Examples
    --------
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator())
    >>> lfo.certify_log(controller, "yesterday.csv")
    Traceback (most recent call last):
    lin_freq_ocp.base.errors.ProblemError: yesterday.csv: got No such file or directory; expected a log that can be ...
    """
    given = _require_controller(controller, "path", path)
    allowed = positive_number("tolerance", tolerance)
    return log.certify_log(given.problem, given.soft, given.delay, Path(path), allowed)


def _require_controller(given: object, field: str, path: object) -> RecedingHorizon:
    if not isinstance(path, (str, PathLike)):
        raise ProblemError(field, brief(path), "the path of a folder" if field == "folder" else "the path of a log")
    if not isinstance(given, RecedingHorizon):
        advice = "Of a problem: lfo.RecedingHorizon(problem)."
        raise ProblemError("controller", brief(given), "a RecedingHorizon", advice)
    return given
