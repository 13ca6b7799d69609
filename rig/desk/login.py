"""The two pages that are seen without being let in: name and password, and what to do without a key."""

import html

LOGIN, LOGOUT = "/login", "/logout"
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>rig desk</title><style>
body {{ background: #0e1113; color: #e8e8e8; font: 18px sans-serif; margin: 12vh auto; max-width: 26em;
  padding: 0 1em; }}
input, button {{ font: inherit; width: 100%; box-sizing: border-box; padding: .5em; margin: .2em 0 1em; }}
[role=alert] {{ color: #ff8a65; }}
</style></head><body><main><h1>rig desk</h1>{body}</main></body></html>"""


def login_page(problem: str = "") -> str:
    """Asks for name and password; `problem` is what was wrong with the last ones."""
    told = f'<p role="alert">{html.escape(problem)}</p>' if problem else ""
    return _PAGE.format(
        body=f'{told}<form method="post" action="{LOGIN}">'
        '<label>name<input name="name" autocomplete="username" required autofocus></label>'
        '<label>password<input name="password" type="password" autocomplete="current-password" required>'
        "</label>"
        "<button>Enter</button></form>"
    )


def refused_page() -> str:
    """For a browser without a key."""
    return _PAGE.format(
        body="<p>This browser does not have the key of this desk.</p>"
        "<p>Open the address that <code>rig desk</code> printed in its terminal: it contains the key. "
        "To darken the laser now, turn the key switch.</p>"
    )
