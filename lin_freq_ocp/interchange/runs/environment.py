"""The environment of a run: versions and kind of machine; no names of users, machines or folders."""

from __future__ import annotations

import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version

from threadpoolctl import threadpool_info

from lin_freq_ocp.interchange.locations import FileTable

PACKAGE = "lin-freq-ocp"


def environment(backend: str | None = None) -> FileTable:
    """Return the versions of Python, of this package and of its dependencies, system, processor and BLAS, for JSON.

    ``backend`` is as given to solve; the package of a solver that qpsolvers calls is found by its name.
    """
    needed = [re.split(r"[^\w.-]", one, maxsplit=1)[0] for one in requires(PACKAGE) or () if "extra ==" not in one]
    solver = (backend or "").partition(":")[2]
    names = [PACKAGE, *needed, *([solver, f"{solver}py"] if solver else [])]
    blas = {" ".join(str(one.get(k)) for k in ("internal_api", "version", "architecture")) for one in threadpool_info()}
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.system(),
        "processor": platform.machine(),
        "packages": {name: found for name in names if (found := _version(name)) is not None},
        "blas": sorted(blas),
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
