"""The command line."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "app": "COMMANDS cli main", "console": "BAD_INPUT NOT_PROVEN NO_SOLUTION fit_table out print_terms",
    "problems": "build", "show": "SCHEMAS as_toml",
})
