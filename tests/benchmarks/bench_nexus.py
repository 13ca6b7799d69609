"""Exports in HDF5 held against the definitions of NeXus by nexusformat, which does not know this program."""

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import h5py

from rig.report.export import export_session
from tests.rig.view.replay_record import make_record

SAMPLES = Path(__file__).resolve().parents[1] / "rig" / "data" / "samples"
_CHECK = """
import logging, sys
from nexusformat.nexus.validate import validate_file
logging.disable(logging.CRITICAL)
print(*validate_file(sys.argv[1]))
"""


def run(quick: bool = False) -> dict[str, Any]:
    """Warnings and errors of a session, of one in px, of one record alone, and of a file that is wrong."""
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_record(folder / "run-1.mcap", 30.0)
        sources = {
            "two runs with results": SAMPLES / "series",
            "in px": SAMPLES / "uncalibrated",
            "a record of today": folder / "run-1.mcap",
        }
        for number, (what, source) in enumerate(sources.items()):
            (made,) = export_session(source, "hdf5", folder / f"{number}.h5")
            results |= _found(what, made)
        with h5py.File(made, "r+") as file:
            file["run_1"].attrs["NX_class"] = "NXnothing"
        results |= _found("the same with a class that does not exist", made)
    return results


def _found(what: str, path: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", _CHECK, str(path)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    warnings, errors = done.stdout.split()[-2:]
    return {f"{what}: warnings": int(warnings), f"{what}: errors": int(errors)}
