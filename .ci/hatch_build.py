"""Put the proof checker into the wheel twice: in its folder, and as the top-level module lfo_check.

``force-include`` would move the file there. A copy outside of the project is added instead.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class TopLevelChecker(BuildHookInterface):
    """Adds lfo_check.py to the root of the wheel, and of an editable install, where it is a copy, too."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Copy the file and name the copy."""
        self.folder = TemporaryDirectory()
        copy = shutil.copy(Path(self.root, "lin_freq_ocp", "proof", "lfo_check.py"), self.folder.name)
        build_data["force_include"][copy] = "lfo_check.py"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Delete the copy."""
        self.folder.cleanup()
