"""Do the tests notice faults? Each fault is put into a copy of the repository alone, and the tests near it are run.

    python scripts/mutations.py [NAME]... [--workers 2] [--cpu 200] [--log build/mutations.jsonl] [--resume]

With NAMEs, it tries the faults of these files of scripts/mutations/, or of these names. A fault is noticed if a test
fails, if the process dies, or if it takes more CPU time than the limit. First the tests of all chosen faults run once,
shared among the workers, on the copy without any fault: they must pass, and they fill the caches of compiled code. The
log has a line for each result; with --resume, faults of the log are not tried again. All faults take some 12 minutes
of CPU time. Exit status 1 if a fault survives for which no reason is stated.

A fault is an entry of a file in scripts/mutations/:

    name = "words-of-the-fault"
    in = "box_minimum"             # a function, a class or a method; or a file, such as "peaks.py"
    old = "a piece of its text"    # it occurs there once; spaces and line ends do not count
    new = "the text in its place"
    tests = ["certificate/test_reach.py"]    # in this order; by default the ``tests`` of the file
    no_fault = "a sentence"        # why the change is no fault, if it survives

The place is looked up in the whole package, so that an entry survives when its code moves to another file.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.util import cache_from_source
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "lin_freq_ocp"
TABLES = ROOT / "scripts" / "mutations"
LEFT_OUT = (".git", ".venv", "build", "dist", "_build", ".*_cache", ".hypothesis")
OPTIONS = ("-x", "-n", "0", "-p", "no:cacheprovider", "--tb=no", "-rfE", "--no-header")
FAILED, INTERRUPTED = 1, 2  # exit statuses of pytest; the second if a file of tests cannot be imported


@dataclass(frozen=True)
class Mutation:
    """One fault: a change of one place, and the tests that should notice it."""

    area: str
    name: str
    place: str
    old: str
    new: str
    tests: tuple[str, ...]
    no_fault: str = ""

    @property
    def key(self) -> str:
        """Return the fault as the log names it: with another change or other tests, it is another fault."""
        return json.dumps([self.name, self.place, self.old, self.new, self.tests])

    def locate(self, package: Path) -> tuple[Path, int, int]:
        """Return the file, relative to the package, with the begin and the end of the text; it must be there once."""
        pattern = re.compile(r"\s+".join(map(re.escape, self.old.split())))
        found = [
            (path, *match.span())
            for path, text in sources(package)
            for match in pattern.finditer(text)
            if any(begin <= match.start() and match.end() <= end for begin, end in spans(path, text, self.place))
        ]
        if len(found) != 1:
            sys.exit(f"pattern of mutation {self.name} no longer matches: renew it ({len(found)} matches, not 1)")
        return found[0]

    def text(self, package: Path) -> tuple[Path, str]:
        """Return the file, relative to the package, and its text with the fault."""
        path, begin, end = self.locate(package)
        text = (package / path).read_text(encoding="utf-8")
        return path, text[:begin] + self.new + text[end:]


@cache
def sources(package: Path) -> list[tuple[Path, str]]:
    """Return the sources of the package in Python and C, each with its path in there."""
    paths = sorted(path for ending in ("*.py", "*.c") for path in package.rglob(ending))
    return [(path.relative_to(package), path.read_text(encoding="utf-8")) for path in paths]


@cache
def spans(path: Path, text: str, place: str) -> list[tuple[int, int]]:
    """Return begin and end of every definition of a name in a file; of the whole file if the place is its name."""
    if place == path.name:
        return [(0, len(text))]
    if path.suffix == ".c":
        function = re.compile(rf"^\w[^\n;]*\b{re.escape(place)}\([^;]*?\{{\n.*?^\}}", re.MULTILINE | re.DOTALL)
        return [match.span() for match in function.finditer(text)]
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    return [
        (starts[node.lineno - 1], starts[node.end_lineno or node.lineno])
        for name, node in definitions(ast.parse(text), "")
        if name == place
    ]


def definitions(node: ast.AST, prefix: str) -> Iterator[tuple[str, ast.FunctionDef | ast.ClassDef]]:
    """Yield the functions and classes with their names: a method's begins with that of its class."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
            yield prefix + child.name, child
            yield from definitions(child, f"{prefix}{child.name}.")


