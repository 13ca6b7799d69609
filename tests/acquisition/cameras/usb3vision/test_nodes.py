"""Node map: caching, selectors, bits, limits and errors that the descriptions of real cameras do not test."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.cameras.usb3vision.genapi.node import AccessRefused
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from processing.errors import DeviceError

HEAD = """<RegisterDescription ModelName="E" VendorName="T" ToolTip="t" StandardNameSpace="USB"
 SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0"
 SubMinorVersion="0" ProductGuid="11111111-2222-3333-4444-555555555555"
 VersionGuid="11111111-2222-3333-4444-666666666666" xmlns="http://www.genicam.org/GenApi/Version_1_1">
 <Category Name="Root"><pFeature>F</pFeature></Category><Port Name="Device"/>"""


ZERO = '<Integer Name="Y"><Value>0</Value></Integer>'


class Ram:
    """Registers that count how often they are read."""

    def __init__(self, size: int = 256) -> None:
        self.data = bytearray(size)
        self.reads: list[tuple[int, int]] = []

    def read(self, address: int, length: int) -> bytes:
        self.reads.append((address, length))
        return bytes(self.data[address : address + length])

    def write(self, address: int, data: bytes) -> None:
        self.data[address : address + len(data)] = data


def node_map(body: str, ram: Ram | None = None, **more: Any) -> NodeMap:
    return NodeMap(f"{HEAD}{body}</RegisterDescription>", ram or Ram(), "camera", **more)


def register(name: str, address: int, more: str = "", kind: str = "IntReg", length: int = 4) -> str:
    return (
        f'<{kind} Name="{name}"><Address>{address}</Address><Length>{length}</Length>'
        f"<AccessMode>RW</AccessMode><pPort>Device</pPort>{more}</{kind}>"
    )


@given(
    value=st.integers(0, 2**64 - 1),
    length=st.sampled_from([1, 2, 3, 4, 8]),
    big=st.booleans(),
    signed=st.booleans(),
    data=st.data(),
)
def test_bits_of_either_byte_order_and_sign(
    value: int, length: int, big: bool, signed: bool, data: st.DataObject
) -> None:
    width = 8 * length
    low = data.draw(st.integers(0, width - 1))
    high = data.draw(st.integers(low, width - 1))
    raw = value % (1 << width)
    lsb, msb = (width - 1 - low, width - 1 - high) if big else (low, high)
    ram = Ram()
    ram.data[8 : 8 + length] = raw.to_bytes(length, "big" if big else "little")
    order = "BigEndian" if big else "LittleEndian"
    sign = "Signed" if signed else "Unsigned"
    more = f"<LSB>{lsb}</LSB><MSB>{msb}</MSB><Sign>{sign}</Sign><Endianess>{order}</Endianess>"
    nodes = node_map(register("F", 8, more, "MaskedIntReg", length), ram)
    count = high - low + 1
    expected = raw >> low & ((1 << count) - 1)
    if (signed or count == 64) and expected >> (count - 1):
        expected -= 1 << count
    assert nodes.get("F") == expected
    # Writing it changes these bits and no others.
    other = data.draw(
        st.integers(-(1 << (count - 1)), (1 << (count - 1)) - 1)
        if signed
        else st.integers(0, min((1 << count) - 1, 2**63 - 1))
    )
    nodes.set("F", other)
    written = int.from_bytes(ram.data[8 : 8 + length], "big" if big else "little")
    assert written >> low & ((1 << count) - 1) == other % (1 << count)
    mask = ((1 << count) - 1) << low
    assert written & ~mask == raw & ~mask
    nodes.forget()
    assert nodes.get("F") == other


def test_a_register_is_read_once_until_something_it_depends_on_is_written() -> None:
    ram = Ram()
    body = (
        register("A", 0)
        + register("B", 4, "<pInvalidator>Width</pInvalidator>")
        + register("C", 8)
        + register("D", 12, "<Cachable>NoCache</Cachable>")
        + '<Integer Name="Width"><pValue>A</pValue></Integer>'
    )
    nodes = node_map(body, ram)
    for name in "BCBCDD":
        nodes.get(name)
    assert ram.reads == [(4, 4), (8, 4), (12, 4), (12, 4)]
    ram.reads.clear()
    nodes.set("Width", 7)
    for name in "BC":
        nodes.get(name)
    assert ram.reads == [(4, 4)]


def test_a_write_also_forgets_registers_that_share_its_bytes() -> None:
    ram = Ram()
    nodes = node_map(register("A", 0) + register("Low", 0, "<Bit>0</Bit>", "MaskedIntReg"), ram)
    assert nodes.get("Low") == 0
    nodes.set("A", 1)
    assert nodes.get("Low") == 1
    nodes.set("Low", 0)
    assert nodes.get("A") == 0


def test_polled_registers_are_read_again_when_their_time_is_up() -> None:
    ram, now_s = Ram(), [0.0]
    nodes = node_map(register("T", 0, "<PollingTime>1000</PollingTime>"), ram, clock=lambda: now_s[0])
    for now_s[0] in (0.0, 0.5, 0.9, 1.1, 1.5, 2.2):
        nodes.get("T")
    assert len(ram.reads) == 3


def test_a_selector_moves_the_address() -> None:
    ram = Ram()
    ram.data[16:28] = struct.pack("<3I", 10, 20, 30)
    body = (
        '<Enumeration Name="Sel"><EnumEntry Name="One"><Value>0</Value></EnumEntry><EnumEntry Name="Two">'
        "<Value>1</Value></EnumEntry><EnumEntry Name='Three'><Value>2</Value></EnumEntry><Value>0</Value>"
        "<pSelected>F</pSelected></Enumeration>"
        '<Integer Name="Stride"><Value>4</Value></Integer>'
        + register("F", 16, '<pIndex pOffset="Stride">Sel</pIndex>')
        + register("G", 16, "<pIndex>Sel</pIndex>")
        + register(
            "H",
            16,
            "<IntSwissKnife Name='x'><pVariable Name='S'>Sel</pVariable><Formula>S*4</Formula>"
            "</IntSwissKnife>",
        )
    )
    nodes = node_map(body, ram)
    for choice, value in (("One", 10), ("Three", 30), ("Two", 20), ("One", 10)):
        nodes.set("Sel", choice)
        assert [nodes.get(name) for name in "FGH"] == [value] * 3
    with pytest.raises(DeviceError, match=r"no choice 'Four'; choices: One, Two, Three"):
        nodes.set("Sel", "Four")


def test_values_chosen_by_an_index() -> None:
    body = (
        '<Integer Name="I"><Value>1</Value></Integer>'
        + register("R", 0)
        + '<Integer Name="F"><pIndex>I</pIndex><ValueIndexed Index="0">5</ValueIndexed>'
        '<pValueIndexed Index="1">R</pValueIndexed><ValueDefault>9</ValueDefault></Integer>'
    )
    ram = Ram()
    ram.data[0] = 77
    nodes = node_map(body, ram)
    for index, value in ((0, 5), (1, 77), (2, 9)):
        nodes.set("I", index)
        assert nodes.get("F") == value


def test_variables_may_mean_limits_and_choices_and_expressions_come_first() -> None:
    body = (
        '<Integer Name="D"><Value>2</Value><Min>-5</Min><Max>9</Max><Inc>1</Inc></Integer>'
        '<Enumeration Name="N"><EnumEntry Name="Aa"><Value>4</Value></EnumEntry><Value>4</Value>'
        "</Enumeration>"
        '<IntSwissKnife Name="F"><pVariable Name="D.Min">D</pVariable><pVariable Name="D.Max">D</pVariable>'
        '<pVariable Name="D.Inc">D</pVariable><pVariable Name="N.Entry.Aa">N</pVariable>'
        '<Constant Name="K">0x10</Constant>'
        '<Expression Name="S">D.Max - D.Min</Expression>'
        "<Formula>S + D.Inc*100 + N.Entry.Aa*1000 + K</Formula>"
        "</IntSwissKnife>"
    )
    assert node_map(body).get("F") == 14 + 100 + 4000 + 16


def test_a_converter_goes_both_ways_and_turns_its_limits_with_it() -> None:
    ram = Ram()
    body = (
        register("R", 0, "<Sign>Unsigned</Sign>", length=2)
        + '<Converter Name="C"><FormulaTo>1000 / FROM</FormulaTo><FormulaFrom>1000.0 / (TO + 1)</FormulaFrom>'
        "<pValue>R</pValue><Slope>Decreasing</Slope></Converter>"
        '<Float Name="F"><pValue>C</pValue><Unit>Hz</Unit></Float>'
    )
    nodes = node_map(body, ram)
    assert nodes.node("F").maximum() == 1000.0
    assert nodes.node("F").minimum() == pytest.approx(1000 / 65536)
    nodes.set("F", 10.0)
    assert struct.unpack_from("<H", ram.data)[0] == 100
    with pytest.raises(DeviceError, match=r"F = 2000.0 is out of range; allowed is 0\.0152\d* to 1000 Hz"):
        nodes.set("F", 2000.0)


def test_locked_absent_and_read_only_features_say_so() -> None:
    body = (
        '<Integer Name="Lock"><Value>0</Value></Integer><Integer Name="There"><Value>1</Value></Integer>'
        '<Integer Name="F"><pIsAvailable>There</pIsAvailable><pIsLocked>Lock</pIsLocked>'
        "<Value>3</Value></Integer>"
        '<Integer Name="G"><pIsImplemented>There</pIsImplemented><ImposedAccessMode>RO</ImposedAccessMode>'
        "<Value>3</Value></Integer>"
    )
    nodes = node_map(body)
    nodes.set("F", 4)
    with pytest.raises(AccessRefused, match="G cannot be set: it is read-only"):
        nodes.set("G", 4)
    nodes.set("Lock", 1)
    assert nodes.get("F") == 4
    with pytest.raises(AccessRefused, match="F cannot be set: it is read-only"):
        nodes.set("F", 5)
    nodes.set("There", 0)
    with pytest.raises(AccessRefused, match="F cannot be read: it is not available"):
        nodes.get("F")
    with pytest.raises(AccessRefused, match="G cannot be read: it is not implemented"):
        nodes.get("G")


def test_texts_switches_commands_and_plain_bytes() -> None:
    ram = Ram()
    body = (
        register("Text", 0, kind="StringReg", length=8)
        + '<String Name="F"><pValue>Text</pValue></String>'
        + register("Raw", 8, kind="Register", length=4)
        + register("Bit", 16)
        + '<Boolean Name="Switch"><pValue>Bit</pValue><OnValue>5</OnValue><OffValue>2</OffValue></Boolean>'
        + register("Do", 20)
        + '<Command Name="Go"><pValue>Do</pValue><CommandValue>9</CommandValue></Command>'
        + register("Copy", 24)
        + '<Integer Name="Both"><pValue>Do</pValue><pValueCopy>Copy</pValueCopy></Integer>'
    )
    nodes = node_map(body, ram)
    nodes.set("F", "Grün")
    assert (nodes.get("F"), bytes(ram.data[:8])) == ("Grün", "Grün".encode().ljust(8, b"\0"))
    with pytest.raises(DeviceError, match="holds 8 bytes, got 9"):
        nodes.set("F", "123456789")
    nodes.set("Raw", b"abcd")
    assert nodes.get("Raw") == b"abcd"
    with pytest.raises(DeviceError, match="is 0, neither on"):
        nodes.get("Switch")
    nodes.set("Switch", True)
    assert (nodes.get("Switch"), ram.data[16]) == (True, 5)
    nodes.set("Switch", False)
    assert (nodes.get("Switch"), ram.data[16]) == (False, 2)
    nodes.set("Go", None)
    assert ram.data[20] == 9
    nodes.set("Both", 3)
    assert (ram.data[20], ram.data[24]) == (3, 3)


def test_floats_of_both_lengths_and_orders() -> None:
    ram = Ram()
    body = register("Small", 0, "<Endianess>BigEndian</Endianess>", "FloatReg") + register(
        "Large", 8, "<Endianess>LittleEndian</Endianess>", "FloatReg", 8
    )
    nodes = node_map(body, ram)
    nodes.set("Small", 1.5)
    nodes.set("Large", -2.25e100)
    assert struct.unpack_from(">f", ram.data, 0)[0] == 1.5
    assert struct.unpack_from("<d", ram.data, 8)[0] == -2.25e100
    with pytest.raises(DeviceError, match="cannot be 1e\\+39"):
        nodes.set("Small", 1e39)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ('<Integer Name="F"><pValue>F</pValue></Integer>', "refers to itself"),
        ('<Integer Name="F"><pValue>Gone</pValue></Integer>', "no feature 'Gone'"),
        ('<Integer Name="F"><Value>many</Value></Integer>', "'many' is not a number"),
        ('<Integer Name="F"/>', "it has no value"),
        (ZERO + '<SwissKnife Name="F"><pVariable Name="X">Y</pVariable><Formula>1/X</Formula></SwissKnife>',
         "divides by zero with X = 0"),
        ('<SmartFeature Name="F"/>', "is a SmartFeature and has no value"),
        (register("F", 0, length=9), "an integer cannot have 9 bytes"),
        (register("F", 0, kind="FloatReg", length=5), "a floating-point number cannot have 5 bytes"),
        (register("F", 0, "<Bit>40</Bit>", "MaskedIntReg"), "bits 40 to 40 of a register of 32 bits"),
        (register("F", 0, length=0), "a register cannot have 0 bytes"),
    ],
)  # fmt: skip
def test_a_wrong_description_is_named(body: str, expected: str) -> None:
    with pytest.raises(DeviceError, match=expected) as error:
        node_map(body).get("F")
    assert "camera" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_float_is_written_into_an_integer_as_the_nearest_one() -> None:
    ram = Ram()
    nodes = node_map(
        '<Float Name="F"><pValue>R</pValue></Float>' + register("R", 8, "<Sign>Signed</Sign>"), ram
    )
    for value, whole in ((33.7, 34), (33.2, 33), (33.5, 34), (-2.5, -3), (-2.4, -2)):
        nodes.set("F", value)
        assert struct.unpack_from("<i", ram.data, 8) == (whole,)


def test_a_long_chain_of_formulas_is_read_once() -> None:
    """Each refers twice to the one before; without being kept, the first would be read 2^40 times."""
    body = register("K0", 0, "<Cachable>NoCache</Cachable>") + "".join(
        f'<IntSwissKnife Name="K{i}"><pVariable Name="A">K{i - 1}</pVariable>'
        f'<pVariable Name="B">K{i - 1}</pVariable><Formula>A + B - A</Formula></IntSwissKnife>'
        for i in range(1, 41)
    )
    ram = Ram()
    ram.data[0] = 7
    nodes = node_map(body + '<Integer Name="F"><pValue>K40</pValue></Integer>', ram)
    assert nodes.get("F") == 7
    assert len(ram.reads) <= 4
    ram.data[0] = 9
    assert nodes.get("F") == 9, "nothing is kept from one reading to the next"


def test_what_is_nested_too_deeply_or_is_no_number_is_one_line() -> None:
    with pytest.raises(DeviceError, match="nested too deeply"):
        node_map('<Integer Name="F">' + "<Extension>" * 5000 + "</Extension>" * 5000 + "</Integer>")
    nodes = node_map('<Integer Name="F"><Value>3</Value></Integer><Float Name="G"><Value>1</Value></Float>')
    nodes.set("F", "0x140")
    assert nodes.get("F") == 320
    for name, value, reason in (
        ("F", "wide", "is not a number"),
        ("F", 1.5, "whole"),
        ("G", "1,5", "is not a number"),
    ):
        with pytest.raises(DeviceError, match=reason):
            nodes.set(name, value)
