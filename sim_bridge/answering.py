"""What PX4 and ArduPilot have in common: one link, streams, answers to a ground station."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import Schedule, Stream, VehicleClock
from sim_bridge.instruments import Instruments
from sim_bridge.log_server import LogServer
from sim_bridge.other_systems import OtherSystems
from sim_bridge.status_messages import StatusMessages
from sim_bridge.vehicle_parameters import Parameter
from sim_bridge.wire import FrameWriter

REBOOT_SILENCE = 1.0
"""s without a word when the autopilot restarts."""

REBOOTED_US = 3_000_000
"""Its clock at the first word after that."""

RESET_INTERVAL = 250_000.0
"""us between messages after another ground station's reset: 4 Hz, as QGroundControl asks."""

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED


class AnsweringAutopilot(ABC):
    """An autopilot on one link. Subclasses say which messages there are and who may ask.

    Attributes:
        clock: of the vehicle.
        schedule: the streams.
        writer: makes the frames.
        parameters: as PARAM_VALUE shows them.
    """

    clock: VehicleClock
    schedule: Schedule
    writer: FrameWriter
    parameters: list[Parameter]
    _status: StatusMessages

    def __init__(
        self, instruments: Instruments, writer: FrameWriter, seed: np.random.SeedSequence
    ) -> None:
        self.instruments = instruments
        self.clock = instruments.clock
        self.writer = writer
        self._sim = instruments.simulation
        self._sensor_faults = instruments.faults.sensor_faults
        skips, disorder, other_systems = seed.spawn(3)
        self._skip_random = np.random.default_rng(skips)
        self._disorder_random = np.random.default_rng(disorder)
        self._other_systems = OtherSystems(instruments, other_systems)
        self._never_sent = set(self._sensor_faults.never_sent)
        self._holds_back = bool(self._never_sent or self._sensor_faults.skips)
        self._reboot_tick = self._tick_of(self._sensor_faults.reboot)
        self._jump_tick = self._tick_of(self._sensor_faults.clock_jump[0])
        self._reset_tick = self._tick_of(self._sensor_faults.rate_reset)
        self._fault_ticks = {self._reboot_tick, self._jump_tick, self._reset_tick}
        self._silent_until = 0
        self._parameters_tick = -1
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        if writer.signer is not None:
            # As the protocol wants it: from now on only what carries the right signature counts.
            self._parser.signing.secret_key = writer.signer.key
        self._handlers: dict[str, Callable[[Any], list[bytes]]] = {
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "MISSION_REQUEST_LIST": self._mission_list,
        }
        self._logs: LogServer | None = None

    def show_parameters(self) -> None:
        """Send all parameters once, early, as a ground station that records has asked for them."""
        # After the first heartbeats and samples: what comes before them belongs to no vehicle.
        self._parameters_tick = round(0.5 / self._sim.step_size)

    def serve(self, logs: LogServer) -> None:
        """Have logs on board."""
        self._logs = logs
        self._handlers |= logs.handlers

    @property
    def rotor_delay(self) -> float:
        """S by which rotor speeds lag behind the IMU stream's stamps."""
        return self.instruments.rotor_age - self.instruments.imu_age

    def _tick_of(self, time: float) -> int:
        return round(time / self._sim.step_size) if time else -1

    def _add_streams(self, streams: list[tuple[int, float, Callable[[], list[bytes]]]]) -> None:
        for msgid, hertz, maker in streams:
            # MAVLink 1 has one byte for a message's number.
            if self.writer.version == 2 or msgid <= 255:
                self.schedule.add(msgid, hertz, maker)

    # What goes out

    def poll(self, tick: int) -> list[bytes]:
        """Frames due at this physics step."""
        self.instruments.advance()
        if tick in self._fault_ticks:
            self._strike(tick)
        frames: list[bytes] = []
        if tick < self._silent_until:
            return frames
        if tick >= self._parameters_tick >= 0:
            self._parameters_tick = -1
            frames += self._parameter_list(None)
        if self._logs is not None:
            frames += self._logs.poll()
        for stream in self.schedule.take(tick):
            if not self._holds_back or self._is_sent(stream):
                frames += stream.make()
        if self._other_systems.some:
            frames += self._other_systems.poll()
        return self._shuffled(frames) if self._sensor_faults.disorder else frames

    def _strike(self, tick: int) -> None:
        """Do what the sensor faults have for this physics step."""
        if tick == self._reboot_tick:
            self._restart(tick)
        if tick == self._jump_tick:
            self.clock.jump(tick, round(1e6 * self._sensor_faults.clock_jump[1]))
        if tick == self._reset_tick:
            self._reset_rates(tick)

    def _is_sent(self, stream: Stream) -> bool:
        if stream.msgid in self._never_sent:
            return False
        share = self._sensor_faults.skips
        return not (share and self._skip_random.random() < share)

    def _shuffled(self, frames: list[bytes]) -> list[bytes]:
        """Some frames after the one that follows: senders of their own share the link."""
        frames = list(frames)
        for i in range(len(frames) - 1):
            if self._disorder_random.random() < self._sensor_faults.disorder:
                frames[i], frames[i + 1] = frames[i + 1], frames[i]
        return frames

    def _restart(self, tick: int) -> None:
        """Switched off and on in the air, as no real vehicle survives it: all is forgotten."""
        self._silent_until = tick + round(REBOOT_SILENCE / self._sim.step_size)
        self.clock.restart(self._silent_until, REBOOTED_US)
        self.writer.sequence = 0
        for stream in self.schedule.streams.values():
            self.schedule.set_interval(stream.msgid, 0.0, self._silent_until)

    def _reset_rates(self, tick: int) -> None:
        """What another ground station does to the rates of everything that is fast."""
        for stream in self.schedule.streams.values():
            if 0.0 < stream.interval < RESET_INTERVAL:
                self.schedule.set_interval(stream.msgid, RESET_INTERVAL, tick)

    # What comes in

    def receive(self, data: bytes, tick: int) -> list[bytes]:
        """Frames that answer what a ground station sent."""
        answers: list[bytes] = []
        for message in self._parser.parse_buffer(data) or ():
            handler = self._handlers.get(message.get_type())
            if handler is not None and self._is_for_us(message) and tick >= self._silent_until:
                answers += handler(message)
        return [frame for frame in answers if frame]

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.writer.sysid) and component in (0, self.writer.compid)

    # Commands

    def _command(self, message: Any) -> list[bytes]:
        result, extra = self._execute(message)
        ack = self.writer.frame(
            mavlink.MAVLink_command_ack_message,
            message.command,
            result,
            0,
            0,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )
        return [ack, *extra]

    def _execute(self, message: Any) -> tuple[int, list[bytes]]:
        """Do what a command asks: its MAV_RESULT and the messages asked for."""
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(message), []
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                return ACCEPTED, [self._interval(round(message.param1))]
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                if round(message.param1) == mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
                    return ACCEPTED, [self._interval(round(message.param2))]
                stream = self.schedule.streams.get(round(message.param1))
                if stream is None:
                    return self._no_such_message, []
                return ACCEPTED, stream.make()
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                return ACCEPTED, self._status.autopilot_version()
            case mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION:
                return ACCEPTED, self._status.protocol_version()
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                return ACCEPTED, self._status.home_position()
        return UNSUPPORTED, []

    _no_such_message = DENIED
    """Answer to REQUEST_MESSAGE for a message that there is not."""

    @abstractmethod
    def _set_interval(self, message: Any) -> int:
        """Do what SET_MESSAGE_INTERVAL asks; its MAV_RESULT."""

    _off = -1
    """The interval that MESSAGE_INTERVAL reports for a message that is not sent."""

    def _interval(self, msgid: int) -> bytes:
        """MESSAGE_INTERVAL: 0 for a message there is none of."""
        stream = self.schedule.streams.get(msgid)
        interval = 0 if stream is None else round(stream.interval) or self._off
        return self.writer.frame(mavlink.MAVLink_message_interval_message, interval, msgid & 0xFFFF)

    def set_rate(self, msgid: int, hertz: float) -> None:
        """Have a message sent so often, as if another ground station had asked; 0: never.

        Raises:
            KeyError: there is no such message here.
        """
        if msgid not in self.schedule.streams:
            raise KeyError(msgid)
        interval = 1e6 / hertz if hertz else -1.0
        self._execute(
            mavlink.MAVLink_command_long_message(
                0, 0, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, msgid, interval, 0, 0, 0, 0, 0
            )
        )

    # Time, parameters, mission

    def _timesync(self, message: Any) -> list[bytes]:
        if message.tc1 != 0:
            return []  # a reply to another station's request
        now = self.instruments.now_us * 1000
        return [self.writer.frame(mavlink.MAVLink_timesync_message, now, message.ts1)]

    def _ping(self, message: Any) -> list[bytes]:
        if message.target_system or message.target_component:
            return []
        return [
            self.writer.frame(
                mavlink.MAVLink_ping_message,
                message.time_usec,
                message.seq,
                message.get_srcSystem(),
                message.get_srcComponent(),
            )
        ]

    def _parameter(self, index: int, shown_index: int | None = None) -> bytes:
        parameter = self.parameters[index]
        return self.writer.frame(
            mavlink.MAVLink_param_value_message,
            parameter.wire,
            len(self.parameters),
            index if shown_index is None else shown_index,
            parameter.name.encode(),
            parameter.kind,
        )

    def _index(self, name: str) -> int | None:
        for i, parameter in enumerate(self.parameters):
            if parameter.name == name:
                return i
        return None

    def _parameter_list(self, message: Any) -> list[bytes]:
        del message
        return [self._parameter(i) for i in range(len(self.parameters))]

    def _parameter_read(self, message: Any) -> list[bytes]:
        index: int | None = message.param_index
        if index is not None and index < 0:
            index = self._index(message.param_id)
        if index is None or index >= len(self.parameters):
            return []
        return [self._parameter(index)]

    def _parameter_set(self, message: Any) -> list[bytes]:
        index = self._index(message.param_id)
        if index is None:
            return []
        self._take_parameter(self.parameters[index], message.param_value)
        return [self._parameter(index)]

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter and apply its effect.

        Raises:
            KeyError: there is no such parameter.
        """
        index = self._index(name)
        if index is None:
            raise KeyError(name)
        parameter = self.parameters[index]
        self._take_parameter(parameter, parameter.encoded(value))

    def _take_parameter(self, parameter: Parameter, wire: float) -> None:
        parameter.set(wire)

    def _mission_list(self, message: Any) -> list[bytes]:
        return [
            self.writer.frame(
                mavlink.MAVLink_mission_count_message,
                0,
                message.get_srcSystem(),
                message.get_srcComponent(),
                getattr(message, "mission_type", 0),
            )
        ]
