"""The GenICam description of the test camera.

Features sit on registers of both byte orders, behind converters, swiss knives, masks and selectors,
as real cameras have them.
"""

# Pixel formats by the numbers of the Pixel Format Naming Convention
FORMATS = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono12": 0x01100005,
    "Mono16": 0x01100007,
    "Mono14": 0x01100025,
    "Mono10Packed": 0x010C0004,
    "Mono10p": 0x010A0046,
    "Mono12p": 0x010C0047,
    "Mono12Packed": 0x010C0006,
    "BayerRG8": 0x01080009,
    "BayerGB12p": 0x010C0055,
}
BITS = {name: (code >> 16) & 0xFF for name, code in FORMATS.items()}

SENSOR_WIDTH, SENSOR_HEIGHT = 1440, 1080

# Addresses of the camera's own registers
BASE = 0x20000
WIDTH, HEIGHT, OFFSET_X, OFFSET_Y = BASE, BASE + 4, BASE + 8, BASE + 12
PIXEL_FORMAT = BASE + 0x10
EXPOSURE_TICKS = BASE + 0x14  # unsigned 32-bit big-endian, 0.1 us
GAIN = BASE + 0x18  # float, dB
FRAME_RATE = BASE + 0x20  # double, Hz
FRAME_RATE_ENABLE = BASE + 0x28  # bit 31 (counted from the most significant, big-endian)
START, STOP = BASE + 0x30, BASE + 0x34
PAYLOAD_SIZE = BASE + 0x38
LOCKED = BASE + 0x3C
TRIGGER_MODE = BASE + 0x40
EXPOSURE_AUTO, GAIN_AUTO = BASE + 0x44, BASE + 0x48
ACQUISITION_MODE = BASE + 0x4C
TRIGGER_SELECTOR = BASE + 0x50
TEMPERATURE = BASE + 0x54  # float, degrees Celsius
GAMMA_ENABLE = BASE + 0x58
TRIGGER_SOURCE = BASE + 0x5C
TRIGGER_ACTIVATION = BASE + 0x60
LINE_SELECTOR = BASE + 0x64
LINE_MODE = BASE + 0x68  # one byte a line
LINE_SOURCE = BASE + 0x6C  # one byte a line
THROUGHPUT = BASE + 0x70  # bytes/s that the bus has left, 0: no limit
END = BASE + 0x1000


def _register(
    name: str, address: int, *, access: str = "RW", order: str = "LittleEndian", more: str = ""
) -> str:
    return f"""
  <IntReg Name="{name}"><Address>0x{address:X}</Address><Length>4</Length>
    <AccessMode>{access}</AccessMode><pPort>Device</pPort>{more}<Sign>Unsigned</Sign>
    <Endianess>{order}</Endianess></IntReg>"""


def _text(name: str, address: int) -> str:
    return f"""
  <StringReg Name="{name}"><Address>0x{address:X}</Address><Length>64</Length><AccessMode>RO</AccessMode>
    <pPort>Device</pPort></StringReg>"""


def _enumeration(name: str, register: int, entries: dict[str, int], more: str = "") -> str:
    listed = "".join(
        f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>' for entry, value in entries.items()
    )
    return f'<Enumeration Name="{name}">{more}{listed}<pValue>{name}Reg</pValue></Enumeration>' + _register(
        f"{name}Reg", register
    )


def _of_line(name: str, register: int, entries: dict[str, int]) -> str:
    """A property of each line, in a byte of its own."""
    listed = "".join(
        f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>' for entry, value in entries.items()
    )
    return f"""<Enumeration Name="{name}">{listed}<pValue>{name}Bit</pValue></Enumeration>
<MaskedIntReg Name="{name}Bit"><Address>0x{register:X}</Address>
 <pIndex Offset="1">LineSelectorReg</pIndex><Length>1</Length><AccessMode>RW</AccessMode>
 <pPort>Device</pPort><Bit>0</Bit><Endianess>LittleEndian</Endianess></MaskedIntReg>"""


def _size(name: str, offset: str, register: int, sensor: str, inc: int) -> str:
    return f"""<Integer Name="{name}"><pIsLocked>TLParamsLocked</pIsLocked><pValue>{name}Reg</pValue>
        <Min>{inc}</Min><pMax>{name}Limit</pMax><Inc>{inc}</Inc></Integer>
        <IntSwissKnife Name="{name}Limit"><pVariable Name="OFFSET">{offset}Reg</pVariable>
        <Constant Name="SENSOR">{sensor}</Constant>
        <Formula>SENSOR - OFFSET</Formula></IntSwissKnife>""" + _register(f"{name}Reg", register)


def _offset(name: str, size: str, register: int, sensor: str) -> str:
    return f"""<Integer Name="{name}"><pValue>{name}Reg</pValue><Min>0</Min>
        <pMax>{name}Limit</pMax><Inc>2</Inc></Integer>
        <IntSwissKnife Name="{name}Limit"><pVariable Name="SIZE">{size}Reg</pVariable>
        <Formula>{sensor} - SIZE</Formula></IntSwissKnife>""" + _register(f"{name}Reg", register)


