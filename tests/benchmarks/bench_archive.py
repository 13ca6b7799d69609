"""An archive of 10,000 sessions: a list, an update of one changed folder, an update that finds nothing new.

Run as ``python -m tests.benchmarks archive [--quick]``. The folders hold links to the files of one real
session; their rows are clones of its rows, with hashes of their own.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rig.archive.catalogue import write_sessions, writing
from rig.archive.session_rows import session_rows
from rig.archive.updating import sessions_below

_SERIES = Path(__file__).resolve().parents[1] / "rig" / "data" / "older" / "series"


def run(quick: bool = False) -> dict[str, Any]:
    """Seconds by the wall clock, the least of three; `quick` takes a hundredth of the sessions."""
    with tempfile.TemporaryDirectory() as name:
        results = _measured(Path(name), 100 if quick else 10_000)
    for key, value in results.items():
        print(f"  {key}: {value:,.4g}", flush=True)
    return results


def _measured(folder: Path, count: int) -> dict[str, float]:
    runs, archive = folder / "runs", folder / "archive.duckdb"
    original = runs / "original"
    original.mkdir(parents=True)
    for path in _SERIES.iterdir():
        (original / path.name).write_bytes(path.read_bytes())
    for number in range(count - 1):
        place = runs / f"{number // 100:04d}" / f"session-{number:05d}"
        place.mkdir(parents=True)
        for path in original.iterdir():
            os.link(path, place / path.name)
    template = session_rows(original).rows
    sessions = {str(place): files for place, files in sessions_below(runs, [])}
    rows = [
        row | {"folder": place, "sha256": _hash(f"{place} {row['run']}"), "session": _hash(place)}
        for place in sessions
        for row in template
    ]
    with writing(archive) as connection:
        connection.execute("insert into folders values (?)", [str(runs)])
        write_sessions(connection, sessions, rows)
    found = {"sessions": float(len(sessions)), "file, MB": archive.stat().st_size / 1e6}
    condition = "b > 0.03 and sample like '%K8%' order by began_utc limit 20"
    for what, words in (("list", ("list", condition)), ("update of nothing", ("update",))):
        found[f"{what}, s"] = min(_taken(*words, "--archive", archive) for _ in range(3))
    times = []
    for number in range(3):
        changed = runs / "0000" / f"session-{number:05d}" / "results-2.json"
        changed.write_bytes((original / "results.json").read_bytes())
        times.append(_taken("update", "--archive", archive))
    return found | {"update of one folder, s": min(times)}


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _taken(*words: str | Path) -> float:
    began_s = time.monotonic()
    subprocess.run(
        [sys.executable, "-m", "rig", "archive", *map(str, words)], check=True, capture_output=True
    )
    return time.monotonic() - began_s
