"""Files of an earlier version are read by every command that reads such files: see data/older/README.md."""

import csv
import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from acquisition.record.reader import RecordReader
from calibration.store import read_calibration
from processing.errors import RigError
from rig.cli import app
from tests.rig.command_line import figures_are_not_drawn

OLDER = Path(__file__).parent / "data" / "older"
SPOTS = 577
SWINGS = 23
PARAMETERS = ("b", "p", "c", "n", "period0_s", "gamma_pa")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the older files, entered: their configuration names the calibration relative to it."""
    copy = tmp_path / "older"
    shutil.copytree(OLDER, copy)
    monkeypatch.chdir(copy)
    return copy


def rig(command: str, status: int = 0) -> str:
    """What a command prints."""
    with figures_are_not_drawn():
        done = CliRunner().invoke(app, command.split())
    if isinstance(done.exception, RigError):
        raise done.exception
    assert done.exit_code == status, f"{done.output}\n{done.exception}"
    return done.output


def results(path: str) -> Any:
    return json.loads(Path(path).read_text(encoding="utf-8"))


def keys(tree: Any, place: str = "") -> Iterator[str]:
    """Dotted names of all keys of nested objects; the entries of a list share one name."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield f"{place}.{key}"
            yield from keys(value, f"{place}.{key}")
    elif isinstance(tree, list):
        for value in tree:
            yield from keys(value, f"{place}[]")


def check_same_fits(new: dict[str, Any], old: dict[str, Any], moved: bool = False) -> None:
    """Values agree within a hundredth of their uncertainty, which is far less than they mean.

    `moved`: the turning points are now measured again that used to be left as detected. Then the values agree
    within five old uncertainties, and the fits have become better.
    """
    assert new.keys() >= old.keys() >= {"asymptotic", "exact"}
    for name, fit in old.items():
        for parameter in (*PARAMETERS, "initial_amplitude_rad", "mean_period_s"):
            before, after = fit[parameter], new[name][parameter]
            u = before["standard_uncertainty"]
            assert after["value"] == pytest.approx(before["value"], abs=(5 if moved else 0.01) * u), parameter
            if moved:
                continue
            # since then that of the exact fit also holds drives which one run cannot exclude
            most = 1.6 if name == "exact" else 1.01
            assert 0.99 * u < after["standard_uncertainty"] < most * u, (name, parameter)
        close = pytest.approx(fit["chi2_per_dof"], rel=0.01)
        assert new[name]["chi2_per_dof"] == close or (
            moved and new[name]["chi2_per_dof"] < fit["chi2_per_dof"]
        )


def check_no_key_is_lost(new: Any, old: Any) -> None:
    """Other programs rely on them. The numbers of the drag verdict are there only where its fit converged."""
    assert not {key for key in set(keys(old)) - set(keys(new)) if ".drag." not in key}


def was_moved(new: dict[str, Any], old: dict[str, Any]) -> bool:
    return old.get("measured_again_on") is None and new["measured_again_on"] is not None


def check_same_run(new: dict[str, Any], old: dict[str, Any]) -> None:
    for key in ("sha256", "frames", "dropped_frames", "half_cycles"):
        assert new[key] == old[key], key
    # those that are counted since then
    assert new["losses"] == (
        old["losses"] and dict.fromkeys(("wrong_time", "error_status", "wrong_id"), 0) | old["losses"]
    )
    for end in ("initial", "final"):
        # schema 1 had px, too, under the name in arcsec
        before = old[f"{end}_amplitude_arcsec"]
        close = pytest.approx(before, rel=1e-4 if was_moved(new, old) else 1e-6)
        assert new[f"{end}_amplitude"] == close
        assert new[f"{end}_amplitude_arcsec"] == (close if new["amplitude_unit"] == "arcsec" else None)


def test_info() -> None:
    text = rig("info series/run-1.mcap")
    for words in (f"/spot                {SPOTS}", f"/swing               {SWINGS}", "laboratory", "0.1.0"):
        assert words in text
    assert "cut short" in rig("info series/run-2.mcap")


def test_check() -> None:
    text = rig("check series/run-1.mcap --results series/results.json")
    assert "is sound" in text
    assert "SHA-256 is the one in results.json" in text


def test_the_reader_gives_numbers_pixels_and_configuration() -> None:
    with RecordReader(Path("series/run-1.mcap")) as record:
        assert len(record.spots()) == SPOTS
        assert len(record.swings()) == SWINGS
        assert sum(1 for _ in record.windows()) == SPOTS
        assert sum(1 for _ in record.images()) == 1
        assert {"configuration.json", "configuration.toml", "calibration/lever.toml"} <= set(
            record.attachments
        )


@pytest.mark.slow
def test_a_fit_gives_what_it_gave() -> None:
    # those versions asked for no drag
    rig("fit series/run-1.mcap --set fit.drag=vacuum -o again")
    (new,), (old,) = results("again/results.json")["runs"], results("series/results.json")["runs"]
    check_same_run(new, old)
    check_no_key_is_lost(new, old)
    check_same_fits(new["fits"], old["fits"], was_moved(new, old))
    assert new["calibration"]["lever"]["sha256"] == old["calibration"]["lever"]["sha256"]


