"""The pages in a real browser: a log to a report, viewers and a pilot, every width, axe-core."""

import base64
import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from gcs_sysid.telemetry.tlog import TlogReader
from tests.blackbox_logs import blackbox_of
from tests.screen import fake

from .conftest import served

pytestmark = pytest.mark.slow

_PATIENCE = 90_000
"""ms; nothing waits so long where all is well."""
WIDTHS = {"phone": (390, 844), "tablet": (820, 1180), "desktop": (1440, 900)}
LEAST_TOUCH = 44
SERIOUS = ("serious", "critical")
AXE = Path(os.environ.get("GCS_SYSID_AXE", "build/node_modules/axe-core/axe.min.js"))
"""From npm, by `make test-web`; without it that part skips."""


class Browser:
    """Pages that note what goes wrong in them, and what they load from elsewhere."""

    def __init__(self, browser):
        self.wrong = []
        self.ended = False
        """Whether the server was ended: who asks it then is told so by the browser, too."""
        self._browser = browser
        self._contexts = []

    def page(self, address, size=WIDTHS["desktop"], **options):
        """A page of somebody else: with cookies of its own."""
        own = address.partition("/?")[0]
        context = self._browser.new_context(
            viewport={"width": size[0], "height": size[1]}, bypass_csp=False, **options
        )
        self._contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(_PATIENCE)
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("console", lambda m: m.type == "error" and self.wrong.append(m.text))
        page.on(
            "request",
            lambda r: r.url.startswith((own, "data:", "blob:")) or self.wrong.append(r.url),
        )
        page.goto(address)
        return page

    def close(self):
        for context in self._contexts:
            context.close()


@pytest.fixture
def web(browser):
    made = Browser(browser)
    yield made
    made.close()
    if made.ended:
        made.wrong = [text for text in made.wrong if "net::ERR_" not in text]
    assert made.wrong == []


def fits(page):
    """No part of the page is wider than the window, and what is touched is large enough."""
    wide, window = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide <= window
    cut = "(e) => e.scrollWidth > e.clientWidth"
    tables = "[...document.querySelectorAll('.scroll')].filter((e) => e.checkVisibility())"
    assert page.evaluate(f"{tables}.filter({cut}).length") == 0
    small = page.evaluate(
        """(least) => [...document.querySelectorAll("button, select, a.button, .button, input")]
        .filter((e) => e.checkVisibility() && !["file", "radio"].includes(e.type))
        .map((e) => [e.id || e.textContent, e.getBoundingClientRect()])
        .filter(([, box]) => box.height < least || box.width < least)
        .map(([name, box]) => `${name} ${box.width} x ${box.height}`)""",
        LEAST_TOUCH,
    )
    assert small == []


def audited(page):
    """No serious finding of axe-core, where it is installed."""
    if AXE.exists():
        # As a debugger does: the page's own policy would not load it.
        page.evaluate(AXE.read_text(encoding="utf-8") + "; undefined")
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        bad = [
            (v["id"], v["nodes"][0]["html"]) for v in found["violations"] if v["impact"] in SERIOUS
        ]
        assert bad == []


# --- a log to its report


def drop(page, path):
    """Drag a file onto the page, as far as a test can."""
    data = path.read_bytes()
    transfer = page.evaluate_handle(
        """([name, bytes]) => { const t = new DataTransfer();
        const data = Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0));
        t.items.add(new File([data], name)); return t; }""",
        [path.name, base64.b64encode(data).decode()],
    )
    page.dispatch_event("#drop", "drop", {"dataTransfer": transfer})


def test_a_dropped_log_becomes_a_report_in_two_clicks(web, bench, fly):
    words = ("--airframe", "px4-quad-x", "--mission", "all-axes", "--duration", "10")
    flight = fly(*words, "--rate", "50", "--seed", "3")
    _, _, site = bench
    page = web.page(site.access.address("pilot"), WIDTHS["phone"])
    assert "token" not in page.url
    drop(page, flight.tlog)
    page.locator("#setup").wait_for()
    assert "4 rotors by CA_ROTORn" in page.inner_text("#log-words")
    page.fill("#scale", "1.5")
    page.click("#identify")  # the first click
    page.locator("#result").wait_for()
    assert "identified" in page.inner_text("#verdict").lower()
    rows = page.locator("#parameters tr").all_inner_texts()
    assert any(row.startswith("Ixx") and "± " in row for row in rows)
    report = page.frame_locator("#report")
    report.locator("h1").wait_for()
    assert "flight.tlog" in report.locator("h1").inner_text()
    for size in WIDTHS.values():
        page.set_viewport_size({"width": size[0], "height": size[1]})
        fits(page)
    audited(page)
    with page.expect_popup() as opened:
        page.click("text=Open the report")  # the second: on a page of its own
    opened.value.locator("svg").first.wait_for()
    # The rotors drawn by hand begin with those shown.
    page.click("text=Draw it")
    assert page.locator("#rotor-rows tr").count() == 4
    page.locator("#picture [role=button]").first.press("Enter")
    assert page.locator("#rotor-rows select").first.input_value() == "cw"
    page.locator("#picture svg").click(position={"x": 20, "y": 60})
    assert page.locator("#rotor-rows tr").count() == 5
    page.click("text=Remove last")
    assert page.locator("#rotor-rows tr").count() == 4


