"""What the screen is given: a session, what can be asked of it, and a snapshot with choices."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import Parameter
from gcs_sysid.results.comparison import Comparison
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import ParameterRow, parameter_rows, rows
from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.summary import before_data
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.screen.snapshot_view import notice

if TYPE_CHECKING:  # the first frame does not wait for what they need
    from gcs_sysid.live.live_session import LiveSession
    from gcs_sysid.live.replay_session import ReplaySession


@dataclass(frozen=True)
class EarlierResult:
    """An earlier result to compare with."""

    name: str
    """Of its file."""
    result: Result


@dataclass(frozen=True)
class Scene:
    """All that a screen or a page is made of but its source, wherever it stands.

    What is asked of a session is called from the screen's thread and returns at once, but `export`
    and `report`, which are called in a thread of their own. What it changed is the session's to
    report: it adds an `Event` to its next snapshots, so that the event log, the recording and the
    headless output agree. What fails raises a `GcsSysidError` or an `OSError`; the screen shows its
    one line and goes on. A text returned says what happened, in one line.

    Attributes:
        truth: true values by parameter name, where the vehicle is an emulator that reports them.
        live: the session, where it is of a link; None: what changes one cannot be done.
        replay: the session, where it is a recorded flight.
        export: write a result for a simulator: one of `export_targets`; never over another file.
        export_targets: names of the formats.
        report: write a report of the flight so far; never over another file.
        baseline: an earlier result to compare with.
        announcer: calls out what is new; None: one that is off.
        large: whether the pilot view comes first.
    """

    truth: Mapping[str, float] = field(default_factory=dict)
    live: "LiveSession | None" = None
    replay: "ReplaySession | None" = None
    export: Callable[[str, Result], str] | None = None
    export_targets: tuple[str, ...] = ()
    report: Callable[[], str] | None = None
    baseline: EarlierResult | None = None
    announcer: Announcer | None = None
    large: bool = False

    @property
    def absent(self) -> str:
        """Why some of it cannot be done, in words that follow "not"."""
        return "here" if self.replay is None else "in a replay"


@dataclass(frozen=True)
class View:
    """One snapshot with the choices made on the screen."""

    snapshot: Snapshot | None
    """None until the source has its first one."""
    truth: Mapping[str, float]
    """The true values by name, empty where unknown."""
    selected: str
    """Name of the parameter in the convergence plot."""
    exponents: Mapping[str, int]
    """Power of ten by unit."""
    silence: float = 0.0
    """Seconds since the link last brought something."""
    paused: bool = False
    """The display is frozen; the session is not."""
    shares: Mapping[str, float | None] = field(default_factory=dict)
    """Half of each 95 % interval over its reference value, see `coach.choice.shares`."""
    baseline: str = ""
    """Name of the earlier result that is compared with."""
    comparison: Comparison | None = None
    """With that; None where there is none."""

    @property
    def waiting(self) -> bool:
        """Whether there is too little flight for any estimate, and more may come."""
        return self.snapshot is not None and before_data(self.snapshot)

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return self.snapshot is not None and self.snapshot.link.state is LinkState.ENDED

    def rows(self) -> list[ParameterRow]:
        """The parameters, in the order of all tables."""
        if self.snapshot is None:
            return []
        result = self.snapshot.result
        return parameter_rows(result, truth=self.truth, waiting=self.waiting, ended=self.ended)

    def estimate(self, name: str) -> tuple[Parameter, Estimate] | None:
        """A parameter of the result by name."""
        if self.snapshot is None:
            return None
        for parameter, estimate in rows(self.snapshot.result):
            if parameter.name == name:
                return parameter, estimate
        return None

    def notice(self) -> tuple[str, str] | None:
        """The sentence for the banner and its level (`info`, `warning` or `error`), if any."""
        if self.snapshot is None:
            return "Opening the link ...", "info"
        if self.paused:
            return "Display paused, identification continues. p: resume", "info"
        found = notice(self.snapshot.link, self.silence)
        if found is not None and self.ended:
            return f"{found[0]} q: quit", found[1]
        return found
