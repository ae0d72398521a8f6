"""The project's dialect agrees with MAVLink's and can be made again from its XML."""

import re
import subprocess
import sys
from pathlib import Path

import fastcrc
import pymavlink
import pytest
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega, common

from gcs_sysid.telemetry import dialect
from gcs_sysid.telemetry.dialect import known_messages, mavlink

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(dialect.__file__).parent


@pytest.mark.parametrize("reference", [common, ardupilotmega, everything], ids=lambda m: m.DIALECT)
def test_every_shared_message_is_laid_out_as_in_pymavlink(reference):
    shared = mavlink.mavlink_map.keys() & reference.mavlink_map.keys()
    assert len(shared) > 35
    for message_id in shared:
        ours, theirs = mavlink.mavlink_map[message_id], reference.mavlink_map[message_id]
        for what in ("msgname", "crc_extra", "fieldnames", "ordered_fieldnames", "orders"):
            assert getattr(ours, what) == getattr(theirs, what), (ours.msgname, what)
        assert ours.unpacker.format == theirs.unpacker.format, ours.msgname


@pytest.mark.parametrize(
    ("name", "message_id", "crc_extra", "length"),
    [("ESC_INFO", 290, 251, 46), ("ESC_STATUS", 291, 10, 57), ("PROTOCOL_VERSION", 300, 217, 22)],
)
def test_messages_that_pymavlink_lacks_have_the_wire_form_of_mavlink(
    name, message_id, crc_extra, length
):
    message = mavlink.mavlink_map[message_id]
    assert (message.msgname, message.crc_extra, message.unpacker.size) == (name, crc_extra, length)


def test_enums_have_mavlinks_values():
    for name, entries in mavlink.enums.items():
        theirs = everything.enums.get(name)
        if theirs is None:
            continue
        names = {entry.name: value for value, entry in theirs.items()}
        for value, entry in entries.items():
            if not entry.name.endswith("_ENUM_END"):
                assert names[entry.name] == value, entry.name


def test_checksums_are_taken_by_fastcrc():
    assert mavlink.mcrf4xx is fastcrc.crc16.mcrf4xx


@pytest.mark.slow
def test_generated_files_are_what_the_generator_makes(tmp_path):
    table = (FOLDER / "known_messages.py").read_text(encoding="utf-8")
    if f"pymavlink {pymavlink.__version__}," not in table:
        pytest.skip("made with another pymavlink")
    script = ROOT / "tools" / "make_dialect.py"
    subprocess.run([sys.executable, script, tmp_path], check=True, capture_output=True)
    for name in ("gcs_sysid_dialect.py", "known_messages.py"):
        made = (tmp_path / name).read_text(encoding="utf-8")
        assert made == (FOLDER / name).read_text(encoding="utf-8"), f"run {script.name}"


def test_generated_files_hold_no_paths_or_dates():
    for name in ("gcs_sysid_dialect.py", "known_messages.py"):
        text = (FOLDER / name).read_text(encoding="utf-8")
        assert str(ROOT) not in text
        assert not re.search(r"\b20\d\d-\d\d-\d\d\b|/home/|/tmp/", text)


def test_other_messages_are_known_by_name_and_checksum():
    known = known_messages.KNOWN_MESSAGES
    assert not known.keys() & mavlink.mavlink_map.keys()
    for message_id, message in everything.mavlink_map.items():
        if message_id not in mavlink.mavlink_map:
            assert known[message_id][0] == message.msgname
