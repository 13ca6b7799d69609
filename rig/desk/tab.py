"""One tab of the browser: the panel that it shows, elements that are refreshed, keys, errors."""

import html
import inspect
import json
import logging
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

from nicegui import context, run, ui

from processing.errors import RigError

T = TypeVar("T")


def text_field(label: str, value: str = "", key: str = "") -> ui.input:
    """A field to type into; `key` is its name for scripts, by default the label."""
    props = f'dense outlined data-key="{key or label}" aria-label="{label}"'
    return ui.input(label, value=value).props(props)


def box(title: str, classes: str = "", *, head: str = "title", region: str = "") -> ui.column:
    """A box of a panel, below its title if it has one; a `region` has this name, and scrolls by keys."""
    with ui.column().classes(f"box {classes}") as column:
        if title:
            ui.html(html.escape(title), tag="h3", sanitize=False).classes(head)
    return column.props(f'role="region" aria-label="{region}" tabindex="0"') if region else column


_DELIBERATE_NAME = "data-deliberate"
DELIBERATE = f'{_DELIBERATE_NAME}="true"'
"""Property of a button that lights, or allows light: a pointer presses it, or a key that is held on it."""
PRESSES = "rigPresses"
"""Property of the page's `window`: the times at which such buttons were pressed last, by their ids, in ms of
the page's own clock."""
_MAX_PRESS_AGE_S = 5.0
"""Age above which a press allows no light: the person may have gone to look at the rig meanwhile."""
_REFRESH_INTERVAL_S = 0.25
Action = Callable[[], object]
"""What a key, a button or a timer does; if it returns an awaitable, that is awaited."""
Text = Callable[[], str]
Condition = Callable[[], bool]
_log = logging.getLogger(__name__)


