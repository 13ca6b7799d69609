"""Sessions of many rigs over years: records of real decays, small, and the results of their fits."""

import copy
import datetime
import hashlib
import json
import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from acquisition.record.events import EventKind
from acquisition.record.writer import RecordWriter
from acquisition.simulation.true_path import true_path
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from processing.swing import swings_of
from rig.analysis import analyse_record, encoded, session_results
from rig.instrument import CONFIGURATION_NAME, complete, configuration_attachments
from rig.settings import load_configuration

CONFIG = Path(__file__).resolve().parents[3] / "configs" / "demo.toml"
RUNS = 3
RATE_HZ = 12
LENGTH_S = 44.0
U_RAD = 2e-8
START_NS = 5_000_000_000
FIRST_NS = 1_600_000_000_000_000_000
STAMP = b"number 000000000000"
"""A note of the same length in every record, by which no two have the same hash."""
_ATTACHMENT, _DATA_END = 0x09, 0x0F
_HEAD = struct.Struct("<BQ")


class Template(NamedTuple):
    """A record's bytes, and what `results.json` says of it."""

    data: bytes
    results: dict[str, Any]


def make_template(path: Path, seed: int) -> Template:
    """One run of a rig, drawn at random: which friction, which sample, which day's air."""
    random = np.random.default_rng(seed)
    rig, glass = seed % 10, ("K8", "fused silica", "silicon", "sapphire")[seed % 4]
    settings = [
        f"simulation.contact.b={37.33e-4 * random.uniform(4.0, 9.0)}",
        f"simulation.contact.c={10.51e-9 * random.uniform(4.0, 9.0)}",
        f"session.sample=steel ball on {glass}",
        f"session.operator=operator of rig {rig}",
        f"environment.temperature_c={random.uniform(19.0, 24.0):.2f}",
        f"environment.humidity_percent={random.uniform(20.0, 60.0):.1f}",
    ]
    config = complete(load_configuration(CONFIG, settings))
    truth = true_path(config.simulation, LENGTH_S, RATE_HZ)
    count = round(LENGTH_S * RATE_HZ)
    times_ns = START_NS + np.round(np.arange(count) / RATE_HZ * 1e9).astype(np.int64)
    x, y = (values[:count] + random.normal(0.0, U_RAD, count) for values in (truth.x_rad, truth.y_rad))
    u = np.full(count, U_RAD)
    session = config.session
    metadata = {
        "session": {
            "operator": session.operator,
            "sample": session.sample,
            "contact_history": session.contact_history,
            "notes": STAMP.decode(),
            "host": f"rig-{rig}",
        },
        "environment": {
            "temperature_c": str(config.environment.temperature_c),
            "humidity_percent": str(config.environment.humidity_percent),
        },
        "camera": {"model": "simulated rig", "serial": f"rig-{rig}", "full_scale_dn": "255"},
        "frame": {"width_px": "1280", "height_px": "1024"},
        "versions": {"optical-pendulum-rig": "0.1.0", "commit": "0" * 40},
    }
    attachments = configuration_attachments(config, CONFIG)
    writer = RecordWriter(
        path,
        FIRST_NS + seed * 86_400_000_000_000,
        metadata=metadata,
        attachments={CONFIGURATION_NAME: attachments[CONFIGURATION_NAME]},
        flush_interval_s=math.inf,
    )
    spots = [Spot(640.0, 512.0, 0.01, 0.01, 9.0, 9.0, 0.0, 200.0, 8.0, 1.0, 0)] * count
    with writer:
        listed = times_ns.tolist()
        deflections = Deflections(times_ns, x, y, u, u, DeflectionUnit.RAD)
        writer.write_spots(range(count), listed, listed, spots, deflections)
        for swing in swings_of(times_ns, y, u):
            writer.write_swing(swing)
        # without an end a record counts as cut short
        writer.write_event(listed[0], EventKind.START, "first frame")
        writer.write_event(listed[-1], EventKind.STOP, "44 s are over")
    tree = encoded(session_results([analyse_record(path)], path.parent))
    data = path.read_bytes()
    path.unlink()
    return Template(data, tree["runs"][0])


def stamped(data: bytes, number: int) -> bytes:
    """A template's record with a note of its own: another hash, and all checksums as they must be."""
    changed = bytearray(data.replace(STAMP, b"number %012d" % number))
    place = 8
    while True:
        kind, length = _HEAD.unpack_from(changed, place)
        first = place + _HEAD.size
        if kind == _DATA_END:
            struct.pack_into("<I", changed, first, zlib.crc32(changed[:place]))
            return bytes(changed)
        if kind == _ATTACHMENT:
            last = first + length - 4
            struct.pack_into("<I", changed, last, zlib.crc32(changed[first:last]))
        place = first + length


def make_sessions(folder: Path, count: int, *, templates: int = 24, seed: int = 1) -> Iterator[Path]:
    """Write sessions of three runs each, one folder each, in folders of a hundred; yields their folders.

    Parameters of the fits are moved by their own standard uncertainties at random.
    """
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(seed)
    made = [make_template(folder / "template.mcap", seed * 1000 + number) for number in range(templates)]
    for session in range(count):
        place = folder / f"{session // 100:04d}" / f"session-{session:05d}"
        place.mkdir(parents=True)
        template = made[int(random.integers(templates))]
        runs = []
        for run in range(RUNS):
            data = stamped(template.data, seed * 10**9 + session * RUNS + run)
            (place / f"run-{run + 1}.mcap").write_bytes(data)
            said = copy.deepcopy(template.results)
            said |= {"record": f"run-{run + 1}.mcap", "sha256": hashlib.sha256(data).hexdigest()}
            for fit in said["fits"].values():
                for item in fit.values():
                    if isinstance(item, dict) and item.get("standard_uncertainty"):
                        item["value"] += item["standard_uncertainty"] * random.normal()
            runs.append(said)
        (place / "results.json").write_text(json.dumps({"schema": 1, "runs": runs}))
        began = datetime.datetime.fromtimestamp(FIRST_NS * 1e-9, datetime.UTC)
        (place / "session.json").write_text(json.dumps({"began": began.isoformat(), "runs": RUNS}))
        yield place
