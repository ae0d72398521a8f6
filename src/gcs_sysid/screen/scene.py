"""What a screen is given beside snapshots, wherever it stands: a terminal or a browser."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gcs_sysid.screen.app import SysidApp
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.screen.replay_app import ReplayApp
from gcs_sysid.screen.source import Actions, SnapshotSource
from gcs_sysid.screen.view import Baseline
from gcs_sysid.screen.widgets.transport import Transport


@dataclass(frozen=True)
class Scene:
    """All that an application is made of but its source.

    Attributes:
        truth: true values by parameter name, where known.
        actions: what can be done with the source.
        transport: what moves it, where it is a replay.
        baseline: an earlier result to compare with.
        announcer: calls out what is new; None: one that is off.
        large: whether the pilot view comes first.
    """

    truth: Mapping[str, float] = field(default_factory=dict)
    actions: Actions = field(default_factory=Actions)
    transport: Transport | None = None
    baseline: Baseline | None = None
    announcer: Announcer | None = None
    large: bool = False

    def app(self, source: SnapshotSource) -> SysidApp:
        """A new application on a source; there may be several."""
        made = (
            SysidApp(source, self.truth, self.actions, self.baseline)
            if self.transport is None
            else ReplayApp(source, self.transport, self.truth, self.actions, self.baseline)
        )
        made.announcer = self.announcer or made.announcer
        made.begins_large = self.large
        return made
