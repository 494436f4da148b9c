"""Named problems, each with its source; `lin-freq-ocp list` shows them."""

from __future__ import annotations

from lin_freq_ocp.library.pendulum import pendulum

__all__ = ["pendulum"]