def description(formats: tuple[str, ...] = tuple(FORMATS), exposure_name: str = "ExposureTime") -> str:
    """The camera's XML; older cameras call the exposure ExposureTimeAbs."""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- written for tests -->
<RegisterDescription ModelName="Eye" VendorName="Testwerk" ToolTip="t" StandardNameSpace="USB"
 SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0"
 SubMinorVersion="0" ProductGuid="11111111-2222-3333-4444-555555555555"
 VersionGuid="11111111-2222-3333-4444-666666666666"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
{_text("DeviceVendorName", 0x4)}{_text("DeviceModelName", 0x44)}{_text("DeviceSerialNumber", 0x144)}
<Category Name="Root"><pFeature>DeviceControl</pFeature>
 <pFeature>Format</pFeature><pFeature>Acquisition</pFeature></Category>
<Category Name="DeviceControl"><pFeature>DeviceVendorName</pFeature><pFeature>DeviceModelName</pFeature>
 <pFeature>DeviceSerialNumber</pFeature><pFeature>DeviceTemperature</pFeature>
 <pFeature>GammaEnable</pFeature></Category>
<Category Name="Format"><pFeature>Width</pFeature><pFeature>Height</pFeature><pFeature>OffsetX</pFeature>
 <pFeature>OffsetY</pFeature><pFeature>PixelFormat</pFeature><pFeature>SensorWidth</pFeature>
 <pFeature>SensorHeight</pFeature><pFeature>PayloadSize</pFeature></Category>
<Category Name="Acquisition"><pFeature>{exposure_name}</pFeature><pFeature>Gain</pFeature>
 <pFeature>AcquisitionFrameRate</pFeature><pFeature>AcquisitionFrameRateEnable</pFeature>
 <pFeature>AcquisitionMode</pFeature><pFeature>AcquisitionStart</pFeature><pFeature>AcquisitionStop</pFeature>
 <pFeature>TriggerSelector</pFeature><pFeature>TriggerMode</pFeature><pFeature>TriggerSource</pFeature>
 <pFeature>TriggerActivation</pFeature><pFeature>ExposureAuto</pFeature><pFeature>GainAuto</pFeature>
 <pFeature>LineSelector</pFeature><pFeature>LineMode</pFeature><pFeature>LineSource</pFeature>
 <pFeature>AcquisitionResultingFrameRate</pFeature></Category>
<Group Comment="sizes">
{_size("Width", "OffsetX", WIDTH, str(SENSOR_WIDTH), 8)}
{_size("Height", "OffsetY", HEIGHT, str(SENSOR_HEIGHT), 2)}
{_offset("OffsetX", "Width", OFFSET_X, str(SENSOR_WIDTH))}
{_offset("OffsetY", "Height", OFFSET_Y, str(SENSOR_HEIGHT))}
</Group>
<Integer Name="SensorWidth"><Value>{SENSOR_WIDTH}</Value></Integer>
<Integer Name="SensorHeight"><Value>{SENSOR_HEIGHT}</Value></Integer>
{
        _enumeration(
            "PixelFormat",
            PIXEL_FORMAT,
            {name: FORMATS[name] for name in formats},
            "<pIsLocked>TLParamsLocked</pIsLocked>",
        )
    }
<Integer Name="PayloadSize"><ImposedAccessMode>RO</ImposedAccessMode><pValue>PayloadSizeReg</pValue></Integer>
{_register("PayloadSizeReg", PAYLOAD_SIZE, access="RO", more="<Cachable>NoCache</Cachable>")}
<Float Name="{exposure_name}"><pValue>ExposureConverter</pValue><Min>20.0</Min><Max>1000000.0</Max>
 <Unit>us</Unit></Float>
<Converter Name="ExposureConverter"><FormulaTo>ROUND(FROM * 10)</FormulaTo>
 <FormulaFrom>TO / 10.0</FormulaFrom><pValue>ExposureTicks</pValue><Slope>Increasing</Slope></Converter>
{_register("ExposureTicks", EXPOSURE_TICKS, order="BigEndian")}
<Float Name="Gain"><pValue>GainReg</pValue><Min>-12</Min><Max>24</Max><Unit>dB</Unit></Float>
<FloatReg Name="GainReg"><Address>0x{GAIN:X}</Address><Length>4</Length><AccessMode>RW</AccessMode>
 <pPort>Device</pPort><Endianess>LittleEndian</Endianess></FloatReg>
<Float Name="AcquisitionFrameRate"><pIsAvailable>AcquisitionFrameRateEnable</pIsAvailable>
 <pValue>FrameRateReg</pValue><Min>0.1</Min><pMax>FrameRateMax</pMax><Unit>Hz</Unit></Float>
