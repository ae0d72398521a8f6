"""`gcs-sysid airframe`: describe a vehicle in a file, and check one."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gcs_sysid.cli.airframe_choice import given_scale
from gcs_sysid.cli.output import check_outputs, show, terminal_width, write_text
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.setup_help.airframe_file import (
    ASCII,
    UNICODE,
    UNICODE_SIGNS,
    Pen,
    airframe_text,
    check_airframe,
    checked,
    draw,
    legend,
    rotor_table,
)
from gcs_sysid.setup_help.checks import SetupFinding, Sign, as_text, can_show, quoted, worst
from gcs_sysid.setup_help.wizard import (
    Answers,
    GivenAnswers,
    Wizard,
    arm_lengths,
    given_answers,
    imu_position,
    plain_name,
    rotor,
)
from gcs_sysid.strict_json import json_text


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    return _new(options) if options.action == "new" else _check(options)


def _pen(encoding: str | None) -> Pen:
    return UNICODE if can_show(UNICODE_SIGNS, encoding) else ASCII


def _check(options: argparse.Namespace) -> int:
    airframe = load_airframe(str(options.file))
    findings = check_airframe(airframe)
    if options.json:
        table = {**airframe.as_json(), "findings": [finding.as_json() for finding in findings]}
        show(json_text(table, 2))
    else:
        show(_picture(airframe, findings))
    return 1 if worst(findings) is Sign.PROBLEM else 0


def _picture(airframe: Airframe, findings: Sequence[SetupFinding]) -> str:
    """Name, drawing, numbers and findings."""
    pen = _pen(sys.stdout.encoding)
    said = as_text(findings, terminal_width() or 80, unicode=pen is UNICODE)
    parts = (airframe.name, draw(airframe.rotors, pen), legend(pen), rotor_table(airframe.rotors))
    return "\n\n".join((*parts, said))


def _new(options: argparse.Namespace) -> int:
    given = _given(options)
    check_outputs(options.output, force=options.force)
    asking = not given.complete
    if not asking:
        answers, path = given_answers(given), given.output
    elif sys.stdin.isatty() and sys.stderr.isatty():
        answers, path = _asked(given)
    else:
        raise InputError(
            "no terminal for questions: give --layout and --arm (or --rotor for each motor), "
            "and --output"
        )
    if path is None:
        print("nothing is written", file=sys.stderr)
        return 0
    text = airframe_text(*answers)
    airframe = checked(text, str(path))
    write_text(str(path), text, force=options.force)
    if not asking:  # else it has been seen already
        _warn(airframe)
    _say_next(path, airframe)
    return 0


def _given(options: argparse.Namespace) -> GivenAnswers:
    return GivenAnswers(
        layout=options.layout,
        arm=None if options.arm is None else arm_lengths(options.arm),
        rotors=tuple(rotor(text) for text in options.rotor),
        spin=options.spin,
        scale=given_scale(options),
        imu_position=None if options.imu is None else imu_position(options.imu),
        priors={name: (value, std) for name, value, std in options.prior},
        name=None if options.name is None else plain_name(options.name),
        output=None if options.output is None else Path(options.output),
    )


def _asked(given: GivenAnswers) -> tuple[Answers, Path | None]:
    """Ask for what is missing; the path is None when the user says no at the end."""

    def ask(question: str) -> str:
        # On standard error: `--output -` has standard output for the file.
        print(question, end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            print(file=sys.stderr)
            raise InputError("end of input before the last question; nothing written")
        return line.rstrip("\r\n")

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    wizard = Wizard(ask, say, _pen(sys.stderr.encoding))
    say("A few questions about the vehicle; Ctrl-C leaves, and nothing is written.\n")
    answers = wizard.answers(given)
    text = airframe_text(*answers)
    findings = check_airframe(checked(text, "airframe"))
    unicode = can_show(UNICODE_SIGNS, sys.stderr.encoding)
    say(f"\n{text}\n{as_text(findings, terminal_width() or 80, unicode=unicode)}\n")
    path = given.output or wizard.new_file(_file_name(answers[0].name))
    return answers, path if wizard.yes(f"Write {path}?", default=True) else None


def _file_name(name: str) -> str:
    """A file name of a vehicle's name, for every system."""
    plain = "".join(c if c.isalnum() or c in "-_" else "-" for c in name.lower()).strip("-")
    return f"{plain or 'airframe'}.toml"


def _warn(airframe: Airframe) -> None:
    """What looks wrong, on standard error."""
    strange = [f for f in check_airframe(airframe) if f.sign is not Sign.OK]
    if strange:
        unicode = can_show("✗", sys.stderr.encoding)
        print(as_text(strange, terminal_width() or 100, unicode=unicode), file=sys.stderr)


def _say_next(path: Path, airframe: Airframe) -> None:
    """What was written and what comes next, on standard error."""
    if str(path) == "-":
        return
    file, scale = quoted(str(path)), "" if airframe.anchor() else " --mass KG"
    print(
        f"written: {path}\n"
        f"next: gcs-sysid live udpin:0.0.0.0:14550 --airframe {file}{scale}\n"
        f"      (gcs-sysid airframe check {file} draws it)",
        file=sys.stderr,
    )
