"""Records that were cut short are used as far as they go; one whose configuration was changed is refused."""

import json
import shutil
from pathlib import Path

import pytest

from acquisition.record.check import recover
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from rig.analysis import read_results
from rig.commands.fitting import fit_records
from rig.instrument import recorded_configuration
from rig.measure import resume_session
from rig.report import make_report
from rig.view.record_replay import replay_record
from rig.view.show import show_record
from tests.rig.command_line import rig
from tests.rig.view.replay_record import WITHOUT_FIT, make_record


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cut")
    data = make_record(folder / "whole.mcap", 20.0, overrides=WITHOUT_FIT).read_bytes()
    path = folder / "run-1.mcap"
    path.write_bytes(data[: round(0.8 * len(data))])
    return path


def test_a_cut_record_is_named_with_its_remedy_and_a_recovered_one_is_not(
    cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a fit and a view; a replay has a test of its own."""
    fit_records([cut], tmp_path / "fit", [])
    fitted = capsys.readouterr()
    show_record(cut, rrd=tmp_path / "view.rrd")
    shown = capsys.readouterr()
    for said in (fitted, shown):
        joined = " ".join((said.out + said.err).split())
        assert (
            f"was cut short (it has no ending); its complete part is used, rig record recover {cut}" in joined
        )
    assert sorted(path.name for path in cut.parent.iterdir()) == ["run-1.mcap", "whole.mcap"]
    recover(cut, tmp_path / "recovered.mcap")
    replay_record(tmp_path / "recovered.mcap", None, retrack=False, overrides=[])
    replayed = capsys.readouterr()
    assert "cut short" not in replayed.out + replayed.err
    assert "frames" in replayed.out


def test_resume_looks_at_the_records_that_were_complete(
    measured_series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "series"
    shutil.copytree(measured_series, folder)
    record = folder / "run-2.mcap"
    record.write_bytes(record.read_bytes()[:-1000])
    assert resume_session(folder) == 0
    said = capsys.readouterr().err
    (line,) = (line for line in said.splitlines() if "cut short" in line)
    assert line.startswith(f"{record}: ")
    assert f"rig record recover {record}" in line
    assert "no run is missing" in said


MASS, OTHER = b"0.406", b"0.606"


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_record(tmp_path_factory.mktemp("sound") / "run-1.mcap", 60.0, overrides=WITHOUT_FIT)


def test_the_second_copy_is_taken(record: Path, tmp_path: Path) -> None:
    path = tmp_path / "run-1.mcap"
    path.write_bytes(record.read_bytes().replace(MASS, OTHER, 1))
    with RecordReader(path) as reader:
        assert recorded_configuration(reader).pendulum.mass_kg == float(MASS)
        assert "attachment configuration.json: its checksum" in reader.damages[0]


@pytest.mark.parametrize("bytes_cut", [0, 37])
def test_without_an_intact_copy_the_record_is_refused(record: Path, tmp_path: Path, bytes_cut: int) -> None:
    path = tmp_path / "run-1.mcap"
    data = record.read_bytes().replace(MASS, OTHER)
    path.write_bytes(data[: len(data) - bytes_cut])
    for use in (
        lambda: fit_records([path], tmp_path / "fit", []),
        lambda: replay_record(path, None, retrack=False, overrides=[]),
    ):
        with pytest.raises(RecordError, match="its configuration is damaged and no copy is intact"):
            use()
    said = rig("record", "recover", path)
    assert "lost: byte " in said.stdout
    assert "attachment configuration.json: its checksum does not match" in said.stdout
    checked = rig("record", "check", tmp_path / "run-1-recovered.mcap")
    assert "warning: recovered from run-1.mcap; " in checked.stdout
    assert "attachment configuration.json" in checked.stdout


@pytest.mark.slow
def test_the_chain_from_record_to_report(record: Path, tmp_path: Path) -> None:
    path = tmp_path / "run-1.mcap"
    path.write_bytes(record.read_bytes())
    fit_records([path], tmp_path, [])
    page = make_report(tmp_path)
    (run,) = read_results(tmp_path).runs
    assert "configuration.json" in run.inputs_sha256
    shown = page.read_text(encoding="utf-8")
    assert run.sha256 in shown
    assert run.inputs_sha256["configuration.json"] in shown
    sound = rig("record", "check", path).stdout
    assert "SHA-256 is the one in results.json: run-1.mcap, configuration.json" in sound
    assert "report.html was made from results.json" in sound
    results, later = tmp_path / "results.json", tmp_path / "results-2.json"
    tree = json.loads(results.read_text())
    tree["runs"][0]["inputs_sha256"]["configuration.json"] = "0" * 64
    later.write_text(json.dumps(tree))
    assert "another SHA-256 than results-2.json states" in rig("record", "check", path).stdout
    later.rename(results)
    wrong = rig("record", "check", path)
    assert wrong.returncode == 1
    assert "configuration.json has another SHA-256 than results.json states" in wrong.stdout
    assert "report.html was made from other results than results.json" in wrong.stdout
