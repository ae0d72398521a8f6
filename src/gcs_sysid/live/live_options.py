"""What a user may set for a live session."""

from dataclasses import dataclass
from pathlib import Path

from gcs_sysid.live.flight_coach import CoachOptions


@dataclass(frozen=True)
class LiveOptions:
    """What a user may set for a live session.

    Attributes:
        rate: Hz to ask for, for IMU and rotors.
        listen_only: send nothing at all.
        wanted: system and perhaps component; None: the first autopilot received.
        duration: s of wall clock after which the session ends; None: never.
        refit_interval: s of vehicle time between estimates.
        signing_key: file with the key of MAVLink 2 signing; None: nothing is signed or checked.
        coach: what the flight coach aims at; None: no advice.
        state_folder: where the rates to restore are kept while the session lasts; None: nowhere.
        predict: whether snapshots show the acceleration that was predicted.
    """

    rate: float = 250.0
    listen_only: bool = False
    wanted: tuple[int, int | None] | None = None
    duration: float | None = None
    refit_interval: float = 0.2
    signing_key: Path | None = None
    coach: CoachOptions | None = None
    state_folder: Path | None = None
    predict: bool = True
