"""The process that reads a long log for an analysis and assesses the hover in it.

    python -m gcs_sysid.health.reader_main

is started by `reader_process.ReaderProcess`, which pickles the task into its standard input: the
path and the vehicle wanted, as of `open_log`, and the pickled arguments of `HoverRecords.health`.
From it come the parts of a `RelayedLog`, then the health; an `InputError` in place of all after it.
However else it ends, nothing more comes. It ends when its input closes, because the other process
has ended in whatever way.
"""

import os
import pickle
import signal
import sys
import threading

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.log_relay import ObjectSender, relayed
from gcs_sysid.telemetry.logs import Log, open_log

MOST_WAITING = 4
"""Blocks under way that are not kept for the assessment."""
_TURN = 5e-4
"""s after which a thread that computes lets the one that sends have its turn."""


def main() -> None:
    """Read, hand over, assess."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.setswitchinterval(_TURN)
    path, wanted, hover = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_input, daemon=True).start()
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed is not for the pipe
    sender = ObjectSender(pipe)
    try:
        sender.put(_health(open_log(path, wanted), sender, hover))
    except InputError as error:
        sender.put(error)
    sender.close()


def _health(log: Log, sender: ObjectSender, hover: bytes) -> object:
    blocks = relayed(log, sender)
    first = next(blocks, None)
    from gcs_sysid.health.assessment import HoverRecords  # the first block is under way meanwhile

    keeper = HoverRecords()
    keeper.begin(log)
    if first is not None:
        keeper.add_records(first)
        del first
    for block in blocks:
        keeper.add_records(block)
        if keeper.full:
            sender.wait(MOST_WAITING)
    return keeper.health(*pickle.loads(hover))


def _end_with_input() -> None:
    while os.read(0, 4096):
        pass
    os._exit(1)


if __name__ == "__main__":
    main()
