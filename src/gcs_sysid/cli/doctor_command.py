"""`gcs-sysid doctor`: is this machine ready, and which vehicles are there?"""

import argparse
import sys

from gcs_sysid.cli.output import show, terminal_width
from gcs_sysid.errors import InputError
from gcs_sysid.setup_help.checks import (
    VEHICLE,
    SetupFinding,
    Sign,
    as_text,
    can_show,
    check_packages,
    check_python,
    check_recordings,
    check_terminal,
    worst,
)
from gcs_sysid.strict_json import json_text


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when there is a problem."""
    findings = [check_python(), check_packages(), check_terminal(), check_recordings()]
    try:
        findings += _links(options)
    except ImportError as error:
        # With a package missing, reported above, links cannot be checked.
        findings.append(SetupFinding("links", Sign.PROBLEM, f"cannot be checked: {error}"))
    if options.json:
        report = {"findings": [finding.as_json() for finding in findings]}
        show(json_text(report, 2))
    else:
        show(as_text(findings, terminal_width() or 100, unicode=can_show("✓✗")))
        show(f"\n{_summary(findings)}")
    return 1 if worst(findings) is Sign.PROBLEM else 0


def _summary(findings: list[SetupFinding]) -> str:
    problems, warnings = (
        sum(finding.sign is sign for finding in findings) for sign in (Sign.PROBLEM, Sign.WARNING)
    )
    if problems:
        return f"problems: {problems} (see ->)"
    comes = any(finding.topic == VEHICLE and finding.sign is Sign.OK for finding in findings)
    said = "ready" if comes else "no vehicle is received yet"
    return said + (f"; warnings: {warnings} (see ->)" if warnings else "")


def _links(options: argparse.Namespace) -> list[SetupFinding]:
    """Serial devices, ports, and vehicles received; its modules need the packages checked
    before.
    """
    from gcs_sysid.setup_help import listening
    from gcs_sysid.setup_help.checks import check_serial
    from gcs_sysid.telemetry.link import serial_devices
    from gcs_sysid.telemetry.urls import parse_url

    asked = [parse_url(text, options.baud) for text in options.urls]
    for url in asked:
        if url.sends_first:
            raise InputError(
                f"{url}: a vehicle there answers only to messages, and doctor only listens"
            )
    findings = check_serial(serial_devices())
    named = {url.port for url in asked if url.kind == "udpin"}
    usual = [url for url in listening.usual_urls() if url.port not in named]
    ears = []
    for urls, taken in ((usual, Sign.WARNING), (asked, Sign.PROBLEM)):
        opened, found = listening.open_ears(urls, taken)
        ears += opened
        findings += found
    if sys.stderr.isatty():
        print(f"listening for {options.duration:g} s ...", file=sys.stderr, flush=True)
    listening.listen(ears, options.duration)
    findings += listening.received(ears, options.duration)
    return findings