<SwissKnife Name="FrameRateMax"><pVariable Name="T">{exposure_name}</pVariable>
 <Formula>(T &lt; 1000) ? 1000 : 1E6 / T</Formula></SwissKnife>
<FloatReg Name="FrameRateReg"><Address>0x{FRAME_RATE:X}</Address><Length>8</Length><AccessMode>RW</AccessMode>
 <pPort>Device</pPort><Endianess>LittleEndian</Endianess></FloatReg>
<Boolean Name="AcquisitionFrameRateEnable"><pValue>FrameRateEnableBit</pValue></Boolean>
<MaskedIntReg Name="FrameRateEnableBit"><Address>0x{FRAME_RATE_ENABLE:X}</Address><Length>4</Length>
 <AccessMode>RW</AccessMode><pPort>Device</pPort><Bit>31</Bit><Endianess>BigEndian</Endianess></MaskedIntReg>
{_enumeration("AcquisitionMode", ACQUISITION_MODE, {"Continuous": 0, "SingleFrame": 1})}
{_enumeration("ExposureAuto", EXPOSURE_AUTO, {"Off": 0, "Continuous": 1})}
{_enumeration("GainAuto", GAIN_AUTO, {"Off": 0, "Continuous": 1})}
<Enumeration Name="TriggerSelector"><EnumEntry Name="FrameStart"><Value>0</Value></EnumEntry>
 <EnumEntry Name="AcquisitionStart"><Value>1</Value></EnumEntry><pValue>TriggerSelectorReg</pValue>
 <pSelected>TriggerMode</pSelected></Enumeration>
{_register("TriggerSelectorReg", TRIGGER_SELECTOR)}
<Enumeration Name="TriggerMode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
 <EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>TriggerModeBit</pValue></Enumeration>
<MaskedIntReg Name="TriggerModeBit"><Address>0x{TRIGGER_MODE:X}</Address>
 <pIndex Offset="1">TriggerSelectorReg</pIndex><Length>1</Length><AccessMode>RW</AccessMode>
 <pPort>Device</pPort><Bit>0</Bit><Endianess>LittleEndian</Endianess></MaskedIntReg>
{_enumeration("TriggerSource", TRIGGER_SOURCE, {"Software": 0, "Line1": 1, "Line3": 3})}
{_enumeration("TriggerActivation", TRIGGER_ACTIVATION, {"RisingEdge": 0, "FallingEdge": 1})}
<Enumeration Name="LineSelector"><EnumEntry Name="Line1"><Value>0</Value></EnumEntry>
 <EnumEntry Name="Line2"><Value>1</Value></EnumEntry><pValue>LineSelectorReg</pValue>
 <pSelected>LineMode</pSelected><pSelected>LineSource</pSelected></Enumeration>
{_register("LineSelectorReg", LINE_SELECTOR)}
{_of_line("LineMode", LINE_MODE, {"Input": 0, "Output": 1})}
{_of_line("LineSource", LINE_SOURCE, {"Off": 0, "ExposureActive": 1})}
<SwissKnife Name="AcquisitionResultingFrameRate"><pVariable Name="T">{exposure_name}</pVariable>
 <pVariable Name="BYTES">PayloadSize</pVariable><pVariable Name="BUS">ThroughputReg</pVariable>
 <pVariable Name="ON">FrameRateEnableBit</pVariable>
 <pVariable Name="RATE">FrameRateReg</pVariable><Expression Name="POSSIBLE">(BUS = 0) ? (1E6 / T) :
 ((BUS / BYTES &lt; 1E6 / T) ? (BUS / BYTES) : (1E6 / T))</Expression>
 <Formula>((ON = 1) &amp;&amp; (RATE &lt; POSSIBLE)) ? RATE : POSSIBLE</Formula><Unit>Hz</Unit></SwissKnife>
{_register("ThroughputReg", THROUGHPUT, access="RO")}
<Command Name="AcquisitionStart"><pValue>StartReg</pValue><CommandValue>1</CommandValue></Command>
{_register("StartReg", START, access="WO")}
<Command Name="AcquisitionStop"><pValue>StopReg</pValue><CommandValue>1</CommandValue></Command>
{_register("StopReg", STOP, access="WO")}
<Float Name="DeviceTemperature"><pValue>TemperatureReg</pValue><Unit>C</Unit></Float>
<FloatReg Name="TemperatureReg"><Address>0x{TEMPERATURE:X}</Address><Length>4</Length>
 <AccessMode>RO</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>
 <Endianess>LittleEndian</Endianess></FloatReg>
<Boolean Name="GammaEnable"><pValue>GammaEnableReg</pValue></Boolean>
{_register("GammaEnableReg", GAMMA_ENABLE)}
<Integer Name="TLParamsLocked"><pValue>LockedReg</pValue><Min>0</Min><Max>1</Max></Integer>
{_register("LockedReg", LOCKED)}
<Port Name="Device"/>
</RegisterDescription>
"""
