"""Make the project's MAVLink dialect from its XML, and the table of all other messages.

    python tools/make_dialect.py [FOLDER]

writes `gcs_sysid_dialect.py` (pymavlink's generator, from `gcs_sysid.xml`) and
`known_messages.py` (from the dialects that pymavlink ships) into FOLDER, by default the
dialect's own folder. The same input gives the same bytes: no dates, no paths.
"""

import argparse
import contextlib
import importlib
import io
import sys
import tempfile
from pathlib import Path

DIALECT_FOLDER = Path(__file__).resolve().parents[1] / "src/gcs_sysid/telemetry/dialect"
XML_NAME = "gcs_sysid.xml"
DIALECT_NAME = "gcs_sysid_dialect.py"
TABLE_NAME = "known_messages.py"

# Later ones win where two dialects give one id to different messages: the autopilots'
# own dialects are what a quadrotor speaks.
KNOWN_FROM = ("all", "development", "common", "ardupilotmega")


def make_dialect(folder: Path) -> Path:
    """Generate the dialect module from the XML."""
    from pymavlink.generator import mavgen, mavparse

    target = folder / DIALECT_NAME
    said = io.StringIO()
    with contextlib.redirect_stdout(said), tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / DIALECT_NAME
        options = mavgen.Opts(
            str(made),
            wire_protocol=mavparse.PROTOCOL_2_0,
            language="Python3",
            validate=False,  # needs lxml, and its answer changes nothing in the output
        )
        if not mavgen.mavgen(options, [str(DIALECT_FOLDER / XML_NAME)]):
            sys.exit(f"pymavlink's generator refused {XML_NAME}:\n{said.getvalue()}")
        text = made.read_text(encoding="utf-8")
    target.write_text(text, encoding="utf-8", newline="\n")
    return target


def make_table(folder: Path) -> Path:
    """Write the table of message types that the dialect does not decode."""
    import pymavlink

    own = {
        int(line.split('id="')[1].split('"')[0])
        for line in (DIALECT_FOLDER / XML_NAME).read_text(encoding="utf-8").splitlines()
        if line.strip().startswith("<message ")
    }
    known: dict[int, tuple[str, int, int]] = {}
    for name in KNOWN_FROM:
        module = importlib.import_module(f"pymavlink.dialects.v20.{name}")
        for message_id, message in module.mavlink_map.items():
            known[message_id] = (message.msgname, message.crc_extra, message.unpacker.size)
    lines = [
        '"""Every other MAVLink message: made by tools/make_dialect.py, do not edit.',
        "",
        f"From the dialects {', '.join(KNOWN_FROM)} of pymavlink {pymavlink.__version__}, so that",
        "frames which the project's dialect does not decode can be checked and named.",
        '"""',
        "",
        "# fmt: off",
        "#: message id -> (name, CRC_EXTRA, longest payload in bytes)",
        "KNOWN_MESSAGES: dict[int, tuple[str, int, int]] = {",
    ]
    for message_id in sorted(set(known) - own):
        name, crc_extra, length = known[message_id]
        lines.append(f'    {message_id}: ("{name}", {crc_extra}, {length}),')
    lines += ["}", "# fmt: on", ""]
    target = folder / TABLE_NAME
    target.write_text("\n".join(lines), encoding="utf-8", newline="\n")
    return target


def main() -> None:
    """Generate both files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=DIALECT_FOLDER)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    print(make_dialect(folder))
    print(make_table(folder))


if __name__ == "__main__":
    main()
