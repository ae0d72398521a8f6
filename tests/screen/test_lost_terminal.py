"""A terminal that closes under the screen."""

import os
import sys
import threading

import pytest

pytest.importorskip("termios")
writer_thread = pytest.importorskip("textual.drivers._writer_thread")

from gcs_sysid.screen.app import SysidApp, TerminalOutput  # noqa: E402

from .fake import FakeSource  # noqa: E402


def test_a_screen_on_a_closed_terminal_ends():
    """Textual's writer takes all that comes, and ends when it is asked to."""
    ours, theirs = os.openpty()
    terminal = os.fdopen(theirs, "w", buffering=1)
    writer = writer_thread.WriterThread(TerminalOutput(terminal))
    writer.start()
    os.close(ours)

    def leave():
        for _ in range(2 * writer_thread.MAX_QUEUED_WRITES):
            writer.write("last words\n")
        writer.stop()

    leaving = threading.Thread(target=leave, daemon=True)
    leaving.start()
    leaving.join(60.0)
    assert not leaving.is_alive()
    assert not writer.is_alive()


def test_the_screen_writes_so():
    class OnTerminal:
        _file = sys.__stderr__

        def __init__(self, *_args, **_settings):
            pass

    app = SysidApp(FakeSource(None))
    app.driver_class = OnTerminal
    assert isinstance(app._build_driver(False, False, False, None)._file, TerminalOutput)
