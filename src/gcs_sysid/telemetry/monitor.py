"""Health of the telemetry: what comes, how often, and what does not.

Everything is counted by the vehicle's clock, so that a live session and the analysis of its
recording show the same figures.

Missing samples show by the vehicle's own stamps. Sequence numbers count modulo 256, so that a
burst of any length looks like a short one, and they do not show what the autopilot never sent: PX4
skips 0.4 to 2 % of its samples with no packet lost. Stamps show both: steps of several usual
intervals have samples missing in them.
"""

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.frame_block import counts_of
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.messages import NAMED_IDS, OTHER_TYPES, message_name


class Counts(NamedTuple):
    """What came, and what did not."""

    received: int = 0
    missing: int = 0
    longest: float = 0.0
    """s, the longest step with samples missing in it."""
    steps: int = 0
    """Between neighboring samples, gaps apart."""
    seconds: float = 0.0
    """In these steps."""
    gaps: int = 0
    longest_gap: float = 0.0
    """s."""
    latest_gaps: tuple[tuple[float, float], ...] = ()
    """(t, length) in s."""

    @property
    def share(self) -> float:
        """`missing` as a part of what was to come."""
        return self.missing / max(self.received + self.missing, 1)

    def as_dict(self) -> dict[str, Any]:
        """For the result's `telemetry`, where the samples are the IMU's."""
        return {
            "imu_gaps": {
                "count": self.gaps,
                "last": [{"t": t, "length": length} for t, length in self.latest_gaps],
            },
            "imu_loss": {
                "received": self.received,
                "missing": self.missing,
                "missing_percent": 100.0 * self.share,
                "longest": self.longest,
            },
        }