def test_a_layout_that_no_log_gives_is_the_users_choice(web, bench, paper_flight, tmp_path):
    _, _, site = bench
    page = web.page(site.access.address("pilot"))
    drop(page, paper_flight.tlog)
    page.locator("#setup").wait_for()
    assert page.input_value("#builtin") == ""
    page.fill("#scale", "1.5")
    page.click("#identify")
    assert page.inner_text("#problem") == "choose a layout first"
    audited(page)
    drop(page, blackbox_of(tmp_path, motors=4))
    page.locator("#about-log", has_text="log.bbl").wait_for()
    assert page.input_value("#builtin") == "betaflight-quad-x"
    assert page.locator("#picture svg text.spin").count() == 4


def test_what_is_wrong_is_said_in_a_line(web, bench, tmp_path):
    _, _, site = bench
    page = web.page(site.access.address("pilot"))
    fits(page)
    wrong = tmp_path / "holiday.jpg"
    wrong.write_bytes(b"\xff\xd8\xff")
    drop(page, wrong)
    page.locator("#problem").wait_for()
    assert "drop a .tlog" in page.inner_text("#problem")
    audited(page)
    # A browser says of every refusal that it was one.
    web.wrong = [text for text in web.wrong if "status of 400" not in text]


# --- a session


@pytest.fixture
def live(page, source):
    source.snapshot = replace(source.snapshot, advice=fake.advice())
    with served(page) as site:
        yield site


def test_two_viewers_and_a_pilot(web, live, source):
    viewers = [web.page(live.access.address("viewer"), WIDTHS["phone"]) for _ in range(2)]
    pilot = web.page(live.access.address("pilot"), WIDTHS["tablet"])
    for page in (*viewers, pilot):
        page.locator("#row-Ixx").wait_for()
        assert "16.553 ± 0.081" in page.inner_text("#row-Ixx")
        assert "▶ FLY" in page.inner_text("#coach")
    for page in viewers:
        assert page.locator("[data-act]:visible, form:visible").count() == 0
        assert "View only" in page.inner_text("#role")
        # What a viewer's page does not show it cannot do, either.
        said = page.evaluate(
            """async () => (await fetch("/live/action",
            {method: "POST", body: JSON.stringify({action: "reset"})})).status"""
        )
        assert said == 403
    assert source.calls == []
    pilot.click("text=Mark this moment")
    for page in (*viewers, pilot):
        page.locator("#events", has_text="mark from the page").wait_for()
    pilot.click("text=Reset the estimate")
    pilot.click("#no")
    assert source.calls == ["mark 'mark from the page'"]
    pilot.click("text=Reset the estimate")
    pilot.click("#yes")
    pilot.wait_for_function("() => document.getElementById('sure').open === false")
    pilot.wait_for_timeout(200)
    assert source.calls == ["mark 'mark from the page'", "reset"]
    live.stop()
    for page in viewers:
        page.locator("#notice", has_text="has ended").wait_for()
    web.ended = True
    web.wrong = [text for text in web.wrong if "status of 403" not in text]


def test_every_width_and_theme_of_the_live_page(web, live):
    page = web.page(live.access.address("pilot"))
    page.locator("#row-Ixx").wait_for()
    page.locator("#plot svg").wait_for()
    for size in WIDTHS.values():
        page.set_viewport_size({"width": size[0], "height": size[1]})
        for theme in ("light", "dark", "sun"):
            page.select_option("#theme", theme)
            fits(page)
    for theme in ("light", "dark", "sun"):
        page.select_option("#theme", theme)
        audited(page)
    assert page.locator("main, header, footer").count() == 3


