"""Which rotor stream identification uses: asked of the chain itself."""

from collections.abc import Sequence

from gcs_sysid.inspection.facts import RotorInput, RotorSource
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.signals.records import Record
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import RotorSource as BelievedSource
from gcs_sysid.signals.sampling import SampleBlock, Sampler


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

    def take(self, record: Record) -> None:
        """Take a record, of whatever stream."""
        self._note(self._sampler.push(record))

    def finish(self, sources: Sequence[RotorSource]) -> RotorInput:
        """What identification rests on at the end, among the sources described."""
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

    def _note(self, blocks: Sequence[SampleBlock]) -> None:
        for block in blocks:
            self._believed = block.rotors or self._believed
