"""`rig export`: every format can be read back, with provenance and units; full disks and formulas."""

import csv
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
from processing.units import size
from rig.report.export import export_session
from tests.rig.command_line import SAMPLES, rig

h5py = pytest.importorskip("h5py")


@pytest.fixture(scope="module")
def results(measured_series: Path) -> Any:
    """results.json of the series."""
    return json.loads((measured_series / "results.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def truth(measured_series: Path) -> dict[str, np.ndarray]:
    """Spots and swings of the first run as its record holds them."""
    with RecordReader(measured_series / "run-1.mcap") as reader:
        return {"spots": reader.table("/spot"), "swings": reader.table("/swing")}


@pytest.fixture(scope="module")
def exported(measured_series: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    """The files of the series in every format."""
    folder = tmp_path_factory.mktemp("exported")
    named = {"csv": "csv", "parquet": "parquet", "latex": "latex", "hdf5": "out.h5"}
    return {kind: export_session(measured_series, kind, folder / name) for kind, name in named.items()}


def not_determined_is_nan(row: dict[str, Any]) -> dict[str, Any]:
    """A row of results.json as tables give it back: NaN, which equals nothing."""
    return {key: math.nan if key in NUMBERS and cell is None else cell for key, cell in row.items()}


NUMBERS = ("value", "u", "u_total", "lower", "upper")


def test_csv_holds_every_digit_and_the_provenance(
    exported: dict[str, list[Path]], truth: dict[str, np.ndarray], results: Any
) -> None:
    made = exported["csv"]
    assert [path.name for path in made] == [
        *(f"run-{number}-{what}.csv" for number in (1, 2) for what in ("spots", "swings", "table")),
        "series-table.csv",
    ]
    lines = made[1].read_text(encoding="utf-8").splitlines()
    head = [line for line in lines if line.startswith("#")]
    assert f"# sha256: {results['runs'][0]['sha256']}" in head
    assert any(line.startswith("# configuration: {") for line in head)
    for path, table in zip(made, truth.values(), strict=False):
        read = read_csv(path, read_options=ReadOptions(skip_rows=len(head)))
        assert read.column_names == list(table.dtype.names)
        for name in table.dtype.names:
            np.testing.assert_array_equal(read[name].to_numpy(), table[name])
    # what the runs say together
    lines = made[-1].read_text(encoding="utf-8").splitlines()
    about = "\n".join(line for line in lines if line[0] == "#")
    assert all(
        word in about for word in ("SIMULATED: 2 of 2 runs", *(run["sha256"] for run in results["runs"]))
    )
    series = list(csv.DictReader(line for line in lines if line[0] != "#"))
    for row, wanted in zip(series, results["series"]["table"], strict=True):
        assert row["quantity"] == wanted["quantity"]
        np.testing.assert_array_equal(
            [float(row[name] or "nan") for name in NUMBERS],
            [not_determined_is_nan(wanted)[name] for name in NUMBERS],
        )


def test_parquet_has_units_and_provenance(
    exported: dict[str, list[Path]], truth: dict[str, np.ndarray], results: Any
) -> None:
    made = exported["parquet"]
    table = parquet.read_table(made[0])
    np.testing.assert_array_equal(table["y_rad"].to_numpy(), truth["spots"]["y_rad"])
    assert table.schema.field("y_arcsec").metadata[b"unit"] == b"arcsec"
    provenance = json.loads(table.schema.metadata[b"provenance"])
    assert provenance["sha256"] == results["runs"][0]["sha256"]
    assert json.loads(provenance["configuration"])["session"]["operator"] == "demonstration"
    for path, rows in ((made[2], results["runs"][0]["table"]), (made[-1], results["series"]["table"])):
        found = parquet.read_table(path).to_pylist()
        assert str([{key: row[key] for key in rows[0]} for row in found]) == str(
            [not_determined_is_nan(row) for row in rows]
        )
    assert size(next(row["unit"] for row in found if row["quantity"] == "gamma_pa")) == size("Pa")
    assert b"SIMULATED: 2 of 2 runs" in parquet.read_schema(made[-1]).metadata[b"provenance"]


def test_the_tables_of_a_report_are_exported_for_latex(exported: dict[str, list[Path]]) -> None:
    made = {path.name: path.read_text(encoding="utf-8") for path in exported["latex"]}
    assert {"run-1-parameters.tex", "run-2-budget.tex", "series-budget.tex"} <= set(made)
    for name, text in made.items():
        assert text.isascii(), (name, re.findall(r"[^\x00-\x7f]+", text))
        assert len(re.findall(r"\\begin", text)) == len(re.findall(r"\\end\{", text)) == 2
        body = text.split(r"\toprule")[1].split(r"\bottomrule")[0]
        counts = {len(re.findall(r"(?<!\\)&", line)) for line in body.splitlines() if line.endswith(r"\\")}
        assert len(counts) == 1, name
        assert text.count("{") == text.count("}")
    assert r"$\gamma$" in made["run-1-parameters.tex"]
    assert r"\unit{\mega\pascal}" in made["run-1-parameters.tex"]
    # the same table of two runs has two labels
    labels = [label for text in made.values() for label in re.findall(r"\\label\{(.*?)\}", text)]
    assert len(labels) == len(set(labels)) > 4


@pytest.mark.slow
def test_hdf5_is_laid_out_as_nexus(
    measured_series: Path, exported: dict[str, list[Path]], truth: dict[str, np.ndarray], results: Any
) -> None:
    half_cycles, first, series = truth["swings"], results["runs"][0], results["series"]
    with h5py.File(*exported["hdf5"]) as file:
        assert file.attrs["NX_class"] == "NXroot"
        assert sorted(file) == ["run_1", "run_2", "series"]
        entry = file["run_1"]
        assert entry.attrs["NX_class"] == "NXentry"
        data = entry["swings"]
        assert data.attrs["NX_class"] == "NXdata"
        signal = data[data.attrs["signal"]]
        np.testing.assert_array_equal(signal[:], half_cycles["amplitude_rad"])
        assert signal.attrs["units"] == "rad"
        np.testing.assert_array_equal(data["amplitude_rad_errors"][:], half_cycles["u_amplitude_rad"])
        assert data[data.attrs["axes"][0]].attrs["units"] == "ns"
        assert json.loads(entry["provenance/description"][()])["sha256"] == first["sha256"]
        value = entry["results/values/exact/gamma_pa"]
        (row,) = [row for row in first["table"] if (row["fit"], row["quantity"]) == ("exact", "gamma_pa")]
        assert value[()] == row["value"]
        assert entry["results/values/exact/gamma_pa_errors"][()] == row["u_total"]
        assert value.attrs["verdict"] == row["verdict"]
        assert value.attrs["units"] == "Pa"
        assert json.loads(entry["results/json"][()]) == first
        assert entry["instrument/detector"].attrs["NX_class"] == "NXdetector"
        assert entry["user/name"][()] == b"demonstration"
        began, ended = (
            datetime.fromisoformat(entry[name][()].decode()) for name in ("start_time", "end_time")
        )
        assert (ended - began).total_seconds() == pytest.approx(70.0, abs=1.0)
        with RecordReader(measured_series / "run-1.mcap") as reader:
            assert began == reader.utc(int(truth["spots"]["time_ns"][0]))
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


def test_a_record_alone_is_exported_without_results_and_texts_are_no_formulas(
    measured_series: Path, tmp_path: Path
) -> None:
    shutil.copy(measured_series / "run-1.mcap", tmp_path)
    made = export_session(tmp_path / "run-1.mcap", "parquet", tmp_path / "alone")
    assert [path.stem for path in made] == ["run-1-spots", "run-1-swings"]
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


def test_nothing_is_written_over(measured_series: Path, exported: dict[str, list[Path]]) -> None:
    folders = {kind: made[0].parent for kind, made in exported.items()}
    for kind, place in {**folders, "hdf5": exported["hdf5"][0]}.items():
        with pytest.raises(ConfigurationError, match="exists already and is not overwritten"):
            export_session(measured_series, kind, place)


def test_results_of_another_record_are_refused(measured_series: Path, tmp_path: Path) -> None:
    shutil.copy(measured_series / "results.json", tmp_path)
    shutil.copy(measured_series / "run-2.mcap", tmp_path / "run-1.mcap")
    with pytest.raises(RecordError, match="other hash"):
        export_session(tmp_path / "run-1.mcap", "csv", tmp_path / "out")


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
def test_every_unit_in_nexus_is_one_and_that_of_its_number(exported: dict[str, list[Path]]) -> None:
    """Names alone would say m2 for an energy over an area."""
    found: dict[str, str] = {}
    with h5py.File(*exported["hdf5"]) as file:
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


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_nothing(measured_series: Path, tmp_path: Path) -> None:
    """HDF5 told of it at every object that it closed, in thousands of lines, and ended the process.

    The largest size of a file stands for the disk.
    """
    pytest.importorskip("resource")
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); "
        "from rig.cli import main; sys.exit(main())"
    )
    words = ("export", measured_series, "--format", "hdf5", "-o", tmp_path / "out.h5")
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode in (1, 2), done.stderr[-500:]
    assert re.fullmatch(r"rig: .*out\.h5: cannot be written: File too large\n", done.stderr)
    assert not list(tmp_path.iterdir())


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
