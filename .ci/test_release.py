"""Recipe, citation and image agree with pyproject.toml and the package in all that a release states twice.

Run by .ci/run: python -m pytest .ci/test_release.py
"""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from jinja2 import Template

import lin_freq_ocp as lfo

ROOT = Path(__file__).parents[1]
CONDA_NAMES = {"matplotlib": "matplotlib-base"}  # without a toolkit for windows
WHOLE = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = WHOLE["project"]


@pytest.fixture(scope="module")
def recipe():
    text = (ROOT / ".ci" / "conda" / "meta.yaml").read_text()
    return yaml.safe_load(Template(text).render(PYTHON="python"))


def as_pairs(requirements):
    """Split each requirement into name and versions: (numpy, >=1.26)."""
    return {name.strip(): f">={least.strip()}" for name, _, least in (one.partition(">=") for one in requirements)}


def test_the_recipe_asks_for_what_the_wheel_asks_for(recipe):
    wheel = {CONDA_NAMES.get(name, name): least for name, least in as_pairs(PROJECT["dependencies"]).items()}
    python = "python" + PROJECT["requires-python"]
    assert as_pairs(recipe["requirements"]["run"]) == wheel | as_pairs([python])
    assert as_pairs(recipe["requirements"]["host"]) == as_pairs([python, "pip", *WHOLE["build-system"]["requires"]])


def test_the_recipe_builds_the_same_package(recipe):
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    assert recipe["source"]["url"].endswith(f"dist/lin_freq_ocp-{PROJECT['version']}.tar.gz")
    assert recipe["build"]["entry_points"] == [f"{name} = {to}" for name, to in PROJECT["scripts"].items()]
    assert (recipe["about"]["summary"], recipe["about"]["license"]) == (PROJECT["description"], PROJECT["license"])


def test_extras_that_messages_name_exist():
    calls = (
        re.findall(r'missing_extra\(.*"(\w+)"\)', path.read_text()) for path in Path(lfo.__file__).parent.rglob("*.py")
    )
    named = {name for found in calls for name in found}
    assert "compiler" in named <= PROJECT["optional-dependencies"].keys()


def test_there_is_one_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert PROJECT["version"] == lfo.__version__ == citation["version"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_image_is_made_of_files_that_are_there():
    lines = (ROOT / ".ci" / "Dockerfile").read_text().splitlines()
    copied = [name for line in lines if line.startswith("COPY") for name in line.split()[1:-1]]
    wheel = WHOLE["tool"]["hatch"]["build"]["targets"]["wheel"]
    packed = {*wheel["packages"], ".ci/hatch_build.py"}
    assert {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"]} | packed == set(copied)
    assert all((ROOT / name).exists() for name in copied)
