"""A changed configuration is never measured with: a copy is taken, or the record is refused."""

import json
from pathlib import Path

import pytest

from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from rig.analysis import read_results
from rig.commands.fitting import fit_records
from rig.instrument import recorded_configuration
from rig.report import make_report
from rig.view.record_replay import replay_record
from tests.rig.command_line import rig
from tests.rig.view.replay_record import WITHOUT_FIT, make_record

MASS, OTHER = b"0.406", b"0.606"


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_record(tmp_path_factory.mktemp("sound") / "run-1.mcap", 60.0, overrides=WITHOUT_FIT)


def test_the_second_copy_is_taken(record: Path, tmp_path: Path) -> None:
    path = tmp_path / "run-1.mcap"
    path.write_bytes(record.read_bytes().replace(MASS, OTHER, 1))
    with RecordReader(path) as reader:
        assert recorded_configuration(reader).pendulum.mass_kg == float(MASS)
        assert "attachment configuration.json: its checksum" in reader.damages[0].description


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
    assert "lost: attachment configuration.json: its checksum does not match" in said.stdout
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
    assert "SHA-256 is the one in results.json, also of configuration.json" in sound
    assert "report.html was made from results.json" in sound
    results = tmp_path / "results.json"
    tree = json.loads(results.read_text())
    tree["runs"][0]["inputs_sha256"]["configuration.json"] = "0" * 64
    results.write_text(json.dumps(tree))
    wrong = rig("record", "check", path)
    assert wrong.returncode == 1
    assert "states another SHA-256 of configuration.json than the record's" in wrong.stdout
    assert "report.html was made from other results than results.json" in wrong.stdout
