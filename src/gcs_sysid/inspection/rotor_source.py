"""Which rotor stream identification uses: asked of the chain itself."""

from collections.abc import Iterable, Sequence

from gcs_sysid.inspection.facts import RotorInput, RotorSource
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.records import Record
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import RotorSource as BelievedSource
from gcs_sysid.signals.sampling import SampleBlock, Sampler

_AT_ONCE = 4096
"""Records that are best taken together."""


class RotorJudge:
    """Asks the chain's own selector, on the chain's own samples, which rotor stream to believe.

    Args:
        airframe: whose rotors; its anchor is used where it has one.
        autopilot: "px4", "ardupilot".
    """

    def __init__(self, airframe: Airframe, autopilot: str) -> None:
        own = airframe.anchor()
        self._rotor_selector = RotorSourceSelector(airframe, ScaleReference(*own) if own else None)
        self._rotor_selector.autopilot = autopilot
        self._sampler = Sampler(self._rotor_selector, len(airframe.rotors))
        self._believed: BelievedSource | None = None
        self._waiting: list[Record] = []

    def take(self, record: Record) -> None:
        """Take a record, of whatever stream."""
        self._waiting.append(record)
        if len(self._waiting) == _AT_ONCE:
            self._take_waiting()

    def _take_waiting(self) -> None:
        block = RecordBlock.of(self._waiting)
        self._waiting.clear()
        for part in block.windows():
            for _, told in part.parameters:
                self._rotor_selector.learn(told.source, told.values[0])
            self._note(self._sampler.take(part.tracks))

    def finish(self, sources: Sequence[RotorSource]) -> RotorInput:
        """What identification rests on at the end, among the sources described."""
        self._take_waiting()
        self._note(self._sampler.finish())
        believed, rotor_selector = self._believed, self._rotor_selector
        refused = rotor_selector.refused if believed is None else believed.refused or {}
        reasons = [f"{name} {why}" for name, why in refused.items()]
        if believed is None:
            return RotorInput(None, tuple(reasons), rotor_selector.judged)
        if believed.kind == "command" or believed.scale != 1.0:
            reasons.append(f"rotors from {believed.name}, {believed.why}")
        span = believed.range
        return RotorInput(
            next((source for source in sources if source.message == believed.name), None),
            tuple(reasons),
            rotor_selector.judged,
            None if span is None else (span.low, span.high),
            "" if span is None else span.origin,
        )

    def _note(self, blocks: Iterable[SampleBlock]) -> None:
        for block in blocks:
            self._believed = block.rotors or self._believed
