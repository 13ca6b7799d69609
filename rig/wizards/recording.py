"""Records what a question wants, with the rig as configured."""

from collections.abc import Callable
from pathlib import Path

from rig.measure import record_plainly, take_frames
from rig.settings import Configuration
from rig.wizards.calibration import next_free
from rig.wizards.question import RecordedAnswer


def recorder_of(config: Configuration, source: Path, folder: Path) -> Callable[[RecordedAnswer], Path]:
    """Records into new files and folders of `folder`; the function returns what it has made.

    It raises RigError where that fails.
    """

    def record(wanted: RecordedAnswer) -> Path:
        path = place_for(wanted, folder)
        if wanted.kind == "record":
            return record_plainly(config, source, path, wanted.seconds)
        exposed = config
        if wanted.exposure_us is not None:
            camera = config.camera.model_copy(update={"exposure_us": wanted.exposure_us})
            exposed = config.model_copy(update={"camera": camera})
        return take_frames(exposed, path, wanted.frames)

    return record


def place_for(wanted: RecordedAnswer, folder: Path) -> Path:
    """A new name in `folder` for what is recorded."""
    return next_free(folder / "records", wanted.name, ".mcap" if wanted.kind == "record" else "")
