"""`rig camera`: set up the camera."""

from typing import Annotated, Any

import typer

from rig.commands.arguments import Config, Set, in_json
from rig.commands.pictures import align, expose, focus, frames, opened_camera, record, snap


def register(app: typer.Typer) -> None:
    """Add `rig camera`."""
    camera = typer.Typer(help="Show, set and test the camera.", no_args_is_help=True)
    camera.command("show")(in_json(show))
    camera.command("set")(in_json(set_features))
    for command in (snap, record, frames, focus, align, expose):
        camera.command()(in_json(command))
    app.add_typer(camera, name="camera")


def show(config: Config, set_: Set = None) -> None:
    """Print the identity, settings and features of the camera.

    \b
    Example:
      rig camera show mine.toml
    """
    from rig.devices import feature_lines
    from rig.presentation import answer, print_line

    with opened_camera(config, set_) as (camera, info, applied):
        print_line(f"{info.driver}: {info.vendor} {info.model} serial {info.serial or 'unknown'}")
        print_line(f"sensor {info.width_px} x {info.height_px} px, full scale {info.full_scale_dn} DN")
        for name, value in applied.model_dump(exclude={"features"}).items():
            print_line(
                f"camera.{name}: not reported by this camera" if value is None else f"camera.{name} = {value}"
            )
        features = getattr(camera, "features", None)
        lines = list(feature_lines(features.nodes.readings())) if features is not None else []
        answer(camera=info, settings=applied.model_dump(mode="json"), features=lines)
        for line in lines:
            print_line(line)


def set_features(
    config: Config,
    assignments: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", show_default=False)],
    set_: Set = None,
) -> None:
    """Set features or settings by their names.

    Features have their GenICam name, settings that of [camera]. They hold until the camera loses its power;
    what a measurement needs belongs in the configuration.

    \b
    Example:
      rig camera set mine.toml exposure_us=80 GainRaw=12
    """
    from acquisition.camera import CameraSettings
    from processing.errors import ConfigurationError
    from rig.presentation import answer, print_line
    from rig.settings import apply_overrides, load_configuration, validate_configuration

    loaded = load_configuration(config, set_ or [])
    with opened_camera(config, set_) as (camera, _, _):
        for assignment in assignments:
            name, equals, value = assignment.partition("=")
            if not equals:
                raise ConfigurationError(f"{assignment}: must read NAME=VALUE")
            if name in CameraSettings.model_fields and name != "features":
                tree: dict[str, Any] = {"camera": {"driver": loaded.camera.driver}}
                apply_overrides(tree, [f"camera.{assignment}"])
                asked = validate_configuration(tree, str(config)).camera
                applied = camera.configure(CameraSettings(**{name: getattr(asked, name)}))
                answer(**{f"camera.{name}": getattr(applied, name)})
                print_line(f"camera.{name} = {getattr(applied, name)}")
            elif hasattr(camera, "features"):
                now = camera.features.set(name, value)
                answer(**{name: now})
                print_line(f"{name} = {now}")
            else:
                known = ", ".join(CameraSettings.model_fields)
                raise ConfigurationError(f"{name}: this camera has no such setting; there are {known}")
