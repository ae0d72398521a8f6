"""What `gcs-sysid` alone shows: where to begin, and what it can do."""

import argparse
from collections.abc import Iterator

from gcs_sysid import __version__


def welcome(parser: argparse.ArgumentParser) -> str:
    """One screen of 80 columns.

    Args:
        parser: the whole command line; its commands are listed.
    """
    commands = "\n".join(f"  {name:<12}{what}" for name, what in commands_of(parser))
    return f"""\
gcs-sysid {__version__} identifies a multirotor from MAVLink, in flight or recorded.
Try the emulator, then your vehicle (--arm: m, center to motor; --mass: kg):
  gcs-sysid demo
  gcs-sysid live udpin:0.0.0.0:14550 --airframe px4-quad-x --arm 0.25 --mass 1.5
Commands
{commands}

Options: gcs-sysid COMMAND --help. No vehicle found? gcs-sysid doctor"""


def commands_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Name and one line of every command of a parser, in the order of its help."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for entry in action._choices_actions:
                yield entry.dest, entry.help or ""
