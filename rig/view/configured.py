"""Starts the configured view."""

from collections.abc import Callable, Sequence
from pathlib import Path

from processing.balance import Balance
from rig.instrument import advice_for
from rig.rerun import LayoutName, Mode
from rig.settings import Configuration
from rig.view.viewer import Viewer


def open_view(
    config: Configuration, record: Path, title: str, full_scale_dn: int, parameters: Sequence[str] = ()
) -> Viewer | None:
    """Start the configured view; None if the configuration asks for none.

    `parameters` are the keys of those that are estimated while the run is measured.
    """
    settings = config.view
    if settings.mode == "none" and not settings.file:
        return None
    rrd = record.with_suffix(".rrd") if settings.file else None
    return start_view(
        config, rrd, settings.mode, settings.layout, title, full_scale_dn, parameters=parameters
    )


def start_view(
    config: Configuration,
    rrd: Path | None,
    mode: Mode,
    layout: LayoutName,
    title: str,
    full_scale_dn: int,
    advise: Callable[[Balance], str] | None = None,
    parameters: Sequence[str] = (),
) -> Viewer:
    """Start the view of a live or replayed run: a Rerun file, a live stream, or both.

    `advise` returns the advice for a balance; default: advice from the expected effects of the weights.
    """
    viewer = Viewer(
        rrd,
        mode,
        layout,
        f"SIMULATED {title}" if config.simulated else title,
        amplitude=config.session.initial_amplitude_arcsec,
        unit=config.deflection_unit,
        image_interval_s=config.view.image_interval_s,
        full_scale_dn=full_scale_dn,
        parameters=parameters,
        has_reference=config.reference is not None,
        advise=advise or (lambda balance: advice_for(config, balance).markdown),
    )
    viewer.start()
    return viewer
