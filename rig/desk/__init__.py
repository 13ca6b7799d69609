"""`rig desk`: one page in a browser on this machine from which the rig is run.

The desk has no logic of its own: it starts the commands (`rig run`, `rig doctor`, `rig balance`) as
processes, watches a session through its order socket (`rig.devices`), and shows what these say. A session is
in no way a part of the desk: it goes on when the desk dies, and a desk that is opened finds it again.

A panel is one module in `rig/desk/panels/` with one function, ``build(desk, tab)``, which makes its elements
(NiceGUI's `ui`) where it is called; a line of ``PANELS`` in `rig/desk/panels/__init__.py` states its name and
its keys. `desk` is what all tabs share: configuration, running session, jobs (`desk.Desk`). `tab` is
this tab of the browser: `tab.label(text)` and `tab.html(content)` show what a function returns, and refresh
it while the panel is visible; `tab.button(text, function)` is a button that shows a RigError as one line,
with functions that tell when it is visible and enabled; `tab.column(value, draw)` builds elements anew for
each new value, `tab.on_interval(seconds, function)` does anything else. Work that takes longer than a moment
is awaited with ``nicegui.run.io_bound``; a command in a process moves devices (`Desk.start`). Charts are
declared by quantities (`charts.py`), colours have names (`static/theme.css`), questions are dialogs
(`dialogs.py`); the models of the configuration judge typed values (`Desk.checked`).
"""

from rig.desk.server import open_desk
