"""`gcs-sysid demo`: fly the bundled emulator and identify it."""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from gcs_sysid.cli import arguments, output
from gcs_sysid.cli.live import JsonLines, follow
from gcs_sysid.errors import GcsSysidError
from gcs_sysid.session.live import LiveOptions, LiveSession
from gcs_sysid.telemetry.link import TcpLink, UdpLink
from gcs_sysid.telemetry.urls import LinkUrl

_TRUTH_WAIT = 15.0
"""s that the emulator may take to start."""


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    airframe = arguments.airframe_of(options)
    # At full speed TCP holds the emulator back where UDP would lose what comes too fast.
    link: UdpLink | TcpLink
    if options.speed == "max":
        link = TcpLink(LinkUrl("tcpin", "tcpin:127.0.0.1", host="127.0.0.1", port=0))
        target = f"tcp:127.0.0.1:{link.port}"
    else:
        link = UdpLink(LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0))
        target = f"udpout:127.0.0.1:{link.port}"
    with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as folder:
        truth_file = Path(folder) / "truth.json"
        emulator = subprocess.Popen(
            [
                *(sys.executable, "-m", "sim_bridge"),
                *("--connect", target, "--truth", str(truth_file)),
                *_emulator_options(options),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        try:
            truth = _wait_for_truth(emulator, truth_file)
            writer = JsonLines(options.json)
            session = LiveSession(
                link,
                airframe,
                LiveOptions(rate=options.rate),
                record_to=Path(options.record) if options.record else None,
                sender_gone=lambda: emulator.poll() is not None,
                on_result=writer.write,
            )
            return follow(
                session,
                writer,
                truth,
                headless=options.headless,
                late_truth=lambda: output.read_truth(str(truth_file)),
            )
        finally:
            link.close()
            emulator.terminate()
            emulator.communicate()


def _emulator_options(options: argparse.Namespace) -> list[str]:
    given = {
        "--airframe": options.airframe,
        "--arm": options.arm,
        "--mission": options.mission,
        "--noise": options.noise,
        "--sigma": options.sigma,
        "--rate": options.rate,
        "--seed": options.seed,
        "--speed": options.speed,
        "--duration": options.duration,
        "--mass-step": options.mass_step,
    }
    return [word for key, value in given.items() if value is not None for word in (key, str(value))]


def _wait_for_truth(emulator: "subprocess.Popen[bytes]", file: Path) -> dict[str, float]:
    """The emulator writes the truth before it flies; its refusal becomes ours."""
    deadline = time.monotonic() + _TRUTH_WAIT
    while not file.exists():
        if emulator.poll() is not None:
            assert emulator.stderr is not None
            said = emulator.stderr.read().decode(errors="replace").strip().splitlines()
            why = said[-1].removeprefix("sim-bridge: error: ") if said else "no reason given"
            raise GcsSysidError(f"the emulator did not start: {why}")
        if time.monotonic() > deadline:
            raise GcsSysidError("the emulator did not start within 15 s")
        time.sleep(0.02)
    return output.read_truth(str(file))
