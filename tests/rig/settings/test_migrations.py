"""Configurations, sessions and results of every schema that there ever was are read in today's keys."""

import json
import logging
import shutil
from pathlib import Path
from typing import Any

import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.errors import ConfigurationError, RecordError
from rig.analysis import read_results
from rig.instrument import earlier_schema, recorded_configuration
from rig.instrument.provenance import CONFIGURATION_NAME, configuration_attachments
from rig.measure.session_file import STATE_NAME, read_session
from rig.settings import SCHEMA, load_configuration, migrated, validate_configuration
from rig.settings.migrations import GONE, SCHEMA_KEY
from tests.rig.command_line import CONFIGS, rig

OLDER = Path(__file__).parents[1] / "data" / "older"
SCHEMAS = {"first": 1, "series": 1, "last_of_schema_1": 1, "last_of_schema_2": 2}
"""Folders of records with the schema of their configuration; of a new schema one is added."""


def record_with(tree: dict[str, Any], folder: Path) -> Path:
    """A record that holds nothing but a configuration."""
    path = folder / "run-1.mcap"
    with RecordWriter(path, 0, attachments={CONFIGURATION_NAME: json.dumps(tree).encode()}):
        pass
    return path


def stored(folder: Path) -> dict[str, Any]:
    """The configuration as the record of a folder holds it."""
    with RecordReader(folder / "run-1.mcap") as reader:
        tree: dict[str, Any] = json.loads(reader.attachments[CONFIGURATION_NAME])
    return tree


def value_at(tree: Any, key: str) -> Any:
    for part in key.split("."):
        tree = tree.get(part, {}) if isinstance(tree, dict) else {}
    return tree


def test_there_is_a_record_of_every_schema() -> None:
    found = {name: stored(OLDER / name).get(SCHEMA_KEY, 1) for name in SCHEMAS}
    assert found == SCHEMAS
    assert {*range(1, SCHEMA)} <= {*found.values()}


@pytest.mark.parametrize("name", SCHEMAS)
def test_an_older_record_is_read_in_todays_keys(name: str) -> None:
    with RecordReader(OLDER / name / "run-1.mcap") as reader:
        config = recorded_configuration(reader)
        assert config.pendulum is not None
        assert (config.pendulum.mass_kg, config.camera.driver) == (0.406, "simulated")
        said = earlier_schema(reader)
        assert f"its configuration is of schema {SCHEMAS[name]}, read as {SCHEMA}: without " in said
        assert "fit.drag" in said
        # that no drag was fitted said nothing of the air
        assert config.fit.drag == "air"
        assert recorded_configuration(reader, ["fit.drag=vacuum"]).fit.drag == "vacuum"


@pytest.mark.parametrize("name", ["first", "last_of_schema_1", "last_of_schema_2"])
def test_commands_take_an_older_record(name: str, tmp_path: Path) -> None:
    shutil.copytree(OLDER / name, tmp_path / name)
    record = tmp_path / name / "run-1.mcap"
    assert "whole" in rig("info", record).stdout
    before = json.loads((OLDER / name / "results.json").read_text())["runs"][0]
    for command in (["fit"], ["replay"]):
        done = rig(*command, record, "-o", tmp_path / command[0])
        assert done.stderr.count(f"is of schema {SCHEMAS[name]}, read as {SCHEMA}") == 1
        (run,) = json.loads((tmp_path / command[0] / "results.json").read_text())["runs"]
        assert (run["sha256"], run["frames"]) == (before["sha256"], before["frames"])
        assert run["half_cycles"] == before["half_cycles"]


@pytest.mark.parametrize("name", SCHEMAS)
def test_older_sessions_and_results_are_read(name: str) -> None:
    tree, note = migrated(read_session(OLDER / name).configuration, "session.json: its configuration")
    assert f"is of schema {SCHEMAS[name]}, read as {SCHEMA}" in note
    assert validate_configuration(tree, "session.json").camera.driver == "simulated"
    (run, *_) = read_results(OLDER / name).runs
    assert run.initial_amplitude is not None
    assert run.initial_amplitude > 0


def test_every_key_that_went_was_once_stored() -> None:
    trees = [stored(OLDER / name) for name in SCHEMAS]
    for key in GONE:
        assert any(value_at(tree, key) != {} for tree in trees), key


def test_a_record_of_today_is_of_todays_schema(tmp_path: Path) -> None:
    config = load_configuration(CONFIGS / "demo.toml")
    tree = json.loads(configuration_attachments(config, tmp_path)[CONFIGURATION_NAME])
    assert tree[SCHEMA_KEY] == SCHEMA
    with RecordReader(record_with(tree, tmp_path)) as reader:
        assert recorded_configuration(reader) == config
        assert earlier_schema(reader) == ""


@pytest.mark.parametrize(
    ("schema", "words"),
    [
        (SCHEMA + 1, f"schema {SCHEMA + 1} was written by a later version; this one reads up to {SCHEMA}"),
        ("2", "schema '2' should be a whole number"),
        (0, "schema 0 should be a whole number"),
        (True, "schema True should be a whole number"),
    ],
)
def test_what_a_later_version_wrote_is_refused(schema: object, words: str, tmp_path: Path) -> None:
    tree = {**stored(OLDER / "last_of_schema_1"), SCHEMA_KEY: schema, "key of tomorrow": 1}
    with (
        RecordReader(record_with(tree, tmp_path)) as reader,
        pytest.raises(RecordError, match=f"run-1.mcap: its configuration: {words}"),
    ):
        recorded_configuration(reader)
    file = tmp_path / "rig.toml"
    file.write_text(f'{SCHEMA_KEY} = {json.dumps(schema)}\n[camera]\ndriver = "simulated"\n')
    with pytest.raises(ConfigurationError, match=f"rig.toml: {words}"):
        load_configuration(file)


def test_a_later_session_is_refused(tmp_path: Path) -> None:
    tree = json.loads((OLDER / "first" / STATE_NAME).read_text())
    (tmp_path / STATE_NAME).write_text(json.dumps(tree | {"schema_version": 9}))
    with pytest.raises(ConfigurationError, match="schema 9 was written by a later version; this one reads"):
        read_session(tmp_path)


def test_a_file_says_its_schema_or_is_of_todays(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    below, above = tmp_path / "below.toml", tmp_path / "above.toml"
    below.write_text('[camera]\ndriver = "usb3vision"\n[camera.usb3vision]\nbuffers = 500\n')
    above.write_text('extends = "below.toml"\n')
    why = "camera.usb3vision.buffers: is no longer a key: frames that are late wait in"
    with pytest.raises(ConfigurationError, match=why):
        load_configuration(above)
    assert not caplog.records
    below.write_text(f"{SCHEMA_KEY} = 1\n{below.read_text()}")
    with caplog.at_level(logging.WARNING):
        assert load_configuration(above).camera.driver == "usb3vision"
    assert f"{below} is of schema 1, read as {SCHEMA}: without camera.usb3vision.buffers" in caplog.text
