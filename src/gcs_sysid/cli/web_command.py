"""`gcs-sysid web`: a page in the browser that analyzes logs."""

import argparse
import threading

from gcs_sysid.cli import output
from gcs_sysid.cli.output import on_signals


def run(options: argparse.Namespace) -> int:
    """Run the command; it ends by Ctrl-C."""
    # aiohttp takes a quarter of a second to load.
    from gcs_sysid.web.site import Site
    from gcs_sysid.web.workbench import Workbench

    host, port = options.address
    stopped = threading.Event()
    site = Site(host, port, Workbench())
    with on_signals(stopped.set):
        site.start()
        try:
            output.say_addresses(site, host)
            output.wait_for(stopped)
        finally:
            site.stop()
    return 0
