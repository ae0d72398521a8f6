"""Requests of a session to the vehicle, where link and gate are in another process."""

from collections.abc import Callable

from gcs_sysid.telemetry.outgoing import Gate


class RelayedRequests:
    """Proxy for the gate where that is in another process: forwards requests to it.

    Args:
        send: called with a method of `Gate`, the protocol version and the arguments.
        listen_only: as of `Gate`.
        signing: as of `Gate`.
    """

    def __init__(
        self, send: Callable[..., None], *, listen_only: bool = False, signing: bool = False
    ) -> None:
        self.version = 2
        self._send = send
        self.listen_only = listen_only
        self.signing = signing

    def heartbeat(self) -> bool:
        """As of `Gate`."""
        return self._ask("heartbeat")

    def set_message_interval(
        self, target: tuple[int, int], message_id: int, interval_us: int, own_us: int = 0
    ) -> bool:
        """As of `Gate`."""
        return self._ask("set_message_interval", target, message_id, interval_us, own_us)

    def get_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """As of `Gate`."""
        return self._ask("get_message_interval", target, message_id)

    def request_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """As of `Gate`."""
        return self._ask("request_message_interval", target, message_id)

    def request_group(self, target: tuple[int, int], group: int, hertz: int) -> bool:
        """As of `Gate`."""
        return self._ask("request_group", target, group, hertz)

    def read_parameter(self, target: tuple[int, int], name: str) -> bool:
        """As of `Gate`."""
        return self._ask("read_parameter", target, name)

    def _ask(self, name: str, *arguments: object) -> bool:
        if not self.listen_only:
            self._send(name, self.version, *arguments)
        return not self.listen_only


class RequestsDone:
    """Executes the requests of `RelayedRequests`, through the gate alone, and can undo them.

    Args:
        gate: decides what is sent.
    """

    def __init__(self, gate: Gate) -> None:
        self._gate = gate
        # (vehicle, message) -> version of MAVLink, and the interval to put back.
        self._changed: dict[tuple[tuple[int, int], int], tuple[int, int]] = {}
        self._may: dict[str, Callable[..., bool]] = {
            "heartbeat": gate.heartbeat,
            "set_message_interval": self._set_message_interval,
            "get_message_interval": gate.get_message_interval,
            "request_message_interval": gate.request_message_interval,
            "request_group": gate.request_group,
            "read_parameter": gate.read_parameter,
        }

    def ask(self, name: str, version: int, *arguments: object) -> None:
        """Have the gate ask.

        Raises:
            NotAllowedError: that must never be sent.
            KeyError: no request has that name.
        """
        self._gate.version = 1 if version == 1 else 2
        self._may[name](*(tuple(a) if isinstance(a, list) else a for a in arguments))

    def _set_message_interval(
        self, target: tuple[int, int], message_id: int, interval_us: int, own_us: int = 0
    ) -> bool:
        if interval_us == own_us:
            self._changed.pop((target, message_id), None)
        else:
            self._changed[target, message_id] = self._gate.version, own_us
        return self._gate.set_message_interval(target, message_id, interval_us)

    def restore(self) -> None:
        """Restore the vehicle's own rates: the session is no longer there to do it."""
        changed, self._changed = self._changed, {}
        for _ in range(2):  # there is no later retry here either
            for (target, message_id), (version, own_us) in changed.items():
                self._gate.version = version
                self._gate.set_message_interval(target, message_id, own_us)
