"""A row of what an autopilot's own log holds: the same idea as `message_table`, in its names."""

from collections.abc import Callable
from dataclasses import dataclass

from gcs_sysid.arrays import Array
from gcs_sysid.signals.records import Stream


@dataclass(frozen=True)
class OnboardMessage:
    """How one topic (.ulg) or type of entry (.bin) makes samples.

    Attributes:
        name: of the topic or entry.
        stream: what it measures.
        fields: that make up the values; in a topic, `q[4]` are `q[0]` to `q[3]`, and `output[n]`
            as many as its field `n` says.
        scale: SI unit per unit of the fields.
        rank: among those of a stream of which one is read, 0 the best; the others are read
            where it is missing.
        is_equal_to: value of a state's only field at which it is true; None: not a state.
        offset: topic and fields that are subtracted, by their latest values.
        sensors: which of several: "first" (another one is another stream, not more samples),
            "primary" (of the estimator that the autopilot flies by), or "all".
        convert: (n, fields) numbers as they are logged to (n, width) values, before the scale.
    """

    name: str
    stream: Stream
    fields: tuple[str, ...]
    scale: float = 1.0
    rank: int = 0
    is_equal_to: int | None = None
    offset: tuple[str, tuple[str, ...]] | None = None
    sensors: str = "first"
    convert: Callable[[Array], Array] | None = None

    def values(self, columns: Array) -> Array:
        """(n, width) in SI units of (n, fields) numbers."""
        if self.is_equal_to is not None:
            state: Array = columns == self.is_equal_to
            return state
        values = columns if self.convert is None else self.convert(columns)
        return values if self.scale == 1.0 else values * self.scale
