"""Put the proof checker into the wheel twice, in its folder and as a module lfo_check, and the compiled C sources.

``force-include`` would move the file of the checker. A copy outside of the project is added instead. The libraries are
those that cross_compile.py wrote into build/libraries; an editable install has none.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class TopLevelChecker(BuildHookInterface):
    """Adds lfo_check.py to the root of the wheel, and of an editable install, where it is a copy, and the libraries."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Copy the file, name the copy, and name the libraries."""
        self.folder = TemporaryDirectory()
        copy = shutil.copy(Path(self.root, "lin_freq_ocp", "proof", "lfo_check.py"), self.folder.name)
        build_data["force_include"][copy] = "lfo_check.py"
        libraries = Path(self.root, "build", "libraries")
        if version == "standard":
            found = {str(path): str(path.relative_to(libraries)) for path in libraries.rglob("*.so")}
            build_data["force_include"].update(found)

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Delete the copy."""
        self.folder.cleanup()
