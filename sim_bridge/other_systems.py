"""Others on the same link: a second vehicle that is forwarded, a telemetry radio."""

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.instruments import Instruments
from sim_bridge.wire import FrameWriter

SECOND_SYSTEM = 2
RADIO = (51, 68)
"""System and component of a SiK radio; "3D" in ASCII."""

PERIOD = 0.02
"""s between the second vehicle's samples."""


class OtherSystems:
    """Makes the frames of other systems on the link, as the traps require.

    The second vehicle is a PX4 that sends what would spoil an estimate if it were taken for the
    first one's: rates, attitude and rotor speeds of random size.

    Attributes:
        some: whether there are any.
    """

    def __init__(self, instruments: Instruments, seed: np.random.SeedSequence) -> None:
        self._instruments = instruments
        self._sim = instruments.simulation
        sensor_faults = instruments.faults.sensor_faults
        self._random = np.random.default_rng(seed)
        self._vehicle = FrameWriter(SECOND_SYSTEM, 1) if sensor_faults.forwarded else None
        self._radio = FrameWriter(*RADIO) if sensor_faults.radio else None
        self.some = self._vehicle is not None or self._radio is not None
        self._sample_ticks = round(PERIOD / self._sim.step_size)
        self._second_ticks = round(1.0 / self._sim.step_size)

    def poll(self) -> list[bytes]:
        """Frames due at this physics step."""
        frames = []
        tick = self._sim.tick
        if self._vehicle is not None and tick % self._sample_ticks == 0:
            frames += self._second_vehicle(self._vehicle)
        if self._radio is not None and tick % self._second_ticks == 0:
            frames.append(
                self._radio.frame(mavlink.MAVLink_radio_status_message, 3, 0, 190, 185, 100, 45, 50)
            )
        return frames

    def _second_vehicle(self, writer: FrameWriter) -> list[bytes]:
        # Switched on a minute before ours.
        now = self._instruments.now_us + 60_000_000
        rates = (2.0 * self._random.standard_normal(3)).tolist()
        frames = [
            writer.frame(
                mavlink.MAVLink_highres_imu_message,
                *(now, 0.1, -0.2, -9.7, *rates, 0.2, 0.0, 0.4),
                *(955.0, 0.0, 490.0, 30.0, 63, 0),
            ),
            writer.frame(
                mavlink.MAVLink_attitude_message,
                *((now // 1000) & 0xFFFFFFFF, 0.4, -0.3, 2.0, *rates),
            ),
            writer.frame(
                mavlink.MAVLink_esc_status_message,
                *(now, *self._random.integers(3000, 9000, 4).tolist()),
                *(15.0, 15.0, 15.0, 15.0, 4.0, 4.0, 4.0, 4.0, 0),
            ),
        ]
        if self._sim.tick % self._second_ticks == 0:
            flying = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            frames.append(
                writer.frame(
                    mavlink.MAVLink_heartbeat_message,
                    *(4 << 16 | 3 << 24, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4),
                    *(flying, mavlink.MAV_STATE_ACTIVE, 3),
                )
            )
        return frames
