"""A new user's path, timed: a fresh clone, the installation, a log of their own, its report.

    python -m benchmarks.new_user [LOG --mass KG]

Clones this repository, installs the clone in a virtual environment of its own, starts `gcs-sysid
web` and does in a Chromium what a user does: choose the log, enter the mass, Identify, open the
report. Without a LOG the installed emulator flies one, which holds the vehicle's parameters. Prints
for each step its seconds, their sum, and the processor time of what had ended by then: on a busy
machine the last says more. Packages come from pip's cache or index. Needs the group `dev`.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from testbed.study import arguments

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 600_000
"""ms, which a step in the browser may take."""


class Watch:
    """Prints what each step took, and the sum."""

    def __init__(self) -> None:
        self._start = self._last = time.monotonic()

    def step(self, name: str) -> None:
        """Print a step that has ended."""
        now = time.monotonic()
        cpu = sum(os.times()[:4])
        print(
            f"{name:<26} {now - self._last:6.1f} s {now - self._start:8.1f} s {cpu:8.1f} s",
            flush=True,
        )
        self._last = now


def installed(folder: Path, watch: Watch) -> Path:
    """The folder of programs of a fresh clone's environment."""
    clone, environment = folder / "gcs-sysid", folder / "venv"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    watch.step("clone")
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    programs = environment / ("Scripts" if sys.platform == "win32" else "bin")
    pip = [str(programs / "python"), "-m", "pip", "install", "--quiet"]
    pip += ["--disable-pip-version-check", "--constraint", str(clone / "constraints.txt")]
    subprocess.run([*pip, str(clone)], check=True)
    watch.step("install")
    return programs


def in_browser(address: str, log: Path, mass: str, watch: Watch) -> str:
    """From the log to the report; the verdict."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
    found = next(filter(None, map(shutil.which, names)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(address)
        watch.step("page open")
        page.set_input_files("#file", log)
        page.locator("#setup").wait_for()
        page.fill("#scale", mass)
        watch.step("log read, mass entered")
        page.click("#identify")
        page.locator("#result").wait_for()
        with page.expect_popup() as opened:
            page.click("text=Open the report")
        opened.value.locator("svg").first.wait_for()
        watch.step("identified, report open")
        verdict = page.inner_text("#verdict")
        browser.close()
    return " ".join(verdict.split())


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("log", nargs="?", type=Path, help="default: a flight of the emulator")
    parser.add_argument("--mass", default="1.5", metavar="KG")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, watch = Path(name), Watch()
        programs = installed(folder, watch)
        log = options.log
        if log is None:
            log = folder / "own.tlog"
            flight = ["--airframe", "px4-quad-x", "--mission", "all-axes", "--trap", "parameters"]
            files = ["--speed", "max", "--tlog", str(log), "--truth", str(folder / "truth.json")]
            subprocess.run([str(programs / "sim-bridge"), *flight, *files], check=True)
            watch.step("fly")
        serving = subprocess.Popen(
            [str(programs / "gcs-sysid"), "web", "0"], stderr=subprocess.PIPE, text=True, cwd=folder
        )
        try:
            assert serving.stderr is not None
            address = re.search(r"http\S+", serving.stderr.readline())
            assert address is not None
            watch.step("gcs-sysid web")
            print(in_browser(address[0], log.resolve(), options.mass, watch))
        finally:
            serving.terminate()
            serving.wait()


if __name__ == "__main__":
    main()
