"""The node map gives the same values as EMVA's, for descriptions of real cameras and random memory."""

import gzip
import random
from pathlib import Path
from typing import Any

import pytest

from acquisition.cameras.usb3vision.genapi.node import Access
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from acquisition.cameras.usb3vision.manifest import decode_description
from processing.errors import DeviceError

genapi = pytest.importorskip(
    "genicam.genapi", reason="pip install genicam: EMVA's reference is the oracle here"
)

SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
"""One of each kind of memory: dense, sparse, nearly all ones."""
ACCESS = {
    genapi.EAccessMode.NI: Access.NOT_IMPLEMENTED,
    genapi.EAccessMode.NA: Access.NOT_AVAILABLE,
    genapi.EAccessMode.WO: Access.WRITE_ONLY,
    genapi.EAccessMode.RO: Access.READ_ONLY,
    genapi.EAccessMode.RW: Access.READ_WRITE,
}
NUMBERS = {"Integer", "Float", "IntReg", "MaskedIntReg", "FloatReg", "IntSwissKnife", "SwissKnife"}
VALUES = NUMBERS | {"Boolean", "Enumeration", "Converter", "IntConverter", "StringReg", "String"}


class Memory:
    """A camera's registers: every byte is random but always the same; what is touched is noted."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.bytes: dict[int, int] = {}
        self.reads: list[tuple[int, int]] = []
        self.writes: list[tuple[int, bytes]] = []

    def _byte(self, address: int) -> int:
        if address not in self.bytes:
            mixed = (address * 0x9E3779B97F4A7C15 + (self.seed + 1) * 0xD1B54A32D192ED03) % (1 << 64)
            random_byte = ((mixed ^ mixed >> 29) * 0xBF58476D1CE4E5B9 >> 40) & 0xFF
            # Sparse memories make more flags agree with each other than dense ones do.
            sparse = random_byte & 0x81 if self.seed % 3 == 1 else random_byte
            self.bytes[address] = 0xFF if self.seed % 3 == 2 and random_byte > 60 else sparse
        return self.bytes[address]

    def read(self, address: int, length: int) -> bytes:
        self.reads.append((address, length))
        return bytes(self._byte(address + index) for index in range(length))

    def write(self, address: int, data: bytes) -> None:
        self.writes.append((address, bytes(data)))
        self.bytes.update({address + index: byte for index, byte in enumerate(data)})


class ReferencePort(genapi.AbstractPort):  # type: ignore[misc]
    def __init__(self, memory: Memory) -> None:
        super().__init__()
        self.memory = memory

    def read(self, address: int, length: int) -> bytes:
        return self.memory.read(address % (1 << 64), length)

    def write(self, address: int, data: Any) -> None:
        self.memory.write(address % (1 << 64), bytes(data))

    def get_access_mode(self) -> int:
        return int(genapi.EAccessMode.RW)


class Pair:
    """The same description on two copies of the same memory: the reference's and ours."""

    def __init__(self, xml: str, seed: int) -> None:
        self.reference_memory, self.our_memory = Memory(seed), Memory(seed)
        self._port = ReferencePort(self.reference_memory)
        self.reference = genapi.NodeMap()
        self.reference.load_xml_from_string(xml)
        self.reference.connect(self._port, "Device")
        self.ours = NodeMap(xml, self.our_memory, "camera")

    def forget(self) -> None:
        self.reference._invalidate_nodes()
        self.ours.forget()
        for memory in (self.reference_memory, self.our_memory):
            memory.reads.clear()
            memory.writes.clear()

    def names(self, kinds: set[str]) -> list[str]:
        return [
            name
            for name in self.ours
            if self.ours.node(name).description.kind in kinds and self.reference.has_node(name)
        ]


def reference_value(pair: Pair, name: str) -> Any:
    """The value, DeviceError where the reference refuses, None where its Python side can't decode."""
    try:
        return pair.reference.get_node(name).value
    except UnicodeDecodeError:
        return None
    except genapi.GenericException as refusal:
        return DeviceError(str(refusal))


def our_value(pair: Pair, name: str) -> Any:
    try:
        return pair.ours.get(name)
    except DeviceError as refusal:
        return refusal


def same(reference: Any, ours: Any) -> bool:
    if isinstance(reference, DeviceError) or isinstance(ours, DeviceError):
        return isinstance(reference, DeviceError) and isinstance(ours, DeviceError)
    if isinstance(reference, float):
        both_nan = reference != reference and ours != ours
        return both_nan or reference == ours or abs(reference - ours) <= 1e-13 * abs(reference)
    return bool(reference == ours)