def test_a_table_gives_what_it_gave() -> None:
    rig("fit decay.csv --unit arcsec --config session.toml --set fit.drag=vacuum -o again")
    new, old = results("again/results.json"), results("table/results.json")
    assert new["half_cycles"] == old["half_cycles"]
    for key in ("period_s", "log_decrement"):
        assert new[key]["value"] == pytest.approx(old[key]["value"], rel=1e-6)
    check_no_key_is_lost(new, old)
    check_same_fits(new["fits"], old["fits"])
    assert new["drag"]["finding"], "a table is judged as a record is"
    assert {item["name"] for item in new["identifiability"]} == set(PARAMETERS)
    assert new["budget"]["surface_energy_table2_j_per_m2"]["sources"]
    assert len(new["decays"]) == 1


def test_another_instrument_gives_what_it_gave() -> None:
    rig("fit series/run-1.mcap --set instrument.kind=herbert -o again")
    (new,), (old,) = results("again/results.json")["runs"], results("herbert/results.json")["runs"]
    check_same_run(new, old)
    check_no_key_is_lost(new, old)
    for name, value in old["instrument"].items():
        if isinstance(value, dict) and isinstance(value.get("value"), float):
            assert new["instrument"][name]["value"] == pytest.approx(value["value"], rel=1e-6), name


def test_a_record_in_px_stays_in_px() -> None:
    text = rig("fit uncalibrated/run-1.mcap -o again", 1)
    assert "248.95 to 239.91 px" in text
    (new,), (old,) = results("again/results.json")["runs"], results("uncalibrated/results.json")["runs"]
    check_same_run(new, old)
    assert new["fits"] == {}
    assert "no calibration" in new["problem"]


@pytest.mark.parametrize("name", ["series", "herbert", "uncalibrated"])
def test_report(name: str) -> None:
    """Of the results as they stand, which say no turning points: those are taken from the record."""
    rig(f"report {name} -o report.html")
    text = Path("report.html").read_text(encoding="utf-8")
    assert "svg" in text
    if name == "series":
        assert "0.03005" in text
        assert "28.35" in text


def test_compare(folder: Path) -> None:
    shutil.copytree("series", "other")
    text = rig("compare series other -o compared.html")
    assert "0.03005 ± 0.00038" in text
    assert Path("compared.html").stat().st_size > 1000


@pytest.mark.slow
def test_replay() -> None:
    text = rig("replay series/run-1.mcap")
    # on another processor the last bit may differ, and a table says so
    assert f"{SPOTS} spots and {SWINGS} half-cycles, equal" in text or "largest change" in text


@pytest.mark.slow
def test_retracking_changes_little() -> None:
    rig("replay series/run-1.mcap --retrack --set fit.drag=vacuum -o again")
    (new,), (old,) = results("again/results.json")["runs"], results("series/results.json")["runs"]
    for name in PARAMETERS:
        before, after = old["fits"]["exact"][name], new["fits"]["exact"][name]
        assert abs(after["value"] - before["value"]) < 3 * before["standard_uncertainty"], name


@pytest.mark.slow
def test_replay_of_a_cut_record_says_so() -> None:
    assert "was cut short" in rig("replay series/run-2.mcap")


def test_recover() -> None:
    rig("recover series/run-2.mcap")
    with RecordReader(Path("series/run-2-recovered.mcap")) as record:
        assert not record.truncated
        assert len(record.spots()) == SPOTS


@pytest.mark.parametrize("format_", ["csv", "parquet", "hdf5"])
def test_export(format_: str) -> None:
    rig(f"export series --format {format_} -o exported")
    if format_ == "csv":
        rows = Path("exported/run-1-spots.csv").read_text(encoding="utf-8").splitlines()
        table = list(csv.DictReader(row for row in rows if not row.startswith("#")))
        assert len(table) == SPOTS
        assert all(math.isfinite(float(value)) for value in list(table[0].values())[:3])
    else:
        assert Path("exported").exists()


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["measuring", "analysing"])
def test_view(layout: str) -> None:
    for name in ("series", "uncalibrated"):
        rig(f"view {name}/run-1.mcap --layout {layout} --rrd {name}.rrd")
        assert Path(f"{name}.rrd").stat().st_size > 100_000


@pytest.mark.slow
def test_an_interrupted_session_goes_on(folder: Path) -> None:
    rig("run --resume series")
    state = results("series/session.json")
    assert [entry["state"] for entry in state["entries"]] == ["complete", "interrupted", "complete"]
    new, (old,) = results("series/results-2.json")["runs"], results("series/results.json")["runs"]
    assert [run["record"] for run in new] == ["run-1.mcap", "run-3.mcap"]
    assert "report-2.html" in rig("report series"), "a folder's results are the latest ones"
    check_same_run(new[0], old)
    # its settings did not name a drag, which is now what is known of the air
    for parameter in PARAMETERS:
        before, after = old["fits"]["exact"][parameter], new[0]["fits"]["exact"][parameter]
        assert abs(after["value"] - before["value"]) < 3 * after["standard_uncertainty"], parameter


def test_a_calibration_file() -> None:
    lever = read_calibration(Path("calibrations/lever-001.toml"), "lever")
    assert lever.values["arm_m"] == 0.3
    assert lever.made_by == "operator"
