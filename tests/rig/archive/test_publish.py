"""`rig archive publish`: an RO-Crate that others can check, and `add` can read."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from rig.archive import add_sessions
from rig.archive.store import Archive
from tests.rig.command_line import rig

OLDER = Path(__file__).resolve().parents[1] / "data" / "older"
SAID = ("--title", "Friction of steel on K8", "--author", "Ada Example https://orcid.org/0000-0000-0000-0001")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    shutil.copytree(OLDER / "series", tmp_path / "runs" / "series")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])
    return tmp_path / "archive"


def test_a_crate_is_described_proved_and_read_again(archive: Path, tmp_path: Path) -> None:
    crate = tmp_path / "crate"
    words = ("archive", "publish", "--where", "state = 'whole'", "-o", crate, *SAID, "--archive", archive)
    done = rig(*words)
    assert done.returncode == 0, done.stderr
    tree = {
        item["@id"]: item for item in json.loads((crate / "ro-crate-metadata.json").read_text())["@graph"]
    }
    root = tree["./"]
    assert root["name"].startswith("SIMULATED (1 of 1 runs): ")
    other = [word if word != crate else tmp_path / "other" for word in words]
    wrong = rig(*other, "--author", "Ada https://orcid.org/0000-0000-0000-0002")
    assert (wrong.returncode, "is no ORCID" in wrong.stderr) == (2, True)
    assert root["license"]["@id"] == "https://spdx.org/licenses/CC-BY-4.0"
    assert root["author"]["@id"] == "https://orcid.org/0000-0000-0000-0001"
    files = {path.relative_to(crate).as_posix() for path in crate.rglob("*") if path.is_file()}
    assert files - set(tree) == {"ro-crate-metadata.json"} - set(tree)
    assert "session-1-series/inputs/calibration/lever.toml" in files
    # of the two runs only the whole one is there, in the results, too
    again = tmp_path / "again"
    assert rig("archive", "add", crate, "--archive", again).stdout.startswith("1 sessions added (1 runs)")
    columns = ("--columns", "sha256, b, state", "--format", "json")
    listed = [
        json.loads(rig("archive", "list", "b > 0", *columns, "--archive", place).stdout)
        for place in (archive, again)
    ]
    assert listed[0] == listed[1] != []
    assert "exists already" in rig(*words).stderr
    assert not list(tmp_path.glob(".crate*"))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_crate_is_what_its_profile_asks(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by roc-validator, without a network: its stored profiles, the context that rocrate holds."""
    services = pytest.importorskip("rocrate_validator.services", reason="pip install roc-validator")
    rocrate = pytest.importorskip("rocrate")
    from rocrate_validator import models
    from rocrate_validator.utils import http

    text = (Path(rocrate.__file__).parent / "data" / "ro-crate.jsonld").read_text(encoding="utf-8")

    class Answer:
        status_code = 200
        headers: ClassVar = {"Content-Type": "application/ld+json"}

        def json(self) -> Any:
            return json.loads(text)

    def get(_: object, address: str, *__: object, **___: object) -> Answer:
        assert address.startswith("https://w3id.org/ro/crate/"), f"{address}: is not here"
        return Answer()

    monkeypatch.setattr(http.HttpRequester, "get", get, raising=False)
    cite = ("--citation", "Example, A.: Friction https://doi.org/10.3390/lubricants11020088")
    for crate, more in ((tmp_path / "crate", ()), (tmp_path / "cited", cite)):
        words = ("--where", "state = 'whole'", "-o", crate, *SAID, *more, "--archive", archive)
        assert rig("archive", "publish", *words).returncode == 0
        asked = services.ValidationSettings(
            rocrate_uri=str(crate),
            requirement_severity=models.Severity.RECOMMENDED,
            profile_identifier="ro-crate-1.3",
            skip_availability_check=True,
        )
        found = services.validate(asked).get_issues()
        # what nobody has stated: where an author works, and how to reach him
        unstated = ("affiliation", "contactPoint")
        assert not [
            str(item.message) for item in found if not any(word in str(item.message) for word in unstated)
        ]


@pytest.mark.parametrize(("pixels", "said"), [("recompressed", "recorded"), ("dropped", "dropped")])
def test_copies_are_thinned_and_of_the_same_measurement(
    archive: Path, tmp_path: Path, pixels: str, said: str
) -> None:
    """Recompressed, this short record would be no smaller: its copy stays as it is."""
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    before = record.read_bytes()
    words = ("--where", "state = 'whole'", "-o", tmp_path / "crate", "--pixels", pixels, *SAID)
    done = rig("archive", "publish", *words, "--archive", archive)
    assert done.returncode == 0, done.stderr
    (copy,) = (tmp_path / "crate").rglob("*.mcap")
    assert (copy.read_bytes() == before) is (said == "recorded")
    assert record.read_bytes() == before
    with RecordReader(copy) as reader, RecordReader(record) as measured:
        assert reader.spots().tobytes() == measured.spots().tobytes()
        kept = 0 if said == "dropped" else len(list(measured.windows()))
        assert len(list(reader.windows())) == kept
    again = tmp_path / "again"
    assert rig("archive", "add", tmp_path / "crate", "--archive", again).returncode == 0
    rows = Archive(again).connection().execute("select sha256, windows, b > 0 from runs").fetchall()
    assert rows == [(sha256_of(record), said, True)]


def test_what_has_changed_is_not_published(archive: Path, tmp_path: Path) -> None:
    words = ("archive", "publish", "-o", tmp_path / "crate", "--archive", archive)
    assert "no run is meant" in rig(*words, *SAID).stderr
    assert "no name of SPDX" in rig(*words, *SAID, "--licence", "all mine").stderr
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    record.write_bytes(record.read_bytes() + b"\0")
    done = rig(*words, *SAID, "--where", "true")
    assert "has changed since it was added" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["archive", "runs"]


def test_without_rocrate_one_line_says_what_to_install(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rocrate.rocrate", None)
    done = rig("archive", "publish", "--where", "true", "-o", tmp_path / "crate", *SAID, "--archive", archive)
    assert done.returncode == 2
    assert done.stderr == (
        f"rig: rig archive publish needs rocrate: {sys.executable} -m pip install rocrate\n"
    )
