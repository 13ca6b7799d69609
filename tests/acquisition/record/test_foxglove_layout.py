"""The layout for Foxglove in docs shows topics and fields that records have."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from acquisition.record.topics import ENVIRONMENT, PIXEL_TOPICS, SPOT, SWING, number_topics
from processing.deflections import DeflectionUnit

LAYOUT = Path(__file__).resolve().parents[3] / "docs" / "foxglove-layout.json"


def panels(place: Any) -> Iterator[str]:
    if isinstance(place, str):
        yield place
    else:
        yield from panels(place["first"])
        yield from panels(place["second"])


def test_everything_it_names_exists() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    known = {f"{kind.topic}.{name}" for kind in (SPOT, SWING, ENVIRONMENT) for name in kind.names}
    topics = {*number_topics(DeflectionUnit.RAD), *PIXEL_TOPICS}
    assert "/losses" in topics
    shown = layout["configById"]
    assert set(panels(layout["layout"])) == set(shown)
    for panel in shown.values():
        assert {path["value"] for path in panel.get("paths", ())} <= known
        named = {panel.get("topicToRender"), panel.get("topicPath"), *panel.get("imageMode", {}).values()}
        assert named - {None} <= topics
    assert "/swing.amplitude_arcsec" in LAYOUT.read_text(encoding="utf-8")
