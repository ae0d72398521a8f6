"""The program on a pseudo terminal, as a user has it."""

import contextlib
import os
import subprocess
import sys

try:
    import termios
except ImportError:  # Windows
    termios = None

PATIENCE = 60.0
"""s; nothing waits so long where all is well."""
_OWN_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execvp(sys.argv[1], sys.argv[1:])
"""
"""Makes standard input the terminal that the process belongs to, and becomes a command."""


class OnTerminal:
    """A command on a terminal of its own, in a session that ends when the terminal closes.

    Args:
        words: of `gcs-sysid`.
        folder: where it runs.
        command: what runs instead of the program of this interpreter.
    """

    def __init__(self, *words, folder, command=(sys.executable, "-m", "gcs_sysid")):
        self._ours, theirs = os.openpty()
        os.set_blocking(self._ours, False)
        termios.tcsetwinsize(theirs, (24, 80))
        ends = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
        started = [sys.executable, "-c", _OWN_TERMINAL, *command, *words]
        environment = os.environ | {"TERM": "xterm-256color"}
        self.process = subprocess.Popen(
            started, **ends, cwd=folder, env=environment, start_new_session=True
        )
        os.close(theirs)
        self.shown = b""

    def shows(self, text=None):
        """Take what is shown until it has this text, or until the command has ended."""
        for _ in range(round(PATIENCE / 0.05)):
            with contextlib.suppress(OSError):  # nothing more has come, or it is gone
                while True:
                    self.shown += os.read(self._ours, 65536)
            if text is not None and text in self.shown:
                return True
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(0.05)
                return text is None
        return False

    def type(self, keys):
        os.write(self._ours, keys)

    def hang_up(self):
        """Close the terminal's window."""
        os.close(self._ours)
        self._ours = -1

    def end(self):
        """Kill what is left of the command and its children, and close the terminal."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, 9)
        self.process.wait()
        if self._ours >= 0:
            os.close(self._ours)
