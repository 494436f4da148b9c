"""The faults of scripts/mutations/ fit the sources. Run by .ci/run: python -m pytest scripts/test_mutations.py."""

import json
import signal
import subprocess
from collections import Counter

import mutations
import pytest
from mutations import PACKAGE, ROOT, Mutation, all_mutations, read_log, select_mutations, table_of

from lin_freq_ocp.methods.native_code import compiler

FAULTS = all_mutations()
MISSING = "no longer matches: renew it"


@pytest.mark.parametrize("area", sorted({fault.area for fault in FAULTS}))
def test_every_fault_has_one_place_and_compiles(area):
    for fault in (fault for fault in FAULTS if fault.area == area):
        path, text = fault.text(ROOT / PACKAGE)
        assert text != (ROOT / PACKAGE / path).read_text(encoding="utf-8"), fault.name
        if path.suffix == ".py":
            compile(text, fault.name, "exec")
        elif (cc := compiler()) is not None:
            folder = (ROOT / PACKAGE / path).parent
            subprocess.run(
                [cc, "-std=c99", "-fsyntax-only", "-I", folder, "-x", "c", "-"], input=text.encode(), check=True
            )


def test_faults_have_names_of_their_own_and_tests_that_exist():
    assert [name for name, count in Counter(fault.name for fault in FAULTS).items() if count > 1] == []
    assert [name for fault in FAULTS for name in fault.tests if not (ROOT / "tests" / name).is_file()] == []


def test_at_most_three_are_no_faults():
    assert len([fault for fault in FAULTS if fault.no_fault]) <= 3


SOURCE = """
def far(x):
    return x + 1


class Near:
    def far(self, x):
        return (x +
                1)
"""


def package(tmp_path, **files):
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def fault(place, old="x + 1", new="x - 1"):
    return Mutation("area", f"fault of {place}", place, old, new, ("test_some.py",))


@pytest.mark.parametrize(("place", "line"), [("far", "    return x - 1"), ("Near.far", "        return (x - 1)")])
def test_a_place_is_a_definition_and_spaces_do_not_count(tmp_path, place, line):
    path, text = fault(place).text(package(tmp_path, some=SOURCE))
    assert path.name == "some.py"
    assert line in text.splitlines()
    assert text.count("x - 1") == 1


@pytest.mark.parametrize(
    ("place", "files"),
    [
        ("far", {"some": SOURCE.replace("x + 1", "x + 2")}),
        ("far", {"some": SOURCE, "other": SOURCE}),
        ("some.py", {"some": SOURCE}),
        ("gone", {"some": SOURCE}),
    ],
    ids=["changed", "two files", "twice in a file", "no such function"],
)
def test_a_fault_that_fits_no_longer_is_said_by_name(tmp_path, place, files):
    with pytest.raises(SystemExit, match=f"pattern of mutation fault of {place} {MISSING}"):
        fault(place).text(package(tmp_path, **files))


def test_a_place_in_c_is_one_function(tmp_path):
    body = "int near(int x) {\n  return x + 1;\n}\n\nstatic int far(\n    int x) {\n  return x + 1;\n}\n"
    (tmp_path / "some.c").write_text(body)
    path, text = fault("far").text(tmp_path)
    assert (path.name, text) == ("some.c", "x - 1".join(body.rsplit("x + 1", 1)))


def test_a_log_that_was_cut_off_keeps_what_is_whole(tmp_path):
    one, other = fault("far"), fault("Near.far")
    log = tmp_path / "log"
    log.write_text(json.dumps({"key": one.key, "noticed": False, "by": "", "seconds": 1.0}) + '\n{"key": "[')
    results = read_log(log)
    assert set(results) == {one.key}
    table, unexplained = table_of([one, other], results)
    assert (table.row_count, unexplained) == (1, [one])


def test_faults_are_chosen_by_name_or_file():
    area = FAULTS[0].area
    assert select_mutations(FAULTS, []) == FAULTS
    assert select_mutations(FAULTS, [FAULTS[-1].name]) == FAULTS[-1:]
    assert {one.area for one in select_mutations(FAULTS, [area])} == {area}
    with pytest.raises(SystemExit, match="nothing"):
        select_mutations(FAULTS, ["nothing"])


def repository(tmp_path, monkeypatch, **tests):
    """A repository whose package has one module, with the two faults of ``SOURCE`` there."""
    for name, text in {f"{PACKAGE}/__init__.py": "", f"{PACKAGE}/some.py": SOURCE, "tests/test_some.py": ""}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(tests.get(name.split("/")[-1].removesuffix(".py"), text))
    monkeypatch.setattr(mutations, "ROOT", tmp_path)
    return [fault("far"), fault("Near.far")]


def test_the_fault_that_no_test_notices_survives(tmp_path, monkeypatch):
    test = f"from {PACKAGE}.some import far\n\n\ndef test_far():\n    assert far(1) == 2\n"
    noticed, survivor = repository(tmp_path, monkeypatch, test_some=test)
    mutations.try_all([noticed, survivor], workers=2, cpu=60, log=tmp_path / "log")
    results = read_log(tmp_path / "log")
    assert [results[one.key]["noticed"] for one in (noticed, survivor)] == [True, False]
    assert results[noticed.key]["by"] == "tests/test_some.py::test_far"
    assert (tmp_path / PACKAGE / "some.py").read_text() == SOURCE


def test_a_fault_that_hangs_or_cannot_be_imported_is_noticed(tmp_path, monkeypatch):
    faults = repository(tmp_path, monkeypatch, test_some="def test():\n    while True:\n        pass\n")
    runner = mutations.Runner(cpu=2)
    assert runner.run(tmp_path, faults[0].tests).status == -signal.SIGXCPU
    (tmp_path / "tests" / "test_some.py").write_text("import no_such_module\n")
    outcome = runner.run(tmp_path, faults[0].tests)
    assert (outcome.status, outcome.failed) == (mutations.INTERRUPTED, "tests/test_some.py")


def test_tests_that_fail_without_any_fault_end_the_run(tmp_path, monkeypatch):
    faults = repository(tmp_path, monkeypatch, test_some="def test():\n    assert False\n")
    with pytest.raises(SystemExit, match=r"without any fault, .* status 1: tests/test_some.py::test"):
        mutations.try_all(faults, workers=1, cpu=60, log=tmp_path / "log")
