"""What a report says of the configuration."""

import json

import pytest

from rig.report.source import shown_configuration
from rig.settings import load_configuration
from tests.rig.command_line import CONFIGS


@pytest.mark.parametrize("simulated", [True, False])
def test_a_real_run_shows_nothing_of_the_simulated_rig(simulated: bool) -> None:
    tree = json.loads(load_configuration(CONFIGS / "demo.toml").model_dump_json())
    shown = shown_configuration(tree, simulated=simulated)
    assert any(key.startswith("simulation.") for key in shown) is simulated
    assert shown["camera.driver"] == "simulated"
