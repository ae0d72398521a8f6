"""`gcs-sysid web`: a page in the browser that analyzes logs."""

import argparse
import threading
from typing import TYPE_CHECKING

from gcs_sysid.cli import output
from gcs_sysid.cli.output import on_signals

if TYPE_CHECKING:
    from gcs_sysid.web.site import Site

_LOOK_EVERY = 0.5
"""s between polls; Windows delivers Ctrl-C only between them."""


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
            say_addresses(site, host)
            while not stopped.wait(_LOOK_EVERY):
                pass
        finally:
            site.stop()
    return 0


def say_addresses(site: "Site", host: str) -> None:
    """Where the page is, for who may do things and for who may only look."""
    from gcs_sysid.web.access import is_loopback

    far = "" if is_loopback(host) else "; not encrypted: use a network that you trust"
    output.say(f"open {site.address('pilot')} in a browser (Ctrl-C ends){far}")
    output.say(f"for viewers, who can only look: {site.address('viewer')}")
