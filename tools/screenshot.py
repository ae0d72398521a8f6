r"""Save a picture (SVG) of the live screen, drawn without a terminal.

    python tools/screenshot.py --factory tests/screen/fake.py:source \
        --truth tests/screen/fake.py:TRUTH --size 120x40 --keys j,j -o docs/screen.svg
    python tools/screenshot.py --pickle snapshot.pickle -o docs/screen.svg
    python tools/screenshot.py --demo -o docs/screen.svg

A factory is `FILE.py:NAME`, NAME being a function that returns a `SnapshotSource`. A pickle holds
one `Snapshot`; open only pickles of your own making.
"""

import argparse
import asyncio
import importlib.util
import pickle
import queue
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gcs_sysid.cli.output import read_truth
from gcs_sysid.live.flight_coach import CoachOptions
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Snapshot
from gcs_sysid.screen import Scene, SnapshotSource, SysidApp
from gcs_sysid.telemetry.link import TcpLink
from gcs_sysid.telemetry.urls import LinkUrl


class Still:
    """A source that serves one snapshot for ever."""

    def __init__(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot

    def latest(self) -> Snapshot | None:
        """The snapshot."""
        return self.snapshot

    def stop(self) -> None:
        """Nothing to stop."""


def without_remote_fonts(svg: str) -> str:
    """Drop the font faces, which Textual's export loads from a CDN, and name local fonts."""
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r"@font-face\s*\{.*?\}\s*", "", svg, flags=re.DOTALL)
    return svg.replace("Fira Code", "DejaVu Sans Mono, Menlo, Consolas")


async def capture(
    source: SnapshotSource,
    truth: Mapping[str, float] | None = None,
    size: tuple[int, int] = (120, 40),
    light: bool = False,
    keys: Sequence[str] = (),
) -> str:
    """The screen as SVG text, after some keys."""
    app = SysidApp(source, Scene(truth or {}))
    async with app.run_test(size=size) as pilot:
        if light:
            app.action_toggle_dark()
        await pilot.press(*keys)
        await pilot.pause()
        return without_remote_fonts(app.export_screenshot(title=app.title))


def demo_source() -> tuple[Still, dict[str, float]]:
    """A snapshot 40 s into the demo flight, with the emulator's truth.

    Over TCP, which holds the emulator back: a busy machine draws the same picture.
    """
    link = TcpLink(LinkUrl("tcpin", "tcpin:127.0.0.1", host="127.0.0.1", port=0))
    with tempfile.TemporaryDirectory() as folder:
        truth = Path(folder) / "truth.json"
        flight = ["--airframe", "paper", "--mission", "all-axes", "--noise", "mems", "--seed", "1"]
        emulator = subprocess.Popen(
            [
                *(sys.executable, "-m", "sim_bridge", *flight),
                *("--connect", f"tcp:127.0.0.1:{link.port}", "--truth", str(truth)),
                *("--speed", "max"),
            ]
        )
        taken: queue.Queue[Snapshot] = queue.Queue()

        def take(_result: Result) -> None:
            snapshot = session.latest()
            if snapshot is not None and snapshot.t > 40.0:
                taken.put(snapshot)

        options = LiveOptions(coach=CoachOptions())
        session = LiveSession(link, load_airframe("paper"), options, on_result=take)
        session.start()
        snapshot = taken.get(timeout=900.0)
        session.stop()
        emulator.terminate()
        emulator.wait()
        # At full speed the vehicle's clock has nothing to be held against.
        snapshot = replace(snapshot, link=replace(snapshot.link, clock_ppm=None))
        return Still(snapshot), read_truth(str(truth))


def load(spec: str) -> Any:
    """The object that `FILE.py:NAME` names."""
    path, _, name = spec.rpartition(":")
    module_spec = importlib.util.spec_from_file_location("screenshot_source", path)
    if module_spec is None or module_spec.loader is None:
        raise SystemExit(f"cannot load {path}")
    module = importlib.util.module_from_spec(module_spec)
    sys.modules["screenshot_source"] = module
    module_spec.loader.exec_module(module)
    return getattr(module, name)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--factory", help="FILE.py:NAME, a function that returns a source")
    what.add_argument("--demo", action="store_true", help="fly the emulator for it")
    what.add_argument("--pickle", type=Path, help="file with one pickled Snapshot")
    parser.add_argument("--truth", help="FILE.py:NAME, a mapping of true values")
    parser.add_argument("--size", default="120x40", help="columns x rows (default: %(default)s)")
    parser.add_argument("--light", action="store_true", help="the light theme")
    parser.add_argument("--keys", default="", help="keys to press first, with commas between")
    parser.add_argument("-o", "--out", type=Path, required=True, help="SVG file to write")
    options = parser.parse_args()
    truth = load(options.truth) if options.truth else None
    source: SnapshotSource
    if options.demo:
        source, truth = demo_source()
    elif options.pickle is not None:
        source = Still(pickle.loads(options.pickle.read_bytes()))
    else:
        source = load(options.factory)()
    columns, _, rows = options.size.partition("x")
    keys = [key for key in options.keys.split(",") if key]
    svg = asyncio.run(capture(source, truth, (int(columns), int(rows)), options.light, keys))
    options.out.write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    main()
