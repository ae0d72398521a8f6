"""`--web` in a real browser: as many as look, one link."""

import contextlib
import re
import signal
import socket
import subprocess
import sys
import threading

import pytest

from gcs_sysid.telemetry.tlog import read_tlog

pytestmark = pytest.mark.slow

_PATIENCE = 60_000
"""ms; nothing waits so long where all is well."""
_ESCAPES = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)|.)")


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


class Served:
    """A command with `--web`, as a process."""

    def __init__(self, *words, folder):
        command = [sys.executable, "-m", "gcs_sysid", *words, "--web", "0"]
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            # Ctrl-C is for this process alone.
            start_new_session=True,
        )
        line = self.process.stderr.readline()
        found = re.fullmatch(r"open (http://127\.0\.0\.1:\d+) in a browser \(Ctrl-C ends\)\n", line)
        assert found, line + self.process.stderr.read()
        self.url = found[1]

    def end(self):
        """Ctrl-C; status and what was printed."""
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err

    def kill(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


class Page:
    """A page, and what its terminal was sent."""

    def __init__(self, browser, url, wrong):
        self.received = ""
        self.page = browser.new_page(viewport={"width": 1500, "height": 900})
        self.page.on("websocket", self._listen)
        self.page.on("pageerror", lambda error: wrong.append(str(error)))
        self.page.on(
            "request",
            lambda request: request.url.startswith((url, "data:")) or wrong.append(request.url),
        )
        self.page.goto(url)

    def _listen(self, websocket):
        websocket.on("framereceived", self._take)

    def _take(self, data):
        if isinstance(data, bytes):
            self.received += _ESCAPES.sub("", data.decode("utf-8", "replace"))

    def press(self, key):
        self.page.bring_to_front()
        self.page.keyboard.press(key)

    def sees(self, text):
        """Wait until a text has come."""
        for _ in range(_PATIENCE // 100):
            if text in self.received:
                return True
            self.page.wait_for_timeout(100)
        return False


@pytest.fixture(scope="module")
def flight(fly):
    return fly("--mission", "all-axes", "--rate", "100", "--duration", "20", "--seed", "5")


@pytest.fixture
def serve(tmp_path):
    served = []

    def serve(*words):
        served.append(Served(*words, folder=tmp_path))
        return served[-1]

    yield serve
    for one in served:
        one.kill()


@pytest.mark.skipif(sys.platform == "win32", reason="sends the signal of Ctrl-C")
def test_two_look_and_there_is_one_link(browser, flight, serve):
    vehicle = TcpVehicle(frame for _, frame in read_tlog(flight.tlog))
    wrong = []
    try:
        served = serve("live", vehicle.url, "--airframe", "paper", "--no-record")
        first, second = (Page(browser, served.url, wrong) for _ in range(2))
        for page in (first, second):
            assert page.sees("Ixx")
            assert page.sees("identified")
        first.press("m")
        assert first.sees("Marked: mark 1")
        assert second.sees("mark 1")
        assert vehicle.connections == 1
        # One that leaves ends nothing.
        first.press("q")
        first.page.get_by_text("This view is closed").wait_for(timeout=_PATIENCE)
        second.press("r")
        assert second.sees("estimate reset")  # the event; the answer may pass unseen
        assert vehicle.connections == 1
        status, out, err = served.end()
        second.page.get_by_text("This view is closed").wait_for(timeout=_PATIENCE)
    finally:
        vehicle.close()
    assert wrong == []
    assert "Traceback" not in err
    assert "mark 1" in err
    assert "parameter" in out
    assert status in (0, 1)  # it was reset at the end of the flight


@pytest.mark.skipif(sys.platform == "win32", reason="sends the signal of Ctrl-C")
def test_a_replay_is_moved_by_whoever_looks(browser, flight, serve):
    wrong = []
    served = serve("replay", str(flight.tlog), "--airframe", "paper")
    first, second = (Page(browser, served.url, wrong) for _ in range(2))
    for page in (first, second):
        assert page.sees("▶ 1x")
    first.press("End")
    for page in (first, second):
        assert page.sees("■ end")
    second.press("r")
    assert second.sees("Reset: not in a replay.")
    status, out, err = served.end()
    assert wrong == []
    assert status == 0
    assert "Traceback" not in err
    assert "identified" in out
