"""Objects full of arrays from one process to another, through a pipe.

Arrays go as they lie in memory, outside the pickle, and are arrays of their own on the other side:
a part that is kept there keeps no other one's memory.
"""

import contextlib
import pickle
import struct
import threading
from collections import deque
from io import BufferedReader
from typing import Any, BinaryIO

import numpy as np

_HEAD = struct.Struct("<QQ")
"""Bytes of the pickle; number of arrays."""
_SIZE = struct.Struct("<Q")


class ObjectSender:
    """Hands objects over as fast as the other side takes them, in a thread of its own.

    Args:
        pipe: to the other process.
    """

    def __init__(self, pipe: BinaryIO) -> None:
        self._pipe = pipe
        self._wake = threading.Condition()
        self._waiting: deque[list[Any]] = deque()
        self._closing = self._broken = False
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def put(self, what: object) -> None:
        """Hand over an object as it is now; its arrays must not change any more.

        Raises:
            BrokenPipeError: nothing can be handed over any more.
        """
        parts = _packed(what)
        with self._wake:
            if self._broken:
                raise BrokenPipeError
            self._waiting.append(parts)
            self._wake.notify_all()

    def wait(self, most: int) -> None:
        """Wait until no more than so many objects are left to hand over."""
        with self._wake:
            self._wake.wait_for(lambda: len(self._waiting) <= most)

    def close(self) -> None:
        """Wait until all is handed over."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        try:
            while self._send_next():
                pass
        except (OSError, MemoryError):
            with self._wake:
                self._broken = True
                self._waiting.clear()
                self._wake.notify_all()
            with contextlib.suppress(OSError):
                self._pipe.close()  # the other side learns of it

    def _send_next(self) -> bool:
        with self._wake:
            self._wake.wait_for(lambda: self._waiting or self._closing)
            if not self._waiting:
                return False
            parts = self._waiting[0]
        # At once: part by part, each would wait for the interpreter.
        self._pipe.write(b"".join(parts))
        self._pipe.flush()
        with self._wake:
            self._waiting.popleft()
            self._wake.notify_all()
        return True


def _packed(what: object) -> list[Any]:
    """The bytes of an object, arrays as views of their own memory."""
    arrays: list[pickle.PickleBuffer] = []
    content = pickle.dumps(what, protocol=5, buffer_callback=arrays.append)
    views = [array.raw() for array in arrays]
    sizes = b"".join(_SIZE.pack(view.nbytes) for view in views)
    return [_HEAD.pack(len(content), len(views)), sizes, content, *views]


def read_object(pipe: BufferedReader) -> Any:
    """The next object that the other side hands over.

    Raises:
        EOFError: the other side has ended.
    """
    size, count = _HEAD.unpack(_filled(pipe, _HEAD.size))
    sizes = [size for (size,) in _SIZE.iter_unpack(_filled(pipe, _SIZE.size * count))]
    content = _filled(pipe, size)
    return pickle.loads(content, buffers=[_filled(pipe, size) for size in sizes])


def _filled(pipe: BufferedReader, size: int) -> memoryview:
    content = np.empty(size, np.uint8).data
    if pipe.readinto(content) < size:
        raise EOFError("the other side has ended")
    return content
