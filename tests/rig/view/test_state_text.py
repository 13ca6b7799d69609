"""What the State panel says: of what time it is, how the session keeps up, why another panel is empty."""

import math
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.topics import (
    RecordedClockStep,
    RecordedEstimate,
    RecordedHealth,
    RecordedLosses,
    RecordedPhase,
)
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections
from processing.spot import Spot
from rig.instrument import complete, configuration_attachments
from rig.settings import load_configuration
from rig.view.show import show_records
from tests.rig.view.replay_record import CONFIG, EPOCH_NS
from tests.rig.view.rrd_contents import column

HEALTHY = RecordedHealth(0, 1000, 4, 0, 0, 0, 10**6, 0.0123, 1e9, 0.0, 31.204, 0.052, "", "one Gaussian")


def state_of(
    folder: Path, *, calibrated: bool = True, estimates: dict[str, tuple[float, float]] | None = None
) -> str:
    """The last text but that of the end of a run of one spot, whose session says something of itself."""
    config = complete(load_configuration(CONFIG))
    if not calibrated:
        config = config.model_copy(update={"lever": None})
    unit, one = config.deflection_unit, np.zeros(1)
    attachments = configuration_attachments(config, CONFIG)
    with RecordWriter(folder / "run.mcap", EPOCH_NS, attachments=attachments, deflection_unit=unit) as writer:
        spot = Spot(320.0, 160.0, 0.01, 0.01, 12.0, 12.0, 0.0, 200.0, 8.0, 1.0, 0)
        writer.write_spots(
            [0], [0], [0], [spot], Deflections(np.zeros(1, np.int64), one, one, one, one, unit)
        )
        writer.write(RecordedPhase(0, 0.0, "measuring", instruction="look at the laser"))
        writer.write(RecordedClockStep(0, 130_000_000, 1000))
        writer.write(RecordedLosses(0, 0, 3, 1, 0, 0))
        writer.write(HEALTHY)
        for name, (value, u) in (estimates or {}).items():
            writer.write(RecordedEstimate(0, 80, value, u, name))
    show_records([folder / "run.mcap"], rrd=folder / "run.rrd")
    ((text,),) = column(folder / "run.rrd", "/state", "TextDocument:text")[1][-2:-1]
    return str(text)


def test_the_state_says_how_the_session_keeps_up_and_why_panels_are_empty(tmp_path: Path) -> None:
    text = state_of(tmp_path)
    assert text.startswith("**measuring**\n\nlook at the laser\n\n- state of ")
    assert "- frames were 12 ms old when they were processed\n" in text
    assert "- camera's clock +31.204 ± 0.052 ppm against the computer's, stepped once by +0.13 s\n" in text
    assert "- lost: 3 by the bus, 1 by this computer\n" in text
    assert "- beam: one Gaussian\n" in text
    # every empty panel has a reason
    assert "amplitude and period are empty until a half-cycle" in text
    assert "the balance is empty until" in text
    assert "enough half-cycles for a first fit" in text


def test_without_a_lever_nothing_is_fitted(tmp_path: Path) -> None:
    assert "without [lever]" in state_of(tmp_path, calibrated=False)


@pytest.mark.parametrize(("u", "vague"), [(0.4, False), (0.6, True), (math.nan, True)])
def test_a_parameter_that_is_not_drawn_is_named(tmp_path: Path, u: float, vague: bool) -> None:
    names = ("b", "p", "c", "n", "period0_s", "gamma_pa", "drag_s")
    text = state_of(tmp_path, estimates=dict.fromkeys(names, (1.0, 0.01)) | {"gamma_pa": (1.0, u)})
    assert ("not known to a half of their values yet, hence not drawn: γ\n" in text) == vague