def test_the_page_by_keyboard(web, live):
    page = web.page(live.access.address("pilot"))
    page.locator("#row-cg_x").wait_for()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    page.locator("#row-cg_x button").focus()
    page.keyboard.press("Enter")
    page.locator("#plot-text", has_text="cg_x").wait_for()
    page.wait_for_timeout(600)  # further snapshots leave the focus where it is
    assert page.evaluate("document.activeElement.textContent") == "cg_x"


def test_call_outs_are_spoken(web, live, source):
    page = web.page(live.access.address("viewer"))
    page.evaluate(
        """() => { window.spoken = [];
        const value = { cancel() {}, speak: (u) => spoken.push(u.text) };
        Object.defineProperty(window, "speechSynthesis", { value }); }"""
    )
    page.locator("#coach").wait_for()
    page.click("#speak")
    advice = replace(fake.advice(), axes=("yaw ±30° 0.5 Hz",), seconds=8.0)
    source.snapshot = replace(source.snapshot, advice=advice)
    page.wait_for_function(
        "() => spoken.some((t) => t.startsWith('Fly yaw plus or minus 30 degrees'))"
    )
    assert page.evaluate("spoken.filter((t) => t.startsWith('Fly yaw')).length") == 1


# --- the commands


class TcpVehicle:
    """Sends a recorded flight at once to whoever connects, counts them, and stays on the line."""

    def __init__(self, frames):
        self.connections = 0
        self._data = b"".join(frame.raw for frame in frames)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp:127.0.0.1:{self._listener.getsockname()[1]}"
        self._held = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        with contextlib.suppress(OSError):
            while True:
                link, _ = self._listener.accept()
                self.connections += 1
                self._held.append(link)
                link.sendall(self._data)

    def close(self):
        for link in (*self._held, self._listener):
            link.close()


class Command:
    """A command that serves a page, as a process."""

    def __init__(self, *words, folder):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gcs_sysid", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            # Ctrl-C is for this process alone.
            start_new_session=True,
        )
        lines = [self.process.stderr.readline() for _ in range(2)]
        found = re.fullmatch(r"open (\S+) in a browser \(Ctrl-C ends\)\n", lines[0])
        assert found, lines[0] + self.process.stderr.read()
        self.pilot = found[1]
        self.viewer = lines[1].split()[-1]

    def end(self):
        """Ctrl-C; status and what was printed."""
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err

    def kill(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


@pytest.fixture
def command(tmp_path):
    started = []

    def command(*words):
        started.append(Command(*words, folder=tmp_path))
        return started[-1]

    yield command
    for one in started:
        one.kill()


@pytest.mark.skipif(sys.platform == "win32", reason="sends the signal of Ctrl-C")
@pytest.mark.thorough
def test_live_with_a_page(web, command, fly):
    flight = fly("--mission", "all-axes", "--rate", "50", "--duration", "15", "--seed", "5")
    vehicle = TcpVehicle(frame for _, frame in TlogReader(flight.tlog))
    try:
        run = command("live", vehicle.url, "--airframe", "paper", "--no-record", "--web", "0")
        page = web.page(run.pilot, WIDTHS["phone"])
        page.locator("#row-Ixx", has_text="±").wait_for()
        viewer = web.page(run.viewer)
        viewer.locator("#row-Ixx", has_text="±").wait_for()
        page.click("text=Mark this moment")
        viewer.locator("#events", has_text="mark from the page").wait_for()
        assert vehicle.connections == 1
        status, out, err = run.end()
        viewer.locator("#notice", has_text="ended").wait_for()
    finally:
        vehicle.close()
    assert "Traceback" not in err
    assert "mark from the page" in err
    assert "parameter" in out
    assert status == 0
    web.ended = True


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="sends the signal of Ctrl-C")
def test_a_replay_is_moved_on_the_page(web, command, fly):
    flight = fly("--mission", "all-axes", "--rate", "100", "--duration", "20", "--seed", "5")
    run = command("replay", str(flight.tlog), "--airframe", "paper", "--web", "0")
    page, viewer = web.page(run.pilot), web.page(run.viewer)
    page.locator("#playing", has_text="▶ 1x").wait_for()
    page.locator("#seek").evaluate(
        "e => { e.value = e.max; e.dispatchEvent(new Event('change')); }"
    )
    for one in (page, viewer):
        one.locator("#playing", has_text="end").wait_for()
    assert viewer.locator("#transport button:visible").count() == 0
    status, out, err = run.end()
    assert (status, "Traceback" in err) == (0, False)
    assert "identified" in out
    web.ended = True
