"""Processes of our own beside this one."""

import os
import subprocess
from typing import Any

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables: processes that share a machine do not each take all of it for their linear algebra."""


def apart() -> dict[str, Any]:
    """Options of `Popen`: not to be reached by the terminal's signals."""
    if os.name == "nt":
        return {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
    return {"start_new_session": True}
