"""The live terminal screen: shows snapshots, knows neither MAVLink nor the estimator.

To add a panel: a widget in `bars` or `panels`, named in `main_view` and styled in `screen.tcss`. A
key: a row of `key_commands`, from which bindings, footer, help and palette follow. What is said of
a session is made in `snapshot_view`, for the page too. Then draw the goldens again:
`UPDATE_GOLDEN=1 pytest tests/screen/test_golden.py`.
"""

from gcs_sysid.screen.app import SysidApp, app_of
from gcs_sysid.screen.view import EarlierResult, Scene

__all__ = ["EarlierResult", "Scene", "SysidApp", "app_of"]
