"""A room is entered through its face: the contract of `make lint` sees who goes round it."""

import pytest
from grimp import ImportGraph
from importlinter.application.user_options import UserOptions

from tests.room_contract import RoomContract


def broken(imports: list[tuple[str, str]], ignored: tuple[str, ...] = ()) -> list[str]:
    graph = ImportGraph()
    for module in ("rig", "rig.cli", "rig.desk", "rig.desk.page", "rig.measure", "rig.measure.run"):
        graph.add_module(module)
    for module in ("rig.measure.preflight", "rig.measure.preflight.checks"):
        graph.add_module(module)
    for importer, imported in imports:
        graph.add_import(importer=importer, imported=imported)
    options = {"rooms": ["rig.*"], "ignore_imports": list(ignored)}
    contract = RoomContract("rooms", UserOptions({}, []).session_options, options)
    return list(contract.check(graph, verbose=False).metadata["broken"])


def test_faces_and_the_rooms_own_modules_are_open() -> None:
    within = ("rig.measure", "rig.measure.run"), ("rig.measure.run", "rig.measure.preflight.checks")
    assert broken([*within, ("rig.desk.page", "rig.measure"), ("rig.cli", "rig.desk")]) == []


@pytest.mark.parametrize(
    "module", ["rig.measure.run", "rig.measure.preflight", "rig.measure.preflight.checks"]
)
@pytest.mark.parametrize("importer", ["rig.cli", "rig.desk", "rig.desk.page", "rig"])
def test_a_way_round_a_face_is_named(importer: str, module: str) -> None:
    assert broken([(importer, module)]) == [f"{importer} -> {module}: enter through rig.measure"]
    assert broken([(importer, module)], (f"{importer} -> rig.measure.**",)) == []
