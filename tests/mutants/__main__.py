"""Single mutations of the sources, and which of them the tests of their room notice: ``make mutants``.

Each is made in a copy of the tree, compiled kernels included, so that nothing here changes. Tests that do not
wait for the real world come first; a test that fails, or does not end, has caught the mutation.
"""

import argparse
import difflib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.mutations import Mutation, mutations
from tests.mutants.nearest import ORDER, nearest_first

TREE = Path(__file__).resolve().parents[2]
ROOMS = ("processing", "acquisition/record", "rig/measure", "rig/analysis", "rig/control")
MARKS = (
    "not realtime and not slow and not bench and not kernel",
    "realtime and not slow and not bench and not kernel",
)
"""What is run, one after the other."""
WORK = TREE / "build" / "mutants"
CACHE = WORK / "cache"
COPIED = ("rig", "acquisition", "calibration", "processing", "tests", "configs", "docs")
NO_TESTS = 5
"""What pytest returns where nothing was to be run."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What noticed it: a test, the clock, or (empty) nothing."""

    caught_by: str
    seconds: float


class Copies:
    """A copy of the tree as it is, and beside it one that is mutated and thrown away."""

    def __init__(self, folder: Path) -> None:
        self.whole, self._mutated = folder / "whole", folder / "mutated"
        self.whole.mkdir(parents=True, exist_ok=True)
        for name in COPIED:
            _mirror(TREE / name, self.whole / name)
        for path in TREE.iterdir():
            if path.is_file():
                shutil.copy2(path, self.whole / path.name)

    def mutated(self, module: Path, text: bytes) -> Path:
        """A tree with one module changed. Files are shared with the whole one, and replaced where written."""
        shutil.rmtree(self._mutated, ignore_errors=True)
        shutil.copytree(self.whole, self._mutated, copy_function=os.link)
        (self._mutated / module).unlink()
        (self._mutated / module).write_bytes(text)
        return self._mutated


def _mirror(source: Path, target: Path) -> None:
    """Copy what changed, remove what is gone; compiled code that the copy has already stays."""
    for path in target.rglob("*"):
        compiled = path.parent.name == "__pycache__"
        if path.is_file() and not compiled and not (source / path.relative_to(target)).is_file():
            path.unlink()
    for path in source.rglob("*"):
        there, compiled = target / path.relative_to(source), path.parent.name == "__pycache__"
        if path.is_file() and not (there.is_file() and (compiled or _as_old(path, there))):
            there.parent.mkdir(parents=True, exist_ok=True)
            there.unlink(missing_ok=True)
            shutil.copy2(path, there)


def _as_old(path: Path, other: Path) -> bool:
    return path.stat().st_mtime_ns == other.stat().st_mtime_ns


def run_tests(
    tree: Path, files: Sequence[Path], marks: str, limit_s: float, *words: str
) -> tuple[int | None, list[str]]:
    """pytest's status, None where it did not end in time, and its lines on what failed."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "CI": "1"}
    environment[ORDER] = os.pathsep.join(str(file) for file in files)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    usual = [
        "-q",
        "-n",
        "0",
        "-p",
        "tests.mutants.nearest",
        "--tb=no",
        "-m",
        marks,
        "-o",
        f"cache_dir={CACHE}",
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "pytest", *usual, *words, *map(str, files)],
        cwd=tree,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            said, _ = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None, ["no end"]
    return process.returncode, [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]


def there(tree: Path, files: Sequence[Path]) -> list[Path]:
    """Those of the files that a copy of the tree has: with another one pytest does not begin."""
    return [file for file in files if (tree / file).is_file()]


def outcome(
    copies: Copies, module: Path, mutation: Mutation, marks: Sequence[str], limit_s: float
) -> Outcome:
    """Whether the tests of the room notice it."""
    files, began_s = there(copies.whole, nearest_first(module, mutation.within)), time.monotonic()
    tree = copies.mutated(module, mutation.applied((copies.whole / module).read_bytes()))
    for marked in marks:
        status, failed = run_tests(tree, files, marked, limit_s, "-x")
        if status not in (0, NO_TESTS):
            nothing_said = "no end" if status is None else "the tests do not begin"
            return Outcome((failed or [nothing_said])[0], time.monotonic() - began_s)
    return Outcome("", time.monotonic() - began_s)


def failing_anyway(copies: Copies, tests: Sequence[str], limit_s: float) -> set[str]:
    """Those of the tests that fail without any mutation, too: they have noticed nothing."""
    if not tests:
        return set()
    _, failed = run_tests(copies.whole, [], "", limit_s, *tests)
    return {_test_of(line) for line in failed}


def _test_of(failed: str) -> str:
    """Its name in pytest's line."""
    return failed.split(" - ")[0].split(" ", 1)[-1]


def difference(module: Path, mutation: Mutation) -> str:
    """The lines before and after."""
    before = module.read_bytes()
    texts = [text.decode().splitlines() for text in (before, mutation.applied(before))]
    return "\n".join(f"    {line}" for line in list(difflib.unified_diff(*texts, lineterm="", n=1))[2:])


def chosen(paths: Sequence[str], count: int, seed: int) -> list[tuple[Path, Mutation]]:
    """So many of all mutations of the modules below the paths, each as likely as any other."""
    modules = sorted({file for path in paths for file in _modules(Path(path))})
    every = [(module, mutation) for module in modules for mutation in mutations(module.read_bytes())]
    return random.Random(seed).sample(every, min(count, len(every)))


def _modules(path: Path) -> list[Path]:
    if not path.exists():
        sys.exit(f"{path}: no such room or module; state one as {ROOMS[0]} or {ROOMS[0]}/periods.py")
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


def main() -> None:
    """Make them one after the other and print what became of each."""
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__)
    parser.add_argument("paths", nargs="*", default=ROOMS, help="rooms or modules")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    parser.add_argument("-n", "--count", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="without the tests that wait for the real world")
    parser.add_argument("--limit-s", type=float, default=900.0, help="for the tests of one mutation")
    parser.add_argument("--list", action="store_true", help="only print the mutations")
    options = parser.parse_args()
    os.chdir(TREE)
    sample = chosen(options.paths, options.count, options.seed)
    copies = None if options.list else Copies(WORK)
    noticed: dict[str, list[str]] = {}
    survivors = []
    for number, (module, mutation) in enumerate(sample, 1):
        line = module.read_bytes()[: mutation.start].count(b"\n") + 1
        place, shown = f"{number:3d} {module}:{line}", difference(module, mutation)
        if copies is None:
            print(f"{place}\n{shown}")
            continue
        found = outcome(copies, module, mutation, MARKS[: 1 if options.quick else 2], options.limit_s)
        if found.caught_by:
            noticed.setdefault(_test_of(found.caught_by), []).append(place)
            print(f"{place}: caught in {found.seconds:.0f} s: {found.caught_by[:160]}", flush=True)
        else:
            survivors.append(f"{place}\n{shown}")
            print(f"{place}: SURVIVED, {found.seconds:.0f} s\n{shown}", flush=True)
    if copies is None:
        return
    unjudged = 0
    for test in failing_anyway(
        copies, [test for test in noticed if test.startswith("tests/")], options.limit_s
    ):
        for place in noticed.get(test, []):
            unjudged += 1
            print(f"{place}: not judged, since {test} fails without it, too")
    print("\n".join(["", *survivors]))
    judged = len(sample) - unjudged
    print(f"seed {options.seed}: {judged - len(survivors)} of {judged} mutations were caught")


if __name__ == "__main__":
    main()
