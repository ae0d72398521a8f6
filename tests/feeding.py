"""Records given to a chain or a time base as a live session gives them: in pieces."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain as joined
from itertools import islice

from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.records import Record
from gcs_sysid.signals.time_base import Block, TimeBase
from testbed.recordings import block_of

AT_ONCE = 512


def pieces(records: Iterable[Record], at_once: int = AT_ONCE) -> Iterator[RecordBlock]:
    """The records as blocks of so many."""
    left = iter(records)
    while some := list(islice(left, at_once)):
        yield block_of(some)


def feed(chain: Chain, records: Iterable[Record], at_once: int = AT_ONCE) -> None:
    """Give records to a chain."""
    for piece in pieces(records, at_once):
        chain.take(piece)


def grid_of(
    base: TimeBase, records: Sequence[Record], at_once: int = 1, *, finish: bool = True
) -> Iterator[Block]:
    """The blocks that records make, one after the other."""
    taken = joined.from_iterable(
        base.feed_tracks(piece.tracks) for piece in pieces(records, at_once)
    )
    yield from taken
    if finish:
        yield from base.finish()
