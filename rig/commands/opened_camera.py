"""The camera as a command has it: opened with its settings, closed at the end."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from acquisition.camera import Camera, CameraInfo, CameraSettings


@contextmanager
def opened_camera(
    config: Path, set_: list[str] | None
) -> Iterator[tuple["Camera", "CameraInfo", "CameraSettings"]]:
    """The configured camera, who it is, and the settings that hold; those that differ are said on stderr."""
    from rig.instrument import camera_settings, check_full_scale, make_camera, setting_differences
    from rig.settings import load_configuration

    loaded = load_configuration(config, set_ or [])
    camera = make_camera(loaded)
    try:
        info = camera.open()
        asked = camera_settings(loaded)
        applied = camera.configure(asked)
        check_full_scale(loaded, info, applied)
        for line in setting_differences(asked, applied):
            typer.echo(line, err=True)
        yield camera, info, applied
    finally:
        camera.close()