class Tab:
    """A tab of the browser; elements belong to the panel that is being built when they are added."""

    def __init__(self) -> None:
        self._client = context.client
        self.panel = ""
        """Name of the visible panel."""
        self.building = ""
        """Name of the panel that is being built; empty for the head of the page, which is always visible."""
        self.keys: dict[str, dict[str, Action]] = {}
        """Actions of keys, by panel and key."""
        self.errors: ui.element | None = None
        """Element in which errors are shown."""
        self._refreshes: dict[str, list[Callable[[], Awaitable[None]]]] = {}

    def on_interval(self, seconds: float, action: Action) -> None:
        """Do an action again and again while the panel is visible, once at a time."""
        ui.timer(seconds, self._guarded(action))

    def on_refresh(self, update: Callable[[], object]) -> None:
        """Do an update now, and some times a second while the panel is visible."""
        update()
        refreshes = self._refreshes.setdefault(self.building, [])
        refreshes.append(self._guarded(update))
        if len(refreshes) > 1:
            return

        async def refresh_all() -> None:
            for refresh in refreshes:
                await refresh()

        ui.timer(_REFRESH_INTERVAL_S, refresh_all)

    def _guarded(self, action: Action) -> Callable[[], Awaitable[None]]:
        """An action that is done only while the panel is visible, and whose error is shown."""
        # each error is reported once: a full log that is not read would block the desk
        panel, reported = self.building, ""

        async def guarded() -> None:
            nonlocal reported
            if panel and self.panel != panel:
                return
            try:
                await _do(action)
            except Exception as error:
                if repr(error) != reported:
                    reported = repr(error)
                    _log.exception("%s is not brought up to date", panel or "the page")
                    self.show_error(f"{panel or 'the page'} is not brought up to date: {reported}")

        return guarded

    def label(self, text: Text, classes: str = "", props: str = "") -> ui.label:
        """A label whose text is refreshed; it is visible while its text is not empty."""
        label = ui.label().classes(classes).props(props)

        def update() -> None:
            label.set_text(text())
            label.set_visibility(bool(label.text))

        self.on_refresh(update)
        return label

    def html(self, content: Text, classes: str = "full-width", props: str = "") -> ui.html:
        """An element whose HTML is refreshed; it is visible while that is not empty."""
        element = ui.html(sanitize=False).classes(classes).props(props)

        def update() -> None:
            element.set_content(content())
            element.set_visibility(bool(element.content))

        self.on_refresh(update)
        return element

    def handler(self, action: Action) -> Callable[[], Awaitable[None]]:
        """A handler that does an action, and shows its RigError in one line."""

        async def handle() -> None:
            if self.errors is not None:
                # an operator who goes on has read the errors of the last action
                self.errors.clear()
            try:
                await _do(action)
            except RigError as error:
                self.show_error(str(error))

        return handle

    def column(self, value: Callable[[], T], draw: Callable[[T], None]) -> ui.column:
        """A column that `draw` fills anew with each new value."""
        column = ui.column().classes("full-width")
        last: list[T] = []

        def update() -> None:
            new = [value()]
            if new != last:
                last[:] = new
                column.clear()
                with column:
                    draw(*new)

        self.on_refresh(update)
        return column

    def button(
        self,
        text: str | Text,
        action: Action,
        props: str = "",
        *,
        visible: Condition | None = None,
        enabled: Condition | None = None,
    ) -> ui.button:
        """A button with a `handler`; its text, and whether it is visible and enabled, are refreshed."""
        button = ui.button(text if isinstance(text, str) else "").props(props)

        def update() -> None:
            if not isinstance(text, str):
                button.set_text(text())
            button.set_visibility(visible is None or visible())
            button.set_enabled(enabled is None or enabled())

        if visible or enabled or not isinstance(text, str):
            self.on_refresh(update)
        handle = self.handler(action)

        async def on_click() -> None:
            if _DELIBERATE_NAME in button.props and not await self._is_fresh(button.html_id):
                delay = f"more than {_MAX_PRESS_AGE_S:g} s before the desk heard of it"
                self.show_error(f"{button.text} was pressed {delay}: press it again")
                return
            await handle()

        return button.on_click(on_click)

    async def _is_fresh(self, button_id: str) -> bool:
        """Whether a button was pressed just now.

        After a freeze of the desk, or a loss of the network, presses arrive late, perhaps after a LIGHT OFF
        that was pressed later. The page states the age of the press: its clock need not agree with this one.
        """
        pressed_ms = f"window.{PRESSES}?.[{json.dumps(button_id)}]"
        asked_s = time.monotonic()
        try:
            age_ms = await self._client.run_javascript(
                f"performance.now() - ({pressed_ms} ?? -Infinity)", timeout=_MAX_PRESS_AGE_S
            )
        except TimeoutError:
            return False
        # infinity comes as null
        if not isinstance(age_ms, int | float):
            return False
        return time.monotonic() - asked_s + age_ms / 1000 <= _MAX_PRESS_AGE_S

    def show_error(self, problem: str) -> None:
        """Show an error in one line at the head of the page, where it covers nothing, until it is closed."""
        if self.errors is None:
            return
        with self.errors, ui.element("div").props('role="alert"') as line:
            ui.label(problem)
            ui.button("close", on_click=line.delete).props('dense flat aria-label="close the error"')

    def key(self, key: str, action: Action) -> None:
        """Give a key an action; it works while the panel is visible."""
        self.keys.setdefault(self.building, {})[key] = action

    async def press(self, key: str) -> None:
        """Do the action of a key, if it has any in the visible panel or everywhere."""
        action = self.keys.get(self.panel, {}).get(key) or self.keys.get("", {}).get(key)
        if action is not None:
            await _do(action)


async def _do(action: Action) -> None:
    if inspect.isawaitable(result := action()):
        await result


def in_background(work: Callable[..., object], *arguments: object) -> Action:
    """An action that works in a thread, since it may wait, and shows the text that the work returns."""

    async def action() -> None:
        if isinstance(reply := await run.io_bound(work, *arguments), str):
            ui.notify(reply)

    return action