class SampleLoss:
    """Counts the samples of a stream by their stamps.

    Steps are compared with the shortest interval that some samples in a row have kept. A stream
    that comes evenly at another rate has another one. The counts depend on the order of samples
    alone, however they are cut into blocks; what is late by less than half of `_HELD` is not lost.
    """

    PAUSE = 10.0
    """s. A longer step is no loss: the link was away, or the vehicle's clock was set."""
    GAP = 0.1
    """s. A pause longer than this, and than five of its usual steps, is a gap."""
    GAPS_KEPT = 100
    _HELD, _SETTLED = 512, 256
    """Samples that wait for late ones, and how many of them are settled then."""
    _AT_ONCE = 2048
    """Samples settled together."""
    _FEW = 8
    """Steps in a row, the shortest mean of which is the interval: half of all samples may be lost,
    and still some of so many are not. One step is not enough: stamps jitter, and ArduPilot sends by
    turns after 2.5 and 5 ms."""
    _CALM, _ALIKE = 64, 1.2
    """Steps in a row whose means over `_FEW` all lie within that ratio: a stream without losses."""
    _CHANGED = 1.5
    """Ratio of intervals that makes another rate."""

    def __init__(self) -> None:
        self._counts = Counts()
        self._held = np.empty(0)
        self._before = np.empty(0)  # the last that are settled
        self._interval = 0.0

    def add_times(self, t: Array) -> None:
        """Take (n,) times of samples, s, in the order in which they came."""
        while len(t):
            room = self._rising(t) if len(t) >= self._HELD else 0
            if room:
                # One settling for many: of those that all come in order nothing is sorted out.
                self._held, t = np.append(self._held, t[:room]), t[room:]
                self._settle(len(self._held) - self._HELD + self._SETTLED)
                continue
            room = self._HELD - len(self._held)
            self._held, t = np.append(self._held, t[:room]), t[room:]
            if len(self._held) == self._HELD:
                self._held = self._new()
                if len(self._held) == self._HELD:
                    self._settle(self._SETTLED)

    def _rising(self, t: Array) -> int:
        """How many of (n,) times to settle together: a multiple of what is settled at a time."""
        most = min(len(t), self._AT_ONCE) + len(self._held)
        count = self._HELD + (most - self._HELD) // self._SETTLED * self._SETTLED
        room = count - len(self._held)
        times = np.concatenate([self._before[-1:], self._held, t[:room]])
        return room if bool((times[1:] > times[:-1]).all()) else 0

    def restart(self) -> None:
        """The clock has gone back: later samples are not compared with earlier ones."""
        self._settle(len(self._held))
        self._before, self._interval = np.empty(0), 0.0

    @property
    def counts(self) -> Counts:
        """Of all that came so far."""
        t = self._new()
        return self._counted(t, len(t))[0]

    def _settle(self, count: int) -> None:
        t = self._new()
        count = min(count, len(t))
        self._counts, self._interval = self._counted(t, count)
        self._before = np.append(self._before, t[:count])[-self._CALM :]
        self._held = t[count:]

    def _new(self) -> Array:
        """(n,) rising times held, without those that came twice, or too late."""
        t = np.unique(self._held)
        return t[t > self._before[-1]] if len(self._before) else t

    def _counted(self, t: Array, count: int) -> tuple[Counts, float]:
        """The counts with the first so many of (n,) rising times, and the interval then."""
        before = self._before
        counts = self._counts._replace(received=self._counts.received + count)
        times = np.concatenate([before, t])
        at, end = max(len(before) - 1, 0), len(before) + count - 1
        if end <= at or len(times) <= self._FEW:
            return counts, self._interval
        steps = np.diff(times)
        # Of the steps that begin with each: mean of a few, and where they are calm, of more.
        few = (times[self._FEW :] - times[: -self._FEW]) / self._FEW
        calm = np.full(len(few), np.nan)
        if len(steps) >= self._CALM:
            runs = sliding_window_view(few, self._CALM - self._FEW + 1)
            even = runs.max(axis=1) < self._ALIKE * runs.min(axis=1)
            calm[: len(runs)] = np.where(even, runs.mean(axis=1), np.nan)
        interval = self._interval or float(few[min(at, len(few) - 1)])
        # Those that are settled together are compared with one interval.
        settled = (
            range(len(before) + self._SETTLED - 1, end, self._SETTLED)
            if count >= self._HELD
            else ()
        )
        for stop_at in (*settled, end):
            while at < stop_at:
                here = slice(at, stop_at)
                changed = (calm[here] > self._CHANGED * interval) | (
                    few[here] < interval / self._CHANGED
                )
                stop = at + int(np.argmax(changed)) if changed.any() else stop_at
                if stop == at:
                    stop, interval = at + 1, float(few[at] if np.isnan(calm[at]) else calm[at])
                interval = float(few[at:stop].min(initial=interval))
                counts = self._with_steps(counts, times[at:stop], steps[at:stop], interval)
                at = stop
        return counts, interval

    def _with_steps(self, counts: Counts, t: Array, steps: Array, interval: float) -> Counts:
        """The counts with (n,) steps in s, from (n,) times on, of one interval."""
        ratio = np.round(steps / interval)
        lost = (ratio > 1.0) & (steps <= self.PAUSE)
        gap = steps > max(self.GAP, 5.0 * interval)
        return counts._replace(
            missing=counts.missing + int((ratio[lost] - 1.0).sum()),
            longest=max(counts.longest, float(steps[lost].max(initial=0.0))),
            steps=counts.steps + int(np.count_nonzero(~gap)),
            seconds=counts.seconds + float(steps[~gap].sum()),
            gaps=counts.gaps + int(np.count_nonzero(gap)),
            longest_gap=max(counts.longest_gap, float(steps[gap].max(initial=0.0))),
            latest_gaps=(
                *counts.latest_gaps, *zip(t[gap].tolist(), steps[gap].tolist(), strict=True)
            )[-self.GAPS_KEPT :],
        )  # fmt: skip


class SequenceCount:
    """Estimates the messages lost from one sender, by its sequence numbers.

    How far the newest number has moved is compared with how many distinct ones came, so that
    late ones are not lost. An outage of more than 255 messages shows modulo 256.
    """

    REORDERED = 64
    """A sequence number up to this far behind is late, not lost (PX4 has several senders)."""

    def __init__(self) -> None:
        self.received = 0
        self.expected = 0
        self._newest: int | None = None
        self._seen = 0  # bit n: the number n behind the newest came

    def count(self, sequence: int) -> None:
        """Count one message."""
        if self._newest is None:
            self._newest, self._seen, self.received, self.expected = sequence, 1, 1, 1
            return
        behind = (self._newest - sequence) % 256
        if behind < self.REORDERED:
            if not self._seen >> behind & 1:
                self._seen |= 1 << behind
                self.received += 1
                # A late one from before the first was not expected either.
                self.expected = max(self.expected, self.received)
            return
        ahead = 256 - behind
        self._newest = sequence
        self._seen = (self._seen << ahead | 1) & ((1 << self.REORDERED) - 1)
        self.received += 1
        self.expected += ahead

    def count_block(self, sequences: Array) -> None:
        """Count (n,) messages, uint8."""
        singles = 0
        while singles < len(sequences) and self.expected < 2 * self.REORDERED:
            self.count(int(sequences[singles]))
            singles += 1
        sequences = sequences[singles:]
        if self._newest is None or not len(sequences):
            return
        # The numbers without wrapping, 0 being the newest before them.
        steps: Array = np.diff(sequences.astype(np.int64), prepend=self._newest)
        steps %= 256
        steps[steps > 256 - self.REORDERED] -= 256
        numbers = np.cumsum(steps)
        newest = np.maximum.accumulate(np.append(0, numbers))
        ahead = numbers - newest[:-1]
        if (ahead > 256 - self.REORDERED).any() or (ahead <= -self.REORDERED).any():
            for sequence in sequences.tolist():
                self.count(sequence)
            return
        seen = [-n for n in range(self.REORDERED) if self._seen >> n & 1]
        numbers = np.sort(np.append(seen, numbers))
        distinct = numbers[np.diff(numbers, append=np.iinfo(np.int64).max) > 0]
        moved = int(newest[-1])
        self.received += len(distinct) - len(seen)
        self.expected += moved
        self._newest = (self._newest + moved) % 256
        recent = moved - distinct[distinct > moved - self.REORDERED]
        self._seen = sum(1 << n for n in recent.tolist())

    def follows(self, sequence: int) -> bool:
        """Whether a number is among the next few: believable in a damaged frame."""
        return self._newest is not None and 0 < (sequence - self._newest) % 256 <= 8

    @property
    def lost(self) -> int:
        """Messages that were sent and did not come."""
        return self.expected - self.received


