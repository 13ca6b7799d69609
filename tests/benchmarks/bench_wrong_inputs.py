"""All wrong inputs that follow from models and commands: how many are not refused as they should be."""

import tempfile
from pathlib import Path
from typing import Any

from tests.rig.commands.test_wrong_inputs import faults_of_key, faults_of_words
from tests.rig.commands.wrong_inputs import wrong_keys, wrong_words


def run(quick: bool = False) -> dict[str, Any]:
    """Number of inputs, and of those that were taken, or answered in another way; it must be 0."""
    keys = list(wrong_keys())[:: 5 if quick else 1]
    with tempfile.TemporaryDirectory() as name:
        words = list(wrong_words(Path(name)))[:: 5 if quick else 1]
        faults = [fault for each in keys for fault in faults_of_key(each)]
        faults += [fault for each in words for fault in faults_of_words(each, Path(name))]
    return {"keys": len(keys), "calls": len(words), "faults": len(faults), "not refused": faults}
