"""The one chain from records to estimates: samples, estimator, parameters.

Live sessions, replays, log analyses and tests all feed this class with blocks of records, a few
frames or minutes of a log. Its state depends on the records and their order alone, so the analysis
of a recording ends with the numbers that the live session ended with.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from gcs_sysid.errors import InputError
from gcs_sysid.estimation.online import Fit, OnlineEstimator
from gcs_sysid.estimation.rotor_signals import RotorInput
from gcs_sysid.estimation.status import Value
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.scale_reference import ScaleKind, ScaleReference
from gcs_sysid.results import summary
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Event, History
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.session.chain_result import Findings
from gcs_sysid.session.learner import Cutoffs, Known, Learner
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import gyro_cutoff, loop_cutoff
from gcs_sysid.signals.sampling import SampleBlock, Sampler

__all__ = ["WINDOW", "Chain", "ChainOptions"]

if TYPE_CHECKING:
    from gcs_sysid.estimation.offline import OfflineFit

WINDOW = 8192
"""IMU samples that are best taken at once."""


class Chain:
    """Feeds records through to estimates.

    Args:
        airframe: with the anchor that sets the scale.
        options: settings.
        anchor: sets the scale instead of the airframe's.

    Raises:
        ValueError: there is no anchor.
    """

    def __init__(
        self,
        airframe: Airframe,
        options: ChainOptions | None = None,
        anchor: ScaleReference | None = None,
    ) -> None:
        own = airframe.anchor()
        if anchor is None and own is not None:
            anchor = ScaleReference(*own, given=airframe.uncertainty.scale_share(*own))
        if anchor is None:
            raise ValueError("the airframe has no scale reference (mass, k_T or T_max)")
        self.airframe = airframe
        self.options = options = options or ChainOptions()
        self._learner = Learner(airframe, anchor, options)
        if options.tuning.method != "forward":
            # The article knows rotor speeds alone.
            airframe = replace(airframe, rotor_input="speed")
        rotor_selector = RotorSourceSelector(airframe, anchor)
        rotor_selector.parameters |= options.parameters
        self.sampler = Sampler(
            rotor_selector,
            len(airframe.rotors),
            options.tick,
            options.start,
            options.end,
            airframe.imu_arm,
        )
        self.clock_error = 0.0
        """Share by which the vehicle's clock may be wrong, set by the owner; affects results
        alone."""
        self._offline: OfflineFit | str | None = None

    def take(self, block: RecordBlock) -> bool:
        """Take records that follow each other; how they are cut into blocks changes no number.

        Returns:
            Whether the estimate was renewed.
        """
        before = self.renewals
        for part in block.windows():
            for _, parameter in part.parameters:
                self.rotor_selector.learn(parameter.source, parameter.values[0])
            for samples in self.sampler.take(part.tracks):
                self._learn(samples)
        return self.renewals > before

    def _learn(self, block: SampleBlock) -> None:
        self._learner.learn(block, self._known())

    def finish(self) -> Result:
        """Use what is still held back and give the final result."""
        for block in self.sampler.finish():
            self._learn(block)
        self._learner.finish(self.t)
        result = self.refit()
        if self.options.offline:
            self._offline = self._fit_offline()
            if not isinstance(self._offline, str):
                self._learner.fit = self._offline.fit
            result = self.result()
        return result

    def _fit_offline(self) -> "OfflineFit | str":
        """The offline estimate, or why there is none."""
        if self._learner.tracker is None:
            return "no estimate from this flight"
        if self.rotor_input != "speed":
            return "--offline needs measured rotor speeds, this flight has commands"
        # Splines and likelihoods take a while to load, and few ask for them.
        from gcs_sysid.estimation.offline import fit_offline

        return fit_offline(self._learner.tracker, self._learner.fit, self.options.progress)

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        # However records were taken, what came before is forgotten, and nothing else.
        for block in self.sampler.catch_up():
            self._learn(block)
        self._learner.reset()
        self.note("estimate reset")

    def check_anchor(self, kind: ScaleKind) -> None:
        """Check that this sets the scale with the rotor input in use.

        Raises:
            InputError: it does not.
        """
        rotors = self._learner.rotors
        used = self.airframe.rotor_input if rotors is None else rotors.kind
        if (used, kind) in (("speed", "T_max"), ("command", "k_T")):
            raise InputError(f"{kind} cannot set the scale with {used}s as the rotors' input")

    def set_anchor(self, anchor: ScaleReference) -> None:
        """Change the scale reference, from the start on; the estimate's history restarts.

        Raises:
            InputError: see `check_anchor`.
        """
        self.check_anchor(anchor.kind)
        self.rotor_selector.anchor = anchor
        self._learner.set_anchor(anchor)
        scale = summary.scale_of(anchor)
        self.note(f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}")

    def renew_every(self, interval: float | None) -> None:
        """As of `Learner`; the fits do not depend on it."""
        self._learner.renew_every(interval)

    def note(self, text: str) -> None:
        """Add a line to the event log."""
        self._learner.note(self.t, text)

    def refit(self) -> Result:
        """Fit now and give the result."""
        if self._learner.tracker is not None:
            tracker = self._learner.tracker
            fit = tracker.fit()
            # Only for a result: it costs more than the fit where the layout is wrong.
            other = tracker.estimator.other_layout(fit.rotation)
            self._learner.fit = replace(fit, other_layout=other)
        return self.result()

    @property
    def t(self) -> float:
        """Seconds of the vehicle's clock since the first record."""
        return self.sampler.t

    @property
    def rotor_selector(self) -> RotorSourceSelector:
        """Of the rotor stream."""
        return self.sampler.rotor_selector

    @property
    def rotor_input(self) -> RotorInput:
        """What the estimate rests on."""
        return self._learner.rotor_input

    @property
    def observers(self) -> list[Callable[[SampleBlock], None]]:
        """Are shown every block of samples before the estimator takes it."""
        return self._learner.observers

    @property
    def renewals(self) -> int:
        """How often the estimate was renewed."""
        return self._learner.renewals

    @property
    def outdated(self) -> bool:
        """Whether parameters came too late: what they say is not what the estimate rests on."""
        if self._learner.tracker is None:
            return False
        learner = self._learner
        return self.rotor_selector.outdated or learner.cutoffs != learner.used_of(self._cutoffs())

    @property
    def fit(self) -> Fit:
        """The latest fit."""
        return self._learner.fit

    @property
    def estimator(self) -> OnlineEstimator | None:
        """The one in force; None before the first sample in flight."""
        return None if self._learner.tracker is None else self._learner.tracker.estimator

    def values(self, fit: Fit) -> dict[str, Value]:
        """Physical parameters of any fit, by the rules of this flight's own."""
        return self._learner.values(fit, self.anchor)

    @property
    def anchor(self) -> ScaleReference:
        """The scale in force."""
        return self._learner.anchors[-1]

    @property
    def gyro_cutoff(self) -> float | None:
        """Hz, low-pass of the autopilot on its gyro that the estimate allows for."""
        return self._learner.cutoffs[0]

    @property
    def used_seconds(self) -> float:
        """Flight time used by the latest estimate."""
        return self._learner.fit.seconds

    @property
    def events(self) -> tuple[Event, ...]:
        """Event log, the latest last."""
        return tuple(self._learner.events)

    @property
    def history(self) -> History:
        """How the estimates moved so far."""
        return self._learner.history.history()

    def result(self) -> Result:
        """The latest fit as a result."""
        return Findings(
            self.airframe,
            self.sampler,
            self._learner,
            self._offline,
            self.clock_error,
            self.outdated,
        ).result()

    def _known(self) -> Known:
        base = self.sampler.time_base
        return Known(
            base.imu_interval,
            base.is_usable,
            bool(base.faults.spikes),
            bool(base.still_speeds),
            self._cutoffs(),
            self.rotor_selector.refused,
        )

    def _cutoffs(self) -> Cutoffs:
        """Of speeds, and of commands, by the parameters that have come."""
        given, rotor_selector = self.airframe.gyro_filter, self.rotor_selector
        known = rotor_selector.autopilot, rotor_selector.parameters
        return gyro_cutoff(given, *known), loop_cutoff(*known)
