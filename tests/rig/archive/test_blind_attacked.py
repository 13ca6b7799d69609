"""A tester who owns the machine but not the key: every command on a blind sample, then all bytes searched.

What may be found is what the record itself holds: who computes a fit of it himself has one.
"""

import json
import math
import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zstandard
from pyarrow import parquet

from processing.errors import ConfigurationError, RecordError
from rig.analysis import analyse_record, encoded, read_results, session_results
from rig.archive import add_sessions, blind_runs, unseal
from rig.archive.store import Archive
from rig.sealing import refuse_blind, seal_over
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
_OPEN = ("beam", "losses", "clock", "settings", "calibration", "surroundings", "conditions", "pendulum")
"""Parts of results that a blind run states: what was asked for, and how frames and air were."""


def numbers(tree: Any) -> Iterator[float]:
    """Numbers with a fraction, which are no chance."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key not in _OPEN:
                yield from numbers(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from numbers(value)
    elif isinstance(tree, float) and len(repr(tree)) > 9:
        yield tree


class Blind:
    """A session that was never fitted, made blind; the key is taken away, true values are known."""

    def __init__(self, base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.base, self.runs, self.archive = base, base / "here" / "runs", base / "here" / "archive"
        monkeypatch.setenv("XDG_DATA_HOME", str(base / "owner"))
        shutil.copytree(SAMPLES / "series", self.runs / "series")
        (self.runs / "series" / "results.json").unlink()
        self.record = self.runs / "series" / "run-1.mcap"
        true = session_results([analyse_record(self.record)], self.runs / "series")
        self.results = true
        self.true = sorted(set(numbers(encoded(true))))
        self.said = blind_runs(self.archive, [], [self.runs])
        self.outputs: list[str] = []
        # the owner takes it along
        monkeypatch.setenv("XDG_DATA_HOME", str(base / "nobody"))

    def run(self, *words: str | Path) -> "subprocess.CompletedProcess[str]":
        done = rig(*map(str, words), cwd=self.base / "here")
        self.outputs += [done.stdout, done.stderr]
        return done

    def found(self) -> list[str]:
        """Places in which a true value lies: files by their bytes, what they hold unpacked, what was said."""
        as_bytes = {struct.pack("<d", value): value for value in self.true}
        as_text = [f"{value:.5g}" for value in self.true] + [repr(value)[:9] for value in self.true]
        as_text = [text for text in as_text if len(text.strip("-0.").replace(".", "")) >= 5]
        places = []

        def look(name: str, data: bytes) -> None:
            places.extend(f"{name}: {value}" for packed, value in as_bytes.items() if packed in data)
            text = data.decode("latin-1") if b"\0" not in data[:4096] else ""
            places.extend(f"{name}: {one}" for one in as_text if one in text)

        for path in sorted(self.base.rglob("*")):
            if not path.is_file() or (path.suffix == ".mcap" and path.parent.name == "series"):
                continue
            data = path.read_bytes()
            look(str(path), data)
            if path.suffix == ".zst":
                look(f"{path} unpacked", zstandard.ZstdDecompressor().decompress(data))
            if path.suffix == ".parquet":
                table = parquet.read_table(path)
                look(f"{path} unpacked", json.dumps(table.to_pylist(), default=str).encode())
                look(f"{path} statistics", str(parquet.read_metadata(path).to_dict()).encode())
        for text in self.outputs:
            look("said", text.encode())
        return places


@pytest.fixture
def blind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Blind:
    return Blind(tmp_path, monkeypatch)


@pytest.mark.slow
def test_no_command_on_a_blind_sample_writes_or_says_a_true_value(blind: Blind) -> None:
    assert len(blind.true) > 100
    fitted = blind.run("fit", blind.record)
    assert "BLIND, sealed" in fitted.stdout
    assert blind.run("archive", "add", blind.runs).returncode == 0
    assert blind.run("archive", "refit", "--level", "swings").returncode == 0
    for words in (
        ("archive", "list"),
        ("archive", "list", "--refits", "--columns", "*", "--format", "csv"),
        ("archive", "list", "--columns", "*", "--format", "parquet", "-o", "runs.parquet"),
        ("archive", "diff"),
        ("info", blind.record),
        ("check", blind.record),
        ("replay", blind.record, "-o", "replayed"),
        ("view", blind.record, "--rrd", "run.rrd"),
        ("archive", "view", "--where", "run = 'run-1'", "--rrd", "runs.rrd"),
    ):
        blind.run(*words)
    for words in (
        ("report", blind.runs / "series"),
        ("compare", blind.runs / "series", blind.runs / "series"),
        ("export", blind.runs / "series", "-o", "csv"),
        ("export", blind.record, "-o", "csv"),
        ("export", blind.record, "--format", "hdf5", "-o", "run.nxs"),
        ("view", blind.record, "--layout", "analysing", "--rrd", "analysing.rrd"),
        ("plan", blind.record),
        ("archive", "publish", "--where", "true", "-o", "crate", "--title", "t", "--author", "A"),
    ):
        done = blind.run(*words)
        assert done.returncode == 2 or "blind" in done.stderr, (words, done.stdout, done.stderr)
        assert "blind" in done.stderr, (words, done.stderr)
    assert not blind.found()


@pytest.mark.slow
def test_what_is_searched_for_is_found_where_it_is(blind: Blind, monkeypatch: pytest.MonkeyPatch) -> None:
    # the search itself can fail
    assert not blind.found()
    blind.outputs.append(json.dumps(encoded(blind.results)))
    assert blind.found()


@pytest.mark.slow
def test_the_owner_sees_moved_values_and_opens_true_ones_once(
    blind: Blind, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (exact,) = (fit for name, fit in blind.results.runs[0].fits.items() if name == "exact")
    blind.run("fit", blind.record)
    add_sessions(blind.archive, [blind.runs])
    question = "select b, u_b, mean_period_s, sealed from runs where run = 'run-1'"
    assert Archive(blind.archive).connection().execute(question).fetchone() == (None, None, None, None)
    with pytest.raises(ConfigurationError, match="the key is not here"):
        unseal(blind.archive, "commit 1234")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "owner"))
    b, u_b, period_s, sealed = Archive(blind.archive).connection().execute(question).fetchone()
    assert (period_s, sealed) == (None, None)
    assert u_b == exact.estimate("b").standard_uncertainty
    assert 0.5 <= b / exact.estimate("b").value <= 2.0
    assert b != exact.estimate("b").value
    # seen again it is the same state
    assert "0 sessions added" in add_sessions(blind.archive, [blind.runs], read=True)
    with pytest.raises(RecordError, match="is blind"):
        read_results(blind.runs / "series")
    unseal(blind.archive, "commit 1234")
    with pytest.raises(ConfigurationError, match="is not blind"):
        unseal(blind.archive, "commit 1234")
    # from now on the key is nobody's secret
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "nobody"))
    assert Archive(blind.archive).connection().execute(question).fetchone()[0] == exact.estimate("b").value
    opened = read_results(blind.runs / "series").runs[0]
    assert encoded(opened)["fits"] == encoded(blind.results.runs[0])["fits"]
    refuse_blind(blind.record, "nothing")
    assert blind.run("report", blind.runs / "series").returncode == 0


@pytest.mark.slow
def test_rows_that_were_fitted_elsewhere_are_sealed_in_a_blind_archive(blind: Blind) -> None:
    other = blind.base / "open" / "series"
    shutil.copytree(SAMPLES / "series", other)
    add_sessions(blind.archive, [other])
    shutil.rmtree(blind.base / "open")
    true = set(numbers(json.loads((SAMPLES / "series" / "results.json").read_text())))
    blind.true = sorted(value for value in true if math.isfinite(value))
    # uncertainties are not hidden
    told = [place for place in blind.found() if "/sessions/" not in place]
    assert not told
    (state,) = (blind.archive / "sessions").glob("*.parquet")
    for row in parquet.read_table(state).to_pylist():
        assert row["b"] is None
        assert row["mean_period_s"] is None
        assert row["initial_amplitude"] is None


@pytest.mark.slow
def test_a_seal_that_cannot_be_read_is_no_open_folder(blind: Blind) -> None:
    seal = blind.runs / "blind.json"
    data = seal.read_bytes()
    for place in range(0, len(data), 7):
        flipped = bytearray(data)
        flipped[place] ^= 4
        seal.write_bytes(bytes(flipped))
        try:
            found = seal_over(blind.record)
        except RecordError:
            continue
        assert found is not None
        assert found.public_key in data.decode()
    seal.write_bytes(data)
    with pytest.raises(ConfigurationError, match="is blind already"):
        blind_runs(blind.base / "other", [], [blind.runs])
