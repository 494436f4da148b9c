"""The interval of a proof, and whether proofs can be checked here."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from lin_freq_ocp.base.errors import missing_extra

LONGEST_CHECK = 20_000  # horizon up to which a file is checked before it is written


@dataclass(frozen=True)
class Enclosure:
    """An interval that contains the optimal cost J*, as the checker of proofs confirms.

    Attributes
    ----------
    lower, upper : float
        Bounds on J*, rounded outwards. Both are infinite if no trajectory is feasible; ``upper`` alone is if none was
        found that is strictly inside all inequalities.

    Examples
    --------
    >>> enclosure = lfo.solve(lfo.library.double_integrator()).enclosure
    >>> enclosure.width < 1e-9 * enclosure.lower
    True
    """

    lower: float
    upper: float

    @property
    def infeasible(self) -> bool:
        """Whether there is no feasible trajectory."""
        return self.lower == np.inf

    @property
    def width(self) -> float:
        """Return upper - lower; 0 without a feasible trajectory."""
        return 0.0 if self.infeasible else self.upper - self.lower

    def __str__(self) -> str:
        if self.infeasible:
            return "no trajectory is feasible"
        if self.upper == np.inf:
            return f"J* >= {self.lower!r}; no trajectory strictly inside all inequalities was found"
        return f"{self.lower!r} <= J* <= {self.upper!r}"


def require_checker() -> None:
    """Raise MissingExtraError unless the numbers of the checker are installed."""
    if find_spec("flint") is None:
        raise missing_extra("proofs", "python-flint", "proof")