@pytest.fixture(scope="module")
def descriptions(shared_data: Path) -> dict[str, str]:
    files = sorted((shared_data / "genicam").glob("*.xml.gz"))
    if not files:
        pytest.skip(f"no descriptions of real cameras in {shared_data / 'genicam'}")
    return {file.name: decode_description(gzip.decompress(file.read_bytes()), file.name) for file in files}


@pytest.mark.parametrize("seed", SEEDS)
def test_access_and_values_are_those_of_the_reference(descriptions: dict[str, str], seed: int) -> None:
    compared = 0
    for file, xml in descriptions.items():
        pair = Pair(xml, seed)
        for name in pair.names(VALUES):
            reference_access = ACCESS[pair.reference.get_node(name).get_access_mode()]
            assert pair.ours.node(name).access() is reference_access, (file, name)
            if reference_access.readable:
                wanted = reference_value(pair, name)
                if wanted is not None:
                    got = our_value(pair, name)
                    assert same(wanted, got), (file, name, wanted, got)
                    compared += 1
    assert compared > 1000


def test_enumerations_offer_what_the_reference_offers(descriptions: dict[str, str]) -> None:
    offered = 0
    for file, xml in descriptions.items():
        pair = Pair(xml, 0)
        for name in pair.names({"Enumeration"}):
            reference = pair.reference.get_node(name)
            if ACCESS[reference.get_access_mode()] in (Access.NOT_IMPLEMENTED, Access.NOT_AVAILABLE):
                continue
            wanted = [
                entry.symbolic for entry in reference.entries if ACCESS[entry.get_access_mode()].readable
            ]
            assert list(pair.ours.node(name).choices()) == wanted, (file, name)
            offered += len(wanted)
    assert offered > 100


@pytest.mark.parametrize("seed", SEEDS)
def test_features_touch_the_registers_that_the_reference_touches(
    descriptions: dict[str, str], seed: int
) -> None:
    compared = 0
    for file, xml in descriptions.items():
        pair = Pair(xml, seed)
        features = set(pair.ours.features())
        for name in pair.names({"Integer", "Float", "Boolean", "Enumeration"}):
            if name not in features:
                continue
            pair.forget()
            wanted = reference_value(pair, name)
            if isinstance(wanted, DeviceError):
                continue
            assert same(wanted, our_value(pair, name)), (file, name)
            assert set(pair.our_memory.reads) == set(pair.reference_memory.reads), (file, name)
            compared += 1
            if pair.ours.node(name).description.kind in ("Integer", "Float"):
                node, reference = pair.ours.node(name), pair.reference.get_node(name)
                for limit, ours in (("min", node.minimum()), ("max", node.maximum())):
                    theirs = getattr(reference, limit)
                    unlimited = ours is None and abs(theirs) > 1e300
                    assert unlimited or same(theirs, ours), (file, name, limit)
    assert compared > 50


@pytest.mark.parametrize("seed", SEEDS)
def test_setting_a_feature_writes_what_the_reference_writes(descriptions: dict[str, str], seed: int) -> None:
    written = 0
    dice = random.Random(seed)
    for file, xml in descriptions.items():
        pair = Pair(xml, seed)
        features = set(pair.ours.features())
        for name in pair.names({"Integer", "Float", "Boolean", "Enumeration", "Command"}):
            kind = pair.ours.node(name).description.kind
            if name not in features or not pair.ours.node(name).access().writable:
                continue
            pair.forget()
            reference = pair.reference.get_node(name)
            value: Any = dice.random() < 0.5
            try:
                if kind in ("Integer", "Float"):
                    low, high = max(reference.min, -1e6), min(reference.max, 1e6)
                    value = low + (high - low) * dice.random() if high > low else low
                    if kind == "Integer":
                        value = int(low) + int(value - low) // max(reference.inc, 1) * reference.inc
                elif kind == "Enumeration":
                    value = dice.choice([entry.symbolic for entry in reference.entries])
                if value != value:
                    continue  # limits that are not numbers, on such a memory
                pair.forget()
                reference.execute() if kind == "Command" else setattr(reference, "value", value)
            except genapi.GenericException:
                # The reference also refuses steps of zero and selectors that stand wrong; what it
                # has not written must not be written here either, or the memories would part.
                continue
            pair.ours.set(name, value)
            assert pair.our_memory.writes == pair.reference_memory.writes, (file, name, value)
            written += 1
    assert written > 20
