"""Records and frames as a calibration needs them: the spot as it is, without phases, view and fits."""

from pathlib import Path

import cv2

from acquisition import atomic_write
from processing.errors import ConfigurationError, DataError, RecordError
from rig.devices import Devices, ask_leave
from rig.instrument import complete
from rig.measure.run_parts import RunPlan
from rig.measure.run_setup import measure_run
from rig.orders import SessionNews, light_told
from rig.settings import Configuration

_NO_END = 1e-9
"""Amplitude in arcsec at which a record would end: a clamped pendulum has none."""


def record_plainly(config: Configuration, source: Path, record: Path, seconds: float) -> Path:
    """Record the spot for a time, whatever it does; returns the record.

    Meanwhile its folder's order socket tells how it looks. One that goes dark ends.

    Raises RigError where that fails, KeyboardInterrupt after Ctrl-C, which leaves a closed record.
    """
    updates = {
        "session": config.session.model_copy(
            update={"max_duration_s": seconds, "final_amplitude_arcsec": _NO_END, "stop_when": ()}
        ),
        "view": config.view.model_copy(update={"mode": "none", "file": False}),
        "preflight": config.preflight.model_copy(update={"when": "never"}),
        "start": config.start.model_copy(update={"way": "at once"}),
        # whoever looks at the picture gives no leave to go on
        "laser": config.laser.model_copy(update={"when_dark": "end"}),
    }
    record.parent.mkdir(parents=True, exist_ok=True)
    config = complete(config.model_copy(update=updates))
    folder, session_news = record.parent, SessionNews(config)
    with (
        Devices(config, folder, "a recording for a calibration") as devices,
        light_told(devices, config, folder, session_news),
    ):
        ask_leave(devices)
        plan = RunPlan(config, source, record, record.stem, fitted=False, session_news=session_news)
        outcome = measure_run(plan, devices)
    if outcome.failure is not None:
        raise outcome.failure
    if outcome.interrupt is not None:
        raise outcome.interrupt
    return record


def take_frames(config: Configuration, folder: Path, count: int) -> Path:
    """Save whole frames as PNG, with every bit, into a new folder; the laser stays as it is.

    Raises ConfigurationError for a folder that exists, DataError if the camera gives too few frames.
    """
    if folder.exists():
        raise ConfigurationError(f"{folder}: exists already and is not overwritten; choose another folder")
    with Devices(config).camera(config) as opened:
        opened.camera.start()
        try:
            frames = [opened.camera.read(config.camera.patience_s) for _ in range(count)]
        finally:
            opened.camera.stop()
    images = [frame.image for frame in frames if frame is not None]
    if len(images) < count:
        raise DataError(f"the camera gave {len(images)} frames, {count} were asked for")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write.folder_being_written(folder) as beside:
            for number, image in enumerate(images):
                done, png = cv2.imencode(".png", image)
                if not done:
                    raise DataError(f"{folder / f'{number:03d}.png'}: cannot be written as PNG")
                (beside / f"{number:03d}.png").write_bytes(png.tobytes())
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder
