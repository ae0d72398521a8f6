"""Processes of our own, and how many threads they compute in."""

import contextlib
import os
import threading
from collections.abc import Callable
from typing import Any

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables: processes that share a machine do not each take all of it for their linear algebra."""


def compute_in_one_thread() -> None:
    """Have linear algebra take one thread, unless the user says otherwise; before NumPy is loaded.

    Matrices are small here: more threads wait for each other, at twice the processor time.
    """
    if not any(name in os.environ for name in ONE_THREAD):
        os.environ.update(dict.fromkeys(ONE_THREAD, "1"))


def one_thread_environment() -> dict[str, str]:
    """Of a process whose linear algebra takes one thread, but for what the user says."""
    return {**dict.fromkeys(ONE_THREAD, "1"), **os.environ}


def end_after(wait: Callable[[], object]) -> None:
    """Have this process end as soon as a wait is over: for the end of the one that started it."""

    def end() -> None:
        with contextlib.suppress(EOFError, OSError, ValueError):
            wait()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def apart() -> dict[str, Any]:
    """Options of `Popen`: not to be reached by the terminal's signals."""
    if os.name == "nt":
        import subprocess

        return {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
    return {"start_new_session": True}
