"""A link that comes back: opened again after the other side hung up or the cable was pulled."""

import time
from collections.abc import Callable

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.link import Address, Chunk, Link, open_link
from gcs_sysid.telemetry.urls import LinkUrl

FIRST_PAUSE = 0.5
"""s before the first attempt to open it again; doubled after each one that failed."""
LONGEST_PAUSE = 5.0
PATIENCE = 1.0
"""s that an attempt may take: nothing else happens meanwhile."""


class PersistentLink(Link):
    """Wraps a link and reopens it when it has ended. It never ends itself.

    UDP needs nothing of this: its socket outlives any silence.

    Args:
        link: open.
        reopen: opens the link again, or raises `LinkError`.
        clock: any steady clock, s.
        sleep: waits for s.
    """

    def __init__(
        self,
        link: Link,
        reopen: Callable[[LinkUrl], Link] = lambda url: open_link(url, PATIENCE),
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(link.url)
        self.datagrams = link.datagrams
        self._link = link
        self._reopen = reopen
        self._clock = clock
        self._sleep = sleep
        self._breaks_before = 0
        self._unsent_while_down = 0
        self._pause = FIRST_PAUSE
        self._next_try = 0.0

    @property
    def open(self) -> bool:
        """Whether the link is there at present."""
        return not self._link.ended

    def receive(self, timeout: float) -> list[Chunk]:
        """What has arrived; while the link is gone, tries to open it when that is due."""
        if self._link.ended:
            self._try(timeout)
            return []
        chunks = self._link.receive(timeout)
        self.breaks = self._breaks_before + self._link.breaks
        self.floods = self._link.floods
        self._count_unsent()
        if self._link.ended:
            self._link.close()
            self._pause = FIRST_PAUSE
            self._next_try = self._clock() + self._pause
        elif chunks:
            self._pause = FIRST_PAUSE
        return chunks

    def _try(self, timeout: float) -> None:
        if self._clock() < self._next_try:
            self._sleep(max(0.0, min(timeout, self._next_try - self._clock())))
            return
        try:
            link = self._reopen(self.url)
        except LinkError:
            self._pause = min(2.0 * self._pause, LONGEST_PAUSE)
            self._next_try = self._clock() + self._pause
            return
        self._breaks_before += self._link.breaks
        self._unsent_while_down += self._link.unsent
        self._link = link

    def send(self, data: bytes) -> None:
        """Send where the link is there."""
        if self._link.ended:
            self._unsent_while_down += 1
        else:
            self._link.send(data)
        self._count_unsent()

    def _count_unsent(self) -> None:
        self.unsent = self._unsent_while_down + self._link.unsent

    def answer_to(self, source: Address | None) -> None:
        """As the link does."""
        self._link.answer_to(source)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()
