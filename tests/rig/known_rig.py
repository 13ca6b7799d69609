"""A rig that has been used before, for tests that are not about the first start."""

import os
from pathlib import Path

from rig.control import LASERS, ControllerSettings, LaserSettings, rig_state_path


def known(port: str, states: Path | None = None) -> None:
    """Nothing is latched of what lights at this port, whatever it is; what is known already stays.

    Only where the states of rigs are kept apart from the user's own: in `states`, which stands for
    XDG_STATE_HOME, or where that is set.
    """
    if states is None and "XDG_STATE_HOME" not in os.environ:
        return
    board = ControllerSettings(kind="serial", port=port)
    fed = LaserSettings(kind="controller", max_power_w=0.001)
    lasers = [LaserSettings.model_construct(kind=kind, port=port) for kind in LASERS]
    for path in (rig_state_path(laser, board) for laser in (fed, *lasers)):
        if path is not None and states is not None:
            path = states / path.parent.name / path.name
        if path is not None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("{}")
