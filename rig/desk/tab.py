"""One tab of the browser: which panel it shows, what its buttons and keys do, where errors stand."""

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
    """A field to type into; `key` is its name beside that which is seen, by default the same."""
    props = f'dense outlined data-key="{key or label}" aria-label="{label}"'
    return ui.input(label, value=value).props(props)


def box(title: str, classes: str = "", *, head: str = "title", region: str = "") -> ui.column:
    """A box of a panel, below its title if it has one; a `region` has this name, and scrolls by keys."""
    with ui.column().classes(f"box {classes}") as found:
        if title:
            ui.html(html.escape(title), tag="h3", sanitize=False).classes(head)
    return found.props(f'role="region" aria-label="{region}" tabindex="0"') if region else found


DELIBERATE = 'data-deliberate="true"'
"""Property of a button that lights, or allows light: a pointer presses it, or a key that is held on it."""
PRESSES = "rigPresses"
"""Of the page's `window`: when such a button was pressed last, by its id, in ms of the page's own clock."""
_FRESH_S = 5.0
"""A press that was made longer ago than this is nobody's leave any more: who made it has gone to look."""
_KEEP_S = 0.25
"""Interval at which what a panel shows is brought up to date."""
Handler = Callable[[], object]
"""What a key, a button or a timer does; if it returns an awaitable, that is awaited."""
Text = Callable[[], str]
Condition = Callable[[], bool]
_log = logging.getLogger(__name__)


class Tab:
    """A tab; `shown` is the panel that is seen, `keys` what a key does in it, `errors` where errors stand."""

    def __init__(self) -> None:
        self._client = context.client
        self.shown = ""
        self.building = ""
        self.keys: dict[str, dict[str, Handler]] = {}
        self.errors: ui.element | None = None
        self._kept: dict[str, list[Callable[[], Awaitable[None]]]] = {}

    def every(self, seconds: float, refresh: Handler) -> None:
        """Call it again and again while the panel that is being built is seen, once at a time."""
        ui.timer(seconds, self._guarded(refresh))

    def keep(self, update: Callable[[], object]) -> None:
        """Call it now, and some times a second while the panel that is being built is seen."""
        update()
        updates = self._kept.setdefault(self.building, [])
        updates.append(self._guarded(update))
        if len(updates) > 1:
            return

        async def due() -> None:
            for one in updates:
                await one()

        ui.timer(_KEEP_S, due)

    def _guarded(self, refresh: Handler) -> Callable[[], Awaitable[None]]:
        """Does it if the panel that is being built is seen, and shows its error.

        An error is reported once: a log that is filled, and that nobody reads, would hold the desk up.
        """
        panel, reported = self.building, ""

        async def guarded() -> None:
            nonlocal reported
            if panel and self.shown != panel:
                return
            try:
                await _done(refresh)
            except Exception as error:
                if repr(error) != reported:
                    reported = repr(error)
                    _log.exception("%s is not brought up to date", panel or "the page")
                    self.tell(f"{panel or 'the page'} is not brought up to date: {reported}")

        return guarded

    def label(self, text: Text, classes: str = "", props: str = "") -> ui.label:
        """A label whose text is kept; it is seen while it has one."""
        label = ui.label().classes(classes).props(props)

        def update() -> None:
            label.set_text(text())
            label.set_visibility(bool(label.text))

        self.keep(update)
        return label

    def html(self, content: Text, classes: str = "full-width", props: str = "") -> ui.html:
        """An element whose HTML is kept; it is seen while it has any."""
        element = ui.html(sanitize=False).classes(classes).props(props)

        def update() -> None:
            element.set_content(content())
            element.set_visibility(bool(element.content))

        self.keep(update)
        return element

    def act(self, do: Handler) -> Callable[[], Awaitable[None]]:
        """A handler whose RigError is shown in one line."""

        async def acted() -> None:
            if self.errors is not None:
                # the operator who does the next thing has read what was wrong with the last one
                self.errors.clear()
            try:
                await _done(do)
            except RigError as error:
                self.tell(str(error))

        return acted

    def drawn(
        self, value: Callable[[], T], draw: Callable[[T], None], classes: str = "full-width"
    ) -> ui.column:
        """A column that `draw` fills anew with each new value."""
        column = ui.column().classes(classes)
        before: list[T] = []

        def update() -> None:
            now = [value()]
            if now != before:
                before[:] = now
                column.clear()
                with column:
                    draw(*now)

        self.keep(update)
        return column

    def button(
        self,
        text: str | Text,
        do: Handler,
        props: str = "",
        *,
        seen: Condition | None = None,
        enabled: Condition | None = None,
    ) -> ui.button:
        """A button for `act`; its text, whether it is seen and whether it can be pressed are kept."""
        button = ui.button(text if isinstance(text, str) else "").props(props)

        def update() -> None:
            if not isinstance(text, str):
                button.set_text(text())
            button.set_visibility(seen is None or seen())
            button.set_enabled(enabled is None or enabled())

        if seen or enabled or not isinstance(text, str):
            self.keep(update)
        acted = self.act(do)

        async def pressed() -> None:
            if DELIBERATE.partition("=")[0] in button.props and not await self._is_fresh(button.html_id):
                late = f"was pressed more than {_FRESH_S:g} s before the desk heard of it: press it again"
                self.tell(f"{button.text} {late}")
                return
            await acted()

        return button.on_click(pressed)

    async def _is_fresh(self, button_id: str) -> bool:
        """Whether a button was pressed just now.

        At a desk that was frozen, or from a network that was away, what was pressed meanwhile comes late, and
        may come after a LIGHT OFF that was pressed later. The page is asked: its clock need not agree with
        this one.
        """
        pressed_ms = f"window.{PRESSES}?.[{json.dumps(button_id)}]"
        asked_s = time.monotonic()
        try:
            age_ms = await self._client.run_javascript(
                f"performance.now() - ({pressed_ms} ?? -Infinity)", timeout=_FRESH_S
            )
        except TimeoutError:
            return False
        # infinity comes as null
        return isinstance(age_ms, int | float) and time.monotonic() - asked_s + age_ms / 1000 <= _FRESH_S

    def tell(self, problem: str) -> None:
        """An error as one line at the head of the page, where it covers nothing, until it is closed."""
        if self.errors is None:
            return
        with self.errors, ui.element("div").props('role="alert"') as line:
            ui.label(problem)
            ui.button("close", on_click=line.delete).props('dense flat aria-label="close the error"')

    def key(self, key: str, do: Handler) -> None:
        """A key of the panel that is being built; it works while the panel is seen."""
        self.keys.setdefault(self.building, {})[key] = do

    async def press(self, key: str) -> None:
        """Do what a key means here, if it means anything."""
        if (do := self.keys.get(self.shown, {}).get(key) or self.keys.get("", {}).get(key)) is not None:
            await _done(do)


async def _done(do: Handler) -> None:
    if inspect.isawaitable(done := do()):
        await done


def apart(do: Callable[..., object], *given: object) -> Handler:
    """A handler that does it in a thread, since it may wait, and shows the words that it returns."""

    async def done() -> None:
        if isinstance(reply := await run.io_bound(do, *given), str):
            ui.notify(reply)

    return done
