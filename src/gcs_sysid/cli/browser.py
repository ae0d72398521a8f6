"""A session shown in browsers instead of on the terminal."""

import threading

from gcs_sysid.cli import output
from gcs_sysid.cli.live_command import Session, say_until_end
from gcs_sysid.cli.signals import on_signals
from gcs_sysid.errors import InputError
from gcs_sysid.screen.scene import Scene
from gcs_sysid.web.share import Share
from gcs_sysid.web.site import Site, is_loopback

_LOOK_EVERY = 0.5
"""s; Windows tells of Ctrl-C between two looks alone."""


def show(session: Session, scene: Scene, address: tuple[str, int]) -> None:
    """Serve a session until Ctrl-C; the terminal says what it says without a screen.

    Args:
        session: not yet started; ends with the serving.
        scene: what the pages show and offer.
        address: host and port to serve on.

    Raises:
        InputError: there is no serving there.
    """
    host, port = address
    stopped = threading.Event()

    def stop() -> None:
        stopped.set()
        session.request_stop()

    share = Share(session, scene)
    site = Site(host, port, share.door)
    try:
        url = site.start()
    except InputError:
        # Nothing of the session may stay: its link, an empty recording.
        session.request_stop()
        session.start()
        session.join()
        raise
    share.start()
    try:
        with on_signals(stop):
            far = "" if is_loopback(host) else "; whoever reaches it can press every key"
            output.say(f"open {url} in a browser (Ctrl-C ends){far}")
            session.start()
            say_until_end(session)
            if not stopped.is_set():
                output.say("ended; the page stays until Ctrl-C")
            while not stopped.wait(_LOOK_EVERY):
                pass
    finally:
        session.stop()
        share.close()
        site.stop()
