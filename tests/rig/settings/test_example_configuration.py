"""configs/rig-example.toml contains every key with its default and description."""

import re

from rig.settings import load_configuration
from tests.rig.settings.example_configuration import TARGET, keys, text


def test_the_example_is_what_the_models_say() -> None:
    assert TARGET.read_text(encoding="utf-8") == text(), (
        "run: python -m tests.rig.settings.example_configuration"
    )


def test_the_example_loads_as_it_is() -> None:
    config = load_configuration(TARGET)
    assert config.camera.driver == "usb3vision"
    assert config.session.runs == 3


def test_every_key_stands_in_the_example() -> None:
    section = ""
    found = set()
    for line in TARGET.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"(?:# )?\[+([\w.]+)\]+", line):
            section = match.group(1) + "."
        elif match := re.match(r"(?:# )?(\w+) = ", line):
            found.add(section + match.group(1))
    assert set(keys()) <= found
