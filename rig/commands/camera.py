"""`rig camera`: set up the camera, look at its pictures, save frames for calibrations."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.commands.arguments import (
    Config,
    Set,
    configuration_of,
    group,
    in_json,
    new_file,
    new_folder,
    output_option,
    print_written,
)

if TYPE_CHECKING:
    from rig.devices import OpenCamera
    from rig.settings import Configuration


@contextmanager
def _opened_camera(config: "Configuration") -> Iterator["OpenCamera"]:
    """The configured camera; its settings that differ from the requested ones are printed on stderr."""
    from rig.devices import Devices

    with Devices(config).camera(config) as opened:
        for line in opened.notes:
            typer.echo(line, err=True)
        yield opened


@in_json
def show(config: Config, set_: Set = None) -> None:
    """Print the identity, settings and features of the camera.

    What --set changes holds until the camera loses its power; what a measurement needs belongs in the
    configuration.

    \b
    Examples:
      rig camera show mine.toml
      rig camera show mine.toml --set camera.exposure_us=80 --set camera.features.GainRaw=12
    """
    from rig.devices import feature_lines
    from rig.terminal import answer, print_line

    with _opened_camera(configuration_of(config, set_)) as opened:
        camera, info, applied = opened.camera, opened.info, opened.applied
        print_line(f"{info.driver}: {info.vendor} {info.model} serial {info.serial or 'unknown'}")
        print_line(f"sensor {info.width_px} x {info.height_px} px, full scale {info.full_scale_dn} DN")
        for name, value in applied.model_dump(exclude={"features"}).items():
            print_line(
                f"camera.{name}: not reported by this camera" if value is None else f"camera.{name} = {value}"
            )
        features = getattr(camera, "features", None)
        lines = list(feature_lines(features.readings())) if features is not None else []
        answer(camera=info, settings=applied.model_dump(mode="json"), features=lines)
        for line in lines:
            print_line(line)


Average = Annotated[
    int, typer.Option(help="Number of frames to average, against laser speckle.", min=1, max=10_000)
]


@in_json
def snap(
    config: Config,
    output: Annotated[Path, output_option("PNG file to write.", new_file(".png"))] = Path("snap.png"),
    average: Average = 1,
    set_: Set = None,
) -> None:
    """Save a frame as PNG; print how good the beam is.

    At its full bit depth.

    \b
    Example:
      rig camera snap mine.toml -o spot.png --average 10
    """
    from acquisition import atomic_write
    from acquisition.camera import Frame
    from processing.errors import RecordError
    from rig.devices import picture, take_look
    from rig.instrument import Pipeline, complete, optics_of
    from rig.terminal import answer, print_line

    complete_config = complete(configuration_of(config, set_))
    with _opened_camera(complete_config) as opened:
        full_scale_dn = opened.info.full_scale_dn
        image = picture.average(
            picture.read_frames(opened.camera, average, complete_config.camera.patience_s)
        )
        try:
            atomic_write.remove_leftovers(output.parent, output.name)
            atomic_write.write_new(output, picture.png_of(image, output))
        except OSError as error:
            raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
        pipeline = Pipeline(optics_of(complete_config, full_scale_dn), image.shape)
        frame = Frame(image, 0, 0, 0)
        look = take_look(frame, full_scale_dn, pipeline, None, opened.applied, complete_config.preflight)
        for name, text in look.rows():
            print_line(f"{name:<20}{text}")
        if look.reference is not None:
            print_line(look.reference.lamp.line)
        answer(picture=look.figures, beam=look.beam)
        print_written(output)


@in_json
def frames(
    config: Config,
    output: Annotated[Path, output_option("Folder to make, for the PNG files.", new_folder)],
    number: Annotated[int, typer.Option("-n", "--number", help="Number of frames.", min=1, max=64)] = 2,
    set_: Set = None,
) -> None:
    """Save whole frames for a calibration of the sensor.

    As PNG files, with every bit.

    \b
    Example:
      rig camera frames mine.toml -o level-1 --set camera.exposure_us=50
    """
    from rig.measure import take_frames

    print_written(take_frames(configuration_of(config, set_), output, number))


@in_json
def align(
    config: Config,
    seconds: Annotated[float, typer.Option(help="Stop after this many seconds; 0: at Ctrl-C.", min=0)] = 0.0,
    set_: Set = None,
) -> None:
    """Show the spot's figures, for aligning.

    With the laser lit, if the rig switches one. The picture is on the page of rig desk, which sets the
    camera, too.

    \b
    Example:
      rig camera align mine.toml
    """
    from rig.devices import align_camera
    from rig.instrument import complete

    align_camera(complete(configuration_of(config, set_)), seconds=seconds)


@in_json
def expose(
    config: Config,
    target: Annotated[
        float, typer.Option(help="Wanted peak, as a fraction of full scale.", min=0.05, max=0.95)
    ] = 0.7,
    set_: Set = None,
) -> None:
    """Find the exposure for a wanted peak.

    \b
    Example:
      rig camera expose mine.toml --target 0.6
    """
    from rig.devices import find_exposure
    from rig.terminal import answer, print_line

    with _opened_camera(configuration_of(config, set_)) as opened:
        exposure = find_exposure(opened.camera, opened.info, opened.applied, target)
        answer(found=exposure)
        print_line(f"peak {100 * exposure.peak:.1f} % of full scale; in the configuration, below [camera]:")
        print_line(f"exposure_us = {exposure.exposure_us:.6g}")


commands = group("camera", "Show and test the camera.", show, snap, frames, align, expose)
