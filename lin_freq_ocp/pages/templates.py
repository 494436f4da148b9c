"""Pages from templates: values are escaped, and a missing value is an error."""

from __future__ import annotations

from importlib.metadata import version

from jinja2 import Environment, PackageLoader, StrictUndefined


def render_template(template: str, **values: object) -> str:
    """Return a page from a template in ``pages/templates``; every template gets the version of the package."""
    environment = Environment(
        loader=PackageLoader("lin_freq_ocp.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(version=version("lin-freq-ocp"), **values)