def all_mutations() -> list[Mutation]:
    """Return all faults, by areas."""
    mutations = list[Mutation]()
    for path in sorted(TABLES.glob("*.toml")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        for entry in table["mutation"]:
            fields = {"tests": table["tests"], **entry}
            place, tests = fields.pop("in"), tuple(fields.pop("tests"))
            mutations.append(Mutation(area=path.stem, place=place, tests=tests, **fields))
    return mutations


def select_mutations(mutations: Iterable[Mutation], names: list[str]) -> list[Mutation]:
    """Return the faults of these names or areas, all without any name."""
    mutations = list(mutations)
    unknown = set(names) - {mutation.name for mutation in mutations} - {mutation.area for mutation in mutations}
    if unknown:
        sys.exit(f"no fault or file of faults is named {', '.join(sorted(unknown))}")
    return [mutation for mutation in mutations if not names or {mutation.name, mutation.area} & set(names)]


def copy_repository(source: Path, target: Path) -> Path:
    """Copy a repository without what is built or downloaded; times of files stay, and so caches of code stay valid."""
    shutil.copytree(source, target, ignore=shutil.ignore_patterns(*LEFT_OUT) if source == ROOT else None)
    return target


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of tests that import the copy in a folder and keep compiled code in there."""
    paths = {"PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(folder / ".cache")}
    return {**os.environ, **paths, "OPENBLAS_NUM_THREADS": "1", "SEEDS_OF_TESTS": "all"}


def require_copy(folder: Path) -> None:
    """Exit if Python imports the package from elsewhere than from the copy."""
    command = [sys.executable, "-c", f"import {PACKAGE}; print({PACKAGE}.__file__)"]
    done = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=True)
    if Path(done.stdout.strip()).resolve().parent != (folder / PACKAGE).resolve():
        sys.exit(f"the tests would import {done.stdout.strip()}, not the copy in {folder}")


@dataclass(frozen=True)
class Outcome:
    """The exit status of tests, the test that failed, their CPU time in seconds, and what they print."""

    status: int
    failed: str
    seconds: float
    output: str


@dataclass
class Runner:
    """Runs tests in copies; ``stop`` ends all of them."""

    cpu: int
    running: set[int] = field(default_factory=set)
    stopped: bool = False

    def run(self, folder: Path, tests: Iterable[str], times: int = 1) -> Outcome:
        """Run tests until the first one fails; every process may use the CPU time of the limit so many times."""
        if self.stopped:
            raise KeyboardInterrupt
        command = [sys.executable, "-m", "pytest", *OPTIONS, *(f"tests/{name}" for name in tests)]
        with tempfile.TemporaryFile("w+", encoding="utf-8") as file:
            output = {"stdout": file, "stderr": file}
            process = subprocess.Popen(command, cwd=folder, env=environment(folder), start_new_session=True, **output)
            resource.prlimit(process.pid, resource.RLIMIT_CPU, (times * self.cpu, times * self.cpu + 5))
            self.running.add(process.pid)
            _, status, usage = os.wait4(process.pid, 0)
            self.running.discard(process.pid)
            process.returncode = os.waitstatus_to_exitcode(status)
            file.seek(0)
            text = file.read()
        failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", text, re.MULTILINE)
        return Outcome(process.returncode, failed[1] if failed else "", usage.ru_utime + usage.ru_stime, text)

    def stop(self) -> None:
        """End the tests that are running, and begin no others."""
        self.stopped = True
        for pid in list(self.running):
            with suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)

    def try_out(self, mutation: Mutation, path: Path, text: str, pristine: Path) -> dict[str, object]:
        """Return what came of a fault, the text of a file of the package, as the log keeps it."""
        folder = copy_repository(pristine, pristine.parent / mutation.name)
        faulty = folder / PACKAGE / path
        faulty.write_text(text, encoding="utf-8")
        Path(cache_from_source(str(faulty))).unlink(missing_ok=True)  # it may be as old and as long as the text
        outcome = self.run(folder, mutation.tests)
        shutil.rmtree(folder)
        if outcome.status not in (0, FAILED, INTERRUPTED) and outcome.status >= 0:
            sys.exit(f"{mutation.name}: pytest ends with status {outcome.status}\n{outcome.output}")
        by = outcome.failed or ("" if outcome.status == 0 else f"ends by signal {-outcome.status}")
        return {"key": mutation.key, "noticed": outcome.status != 0, "by": by, "seconds": round(outcome.seconds, 1)}


def read_log(path: Path) -> dict[str, dict[str, object]]:
    """Return the results of a log by the keys of their faults; a last line that was cut off does not count."""
    results = dict[str, dict[str, object]]()
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        with suppress(json.JSONDecodeError):
            result = json.loads(line)
            results[result["key"]] = result
    return results


def try_all(mutations: list[Mutation], workers: int, cpu: int, log: Path) -> None:
    """Try faults by several workers, and write each result into the log."""
    runner = Runner(cpu)
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder, log.open("a", encoding="utf-8") as file:
        pristine = copy_repository(ROOT, Path(folder) / "pristine")
        require_copy(pristine)
        faults = [(mutation, *mutation.text(pristine / PACKAGE)) for mutation in mutations]
        tests = list(dict.fromkeys(name for mutation in mutations for name in mutation.tests))
        with ThreadPoolExecutor(workers) as pool:
            try:
                parts = [tests[i::workers] for i in range(min(workers, len(tests)))]
                for part in pool.map(lambda names: runner.run(pristine, names, times=20), parts):
                    if part.status != 0:
                        sys.exit(f"without any fault, the tests end with status {part.status}: {part.failed}")
                    print(f"without any fault, tests pass in {part.seconds:.0f} s of CPU time", flush=True)
                tasks = {pool.submit(runner.try_out, *fault, pristine): fault[0] for fault in faults}
                for task in as_completed(tasks):
                    result = task.result()
                    file.write(json.dumps(result) + "\n")
                    file.flush()
                    print(f"{tasks[task].name}: {result['by'] or 'SURVIVES'} ({result['seconds']} s)", flush=True)
            except KeyboardInterrupt:
                print("interrupted; --resume goes on")
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
                runner.stop()


def table_of(mutations: list[Mutation], results: dict[str, dict[str, object]]) -> tuple[Table, list[Mutation]]:
    """Return a table of the survivors, and those without a reason."""
    table = Table("fault", "where", "change", "tests", "why it is no fault", title="Survivors")
    survivors = [mutation for mutation in mutations if results.get(mutation.key, {"noticed": True})["noticed"] is False]
    for fault in survivors:
        change = f"- {fault.old}\n+ {fault.new}"
        table.add_row(fault.name, fault.place, change, "\n".join(fault.tests), fault.no_fault or "it is one")
    return table, [fault for fault in survivors if not fault.no_fault]


def main() -> int:
    """Try the chosen faults and print the survivors; return 1 if one has no reason."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="faults or files of faults; default: all")
    parser.add_argument("--workers", type=int, default=2, help="faults that are tried at a time")
    parser.add_argument("--cpu", type=int, default=200, help="limit of CPU time of a fault, in seconds")
    parser.add_argument("--log", type=Path, default=ROOT / "build" / "mutations.jsonl", help="file of the results")
    parser.add_argument("--resume", action="store_true", help="do not try again what the log has")
    options = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background, Python would ignore the first
        signal.signal(number, signal.default_int_handler)
    mutations = select_mutations(all_mutations(), options.names)
    options.log.parent.mkdir(parents=True, exist_ok=True)
    if not options.resume:
        options.log.unlink(missing_ok=True)
    left = [mutation for mutation in mutations if mutation.key not in read_log(options.log)]
    if left:
        try_all(left, options.workers, options.cpu, options.log)
    results = read_log(options.log)
    tried = [results[mutation.key] for mutation in mutations if mutation.key in results]
    table, unexplained = table_of(mutations, results)
    Console(width=200, markup=False).print(table)
    seconds = sum(float(str(result["seconds"])) for result in tried)
    print(f"{len(tried)} of {len(mutations)} faults tried, {table.row_count} survive; {seconds:.0f} s of CPU time")
    return 1 if unexplained or len(tried) < len(mutations) else 0


if __name__ == "__main__":
    sys.exit(main())
