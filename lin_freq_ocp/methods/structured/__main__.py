"""Compile all loops of the methods ahead: ``python -m lin_freq_ocp.methods.structured``.

The modules whose names end in "kernels" contain the loops, and register them when they are imported.
"""

from importlib import import_module
from pkgutil import walk_packages

from lin_freq_ocp import methods
from lin_freq_ocp.methods.structured.kkt.compilation import Kernels

for module in walk_packages(methods.__path__, f"{methods.__name__}."):
    if module.name.endswith("kernels"):
        import_module(module.name)
for kernels in Kernels.registered:
    kernels.prepare()
