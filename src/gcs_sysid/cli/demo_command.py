"""`gcs-sysid demo`: fly the bundled emulator and identify it."""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TextIO

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.followed_session import (
    baseline_of,
    coach_options,
    follow,
    load_screen,
    refit_interval,
)
from gcs_sysid.cli.output import JsonLines
from gcs_sysid.errors import GcsSysidError
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.receiver_process import ReceiverProcess
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.link import TcpLink
from gcs_sysid.telemetry.urls import LinkUrl


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    _default_mass(options)
    airframe = airframe_choice.airframe_of(options)
    baseline = baseline_of(options)
    record_to = Path(options.record) if options.record else None
    load_screen(options)
    # At full speed TCP holds the emulator back, as far as the session does not read ahead.
    source: ReceiverProcess | TcpLink
    if options.speed == "max":
        source = TcpLink(LinkUrl("tcpin", "tcpin:127.0.0.1", host="127.0.0.1", port=0))
        target = f"tcp:127.0.0.1:{source.port}"
    else:
        url = LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0)
        source = ReceiverProcess(url, record_to=record_to)
        target = f"udpout:127.0.0.1:{source.url.port}"
    with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as folder:
        truth_file = Path(folder) / "truth.json"
        said = (Path(folder) / "said.txt").open("w+", encoding="utf-8", errors="replace")
        emulator = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "sim_bridge"),
                *("--connect", target, "--truth", str(truth_file), "--until-stdin-closes"),
                *_emulator_options(options),
            ],
            # However this process ends, the pipe closes and the emulator with it.
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=said,
        )
        try:
            truth = _wait_for_truth(emulator, truth_file, said)
            writer = JsonLines(options.json, force=options.force)
            session = LiveSession(
                source,
                airframe,
                LiveOptions(
                    rate=options.rate,
                    refit_interval=refit_interval(options),
                    coach=coach_options(options),
                    predict=not options.web,
                ),
                record_to=record_to,
                sender_gone=lambda: emulator.poll() is not None,
                on_result=writer.write,
            )
            return follow(
                session,
                writer,
                truth,
                options,
                baseline,
                late_truth=lambda: output.read_truth(str(truth_file)),
            )
        finally:
            source.close()
            emulator.terminate()
            emulator.communicate()
            said.close()


def _default_mass(options: argparse.Namespace) -> None:
    """Where nothing sets the scale, weigh the emulated vehicle as a user would weigh a real one."""
    if airframe_choice.given_scale(options) is not None:
        return
    if load_airframe(options.airframe).anchor() is None:
        with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as folder:
            log, truth = Path(folder) / "weigh.tlog", Path(folder) / "truth.json"
            command = [sys.executable, "-P", "-m", "sim_bridge", "--duration", "0.1"]
            command += ["--airframe", options.airframe, "--tlog", str(log), "--truth", str(truth)]
            if options.arm is not None:
                command += ["--arm", str(options.arm)]
            done = subprocess.run(command, capture_output=True, check=False)
            if done.returncode == 0:
                options.mass = output.read_truth(str(truth))["mass"]
                output.say(f"weighed: {options.mass:g} kg")


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


def _wait_for_truth(
    emulator: "subprocess.Popen[bytes]", file: Path, said: TextIO
) -> dict[str, float]:
    """The emulator writes the truth before it flies; its refusal becomes ours."""
    within = 15.0  # s
    deadline = time.monotonic() + within
    while not file.exists():
        if emulator.poll() is not None:
            said.seek(0)
            lines = said.read().strip().splitlines()
            why = lines[-1].removeprefix("sim-bridge: error: ") if lines else "no reason given"
            raise GcsSysidError(f"the emulator did not start: {why}")
        if time.monotonic() > deadline:
            raise GcsSysidError(f"the emulator did not start within {within:g} s")
        time.sleep(0.02)
    return output.read_truth(str(file))
