"""Settings of a chain from records to estimates."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.record.tuning import EstimatorTuning


@dataclass(frozen=True)
class ChainOptions:
    """What a user may set.

    Attributes:
        tuning: of the estimator with rotor speeds; with commands it has its own.
        changes: of the change detector; None: changes in flight are not looked for.
        history_interval: s between refits for the estimate's history; None: only at the end.
        tick: s of vehicle time between blocks; the estimate does not depend on it.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
        offline: whether the final estimate is the offline one.
        progress: called with the offline estimator's current step and the share of it that is done.
        reserve: whether the memory of a long flight is taken at once, so that a session does not
            find it wanting; a log takes what it needs.
        parameters: of the autopilot, as far as they are known beforehand.
    """

    tuning: EstimatorTuning = field(default_factory=EstimatorTuning)
    changes: ChangeTuning | None = field(default_factory=ChangeTuning)
    history_interval: float | None = 0.5
    tick: float = 0.1
    start: float = 0.0
    end: float = float("inf")
    offline: bool = False
    progress: Callable[[str, float], None] | None = None
    reserve: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