class Monitor:
    """Counts the frames of a session.

    Attributes:
        counts: message name -> messages of the vehicle.
        received: frames whose checksum is right, of all systems.
        from_vehicle: frames of the chosen vehicle, repeated ones too.
        bad_crc: frames whose checksum is wrong.
        unknown: frames of unknown types.
        imu_loss: what is missing of the IMU's samples.
    """

    WINDOW = 5.0
    """s of vehicle time that rates are taken over."""
    STEP = 0.5
    """s. Messages are counted in steps of this length."""
    MOST_UNNAMED = 64
    """Message types without a name that are counted one by one, the first received; a hostile
    sender can make up 16 million."""

    def __init__(self) -> None:
        self.received = 0
        self.from_vehicle = 0
        self.bad_crc = 0
        self.unknown = 0
        self.imu_loss = SampleLoss()
        self._counts: Counter[int] = Counter()
        self._known = set(NAMED_IDS.tolist())
        self._most_known = len(self._known) + self.MOST_UNNAMED
        # Of the chosen vehicle alone: what it forwards from other systems was numbered for
        # another link and shows gaps where nothing was lost.
        self._sequence = SequenceCount()
        # Steps of vehicle time: (number of the step, message id -> messages, bytes).
        self._steps: deque[tuple[int, Counter[int], list[int]]] = deque()
        self._first: float | None = None
        self._spans = 0.0  # s of vehicle time before the last reboot
        self._now: float | None = None

    def count_frames(self, validity: Array) -> None:
        """Count (n,) frames of any sender, by `FrameBlock.validity`."""
        counts = counts_of(validity)
        self.received += counts.get(Validity.OK, 0)
        self.unknown += counts.get(Validity.UNKNOWN, 0)
        self.bad_crc += counts.get(Validity.BAD_CRC, 0)

    def restart(self) -> None:
        """From now on another vehicle is the chosen one; totals over all senders continue."""
        self.from_vehicle = 0
        self._counts.clear()
        self._sequence = SequenceCount()

    def count_chosen(
        self, message_id: Array, sequence: Array, size: Array, now: Array, bad_crc: Mask
    ) -> None:
        """Count frames of the chosen vehicle while its clock runs on.

        Args:
            message_id: (n,).
            sequence: (n,) uint8.
            size: (n,) bytes of each.
            now: (n,) s, its clock after each; NaN before the first stamp.
            bad_crc: (n,) whether its checksum is wrong.
        """
        if bad_crc.any():
            for number, bad in zip(sequence.tolist(), bad_crc.tolist(), strict=True):
                if not bad or self._sequence.follows(number):
                    self._sequence.count(number)
            message_id, size, now = (part[~bad_crc] for part in (message_id, size, now))
        else:
            self._sequence.count_block(sequence)
        if not len(now):
            return
        self.from_vehicle += len(now)
        every = counts_of(message_id)
        if not self._known.issuperset(every):
            message_id = self._types(message_id)
            every = counts_of(message_id)
        self._counts.update(every)
        timed = np.isfinite(now)
        if not timed.all():
            message_id, size, now = (part[timed] for part in (message_id, size, now))
            every = counts_of(message_id)
            if not len(now):
                return
        self._go_on(float(now[0]))
        self._now = float(now[-1])
        steps = (now / self.STEP).astype(np.int64)
        first = int(np.searchsorted(steps, steps[-1] - self.WINDOW / self.STEP))
        edges = np.flatnonzero(np.diff(steps[first:], prepend=-1, append=-1)) + first
        for start, end in pairwise(edges.tolist()):
            whole = end - start == len(message_id)
            counts = every if whole else counts_of(message_id[start:end])
            self._add_step(int(steps[start]), counts, int(size[start:end].sum()))

    def _types(self, message_id: Array) -> Array:
        """What (n,) messages are counted as, in order."""
        ids, first = np.unique(message_id, return_index=True)
        new = [i for i in ids[np.argsort(first)].tolist() if i not in self._known]
        self._known.update(new[: self._most_known - len(self._known)])
        return np.where(np.isin(message_id, sorted(self._known)), message_id, OTHER_TYPES)

    def _go_on(self, now: float) -> None:
        """See whether the clock went back."""
        if self._now is not None and self._first is not None and now < self._now - self.STEP:
            self._spans += self._now - self._first
            self._first = None
            self._steps.clear()
            self.imu_loss.restart()
        if self._first is None:
            self._first = now

    def _add_step(self, step: int, messages: Mapping[int, int], size: int) -> None:
        if not self._steps or self._steps[-1][0] != step:
            self._steps.append((step, Counter(), [0]))
            while self._steps[0][0] < step - self.WINDOW / self.STEP:
                self._steps.popleft()
        _, counts, sizes = self._steps[-1]
        counts.update(messages)
        sizes[0] += size

    @property
    def counts(self) -> dict[str, int]:
        """Message name -> messages of the vehicle."""
        return {message_name(i): n for i, n in sorted(self._counts.items())}

    @property
    def lost(self) -> int:
        """Messages of the chosen vehicle that did not come."""
        return self._sequence.lost

    @property
    def sent(self) -> int:
        """Messages that the chosen vehicle has sent since it was first received, `lost`
        included.
        """
        return self._sequence.expected

    @property
    def lost_percent(self) -> float:
        """`lost` as a part of what was sent, in percent."""
        return 100.0 * self.lost / self.sent if self.sent else 0.0

    @property
    def span(self) -> float:
        """Vehicle time covered, s, added up over reboots."""
        if self._now is None or self._first is None:
            return self._spans
        return self._spans + self._now - self._first

    def rates(self) -> dict[str, float]:
        """Messages a second over the last whole steps of the window, by name."""
        counts, _, seconds = self._window()
        return {message_name(i): n / seconds for i, n in sorted(counts.items())} if seconds else {}

    def _window(self) -> tuple[Counter[int], int, float]:
        """Messages by id, bytes, and s of the whole steps in the window."""
        whole = list(self._steps)[:-1]  # the last step still fills
        begun_inside = (
            self._first is not None and whole and whole[0][0] == int(self._first / self.STEP)
        )
        if begun_inside and len(whole) > 1:
            whole = whole[1:]
        total: Counter[int] = Counter()
        size = 0
        for _, counts, step_size in whole:
            total.update(counts)
            size += step_size[0]
        # Steps without any message are silence, and count.
        seconds = (self._steps[-1][0] - whole[0][0]) * self.STEP if whole else 0.0
        return total, size, seconds

    def health(self, garbage_bytes: int = 0) -> dict[str, Any]:
        """Figures of the moment, named as in `results.snapshot.LinkStatus`.

        Garbage counts as one rejection a started 64 bytes.
        """
        _, size, seconds = self._window()
        loss = self.imu_loss.counts
        return {
            "rates": self.rates(),
            "received": self.received,
            "rejected": self.bad_crc + -(-garbage_bytes // 64),
            "unknown": self.unknown,
            "lost": self.lost,
            "lost_percent": self.lost_percent,
            "gaps": loss.gaps,
            "last_gap": loss.latest_gaps[-1][1] if loss.gaps else None,
            "bytes_per_second": size / seconds if seconds else 0.0,
        }

    def as_dict(self, systems: Iterable[str] = (), garbage_bytes: int = 0) -> dict[str, Any]:
        """The result's `telemetry`: figures of the whole flight."""
        span = self.span
        return {
            "duration": span,
            "systems": list(systems),
            "messages": {
                name: {"count": n, "rate": n / span if span > 0.0 else None}
                for name, n in self.counts.items()
            },
            "received": self.received,
            "unknown": self.unknown,
            "bad_crc": self.bad_crc,
            "garbage_bytes": garbage_bytes,
            "lost": self.lost,
            "lost_percent": self.lost_percent,
            **self.imu_loss.counts.as_dict(),
        }
