"""Modules of tests that import python-flint, of the extra proof, are skipped where it is missing."""

from __future__ import annotations

from typing import Any

import pytest


class SkippedModule(pytest.Module):
    """A module that is skipped if it cannot be imported without python-flint."""

    def collect(self) -> Any:
        """Collect the tests; the checker of proofs ends the process that imports it."""
        try:
            return super().collect()
        except (SystemExit, self.CollectError) as error:
            if isinstance(error, SystemExit) or "flint" in str(error):
                pytest.skip("needs python-flint, of the extra proof", allow_module_level=True)
            raise
