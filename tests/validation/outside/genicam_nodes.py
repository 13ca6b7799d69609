"""Node maps of real cameras' descriptions: this driver's values, and those of EMVA's reference."""

import gzip
import importlib.util
from pathlib import Path

from acquisition.cameras.usb3vision.manifest import decode_description
from tests.validation.outside.shared import shared
from tests.validation.row import Found, Missing

SEEDS = (0, 1, 2)


def compared() -> dict[str, Found]:
    """Nodes whose access or value differs, over three descriptions and three memories."""
    if importlib.util.find_spec("genicam") is None:
        raise Missing('genicam: pip install ".[test-cameras]"')
    # the module skips as a test where the reference is missing
    from tests.acquisition.cameras.usb3vision import test_oracle as oracle

    folder: Path = shared("genicam")
    different, count, nodes = [], 0, 0
    for file in sorted(folder.glob("*.xml.gz")):
        xml = decode_description(gzip.decompress(file.read_bytes()), file.name)
        for seed in SEEDS:
            pair = oracle.Pair(xml, seed)
            for name in pair.names(oracle.VALUES):
                nodes += 1
                access = oracle.ACCESS[pair.reference.get_node(name).get_access_mode()]
                if pair.ours.node(name).access() is not access:
                    different.append(f"{file.name}: access of {name}")
                elif access.readable and (wanted := oracle.reference_value(pair, name)) is not None:
                    count += 1
                    if not oracle.same(wanted, oracle.our_value(pair, name)):
                        different.append(f"{file.name}: {name}")
    detail = f"{nodes:,} nodes, {count:,} values" + "".join(f"; {name}" for name in different[:3])
    return {"different": Found((float(len(different)),), detail)}
