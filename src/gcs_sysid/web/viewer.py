"""One viewer: `python -m gcs_sysid.web.viewer`, which the web server starts for each browser."""

import os
import sys

from gcs_sysid.errors import GcsSysidError
from gcs_sysid.screen import SysidApp
from gcs_sysid.web.share import VARIABLE, Door, RemoteSource


def main() -> int:
    """Show the session of the process that started this one, until that or the user ends it."""
    shown: list[SysidApp] = []

    def leave() -> None:
        for app in shown:
            if app.is_running:
                app.call_from_thread(app.exit)

    try:
        source = RemoteSource(Door.parse(os.environ.get(VARIABLE, "")), leave)
    except (GcsSysidError, ValueError) as error:
        print(f"gcs-sysid: error: no session to show: {error}", file=sys.stderr)
        return 2
    app = source.scene.app(source)
    shown.append(app)
    source.start()
    app.run()
    source.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
