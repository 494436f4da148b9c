"""What became of one problem of a trial."""

from __future__ import annotations

import traceback
from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """What was said of one problem; ``wrong`` is empty if nothing refutes it."""

    seed: int
    kind: str
    statuses: tuple[str, ...]
    wrong: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is refuted."""
        return not self.wrong


def finding_of(error: Exception) -> str:
    """Return an error that is a finding, with the place that raised it."""
    return "".join(traceback.format_exception(error)).rstrip()
