"""Commands that read a truncated record use its complete part and say so in one line, with the remedy."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition.record.recover import recover
from rig.commands.fitting import fit_records
from rig.measure import resume_session
from rig.view.record_replay import replay_record
from rig.view.show import show_records
from tests.rig.view.replay_record import WITHOUT_FIT, make_record


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cut")
    data = make_record(folder / "whole.mcap", 20.0, overrides=WITHOUT_FIT).read_bytes()
    path = folder / "run-1.mcap"
    path.write_bytes(data[: round(0.8 * len(data))])
    return path


READERS: dict[str, Callable[[Path, Path], object]] = {
    "replay": lambda record, folder: replay_record(record, None, retrack=False, overrides=[]),
    "fit": lambda record, folder: fit_records([record], folder / "fit", []),
    "view": lambda record, folder: show_records([record], rrd=folder / "view.rrd"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_cut_record_is_named_with_its_remedy(
    name: str, cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    READERS[name](cut, tmp_path)
    said = capsys.readouterr()
    joined = " ".join((said.out + said.err).split())
    assert f"was cut short (it has no ending); its complete part is used, rig record recover {cut}" in joined
    assert sorted(path.name for path in cut.parent.iterdir()) == ["run-1.mcap", "whole.mcap"]


def test_a_recovered_record_is_not(cut: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = tmp_path / "recovered.mcap"
    recover(cut, whole)
    replay_record(whole, None, retrack=False, overrides=[])
    said = capsys.readouterr()
    assert "cut short" not in said.out + said.err
    assert "frames" in said.out


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
