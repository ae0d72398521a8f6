"""What a chain has found so far, as a result."""

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.parameters.given_errors import (
    CAUSES,
    Alignment,
    Given,
    aligned,
    alignment_of,
    given_effects,
    given_stds,
)
from gcs_sysid.estimation.parameters.parameter_covariance import parameter_covariance
from gcs_sysid.estimation.parameters.physical_parameters import rotor_values, timing_values
from gcs_sysid.estimation.parameters.scale import AbsoluteScale, resolve_scale
from gcs_sysid.estimation.rows.rotor_signals import cutoff_of
from gcs_sysid.judgement.evidence import Evidence, Received
from gcs_sysid.judgement.judge import judge, judged
from gcs_sysid.judgement.status import of_rotors
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXES, REGISTRY
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results import summary
from gcs_sysid.results.result import Result
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS

if TYPE_CHECKING:
    from gcs_sysid.session.chain import Chain


@dataclass(frozen=True)
class Findings:
    """Where a chain stands."""

    chain: "Chain"

    def result(self) -> Result:
        """All of it."""
        chain = self.chain
        fit, anchor, offline = chain.fit, chain.anchor, chain.offline
        evidence = self._evidence(fit, anchor)
        found = judge(evidence)
        estimates = summary.complete(found.estimates, fit, anchor, self._bounds())
        parameters, timing = (
            {name: e for name, e in estimates.items() if REGISTRY[name].section == section}
            for section in ("parameters", "timing")
        )
        past = self._past_values()
        return Result(
            verdict=found.verdict,
            reasons=found.reasons,
            objections=found.objections,
            source="",
            vehicle={},
            scale=summary.scale_of(anchor),
            rotor_input=chain.rotor_input,
            parameters=parameters,
            estimator="online" if isinstance(offline, str | None) else "offline",
            method="" if isinstance(offline, str | None) else offline.method,
            timing=timing,
            events=(*chain.log.of_rotors, *self._changes([*past, chain.values(fit, anchor)])),
            segments=self._segments(),
            validation=summary.validation_of(fit),
            priors={
                name: {"value": value, "std": std}
                for name, (value, std) in chain.airframe.priors.items()
            },
            telemetry=self._telemetry(),
            airframe=chain.airframe.as_json(),
            disturbance=self._disturbance(),
            rotors=self._rotors(),
            covariance=self._covariance(parameters, timing),
        )

    def _evidence(self, fit: Fit, anchor: ScaleReference) -> Evidence:
        """What is judged of a flight as a whole."""
        chain, sampler, selector = self.chain, self.chain.sampler, self.chain.rotor_selector
        segment = self._segment_evidence(fit, anchor)
        timing = timing_values(fit.rotation, chain.rotor_input)
        note = ""
        if isinstance(chain.offline, str):
            note = f"this is the online estimate: {chain.offline}"
        evidence = replace(
            segment,
            estimates={**segment.estimates, **timing},
            received=Received(
                frozenset(sampler.seen),
                sampler.recorded,
                dict(selector.refused),
                selector.judged,
                chain.rotors is not None,
                chain.input_lost,
                chain.outdated,
            ),
            note=note,
        )
        return evidence if chain.origin is None else chain.origin.known_to(evidence)

    def _segment_evidence(self, fit: Fit, anchor: ScaleReference) -> Evidence:
        """What is judged of a stretch of flight."""
        chain, source = self.chain, self.chain.rotors
        evidence = chain.evidence(fit, anchor)
        return replace(
            evidence,
            given=given_stds(evidence.estimates, fit, self._given(anchor)),
            assumed="" if source is None else source.assumed,
            reread=source is not None and source.scale != 1.0,
            clock=None if chain.origin is None else chain.origin.clock_doubt,
        )

    @property
    def _scale(self) -> AbsoluteScale:
        fit, anchor = self.chain.fit, self.chain.anchor
        return resolve_scale(anchor, fit.translation, self.chain.known_beforehand(anchor))

    def _disturbance(self) -> dict[str, float]:
        rotation = self.chain.fit.rotation
        if rotation is None or not np.isfinite(rotation.disturbance).all():
            return {}
        return dict(zip(AXES, rotation.disturbance.tolist(), strict=True))

    def _rotors(self) -> tuple[dict[str, Estimate], ...]:
        """Each rotor's coefficients; with commands there are none."""
        if self.chain.rotor_input.motors:
            return ()
        rotors, cant = len(self.chain.airframe.rotors), self.chain.airframe.cant
        return of_rotors(rotor_values(self._aligned_rotation, self._scale, rotors, cant))

    @property
    def _aligned_rotation(self) -> RotationFit | None:
        """As values are: with rotors and IMU at their identified poses."""
        return aligned(self.chain.fit, self._alignment).rotation

    @cached_property
    def _alignment(self) -> Alignment | None:
        return alignment_of(self.chain.fit, self.chain.airframe)

    def _covariance(
        self, parameters: dict[str, Estimate], timing: dict[str, Estimate]
    ) -> dict[str, Any]:
        rotation = self._aligned_rotation
        if rotation is None:
            return {}
        values = {
            name: (e.value, e.std)
            for name, e in (parameters | timing).items()
            if e.value is not None and e.std is not None
        }
        given = given_effects(parameters, self.chain.fit, self._given(self.chain.anchor))
        names, matrix, effects = parameter_covariance(rotation, self._scale, values, given)
        if not np.isfinite(matrix).all():
            return {}
        return {
            "names": list(names),
            "matrix": matrix.tolist(),
            "causes": list(CAUSES),
            "given": effects.tolist(),
        }

    def _given(self, anchor: ScaleReference) -> Given:
        known = self.chain.known_beforehand(anchor)
        return Given(self.chain.airframe, anchor, self.chain.rotor_input, known)

    def _past_values(self) -> list[dict[str, Estimate]]:
        if self.chain.tracker is None:
            return []
        return [
            self.chain.values(segment.fit, anchor)
            for segment, anchor in zip(
                self.chain.tracker.segments, self.chain.anchors, strict=False
            )
        ]

    def _bounds(self) -> dict[str, Estimate]:
        if isinstance(self.chain.offline, str | None):
            return {}
        bounds = self.chain.values(self.chain.offline.bounding_fit, self.chain.anchor)
        # The likelihood is that of the rotation.
        return {n: v for n, v in bounds.items() if REGISTRY[n].fit in ("rotation", "actuator")}

    def _changes(self, values: list[dict[str, Estimate]]) -> tuple[dict[str, Any], ...]:
        if self.chain.tracker is None:
            return ()
        out = []
        before = 0
        for event in self.chain.tracker.events:
            after = None
            if event.segment is not None:
                before, after = event.segment, values[event.segment + 1]
            out.append(summary.event_of(event, values[before], after))
            if event.segment is not None:
                before = event.segment + 1
        return tuple(out)

    def _segments(self) -> tuple[dict[str, Any], ...]:
        if self.chain.tracker is None:
            return ()
        return tuple(
            {
                "start": segment.start,
                "end": segment.end,
                "scale": summary.scale_of(anchor).as_json(),
                "parameters": {
                    name: estimate.as_json()
                    for name, estimate in summary.complete(
                        judged(self._segment_evidence(segment.fit, anchor)), segment.fit, anchor
                    ).items()
                },
                "validation": summary.validation_of(segment.fit),
            }
            for segment, anchor in zip(
                self.chain.tracker.segments, self.chain.anchors, strict=False
            )
        )

    def _telemetry(self) -> dict[str, Any]:
        base = self.chain.sampler.time_base
        return {
            "grid_rate": 1.0 / base.dt if base.dt else None,
            "used_seconds": self.chain.fit.seconds,
            "late": base.late,
            "repeated": base.repeated,
            "restarts": base.restarts,
            "imu_outliers": asdict(base.faults),
            "rotor_outliers": base.wild_speeds,
            "rotor_still": base.still_speeds,
            "rotor_input": self._input_telemetry(),
            "imu_rotation": self._imu_rotation(),
            "thrust_voltage": self.chain.tracker.voltage if self.chain.tracker else None,
        }

    def _imu_rotation(self) -> dict[str, Any] | None:
        """How the IMU is turned, in degrees; None where that is given as exact or not
        identifiable.
        """
        found = self._alignment
        if found is None or not found.turned_std.any():
            return None
        return {
            "value": np.degrees(found.turned).tolist(),
            "std": np.degrees(found.turned_std).tolist(),
        }

    def _gyro_filter_found(self) -> float | None:
        """Hz of the undeclared low-pass that the gyro's delay is that of; None: none was found."""
        tracker, fit = self.chain.tracker, self.chain.fit.rotation
        if tracker is None or fit is None or not tracker.low_passed or not fit.delay < 0.0:
            return None
        return cutoff_of(-float(fit.delay))

    @property
    def _twin(self) -> str | None:
        """The other stream of commands that is used."""
        return (
            self.chain.sampler.rotor_selector.twin
            if self.chain.sampler.time_base.dt >= SLOW_COMMANDS
            else None
        )

    def _input_telemetry(self) -> dict[str, Any]:
        """Which rotor stream is used, how it is read, and why not the others."""
        source = self.chain.rotors
        if source is None:
            return {"source": None, "refused": dict(self.chain.sampler.rotor_selector.refused)}
        out: dict[str, Any] = {
            "source": source.name,
            "why": source.why,
            "refused": dict(source.refused or {}),
            "with": self._twin,
            "repeats": self.chain.sampler.rotor_selector.repeats[source.name].as_dict(),
            "gyro_filter": None if self.chain.tracker is None else self.chain.cutoffs[0],
            "gyro_filter_found": self._gyro_filter_found(),
            "loop_filter": None if self.chain.tracker is None else self.chain.cutoffs[1],
        }
        if source.range is not None:
            out["range"] = [source.range.low, source.range.high]
            out["range_from"] = source.range.origin
        return out
