"""The live terminal screen: shows snapshots, knows neither MAVLink nor the estimator."""

from gcs_sysid.screen.app import SysidApp
from gcs_sysid.screen.source import SnapshotSource

__all__ = ["SnapshotSource", "SysidApp"]
