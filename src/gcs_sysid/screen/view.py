"""What every panel is given to draw: one snapshot and how the user wants to see it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from gcs_sysid.model.parameters import Parameter
from gcs_sysid.results.comparison import Comparison
from gcs_sysid.results.result import Estimate, Result
from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.summary import before_data
from gcs_sysid.results.words import rows
from gcs_sysid.screen import formatting


@dataclass(frozen=True)
class Baseline:
    """An earlier result to compare with."""

    name: str
    """Of its file."""
    result: Result


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
    """Half of each 95 % interval over what it is measured against, see `standing.shares`."""
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
        link = self.snapshot.link
        if self.paused:
            return "Display paused, identification continues. p: resume", "info"
        if link.state is LinkState.WAITING:
            return (
                f"Listening on {link.url}: no vehicle yet. "
                "Is the vehicle on, or telemetry forwarding enabled?",
                "warning",
            )
        if link.state is LinkState.LOST:
            return (
                f"Link lost: no data for {formatting.duration(self.silence)}. "
                "Estimates are kept; still listening.",
                "error",
            )
        if link.state is LinkState.ENDED:
            return "Stream ended, numbers are final. q: quit", "info"
        return None


class Panel(Protocol):
    """A part of the screen that draws a view."""

    def show(self, view: View) -> None:
        """Bring the panel up to date; does nothing where nothing it shows has changed."""
        ...
