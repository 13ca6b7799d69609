"""The kind of import-linter contract that closes rooms: named in `pyproject.toml`, run by `make lint`."""

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output
from importlinter.application import contract_utils
from importlinter.domain import helpers


class RoomContract(Contract):
    """A package among `rooms` is entered through its face: nothing outside imports what lies below it.

    `rooms` may hold wildcards; a module that is no package has nothing to close. Which modules
    below a room are open, and to whom, stands in `ignore_imports`; an entry that no import needs is an error.
    """

    type_name = "rooms"

    rooms = fields.SetField(subfield=fields.ModuleExpressionField())
    ignore_imports = fields.SetField(subfield=fields.ImportExpressionField(), required=False)

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Every import from outside of a room into it."""
        removed = contract_utils.remove_ignored_imports_and_report(
            graph=graph,
            ignore_imports=self.ignore_imports,  # type: ignore[arg-type]
            unmatched_alerting=contract_utils.AlertLevel.ERROR,
        )
        rooms = helpers.module_expressions_to_modules(graph, self.rooms, as_packages=False)  # type: ignore[arg-type]
        broken = []
        for room in sorted(module.name for module in rooms):
            inside = graph.find_descendants(room)
            for module in sorted(inside):
                importers = graph.find_modules_that_directly_import(module) - inside - {room}
                broken += [f"{importer} -> {module}: enter through {room}" for importer in sorted(importers)]
        return ContractCheck(
            kept=not broken,
            warnings=list(removed.warnings),
            ignored_import_count=removed.ignored_import_count,
            metadata={"broken": broken},
        )

    def render_broken_contract(self, check: ContractCheck) -> None:
        """One line an import."""
        for line in check.metadata["broken"]:
            output.print_error(f"- {line}", bold=False)
        output.new_line()
