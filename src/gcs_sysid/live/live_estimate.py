"""The estimate of a live session, and what looks on while it is made."""

from collections.abc import Sequence

from gcs_sysid.live.acceleration_prediction import LivePrediction
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.live.live_options import LiveOptions
from gcs_sysid.live.live_view import picture
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Advice, LinkStatus, Snapshot
from gcs_sysid.session.chain import Chain
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.telemetry.frames import Frame


class LiveEstimate:
    """A pipeline that knows nothing yet, its prediction and its coach.

    Args:
        airframe: with a scale anchor.
        source: what the result names as its source.
        options: settings.
        wanted: system and perhaps component; None: the first autopilot heard.
    """

    def __init__(
        self,
        airframe: Airframe,
        source: str,
        options: LiveOptions,
        wanted: tuple[int, int | None] | None,
    ) -> None:
        self._options = options
        own = ChainOptions(history_interval=options.refit_interval)
        self.pipeline = Pipeline(airframe, source, wanted, own)
        self._prediction = LivePrediction(self.chain)
        if options.predict:
            self.chain.observers.append(self._prediction.take)
        self._coach = None if options.coach is None else Coach(self.chain, options.coach)
        self._advised: Advice | None = None
        self.relieved = False
        """Whether the estimate is not renewed on the way."""

    @property
    def chain(self) -> Chain:
        """From records to estimates."""
        return self.pipeline.chain

    def take(self, frames: Sequence[Frame], wall: float, garbage_bytes: int) -> None:
        """Learn from frames.

        Args:
            frames: as they came.
            wall: when, s, as it is recorded.
            garbage_bytes: of the link so far.
        """
        self.pipeline.intake.garbage_bytes = garbage_bytes
        self.pipeline.take(frames, wall)

    def relieve(self, *, on: bool) -> None:
        """Whether to learn alone, and not to renew the estimate: there is no time, or no use."""
        self.relieved = on
        self.chain.renew_every(None if on else self._options.refit_interval)

    def think(self) -> None:
        """Let the coach think."""
        if self._coach is not None:
            self._coach.think()
            self._advised = self._coach.look()

    def silence(self) -> None:
        """Have no coach any more."""
        self._coach = self._advised = None

    def snapshot(self, result: Result, link: LinkStatus) -> Snapshot:
        """How things stand.

        Args:
            result: the latest, with what only the link knows.
            link: health of it.
        """
        acceleration = self._prediction.acceleration()
        target = (self._options.coach or CoachOptions()).target
        return picture(self.chain, result, link, acceleration, target, self._advised)

    def drop(self) -> None:
        """Let go of the pipeline, which would outlive its session."""
        self.pipeline.drop()
