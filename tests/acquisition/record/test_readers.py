"""Other readers can read records: Foxglove's, with its layout in docs, Rerun's, the mcap package."""

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun_cli
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import RrdReader

from acquisition.record import pixels_path
from acquisition.record.reader import RecordReader
from acquisition.record.topics import (
    ENVIRONMENT,
    HALF_CYCLE,
    METADATA_COPY,
    PIXEL_TOPICS,
    PREVIEW_TOPIC,
    SPOT,
    number_topics,
)
from processing.deflections import DeflectionUnit
from processing.swing import HalfCycleFlag
from processing.units import ARCSEC_RAD
from tests.acquisition.record.samples import EPOCH_OFFSET_NS, FRAME_NS, write_sample
from tests.rig.view.replay_record import make_record

PACKAGES = ("@mcap/core@2.2.2", "@mcap/support@1.1.0")
SCRIPT = Path(__file__).parent / "node" / "read.mjs"
FRAMES = 128


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("record") / "run.mcap"
    write_sample(path, FRAMES, dtype="u2")
    return path


@pytest.fixture(scope="session")
def mcap_packages(request: pytest.FixtureRequest) -> Path:
    """Folder with Foxglove's reader, installed by npm once into pytest's cache."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm run Foxglove's MCAP reader; install them for this test")
    assert request.config.cache is not None
    folder = Path(request.config.cache.mkdir("mcap-typescript")) / "-".join(PACKAGES).replace("/", "_")
    if not (folder / "node_modules" / "@mcap" / "support").is_dir():
        command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder)]
        done = subprocess.run([*command, *PACKAGES], capture_output=True, text=True, timeout=120, check=False)
        if done.returncode:
            pytest.skip(f"npm could not install {PACKAGES}: {done.stderr.strip().splitlines()[-1:]}")
    return folder


def read_with_node(folder: Path, path: Path, mode: str) -> dict[str, Any]:
    done = subprocess.run(
        ["node", str(SCRIPT), str(folder), str(path), mode],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["indexed", "stream"])
def test_foxgloves_reader_sees_the_same(mcap_packages: Path, record: Path, mode: str) -> None:
    found = read_with_node(mcap_packages, record, mode)
    with RecordReader(record) as reader:
        spots, counts = reader.spots(), reader.counts
        assert found["counts"] == {topic: n for topic, n in counts.items() if topic not in PIXEL_TOPICS}
        for name in SPOT.names:
            ours = spots[name]
            theirs = [spot[name] for spot in found["spots"]]
            if ours.dtype.kind == "i":
                assert theirs == [str(value) for value in ours.tolist()]
            else:
                assert theirs == [value.tobytes().hex() for value in ours]
        assert found["times"]["/spot"] == [str(EPOCH_OFFSET_NS + i * FRAME_NS) for i in range(FRAMES)]
        assert found["logs"] == [event.line for event in reader.events()]
        assert found["metadata"] == reader.metadata
        assert found["attachments"].pop(METADATA_COPY) > 100
        assert found["attachments"] == {name: len(data) for name, data in reader.attachments.items()}
    pictures = read_with_node(mcap_packages, pixels_path(record), mode)
    assert pictures["counts"] == {topic: counts[topic] for topic in PIXEL_TOPICS}
    for (form, data), image in zip(pictures["images"], previewed(record), strict=True):
        assert form == "jpeg"
        seen = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
        assert seen.shape == image.shape
        assert abs(float(seen.mean()) - float(image.mean())) < 1.0
    if mode == "indexed":
        assert found["stated"] == sum(found["counts"].values())
    else:
        assert found["done"] is True


def previewed(record: Path) -> list[np.ndarray[Any, Any]]:
    """The images of which a record has small pictures."""
    with RecordReader(record) as reader:
        kept = [message.sequence for message in reader.messages(PREVIEW_TOPIC)]
        shown = {frame.sequence: frame.image for frame in reader.images()}
        return [shown[sequence] for sequence in kept]


def test_foxgloves_reader_sees_the_whole_chunks_of_a_cut_file(
    mcap_packages: Path, record: Path, tmp_path: Path
) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(record.read_bytes()[: record.stat().st_size * 2 // 3])
    found = read_with_node(mcap_packages, path, "stream")
    with RecordReader(path) as reader:
        assert len(found["spots"]) == len(reader.spots())
    assert found["done"] is False


def test_a_stranger_plots_the_decay(mcap_packages: Path, tmp_path: Path) -> None:
    """With an MCAP reader and what the file itself says, without protobuf and without this program."""
    path = make_record(tmp_path / "run-1.mcap", 40.0)
    command = ["node", str(SCRIPT.with_name("stranger.mjs")), str(mcap_packages), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    with RecordReader(path) as reader:
        half_cycles = [h for h in reader.half_cycles() if not h.flags]
        expected = [(reader.utc(h.turn_time_ns).timestamp(), h.amplitude / ARCSEC_RAD) for h in half_cycles]
    np.testing.assert_allclose(found["decay"], expected, rtol=1e-12)
    assert "arc" in found["comments"]["amplitude_arcsec"]
    assert "standard uncertainty" in found["comments"]["u_amplitude_rad"]
    assert "UTC" in found["comments"]["turn_time_ns"]
    assert found["enums"]["Flag"] == {"FLAG_NONE": 0, **{f"FLAG_{flag.name}": flag for flag in HalfCycleFlag}}
    assert found["enums"]["Side"] == {"SIDE_NONE": 0, "SIDE_POSITIVE": 1, "SIDE_NEGATIVE": -1}
    assert found["attachments"]["record.md"].startswith("# Records")


def run_rerun(folder: Path, *arguments: str) -> str:
    """Rerun's own program, with its usage reports switched off in a settings folder of its own."""
    name = "rerun.exe" if os.name == "nt" else "rerun"
    program = Path(rerun_cli.__file__).parent / name
    if not program.exists():
        pytest.skip(f"no Rerun program at {program}")
    environment = {**os.environ, "XDG_CONFIG_HOME": str(folder / "settings"), "NO_COLOR": "1"}
    subprocess.run([program, "analytics", "disable"], check=True, capture_output=True, env=environment)
    done = subprocess.run(
        [program, *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=60,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_rerun_finds_nothing_wrong(record: Path, tmp_path: Path) -> None:
    rows: list[list[str]] = []
    for path in (record, pixels_path(record)):
        report = run_rerun(tmp_path, "mcap", "check", "--full", str(path))
        rows += [line.split() for line in report.splitlines() if " /" in line and not line.startswith("/")]
    with RecordReader(record) as reader:
        assert {row[3]: row[0] for row in rows} == dict.fromkeys(reader.counts, "ok")
    assert "embedded" in run_rerun(tmp_path, "mcap", "info", str(record))


def test_reruns_conversion_has_every_number_as_a_column_that_plots(record: Path, tmp_path: Path) -> None:
    converted = tmp_path / "run.rrd"
    run_rerun(tmp_path, "mcap", "convert", str(record), "-o", str(converted))
    rows: list[dict[str, Any]] = []
    times: list[int] = []
    components: dict[str, set[str]] = {}
    for chunk in RrdReader(converted).stream():
        batch = chunk.to_record_batch()
        components.setdefault(str(chunk.entity_path), set()).update(batch.schema.names)
        if str(chunk.entity_path) == "/spot" and not chunk.is_static:
            column = batch.column("optical_pendulum.Spot:message")
            fields = column.type.value_type
            assert {str(fields.field(name).type) for name in ("x_px", "y_arcsec", "u_y_rad")} == {"double"}
            rows += [entry[0] for entry in column.to_pylist()]
            times += batch.column("message_log_time").cast("int64").to_pylist()
    with RecordReader(record) as reader:
        spots = reader.spots()
    order = np.argsort(times)
    assert np.array(times)[order].tolist() == [EPOCH_OFFSET_NS + i * FRAME_NS for i in range(FRAMES)]
    for name in ("x_px", "y_rad", "y_arcsec", "u_x_px"):
        assert np.array([rows[i][name] for i in order]).tobytes() == spots[name].tobytes()
    assert [rows[i]["sequence"] for i in order] == spots["sequence"].tolist()
    assert "TextLog:text" in components["/log"]
    assert "Pinhole:image_from_camera" in components["/camera_calibration"]
    assert "optical_pendulum.Swing:message" in components["/swing"]
    run_rerun(tmp_path, "mcap", "convert", str(pixels_path(record)), "-o", str(converted))
    shown = {
        name
        for chunk in RrdReader(converted).stream()
        if str(chunk.entity_path) == "/preview"
        for name in chunk.to_record_batch().schema.names
    }
    assert "EncodedImage:blob" in shown


def test_the_mcap_package_sees_the_same(record: Path) -> None:
    with record.open("rb") as file, pixels_path(record).open("rb") as pixels, RecordReader(record) as ours:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        spots = ours.spots()
        decoded = [item.decoded_message for item in reader.iter_decoded_messages(topics=["/spot"])]
        assert np.array([spot.y_rad for spot in decoded]).tobytes() == spots["y_rad"].tobytes()
        assert [spot.flags for spot in decoded] == spots["flags"].tolist()
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert times == sorted(times)
        middle = EPOCH_OFFSET_NS + FRAMES // 2 * FRAME_NS
        later = list(make_reader(pixels).iter_messages(topics=["/window"], starting_at=middle))
        assert len(later) == FRAMES // 2


LAYOUT = Path(__file__).resolve().parents[3] / "docs" / "foxglove-layout.json"


def panels(place: Any) -> Iterator[str]:
    if isinstance(place, str):
        yield place
    else:
        yield from panels(place["first"])
        yield from panels(place["second"])


def test_everything_it_names_exists() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    known = {f"{kind.topic}.{name}" for kind in (SPOT, HALF_CYCLE, ENVIRONMENT) for name in kind.names}
    topics = {*number_topics(DeflectionUnit.RAD), *PIXEL_TOPICS}
    assert "/losses" in topics
    shown = layout["configById"]
    assert set(panels(layout["layout"])) == set(shown)
    for panel in shown.values():
        assert {path["value"] for path in panel.get("paths", ())} <= known
        named = {panel.get("topicToRender"), panel.get("topicPath"), *panel.get("imageMode", {}).values()}
        assert named - {None} <= topics
    assert "/swing.amplitude_arcsec" in LAYOUT.read_text(encoding="utf-8")
