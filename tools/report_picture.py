"""Save a picture (PNG) of a report's first screens, as a browser shows them.

    python tools/report_picture.py -o docs/report.png
    python tools/report_picture.py --report flight.html --width 390 --dark -o phone.png

Needs playwright and a Chromium that is installed. Without `--report` the sample flight is analysed.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from gcs_sysid.cli.program import run

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SAMPLE = Path(__file__).resolve().parents[1] / "logs" / "sample.tlog"
_GAP = 18


def capture(report: Path, width: int, most: int, sections: list[str], *, dark: bool) -> bytes:
    """The page as PNG, of its sections only those named."""
    with sync_playwright() as playwright:
        found = next(filter(None, map(shutil.which, _BROWSERS)), None)
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page(
            viewport={"width": width, "height": 900},
            color_scheme="dark" if dark else "light",
        )
        page.goto(report.resolve().as_uri())
        page.evaluate(
            """(shown) => {
              for (const e of document.querySelectorAll("main > *, footer")) {
                if (!shown.includes(e.id)) e.hidden = true;
              }
            }""",
            sections,
        )
        height = page.evaluate("document.querySelector('main').getBoundingClientRect().bottom")
        page.set_viewport_size({"width": width, "height": min(round(height) + _GAP, most)})
        picture = page.screenshot()
        browser.close()
    return picture


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--report", type=Path, help="HTML file (default: of logs/sample.tlog)")
    parser.add_argument("--width", type=int, default=1100, help="pixels (default: %(default)s)")
    parser.add_argument("--height", type=int, default=1000, help="at most (default: %(default)s)")
    parser.add_argument("--dark", action="store_true", help="the dark colors")
    parser.add_argument(
        "--sections", default="verdict,prediction", help="with commas (default: %(default)s)"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="PNG file to write")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        report = options.report
        if report is None:
            report = Path(folder) / "sample.html"
            run(["analyze", str(SAMPLE), "--airframe", "paper", "--report", str(report)])
        picture = capture(
            report, options.width, options.height, options.sections.split(","), dark=options.dark
        )
    options.out.write_bytes(picture)


if __name__ == "__main__":
    main()
