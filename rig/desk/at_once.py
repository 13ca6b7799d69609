"""Elements that show what a person chose at once, and keep it whatever the server says later.

As NiceGUI makes a tab, a toggle, a checkbox, they show a choice only when the server has answered. Where that
takes long, going back to what is still shown is no change and never sent: two quick presses end at the first.
A field one types into is at once by itself, and a dialog is opened by the server.
"""

from typing import Any, TypeVar

from nicegui.elements.mixins.value_element import ValueElement

E = TypeVar("E", bound=ValueElement[Any])


def at_once(element: E) -> E:
    """Let the browser own what is chosen; the server is told, and what it sets itself is shown, too."""
    element.LOOPBACK = False
    # NiceGUI's own way in the browser would store a list with the value in it, which fields alone take
    element.props["loopback"] = None
    shown = f"mounted_app.elements[{element.id}].props['{element.VALUE_PROP}']"
    element.on(f"update:{element.VALUE_PROP}", js_handler=f"value => {{ {shown} = value; }}")
    return element
