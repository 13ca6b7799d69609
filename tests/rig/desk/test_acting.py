"""Who may act: one tab, asked for, kept over a reload, a lost network and a desk that is started again."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import ConfigurationError
from rig.desk.acting import ANSWER_S, KEPT_S, Acting
from rig.desk.kept import Kept
from tests.disk_without_locks import without_locks


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def acting(clock: Clock) -> Acting:
    found = Acting(clock=clock)
    found.arrived("first", "Ada")
    found.arrived("second", "Bob")
    return found


def who(acting: Acting) -> str:
    return "" if acting.now is None else acting.now.tab


def test_the_first_tab_acts_and_a_reload_hands_nothing_over(acting: Acting, clock: Clock) -> None:
    assert acting.acts("first")
    acting.left("first")
    clock.now_s += KEPT_S / 2
    acting.arrived("third", "Eve")
    assert acting.acts("first")
    acting.arrived("first", "")
    assert acting.now is not None
    assert (acting.now.name, acting.now.here) == ("Ada", True)


def test_a_connection_that_is_found_lost_after_its_tab_is_back_takes_nothing_away(
    acting: Acting, clock: Clock
) -> None:
    """A network that fails for seconds: the new connection is heard of before the old one is missed."""
    acting.arrived("first", "")
    acting.left("first")
    assert acting.now is not None
    assert acting.now.here
    clock.now_s += KEPT_S + 1
    acting.arrived("third", "Eve")
    assert acting.acts("first")
    # nor its question
    assert not acting.ask("second", "Bob")
    acting.arrived("second", "Bob")
    acting.left("second")
    assert acting.waits("second")
    acting.left("second")
    assert not acting.waits("second")
    acting.left("first")
    assert acting.now is not None
    assert not acting.now.here


def test_a_tab_that_does_not_come_back_is_replaced_by_the_next_that_is_opened(
    acting: Acting, clock: Clock
) -> None:
    acting.left("first")
    clock.now_s += KEPT_S + 1
    assert not acting.acts("second")
    acting.arrived("third", "Eve")
    assert acting.acts("third")


def test_taking_over_is_asked_and_may_be_refused(acting: Acting) -> None:
    assert not acting.ask("second", "Bob")
    assert acting.waits("second")
    assert acting.now is not None
    assert (acting.now.tab, acting.now.asked_by) == ("first", "Bob")
    acting.answer("second", give=True)
    assert acting.acts("first"), "who asks does not answer"
    acting.answer("first", give=False)
    assert acting.refused("second")
    assert not acting.waits("second")
    acting.ask("second", "Bob")
    acting.answer("first", give=True)
    assert acting.acts("second")


def test_who_says_nothing_and_who_is_gone_gives_it(acting: Acting, clock: Clock) -> None:
    acting.ask("second", "Bob")
    clock.now_s += ANSWER_S + 1
    assert acting.acts("second")
    acting.left("second")
    assert acting.ask("first", "Ada")
    assert acting.acts("first")


def test_a_desk_that_comes_again_waits_for_the_tab_that_acted(acting: Acting, clock: Clock) -> None:
    again = Acting("second", clock=clock)
    again.arrived("first", "Ada")
    assert who(again) == "second"
    again.arrived("second", "Bob")
    assert again.acts("second")


def test_no_tab_without_a_connection_acts() -> None:
    assert not Acting().acts("")


def test_keys_port_and_what_was_typed_outlive_a_desk(tmp_path: Path) -> None:
    source = tmp_path / "rig.toml"
    first = Kept(source)
    first.hold(tmp_path)
    first.opened_at("http://127.0.0.1:8642/", 8642)
    first.note_acting("tab")
    first.type("Ada", "session.notes", "humid today")
    first.use("Ada", "steel", {"session.sample": "steel"})
    first.close()
    second = Kept(source)
    second.hold(tmp_path)
    assert (second.key, second.watch_key, second.port) == (first.key, first.watch_key, 8642)
    assert second.acting == "tab"
    assert second.typed("Ada") == {"session.notes": "humid today"}
    assert second.typed("Bob") == {}
    assert second.presets("Ada") == {"steel": {"session.sample": "steel"}}
    assert first.key != first.watch_key
    second.close()


@pytest.mark.slow
def test_of_a_configuration_there_is_one_desk(tmp_path: Path) -> None:
    source = tmp_path / "rig.toml"
    kept = Kept(source)
    kept.hold(tmp_path)
    kept.opened_at("http://127.0.0.1:1/?key=k", 1)
    other = (
        "import sys; from pathlib import Path; from rig.desk.kept import Kept; "
        "source = Path(sys.argv[1]); Kept(source).hold(source.parent)"
    )
    done = subprocess.run(
        [sys.executable, "-c", other, str(source)], capture_output=True, text=True, check=False, timeout=50
    )
    assert "it already has an open desk: use http://127.0.0.1:1/?key=k" in done.stderr
    kept.close()
    Kept(source).hold(tmp_path)


def test_two_desks_of_one_configuration_in_a_process(tmp_path: Path) -> None:
    kept = Kept(tmp_path / "rig.toml")
    kept.hold(tmp_path)
    with pytest.raises(ConfigurationError, match="already has an open desk"):
        Kept(tmp_path / "rig.toml").hold(tmp_path)
    kept.close()


def test_a_disk_without_locks_is_not_called_another_desk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)
    kept = Kept(tmp_path / "rig.toml")
    kept.hold(tmp_path)
    kept.note_acting("tab")
    kept.close()
    again = Kept(tmp_path / "rig.toml")
    again.hold(tmp_path)
    assert again.acting == "tab"
    again.close()
