"""The view that a configuration asks for."""

from collections.abc import Callable
from pathlib import Path

from processing.balance import Balance
from rig.instrument import advice_text
from rig.rerun import LayoutName, Mode
from rig.settings import Configuration
from rig.view.viewer import Viewer


def open_view(config: Configuration, record: Path, title: str, full_scale_dn: int) -> Viewer | None:
    """The view that the configuration asks for, started; None where it asks for none."""
    settings = config.view
    if settings.mode == "none" and not settings.file:
        return None
    rrd = record.with_suffix(".rrd") if settings.file else None
    return start_view(config, rrd, settings.mode, settings.layout, title, full_scale_dn)


def start_view(
    config: Configuration,
    rrd: Path | None,
    mode: Mode,
    layout: LayoutName,
    title: str,
    full_scale_dn: int,
    advise: Callable[[Balance], str] | None = None,
) -> Viewer:
    """A view of a run that goes on, or is replayed: a Rerun file, a live stream, or both.

    `advise` says what to turn where more is known than what the weights should do.
    """
    viewer = Viewer(
        rrd,
        mode,
        layout,
        title,
        amplitude=config.session.initial_amplitude_arcsec,
        unit=config.deflection_unit,
        image_interval_s=config.view.image_interval_s,
        full_scale_dn=full_scale_dn,
        advise=advise or (lambda balance: advice_text(config, balance)),
    )
    viewer.start()
    return viewer
