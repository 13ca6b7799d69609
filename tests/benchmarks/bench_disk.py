"""Disks that do not answer for 20 s during a session in real time: what is lost, and what is said."""

import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from acquisition.record.reader import RecordReader
from tests.acquisition.record.hanging_disk import NoFuse, mounted, wait_for
from tests.rig.command_line import CONFIGS, SMALL, rig_process, set_words

RATE_HZ = 100


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` hangs for 4 s."""
    hang_s = 4.0 if quick else 20.0
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        try:
            results = _session(Path(name), hang_s)
        except NoFuse as missing:
            results["not measured"] = str(missing)
    table = Table("a disk that hangs", "measured")
    for key, value in results.items():
        table.add_row(key, str(value))
    Console().print(table)
    return results


def _session(base: Path, hang_s: float) -> dict[str, Any]:
    """The simulated rig in real time, with windows of every frame."""
    with mounted(base) as disk:
        record = disk.folder / "out" / "run-1.mcap"

        def hang() -> None:
            wait_for(lambda: record.exists() and record.stat().st_size > 1_000_000)
            disk.hang()
            disk.wait_for_hanging()
            time.sleep(hang_s)
            disk.go_on()

        hanging = threading.Thread(target=hang)
        hanging.start()
        values = {
            **SMALL,
            "camera.frame_rate_hz": str(RATE_HZ),
            "session.max_duration_s": str(hang_s + 15.0),
            "simulation.real_time": "true",
        }
        rig_process("run", CONFIGS / "demo.toml", "-o", record.parent, *set_words(values))
        hanging.join()
        with RecordReader(record) as reader:
            sequences, losses = reader.spots()["sequence"], reader.losses()
            said = [event.text for event in reader.events() if event.kind == "slow disk"]
        return {
            "hung, s": hang_s,
            "frames/s": RATE_HZ,
            "frames recorded": len(sequences),
            "frames missing": int(sequences[-1]) + 1 - len(sequences),
            "counted as lost": "?" if losses is None else losses.total,
            "said": "; ".join(said),
        }
