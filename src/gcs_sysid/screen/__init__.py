"""The live terminal screen: shows snapshots, knows neither MAVLink nor the estimator."""

from gcs_sysid.screen.app import SysidApp
from gcs_sysid.screen.view import Actions, EarlierResult, SnapshotSource

__all__ = ["Actions", "EarlierResult", "SnapshotSource", "SysidApp"]
