"""The panels of the desk, in their order. A new one is a module here, and a line below."""

from collections.abc import Callable
from typing import NamedTuple

from rig.desk.desk import Desk
from rig.desk.panels import balance, calibrate, measure, rig_panel, runs
from rig.desk.tab import Tab


class Panel(NamedTuple):
    """A panel: its name, the function that builds it, and its keys with what they do."""

    name: str
    build: Callable[[Desk, Tab], None]
    keys: tuple[tuple[str, str], ...] = ()


PANELS = (
    Panel("Rig", rig_panel.build, rig_panel.KEYS),
    Panel("Balance", balance.build),
    Panel("Measure", measure.build),
    Panel("Calibrate", calibrate.build),
    Panel("Runs", runs.build, runs.KEYS),
)
