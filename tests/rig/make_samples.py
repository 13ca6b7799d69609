"""Makes the sessions that tests read, `tests/rig/data/samples`, again: ``python -m tests.rig.make_samples``.

To be run where a schema, a key of the configuration or a name in results.json has changed.
"""

import json
import math
import shutil
import tempfile
from contextlib import chdir
from pathlib import Path
from unittest.mock import patch

import numpy as np

from acquisition.camera import Frame
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import HalfCycle
from rig.analysis import analyse_record, session_results
from rig.analysis.results_file import write_results
from rig.instrument.provenance import CONFIGURATION_NAME
from rig.settings import Configuration
from tests.rig.command_line import rig

SAMPLES = Path(__file__).parent / "data" / "samples"
_KEPT = ("run-1.mcap", "run-1.pixels.mcap", "run-2.mcap", "run-2.pixels.mcap", "session.json", "results.json")
_CUT = 0.8
"""The part that is left of a record whose program was killed."""


def make(folder: Path) -> None:
    """A whole run (`first`), a series killed in its second run, and a run in px without a lever."""
    short = ("session.runs=1", "record.windows=false", "session.max_duration_s=30")
    _run("first", *short)
    _run("series")
    for name in ("series/run-2.mcap", "series/run-2.pixels.mcap", "series/session.json"):
        path = folder / name
        if path.suffix == ".json":
            state = json.loads(path.read_text())
            state["entries"][1] |= {"state": "recording", "reason": "", "ended_utc": ""}
            path.write_text(json.dumps(state, indent=1))
        else:
            data = path.read_bytes()
            path.write_bytes(data[: int(_CUT * len(data))])
    (folder / "series" / "results.json").unlink()
    fitted = rig("fit", "series/run-1.mcap", "-o", "series")
    assert fitted.returncode == 0, fitted.stderr
    _session_in_pixels(folder / "uncalibrated")


def _session_in_pixels(folder: Path) -> None:
    """A record of 40 s in px, with a period of 4 s and a log decrement of 0.04, and its results."""
    folder.mkdir()
    time_s = np.arange(0, 40, 0.02)
    y = 100 * np.exp(-0.01 * time_s) * np.cos(2 * math.pi * time_s / 4.0)
    x, u = 0.1 * y, np.full_like(y, 0.01)
    spots = [Spot(32 + a, 120 + b, 0.01, 0.01, 3, 3, 0, 200, 8, 1, 0) for a, b in zip(x, y, strict=True)]
    record, tree = folder / "run-1.mcap", Configuration(camera={"driver": "simulated"}).model_dump_json()
    attachments = {CONFIGURATION_NAME: tree.encode()}
    epoch_ns = 1_700_000_000_000_000_000
    with RecordWriter(record, epoch_ns, attachments=attachments, deflection_unit=DeflectionUnit.PX) as writer:
        times_ns = np.round(time_s * 1e9).astype(np.int64)
        deflections = Deflections(times_ns, x, y, u, u, DeflectionUnit.PX)
        writer.write_spots(list(range(len(y))), times_ns.tolist(), times_ns.tolist(), spots, deflections)
        image = np.full((240, 64), 8, dtype=np.uint8)
        image[218:223, 40:45] = 200
        writer.write_image(Frame(image, 0, 0, 0))
        for index in range(20):
            turn_ns, amplitude, side = (
                2_000_000_000 * index,
                100 * math.exp(-0.02 * index),
                1 - 2 * (index % 2),
            )
            writer.write_half_cycle(HalfCycle(index, turn_ns, 1e-4, amplitude, 0.01, 2.0, 1e-4, 0.0, side, 0))
    write_results(folder / "results.json", session_results([analyse_record(record)], folder))


def _run(name: str, *changes: str) -> None:
    done = rig("run", "session.toml", "-o", name, *[word for each in changes for word in ("--set", each)])
    # 1 where a condition is not met: a sample drops more frames than a run should
    assert done.returncode in (0, 1), done.stderr
    assert (Path(name) / "results.json").exists(), done.stderr


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place, chdir(place):
        made = Path(place)
        shutil.copytree(SAMPLES / "calibrations", made / "calibrations")
        shutil.copy(SAMPLES / "session.toml", made)
        with (
            patch("socket.gethostname", return_value="laboratory"),
            patch("platform.platform", return_value="Linux"),
            patch("rig.instrument.provenance.code_commit", return_value="unknown"),
        ):
            make(made)
        for sample in ("first", "series", "uncalibrated"):
            (SAMPLES / sample).mkdir(exist_ok=True)
            for file in _KEPT:
                (SAMPLES / sample / file).unlink(missing_ok=True)
                if (made / sample / file).exists():
                    shutil.copy(made / sample / file, SAMPLES / sample)
