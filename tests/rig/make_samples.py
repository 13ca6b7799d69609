"""Makes the sessions that tests read, `tests/rig/data/samples`, again: ``python -m tests.rig.make_samples``.

To be run where a schema, a key of the configuration or a name in results.json has changed.
"""

import json
import shutil
import tempfile
from contextlib import chdir
from pathlib import Path
from unittest.mock import patch

from tests.rig.command_line import rig
from tests.rig.report.test_uncalibrated import session_in_pixels

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
    session_in_pixels(folder / "uncalibrated", lost=False)


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
