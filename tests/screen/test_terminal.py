"""The screen's driver on a terminal that is closed under it."""

import errno
import io
import sys
import threading

import pytest
from textual.drivers._writer_thread import MAX_QUEUED_WRITES, WriterThread

from gcs_sysid.screen.terminal import HangingUpFile, ending_with_its_terminal

linux_driver = pytest.importorskip("textual.drivers.linux_driver")


class HungUp(io.StringIO):
    """A terminal that takes some writes and is then gone."""

    def __init__(self, takes):
        super().__init__()
        self.takes = takes

    def write(self, text):
        if not self.takes:
            raise OSError(errno.EIO, "Input/output error")
        self.takes -= 1
        return super().write(text)

    def flush(self):
        if not self.takes:
            raise OSError(errno.EIO, "Input/output error")


def test_a_lost_terminal_discards_output_and_what_came_before_stays():
    terminal = HungUp(takes=2)
    file = HangingUpFile(terminal)
    for text in ("a", "b", "c", "d"):
        assert file.write(text) == 1
        file.flush()
    assert terminal.getvalue() == "ab"
    assert file.gone


def test_the_writer_of_a_lost_terminal_ends_however_much_is_queued():
    writer = WriterThread(HangingUpFile(HungUp(takes=1)))
    writer.start()

    def end():
        for _ in range(3 * MAX_QUEUED_WRITES):
            writer.write("x")
        writer.stop()

    ending = threading.Thread(target=end, daemon=True)
    ending.start()
    ending.join(10.0)
    assert not ending.is_alive()


def test_messages_that_go_to_a_file_take_no_picture_with_them(monkeypatch):
    plain = type("Driver", (), {"_file": io.StringIO()})
    monkeypatch.setattr(sys, "__stdout__", shown := HungUp(takes=1))
    shown.isatty = lambda: True
    ending_with_its_terminal(plain)()._file.write("picture")
    assert shown.getvalue() == "picture"
