"""What became of one problem of a trial."""

from __future__ import annotations

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
