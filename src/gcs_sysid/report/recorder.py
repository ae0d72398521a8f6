"""Keeps what an analysis uses, in bounded memory, for figures that are drawn afterwards."""

import tempfile
from collections.abc import Iterator

import numpy as np

from gcs_sysid.estimation.validation import Validation
from gcs_sysid.live.acceleration_prediction import Motion
from gcs_sysid.results.snapshot import Event, History
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock

_IN_MEMORY = 64 << 20
"""Bytes of samples kept in memory; more go to a temporary file."""
_AT_ONCE = 8192
"""Samples read back at once."""
NO_COURSE = History(np.empty(0), {}, {})


class Recorder:
    """An observer of `analyze_log`: the samples, the estimate's history and the validation.

    Args:
        rotors: how many the airframe has.
    """

    def __init__(self, rotors: int) -> None:
        self.history = NO_COURSE
        self.validation: Validation | None = None
        self.notes: tuple[Event, ...] = ()
        """What the analysis noted on the way."""
        self.dt: float | None = None
        """s between samples."""
        self._row = np.dtype([("t", "<f8"), ("x", "<f4", (6 + rotors,))])
        self._file = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115
        self._input: object = None

    def begin(self) -> None:
        """A reading of the log begins; one before it does not count."""
        self.history, self.validation, self.notes = NO_COURSE, None, ()
        self._restart(None, None)

    def take(self, block: SampleBlock) -> None:
        """The next block of samples."""
        if block.rotors is None:
            return
        if block.dt != self.dt or block.rotors is not self._input:
            if not np.isfinite(block.samples.gyro).any():
                return  # nothing flies: the estimate keeps what it has
            # The estimate does so too.
            self._restart(block.dt, block.rotors)
        s = block.samples
        gap = int(block.fresh)
        rows = np.full(len(block.t) + gap, np.nan, self._row)
        rows["x"][:gap] = np.nan
        rows["t"][gap:] = block.t
        rows["x"][gap:] = np.column_stack([s.gyro, s.rates, s.speeds])
        self._file.write(rows.tobytes())

    def end(self, chain: Chain) -> None:
        """All is read, and the estimate final."""
        self.history, self.validation = chain.history, chain.fit.validation
        self.notes = chain.events

    def samples(self) -> Iterator[Motion]:
        """What was taken, in pieces; a gap is a sample that is missing."""
        self._file.seek(0)
        while data := self._file.read(_AT_ONCE * self._row.itemsize):
            rows = np.frombuffer(data, self._row)
            x = rows["x"].astype(float)
            yield Motion(rows["t"], x[:, :3], x[:, 3:6], x[:, 6:])

    def close(self) -> None:
        """Drop the samples."""
        self._file.close()

    def _restart(self, dt: float | None, rotors: object) -> None:
        self._file.seek(0)
        self._file.truncate()
        self.dt, self._input = dt, rotors
