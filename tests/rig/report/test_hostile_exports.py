"""Exports where the disk is full, where names are formulas, and of runs that were not fitted."""

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rig.report.export import export_session
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
FORMULA = "=cmd|' /C calc'!A0"


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_nothing(measured_series: Path, tmp_path: Path) -> None:
    """HDF5 told of it at every object that it closed, in thousands of lines, and ended the process.

    The largest size of a file stands for the disk.
    """
    pytest.importorskip("h5py")
    pytest.importorskip("resource")
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); "
        "from rig.cli import main; sys.exit(main())"
    )
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            code,
            "export",
            measured_series,
            "--format",
            "hdf5",
            "-o",
            tmp_path / "out.h5",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (1, 2), done.stderr[-500:]
    assert re.fullmatch(r"rig: .*out\.h5: cannot be written: File too large\n", done.stderr)
    assert not list(tmp_path.iterdir())


def test_the_same_table_of_two_runs_has_two_labels(measured_series: Path, tmp_path: Path) -> None:
    labels = [
        re.findall(r"\\label\{(.*?)\}", path.read_text())
        for path in export_session(measured_series, "latex", tmp_path)
    ]
    flat = [label for each in labels for label in each]
    assert len(flat) == len(set(flat)) > 4


def test_what_was_not_fitted_to_the_contact_says_so(tmp_path: Path) -> None:
    folder = shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "run")
    tree = json.loads((folder / "results.json").read_text())
    tree["runs"][0] |= {"conditions": []}
    (folder / "results.json").write_text(json.dumps(tree))
    done = rig("export", folder, "--format", "latex", "-o", tmp_path / "out")
    assert done.returncode in (1, 2)
    assert "its results have no tables" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_table_whose_unit_is_a_formula(tmp_path: Path) -> None:
    time_s = 0.05 * np.arange(600)
    x = 10.0 * np.exp(-0.01 * time_s) * np.cos(2.5 * time_s)
    x += 0.01 * np.random.default_rng(1).standard_normal(len(time_s))
    np.savetxt(tmp_path / "decay.txt", np.column_stack([time_s, x]))
    fitted = rig("fit", tmp_path / "decay.txt", "--unit", FORMULA, "-o", tmp_path / "fit")
    assert fitted.returncode == 0, fitted.stderr
    made = export_session(tmp_path / "fit", "csv", tmp_path / "csv")
    rows = list(csv.DictReader(line for line in made[2].read_text().splitlines() if not line.startswith("#")))
    assert "'" + FORMULA in {row["unit"] for row in rows}
    assert not [cell for row in rows for cell in row.values() if cell[:1] in ("=", "@")]
