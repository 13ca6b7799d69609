"""One tab of the browser: what it may do, which panel it shows, how it is notified."""

import asyncio
import inspect
from collections.abc import Awaitable, Callable

from nicegui import context, ui

from processing.errors import RigError
from rig.desk.desk import Desk
from rig.desk.people import Person, Role

DELIBERATE = 'data-deliberate="true"'
"""Property of a button that lights, or allows light: a pointer presses it, or a key that is held on it."""
Handler = Callable[[], None] | Callable[[], Awaitable[None]]


class Tab:
    """A tab; `name` tells it from others, also after a reload, and is empty until it is connected.

    `shown` is the panel that is seen, `keys` what a key does in it, `person` who was let in,
    `operator_name` who says to sit there, `errors` where on the page errors stand.
    """

    def __init__(self, desk: Desk, person: Person, is_in: Callable[[], bool]) -> None:
        self._desk = desk
        self._is_in = is_in
        self._client = context.client
        self.person = person
        self.operator_name = person.name
        self.name = ""
        self.shown = ""
        self.building = ""
        self.keys: dict[str, dict[str, Handler]] = {}
        self.errors: ui.element | None = None

    @property
    def operator(self) -> str:
        """Who works at it, as others are told."""
        return self.operator_name or "the desk"

    @property
    def is_in(self) -> bool:
        """Whether who was let in has not logged out since."""
        return self._is_in()

    @property
    def may_act(self) -> bool:
        """Whether who sits there was let in to act."""
        return self.person.role is Role.ACT and self.is_in

    @property
    def acts(self) -> bool:
        """Whether this tab is the one that acts; the others watch."""
        return self.may_act and self._desk.acting.acts(self.name)

    @property
    def why_not(self) -> str:
        """Why its buttons do nothing; empty where they do."""
        if self.acts:
            return ""
        why = "Take over first" if self.may_act else "its address allows watching only"
        return f"this tab only watches; {why}"

    def connected(self) -> None:
        """The browser has opened its connection: only now is somebody there."""
        self.name = self._client.tab_id or self.name
        if self.may_act:
            self._desk.acting.arrived(self.name, self.operator_name)

    def disconnected(self) -> None:
        """The browser has closed it, or was lost."""
        self._desk.acting.left(self.name)

    def every(self, seconds: float, refresh: Handler) -> None:
        """Call it again and again while the panel that is being built is seen, once at a time."""
        panel = self.building

        async def due() -> None:
            if not panel or self.shown == panel:
                done = refresh()
                if inspect.isawaitable(done):
                    await done

        ui.timer(seconds, due)

    def act(self, do: Handler) -> Callable[[], Awaitable[None]]:
        """A handler that works in the tab that may act; a RigError is shown in its one line."""

        async def acted() -> None:
            if not self.acts:
                ui.notify(self.why_not, type="warning")
                return
            if self.errors is not None:
                # whoever does the next thing has read what was wrong with the last one
                self.errors.clear()
            try:
                done = do()
                if inspect.isawaitable(done):
                    await done
            except RigError as error:
                self.tell(str(error))

        return acted

    def button(self, text: str, do: Handler) -> ui.button:
        """A button for `act`; where the tab watches it is grey, and says why."""
        return ui.button(text, on_click=self.act(do)).classes("acts")

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

    def press(self, key: str) -> bool:
        """A key was pressed; whether it means something here."""
        do = self.keys.get(self.shown, {}).get(key) or self.keys.get("", {}).get(key)
        if do is None:
            return False
        done = do()
        if inspect.isawaitable(done):
            task = asyncio.ensure_future(self._within(done))
            _running.add(task)
            task.add_done_callback(_running.discard)
        return True

    async def _within(self, done: Awaitable[None]) -> None:
        """Await it as a part of this tab: a task of its own does not know where its messages belong."""
        with self._client:
            await done


_running: set["asyncio.Future[None]"] = set()
"""The event loop itself keeps only weak references to tasks."""
