"""MAVLink's definitions as pymavlink ships them in XML, beside the modules made from them."""

import xml.etree.ElementTree as ET
from importlib import resources

SIZES = {
    "char": 1, "uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4, "int32_t": 4,
    "uint64_t": 8, "int64_t": 8, "float": 4, "double": 8,
}  # fmt: skip


def definitions(*files):
    """Number of a message -> (name, fields, fields of the extension), as written.

    A field is (type, length of the array or 0, name).
    """
    folder = resources.files("pymavlink.dialects.v20")
    found = {}
    for file in files:
        root = ET.fromstring((folder / f"{file}.xml").read_text(encoding="utf-8"))
        for message in root.iter("message"):
            parts = [], []
            extended = 0
            for child in message:
                if child.tag == "extensions":
                    extended = 1
                elif child.tag == "field":
                    kind, _, length = child.attrib["type"].rstrip("]").partition("[")
                    kind = kind.removesuffix("_mavlink_version")
                    parts[extended].append((kind, int(length or 0), child.attrib["name"]))
            found[int(message.attrib["id"])] = message.attrib["name"], *parts
    return found
