"""The last result of every row, kept in the repository: what, when, of which commit, where, at what cost."""

import datetime
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.validation.row import Found

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "docs" / "validation.json"
_PROGRAM = ("rig", "acquisition", "calibration", "processing")
_DIGITS = 6
"""Significant digits that are kept: more would make two equal measurements differ."""


@dataclass(frozen=True)
class Kept:
    """What one row measured last."""

    values: tuple[float, ...]
    detail: str
    date: str
    commit: str
    machine: str
    cpu_s: float


def read_kept(path: Path = FILE) -> dict[str, Kept]:
    """All of them by row; none where there is no file."""
    if not path.exists():
        return {}
    stored = json.loads(path.read_text(encoding="utf-8"))
    return {name: Kept(**{**row, "values": tuple(row["values"])}) for name, row in stored.items()}


def write_kept(kept: Mapping[str, Kept], path: Path = FILE) -> None:
    """All of them, in the order of their names, one row a line: rows of other machines merge."""
    lines = ",\n".join(
        f"{json.dumps(name)}: {json.dumps(asdict(kept[name]), ensure_ascii=False)}" for name in sorted(kept)
    )
    path.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


def kept_now(found: Found, cpu_s: float) -> Kept:
    """A result as of today, this commit and this machine."""
    return Kept(
        tuple(float(f"{value:.{_DIGITS}g}") for value in found.values),
        found.detail,
        datetime.datetime.now(datetime.UTC).date().isoformat(),
        program_commit(),
        machine(),
        round(cpu_s, 1),
    )


def program_commit() -> str:
    """The last commit that touched the program, not its tests; with a + where something is not committed."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    commit = git("log", "-1", "--format=%h", "--", *_PROGRAM)
    return (commit or "unknown") + ("+" if git("status", "--porcelain", "--", *_PROGRAM) else "")


def machine() -> str:
    """What can make a number differ, and nothing that names this machine."""
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, numpy {np.__version__}"
    )
