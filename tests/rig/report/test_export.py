"""`rig export`: every format can be read back, with provenance and units; full disks and formulas."""

import json
import math
import re
import shutil
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pint
import pytest
from pyarrow import parquet
from pyarrow.csv import ReadOptions, read_csv

from acquisition.record.reader import RecordReader
from processing.errors import ConfigurationError, RecordError
from rig.report.export import export_session
from tests.rig.command_line import SAMPLES, rig

h5py = pytest.importorskip("h5py")


@pytest.fixture(scope="module")
def truth(measured_series: Path) -> tuple[Any, Any, dict[str, Any]]:
    """Spots, swings and results of the first run as record and results.json hold them."""
    with RecordReader(measured_series / "run-1.mcap") as reader:
        spots, swings = reader.table("/spot"), reader.table("/swing")
    return (
        spots,
        swings,
        json.loads((measured_series / "results.json").read_text(encoding="utf-8"))["runs"][0],
    )


@pytest.fixture(scope="module")
def nexus(measured_series: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The series as one HDF5 file."""
    (made,) = export_session(measured_series, "hdf5", tmp_path_factory.mktemp("nexus") / "out.h5")
    return made


def test_csv_holds_every_digit_and_the_provenance(
    measured_series: Path, truth: tuple[Any, Any, dict[str, Any]], tmp_path: Path
) -> None:
    spots, swings, results = truth
    made = export_session(measured_series, "csv", tmp_path / "csv")
    assert [path.name for path in made] == [
        *(f"run-{number}-{what}.csv" for number in (1, 2) for what in ("spots", "swings", "table")),
        "series-table.csv",
    ]
    lines = made[1].read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith("#")]
    assert f"# sha256: {results['sha256']}" in head
    assert any(line.startswith("# configuration: {") for line in head)
    for path, table in ((made[0], spots), (made[1], swings)):
        read = read_csv(path, read_options=ReadOptions(skip_rows=len(head)))
        assert read.column_names == list(table.dtype.names)
        for name in table.dtype.names:
            np.testing.assert_array_equal(read[name].to_numpy(), table[name])


def test_parquet_has_units_and_provenance(
    measured_series: Path, truth: tuple[Any, Any, dict[str, Any]], tmp_path: Path
) -> None:
    spots, _, results = truth
    made = export_session(measured_series / "run-1.mcap", "parquet", tmp_path)
    table = parquet.read_table(made[0])
    np.testing.assert_array_equal(table["y_rad"].to_numpy(), spots["y_rad"])
    assert table.schema.field("y_arcsec").metadata[b"unit"] == b"arcsec"
    provenance = json.loads(table.schema.metadata[b"provenance"])
    assert provenance["sha256"] == results["sha256"]
    assert json.loads(provenance["configuration"])["session"]["operator"] == "demonstration"
    values = parquet.read_table(made[2])
    assert str(values.to_pylist()) == str([_with_nan(row) for row in results["table"]])


def _with_nan(row: dict[str, Any]) -> dict[str, Any]:
    """A row of results.json as Parquet gives it back: not determined is NaN, which equals nothing."""
    numbers = ("value", "u", "u_total", "lower", "upper")
    return {key: math.nan if key in numbers and cell is None else cell for key, cell in row.items()}


@pytest.mark.slow
def test_hdf5_is_laid_out_as_nexus(
    measured_series: Path, truth: tuple[Any, Any, dict[str, Any]], nexus: Path
) -> None:
    _, swings, results = truth
    series = json.loads((measured_series / "results.json").read_text(encoding="utf-8"))["series"]
    with h5py.File(nexus) as file:
        assert file.attrs["NX_class"] == "NXroot"
        assert sorted(file) == ["run_1", "run_2", "series"]
        entry = file["run_1"]
        assert entry.attrs["NX_class"] == "NXentry"
        data = entry["swings"]
        assert data.attrs["NX_class"] == "NXdata"
        signal = data[data.attrs["signal"]]
        np.testing.assert_array_equal(signal[:], swings["amplitude_rad"])
        assert signal.attrs["units"] == "rad"
        np.testing.assert_array_equal(data["amplitude_rad_errors"][:], swings["u_amplitude_rad"])
        assert data[data.attrs["axes"][0]].attrs["units"] == "ns"
        assert json.loads(entry["provenance/description"][()])["sha256"] == results["sha256"]
        value = entry["results/values/exact/gamma_pa"]
        (row,) = [row for row in results["table"] if (row["fit"], row["quantity"]) == ("exact", "gamma_pa")]
        assert value[()] == row["value"]
        assert entry["results/values/exact/gamma_pa_errors"][()] == row["u_total"]
        assert value.attrs["verdict"] == row["verdict"]
        assert value.attrs["units"] == "Pa"
        assert json.loads(entry["results/json"][()]) == results
        assert entry["instrument/detector"].attrs["NX_class"] == "NXdetector"
        assert entry["user/name"][()] == b"demonstration"
        began, ended = (
            datetime.fromisoformat(entry[name][()].decode()) for name in ("start_time", "end_time")
        )
        assert (ended - began).total_seconds() == pytest.approx(70.0, abs=1.0)
        assert file["series"].attrs["NX_class"] == "NXentry"
        assert json.loads(file["series/results/json"][()]) == series
        gamma = file["series/results/values/exact/gamma_pa_errors"]
        (row,) = [row for row in series["table"] if row["quantity"] == "gamma_pa"]
        assert (gamma[()], gamma.attrs["units"]) == (row["u_total"], "Pa")
        names: list[str] = []
        file.visit(names.append)
        assert all(re.fullmatch(r"[A-Za-z0-9_]+", part) for name in names for part in name.split("/"))


def test_what_a_record_lacks_is_said_in_every_file(
    measured_series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cut record with a changed bit is exported as far as it goes, and never looks like a whole one."""
    path = tmp_path / "=run.mcap"
    data = bytearray((measured_series / "run-1.mcap").read_bytes()[:-2000])
    with RecordReader(measured_series / "run-1.mcap") as reader:
        contents = reader.numbers
    spot = next(number for number, topic in contents.channels.items() if topic == "/spot")
    *_, chunk = (chunk for chunk in contents.chunks if chunk.channels >> spot & 1)
    data[chunk.offset + chunk.length // 2] ^= 1
    path.write_bytes(data)
    spots, *_ = export_session(path, "csv", tmp_path / "csv")
    said = capsys.readouterr().err
    assert "was cut short" in said
    assert "damaged, not used" in said
    head = [line for line in spots.read_text(encoding="utf-8").splitlines() if line.startswith("# NOTE: ")]
    assert ["was cut short" in line for line in head] == [True, False]
    assert "damaged, not used" in head[1]
    table, *_ = export_session(path, "parquet", tmp_path / "parquet")
    notes = json.loads(parquet.read_schema(table).metadata[b"notes"])
    assert [f"# NOTE: {note}" for note in notes] == head
    (made,) = export_session(path, "hdf5", tmp_path / "out.h5")
    with h5py.File(made) as file:
        assert file["_run/lacking/description"][()].decode().splitlines() == notes


def test_texts_are_no_formulas(measured_series: Path, tmp_path: Path) -> None:
    shutil.copy(measured_series / "run-1.mcap", tmp_path)
    tree = json.loads((measured_series / "results.json").read_text(encoding="utf-8"))
    for row, text in zip(
        tree["runs"][0]["table"], ("=HYPERLINK(0)", "@SUM(1)", "1 is no formula"), strict=False
    ):
        row["unit"] = text
    (tmp_path / "results.json").write_text(json.dumps(tree))
    made = export_session(tmp_path / "run-1.mcap", "csv", tmp_path / "out")
    text = made[2].read_text(encoding="utf-8")
    assert '"\'=HYPERLINK(0)"' in text
    assert '"\'@SUM(1)"' in text
    assert '"1 is no formula"' in text


def test_nothing_is_written_over(measured_series: Path, tmp_path: Path) -> None:
    (tmp_path / "a.h5").touch()
    with pytest.raises(ConfigurationError, match="exists already and is not overwritten"):
        export_session(measured_series, "hdf5", tmp_path / "a.h5")
    export_session(measured_series, "csv", tmp_path / "a")
    with pytest.raises(ConfigurationError, match="exists already and is not overwritten"):
        export_session(measured_series, "csv", tmp_path / "a")


def test_results_of_another_record_are_refused(measured_series: Path, tmp_path: Path) -> None:
    shutil.copy(measured_series / "results.json", tmp_path)
    shutil.copy(measured_series / "run-2.mcap", tmp_path / "run-1.mcap")
    with pytest.raises(RecordError, match="other hash"):
        export_session(tmp_path / "run-1.mcap", "csv", tmp_path / "out")


def test_a_record_alone_is_exported_without_results(measured_series: Path, tmp_path: Path) -> None:
    shutil.copy(measured_series / "run-1.mcap", tmp_path)
    made = export_session(tmp_path / "run-1.mcap", "parquet", tmp_path / "out")
    assert [path.stem for path in made] == ["run-1-spots", "run-1-swings"]


def test_a_missing_library_is_one_line(
    measured_series: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(
        ConfigurationError, match=r"--format hdf5 needs h5py, of the extra data: .* -m pip install h5py$"
    ):
        export_session(measured_series, "hdf5", tmp_path / "a.h5")


UNITS = {
    "exact/b": "rad^-p",
    "exact/b_upper_95": "rad^-p",
    "exact/drag_s": "s",
    "exact/gamma_pa_errors": "Pa",
    "exact/surface_energy_table2_j_per_m2": "J/m^2",
    "asymptotic/initial_amplitude_rad": "rad",
    "decay/mean_period_s": "s",
    "decay/initial_amplitude": "arcsec",
}


@pytest.mark.slow
def test_every_unit_in_nexus_is_one_and_that_of_its_number(nexus: Path) -> None:
    """Names alone would say m2 for an energy over an area."""
    found: dict[str, str] = {}
    with h5py.File(nexus) as file:
        values = file["run_1/results/values"]
        values.visititems(lambda name, item: found.update({name: item.attrs.get("units", "")}))
        numbers = {name for name in found if isinstance(values[name], h5py.Dataset)}
    assert {name: found[name] for name in UNITS} == UNITS
    theirs = pint.UnitRegistry()
    for name in sorted(numbers):
        unit = found[name].replace("sqrt(Hz)", "Hz^0.5").replace("^-p", "^-0.9").replace("degC", "kelvin")
        quantity = theirs.Quantity(1.0, unit)
        suffix = re.search(r"_(kg|m|s|ns|rad|pa|j|px)(_errors|_lower_95|_upper_95)?$", name)
        if suffix is not None and "_per_" not in name:
            assert quantity.check(
                theirs.Quantity(1.0, {"pa": "Pa", "j": "J"}.get(suffix[1], suffix[1])).units
            ), name


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
    (made,) = export_session(folder, "latex", tmp_path / "decay")
    assert made.name == "run-1-decay.tex"
    period = next(row for row in tree["runs"][0]["table"] if row["quantity"] == "mean_period_s")
    assert f"{period['value']:.3f}"[:4] in made.read_text()
    tree["runs"][0] |= {"table": []}
    (folder / "results.json").write_text(json.dumps(tree))
    done = rig("export", folder, "--format", "latex", "-o", tmp_path / "out")
    assert done.returncode in (1, 2)
    assert "no run of it has a decay" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
