"""What stands on every page beside NiceGUI's elements: style, scripts, safety bar, the watchdog's line.

The safety bar at the foot has lamps with their ages, LIGHT OFF and silence. It is drawn by the page itself,
over dialogs too, so that a desk which says nothing any more is seen: what is older than two seconds is no
state, and what was confirmed last is stated with its time. The watchdog finds a desk that is slow or gone.
"""

import json
from pathlib import Path

from nicegui import ui

from rig.alarms import CATALOGUE, AlarmKey
from rig.control import STALE_S
from rig.desk.theme import named_colours

DARK = "/dark"
"""Where LIGHT OFF is sent to, at both servers."""
_DEAD_S = 30.0
"""A page that was told nothing for so long is not merely slow."""
_STATIC = Path(__file__).with_name("static")
_SCRIPTS = ("page.js", "safety.js", "watchdog.js")
_BARS = """
<div id="watchdog" role="alert" aria-live="assertive" hidden></div>
<div id="safety" role="region" aria-label="safety">
  <button id="light-off" type="button" aria-label="light off, key F9">LIGHT OFF</button>
  <span class="lamp" id="lamp-laser" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-interlock" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-recording"></span>
  <span class="lamp" id="lamp-age"></span>
  <span id="off-said" role="status" aria-live="assertive"></span>
  <button id="silence" type="button" hidden>Silence</button>
</div>
"""


def build_head(off_port: int) -> None:
    """Add it to the page that is being built; `off_port` is the server of LIGHT OFF beside the event loop."""
    lost = CATALOGUE[AlarmKey.DESK_LOST]
    told = {
        "offPort": off_port,
        "dark": DARK,
        "staleS": STALE_S,
        "deadS": _DEAD_S,
        "lost": {"title": AlarmKey.DESK_LOST, "remedy": lost.remedy},
    }
    ui.add_css(named_colours() + (_STATIC / "desk.css").read_text("utf-8"))
    scripts = "".join((_STATIC / name).read_text("utf-8") for name in _SCRIPTS)
    ui.add_head_html(f"<script>window.rigDesk = {json.dumps(told)};\n{scripts}</script>")
    ui.add_body_html(_BARS)
