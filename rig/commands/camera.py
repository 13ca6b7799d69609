"""`rig camera`: set up the camera, look at its pictures, record what calibrations need."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.commands.arguments import (
    MODES,
    Config,
    NewRecord,
    Set,
    View,
    group,
    in_json,
    loaded,
    new_file,
    new_folder,
    old_folder,
    output_option,
    print_written,
)

if TYPE_CHECKING:
    from acquisition.camera import Camera, CameraInfo, CameraSettings, Frame
    from processing.spot import Spot
    from rig.settings import Configuration


@contextmanager
def _opened_camera(
    config: "Configuration",
) -> Iterator[tuple["Camera", "CameraInfo", "CameraSettings"]]:
    """The configured camera, its identity and its settings; settings that differ are printed on stderr."""
    from rig.instrument import camera_settings, check_full_scale, make_camera, setting_differences

    camera = make_camera(config)
    try:
        info = camera.open()
        requested = camera_settings(config)
        applied = camera.configure(requested)
        check_full_scale(config, info, applied)
        for line in setting_differences(requested, applied):
            typer.echo(line, err=True)
        yield camera, info, applied
    finally:
        camera.close()


@in_json
def show(config: Config, set_: Set = None) -> None:
    """Print the identity, settings and features of the camera.

    What is set holds until the camera loses its power.

    \b
    Example:
      rig camera show mine.toml --set camera.exposure_us=80 --set camera.features.GainRaw=12
    """
    from rig.devices import feature_lines
    from rig.terminal import answer, print_line

    with _opened_camera(loaded(config, set_)) as (camera, info, applied):
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


@in_json
def snap(
    config: Config,
    output: Annotated[Path, output_option("PNG file to write.", new_file(".png"))] = Path("snap.png"),
    average: Annotated[
        int, typer.Option(help="Number of frames to average, against laser speckle.", min=1, max=10_000)
    ] = 1,
    set_: Set = None,
) -> None:
    """Save a frame as PNG; print how good the beam is.

    At its full bit depth, with its histogram.

    \b
    Example:
      rig camera snap mine.toml -o spot.png --average 10
    """
    from acquisition import atomic_write
    from processing.errors import RecordError
    from rig.devices import ReferencePart
    from rig.devices import picture as camera_picture
    from rig.instrument import beam_quality, complete, optics_of
    from rig.terminal import answer, print_line

    stated = complete(loaded(config, set_))
    with _opened_camera(stated) as (camera, info, _):
        image = camera_picture.average(camera_picture.read_frames(camera, average, stated.camera.patience_s))
        png = camera_picture.png_of(image, output)
        try:
            atomic_write.take_away_leftovers(output.parent, output.name)
            atomic_write.write_new(output, png)
        except OSError as error:
            raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
        print_line("pixels in each range of grey values (bars: logarithmic)")
        for line in camera_picture.histogram_bars(image, info.full_scale_dn):
            print_line(line)
        figures = camera_picture.figures(image, info.full_scale_dn)
        saturated = f"{figures.saturated_px} px SATURATED" if figures.saturated_px else "none saturated"
        peak = f"peak {100 * figures.peak:6.1f} %"
        print_line(f"{peak}  {saturated}  sharpness {figures.sharpness_per_px:.4f} /px")
        optics = optics_of(stated, info.full_scale_dn)
        tracker, reference = optics.tracker(), optics.reference()
        # each spot is judged in its own part of the frame
        split_row = len(image) if reference is None else min(len(image), reference[1])
        spot = tracker.track(image[:split_row])
        limits = stated.preflight
        beam = beam_quality([image[:split_row]], [spot], tracker.model, info.full_scale_dn, limits)
        print_line(beam.line)
        if reference is not None and split_row < len(image):
            reference_spot = reference[0].track(image[split_row:])
            reference_spot = reference_spot._replace(y_px=reference_spot.y_px + split_row)
            print_line(ReferencePart.in_image(reference_spot, split_row, image, info.full_scale_dn).lamp.line)
        answer(picture=figures, beam=beam)
        print_written(output)


@in_json
def record(
    config: Config,
    output: NewRecord,
    seconds: Annotated[float, typer.Option(help="Length of the record.", min=1)] = 20.0,
    set_: Set = None,
) -> None:
    """Record the spot as it is, for a calibration.

    No preflight, start, view or fits; the pendulum may be clamped.

    \b
    Example:
      rig camera record mine.toml -o clamped.mcap --seconds 120
    """
    from rig.measure import record_plainly

    print_written(record_plainly(loaded(config, set_), config, output, seconds))


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

    print_written(take_frames(loaded(config, set_), output, number))


@in_json
def align(
    config: Config,
    output: Annotated[Path, output_option("Folder for pictures (key s).", old_folder)] = Path("."),
    seconds: Annotated[float, typer.Option(help="Stop after this many seconds; 0: at q.", min=0)] = 0.0,
    rrd: Annotated[
        Path | None,
        output_option("Also write the live picture into this Rerun file.", new_file(".rrd"), names=()),
    ] = None,
    view: View = None,
    set_: Set = None,
) -> None:
    """Show the live picture, for aligning.

    With crosshair, saturation, histogram and beam, and with the laser lit, if the rig switches one. e and E
    make the exposure shorter and longer, a finds it, g and G the gain smaller and larger, z zooms in on the
    spot, s saves the picture, q ends. What was set holds until the camera loses its power.

    \b
    Example:
      rig camera align mine.toml --view web
    """
    from contextlib import nullcontext

    from rig.devices import align_camera
    from rig.instrument import complete, configuration_attachments, session_metadata
    from rig.view import ScratchView

    stated = complete(loaded(config, set_))
    is_viewed = rrd is not None or bool(view)
    with (
        ScratchView("aligning", MODES[view], rrd, "balancing", stated.deflection_unit)
        if is_viewed
        else nullcontext()
    ) as scratch_view:

        def show_frame(frame: "Frame", spot: "Spot", info: "CameraInfo") -> None:
            assert scratch_view is not None
            if not scratch_view.begun:
                scratch_view.begin(
                    frame.time_ns,
                    epoch_offset_ns=time.time_ns() - frame.time_ns,
                    metadata=session_metadata(stated, info, frame),
                    attachments=configuration_attachments(stated, config),
                )
            scratch_view.look(frame, spot)

        print_written(
            *align_camera(stated, folder=output, seconds=seconds, view=show_frame if is_viewed else None)
        )


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

    with _opened_camera(loaded(config, set_)) as (camera, info, applied):
        found = find_exposure(camera, info, applied, target)
        answer(found=found)
        print_line(f"peak {100 * found.peak:.1f} % of full scale; in the configuration, below [camera]:")
        print_line(f"exposure_us = {found.exposure_us:.6g}")


commands = group("camera", "Show and test the camera.", show, snap, record, frames, align, expose)
