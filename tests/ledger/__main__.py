"""What a user sees of fixed sessions, kept beside the sources and compared: ``make ledger``.

``make ledger`` runs the cases and prints every difference from what is kept; ``make ledger ARGS="--write"``
keeps what they give now. A difference that is meant is explained by a line of ``explained.toml``, whose keys
are patterns ``CASE PATH``. The exit status is 1 where one is neither within the limits nor explained.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from difflib import unified_diff
from fnmatch import fnmatchcase
from html import unescape
from itertools import chain
from pathlib import Path

from rig.cli import GROUPS
from tests.ledger.cases import CASES, Case
from tests.ledger.numbers import Difference, Entry, differences, entries

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
WORKERS = os.cpu_count() or 1


def main() -> int:
    """Run the cases that are named, or all; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.ledger", description=__doc__)
    parser.add_argument("cases", nargs="*", help="names of cases, or help; default: all")
    parser.add_argument("--write", action="store_true", help="keep what the cases give now")
    parser.add_argument("--verbose", action="store_true", help="print every difference")
    given = parser.parse_args()
    known = [*(case.name for case in CASES), "help"]
    if unknown := set(given.cases) - set(known):
        parser.error(f"{', '.join(sorted(unknown))}: the cases are {', '.join(known)}")
    chosen = given.cases or known
    explained = tomllib.loads((FOLDER / "explained.toml").read_text(encoding="utf-8"))
    unexplained = 0
    with ThreadPoolExecutor(WORKERS) as pool:
        cases = [case for case in CASES if case.name in chosen]
        for case, (numbers, headings) in zip(cases, pool.map(_run, cases), strict=True):
            if given.write:
                _write_numbers(FOLDER / f"{case.name}.json", numbers, headings)
                print(f"{case.name}: {len(numbers)} entries, {len(headings)} headings")
            else:
                unexplained += _compare(case.name, numbers, headings, explained, verbose=given.verbose)
    if "help" in chosen:
        text, kept = "\n".join(_helps(())), FOLDER / "help.txt"
        if given.write:
            kept.write_text(text, encoding="utf-8")
        lines = _changed(kept.read_text(encoding="utf-8").splitlines(), text.splitlines())
        print(f"help: {len(lines)} lines of difference", *lines, sep="\n")
    if unexplained:
        print(f"{unexplained} differences are neither within the limits nor explained")
    return 1 if unexplained else 0


def _run(case: Case) -> tuple[dict[str, Entry], list[str]]:
    """Numbers of the results and headings of the report of a case."""
    with tempfile.TemporaryDirectory() as folder:
        if case.prepare is not None:
            case.prepare(Path(folder))
        words = [str(ROOT / word) if word.startswith("configs/") else word for word in case.words]
        for key, value in case.settings.items():
            words += ["--set", f"{key}={value}"]
        _rig([*words, "-o", "out"], Path(folder), case.status)
        out = Path(folder) / "out"
        results = json.loads((out / "results.json").read_text(encoding="utf-8"))
        return entries(results), _headings((out / "report.html").read_text(encoding="utf-8"))


def _rig(words: Sequence[str], folder: Path, status: int = 0) -> str:
    """What a command prints; raises RuntimeError with its messages where it ends with another status."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "80", "NO_COLOR": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "rig", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != status:
        raise RuntimeError(f"rig {' '.join(words)}: exit status {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout


def _changed(kept: Sequence[str], now: Sequence[str]) -> list[str]:
    return list(unified_diff(kept, now, "kept", "now", lineterm="", n=0))


def _headings(page: str) -> list[str]:
    found = re.findall(r"<h([1-6])[^>]*>(.*?)</h\1>", page, re.DOTALL)
    texts = (f"{level} {' '.join(unescape(re.sub('<[^>]*>', '', text)).split())}" for level, text in found)
    return [re.sub(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d)?( UTC)?", "DATE", text) for text in texts]


def _helps(command: tuple[str, ...]) -> Iterator[str]:
    """The help of a command and of all its subcommands."""
    text = _rig([*command, "--help"], ROOT)
    yield f"== rig {' '.join(command)}".rstrip()
    yield text
    listed = text.partition("\nCommands:\n")[2]
    names = re.findall(r"^  (\S+)", listed, re.MULTILINE) if command else chain.from_iterable(GROUPS.values())
    for name in names:
        yield from _helps((*command, name))


def _write_numbers(path: Path, numbers: Mapping[str, Entry], headings: Sequence[str]) -> None:
    """One line an entry, so that a difference between versions is read line by line."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(numbers.items())]
    lines.append(f'  "headings": {json.dumps(headings, ensure_ascii=False)}')
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _compare(
    case: str,
    numbers: Mapping[str, Entry],
    headings: Sequence[str],
    explained: Mapping[str, str],
    *,
    verbose: bool,
) -> int:
    """Print the differences of a case; returns how many are neither within the limits nor explained."""
    kept = json.loads((FOLDER / f"{case}.json").read_text(encoding="utf-8"))
    before = {key: value for key, value in kept.items() if key != "headings"}
    found = differences(case, before, numbers)
    reasons: Counter[str] = Counter()
    unexplained = 0
    for difference in found:
        reason = _reason(difference, explained)
        reasons[reason or difference.kind] += 1
        if reason is None and difference.kind in ("moved", "gone"):
            unexplained += 1
        if verbose or (reason is None and difference.kind != "within"):
            print(f"  {difference}")
    equal = len(before) - sum(difference.kind != "new" for difference in found)
    print(
        f"{case}: {equal} of {len(before)} entries equal", *_changed(kept["headings"], headings), sep="\n  "
    )
    for reason, count in reasons.items():
        print(f"  {count} {reason}")
    return unexplained


def _reason(difference: Difference, explained: Mapping[str, str]) -> str | None:
    name = f"{difference.case} {difference.path}"
    return next((reason for pattern, reason in explained.items() if fnmatchcase(name, pattern)), None)


if __name__ == "__main__":
    sys.exit(main())
