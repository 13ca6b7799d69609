"""What is typed survives a reload, a desk that is started again and a lost network.

The desk keeps it for each operator. What it has not confirmed yet the browser keeps, and says when it is
connected again. The panel that was seen and the name are the browser's.
"""

import json
from collections.abc import Callable

from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.value_element import ValueElement

from rig.desk.desk import Desk
from rig.desk.tab import Tab


class Drafts:
    """Of one tab: fields with `data-draft`, or with the key (`data-key`) of a setting of sessions, are kept.

    `show` brings a panel to the front.
    """

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk, self._tab = desk, tab
        self._fields: dict[str, ValueElement[str]] = {}
        self._unsaid: dict[str, str] = {}
        self._client = ui.context.client
        self.show: Callable[[str], None] = lambda _name: None

    def find(self) -> None:
        """Keep all fields of the page that is built; they get back what is on the disk."""
        for element in self._client.elements.values():
            key = _key_of(element)
            if key and isinstance(element, ValueElement):
                self._fields[key] = element
                element.on_value_change(lambda event, key=key: self._typed(key, str(event.value or "")))
        ui.timer(_SAY_S, self._say)
        self._restore({})

    async def connected(self) -> None:
        """Ask the browser what it has kept."""
        with self._client:
            try:
                kept = await ui.run_javascript("window.rigKept()", timeout=_ANSWERS_S)
            except TimeoutError:
                # a browser that is busy, or gone again, keeps what it has until it connects the next time
                return
            if not isinstance(kept, dict):
                return
            tab = self._tab
            if not tab.person.name and kept.get("operator"):
                tab.operator_name = str(kept["operator"])[:60]
                self._desk.acting.called(tab.name, tab.operator_name)
            if kept.get("panel"):
                self.show(str(kept["panel"]))
            unsaid = kept.get("drafts")
            self._restore({str(key): str(value) for key, value in unsaid.items()} if unsaid else {})

    def named(self) -> None:
        """Somebody has said who sits here: what is typed is that person's."""
        ui.run_javascript(f"window.rigKeep('operator', {json.dumps(self._tab.operator_name)})")
        self._restore({})

    def panel(self, name: str) -> None:
        """This panel is seen."""
        ui.run_javascript(f"window.rigKeep('panel', {json.dumps(name)})")

    def _restore(self, unsaid: dict[str, str]) -> None:
        typed = {**self._desk.place.typed(self._tab.operator_name), **unsaid}
        for key, field in self._fields.items():
            if key in typed and str(field.value or "") != typed[key]:
                field.set_value(typed[key])
        for key, value in unsaid.items():
            self._typed(key, value)

    def _typed(self, key: str, value: str) -> None:
        self._desk.place.type(self._tab.operator_name, key, value)
        self._unsaid[key] = value

    def _say(self) -> None:
        """Tell the browser what it need not keep any more: what is on the disk."""
        if self._unsaid and self._desk.place.has_written(self._tab.operator_name):
            said, self._unsaid = self._unsaid, {}
            ui.run_javascript(f"window.rigSaid({json.dumps(said)})")


def _key_of(element: Element) -> str:
    """Under which key what is typed into an element is kept; empty if it is not."""
    key = str(element.props.get("data-key") or "")
    return str(element.props.get("data-draft") or (key if key.startswith("session.") else ""))


_SAY_S = 0.5
_ANSWERS_S = 5.0
KEEPING = """
(() => {
  const place = 'rigDrafts';
  const read = () => {
    try { return JSON.parse(localStorage.getItem(place)) || {}; } catch (e) { return {}; }
  };
  const keyOf = field => field.dataset && (field.dataset.draft ||
    ((field.dataset.key || '').startsWith('session.') ? field.dataset.key : ''));
  document.addEventListener('input', event => {
    const key = keyOf(event.target);
    if (!key) return;
    const drafts = read();
    drafts[key] = event.target.value;
    localStorage.setItem(place, JSON.stringify(drafts));
  }, true);
  window.rigSaid = said => {
    const drafts = read();
    for (const key in said) if (drafts[key] === said[key]) delete drafts[key];
    localStorage.setItem(place, JSON.stringify(drafts));
  };
  window.rigKeep = (name, value) =>
    (name === 'panel' ? sessionStorage : localStorage).setItem('rig-' + name, value);
  window.rigKept = () => ({drafts: read(), operator: localStorage.getItem('rig-operator') || '',
    panel: sessionStorage.getItem('rig-panel') || ''});
})();
"""
"""The browser's side of it."""
