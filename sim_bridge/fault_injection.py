"""What the traps do to measured values. Without a trap, values pass untouched."""

import math

import numpy as np

from sim_bridge.choices import Span
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.simulated_vehicle import Vehicle

RPM = 30.0 / math.pi
"""Revolutions a minute in 1 rad/s."""

SPIKE = 8.0
"""rad/s, least size of a gyro outlier; the largest is twice that."""

FORCE_SPIKE = 40.0
"""m/s^2, the same of an accelerometer outlier."""

TILT_SPIKE = 0.5
"""rad, the same of an attitude outlier."""

RPM_SPIKE = 20_000
"""Largest wild value of a rotor speed, rpm."""

Sample = list[float]


class FaultInjector:
    """Spoils the readings of one vehicle's sensors.

    Attributes:
        sensor_faults: which are in force.
        spoils: whether any is.
        now: s since the start of the flight, set by the owner where any is in force.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        sensor_faults: SensorFaults = NO_SENSOR_FAULTS,
        seed: np.random.SeedSequence | None = None,
    ) -> None:
        self.sensor_faults = sensor_faults
        self.now = 0.0
        self.spoils = sensor_faults != NO_SENSOR_FAULTS
        # A generator each: one trap does not move what another does.
        rotor, attitude, gyro, imu, force, tilt, air = (seed or np.random.SeedSequence(0)).spawn(7)
        self._rotor_random = np.random.default_rng(rotor)
        self._attitude_random = np.random.default_rng(attitude)
        self._gyro_random = np.random.default_rng(gyro)
        self._imu_random = np.random.default_rng(imu)
        self._force_random = np.random.default_rng(force)
        self._tilt_random = np.random.default_rng(tilt)
        self._air_random = np.random.default_rng(air)
        self._spins = [rotor.spin for rotor in vehicle.rotors]
        self._last_rpm: list[int] = []
        self._last_inertial: tuple[Sample, Sample] | None = None
        self._last_angles: Sample = []

    def rpm(self, speeds: Sample) -> list[int]:
        """The rpm field for these rotor speeds in rad/s, motor by motor."""
        if not self.spoils:
            return [round(s * RPM) for s in speeds]
        sensor_faults = self.sensor_faults
        if (
            sensor_faults.rpm_repeats
            and self._last_rpm
            and self._rotor_random.random() < sensor_faults.rpm_repeats
        ):
            return self._last_rpm
        if self._last_rpm and self._is_on(sensor_faults.rpm_stuck):
            return self._last_rpm
        rpm = [round(s if sensor_faults.rpm_rad else s * RPM) for s in speeds]
        if sensor_faults.rpm_signed:
            rpm = [n * spin for n, spin in zip(rpm, self._spins, strict=True)]
        if sensor_faults.rpm_zero:
            rpm = [0] * len(rpm)
        elif 0 < sensor_faults.rpm_dead <= len(rpm):
            rpm[sensor_faults.rpm_dead - 1] = 0
        motor, silent_from = sensor_faults.esc_silent
        if 0 < motor <= len(rpm) and self.now >= silent_from:
            rpm[motor - 1] = 0
        self._last_rpm = rpm
        if sensor_faults.rpm_spikes and self._rotor_random.random() < sensor_faults.rpm_spikes:
            rpm = list(rpm)
            rpm[int(self._rotor_random.integers(len(rpm)))] = int(
                self._rotor_random.integers(RPM_SPIKE)
            )
        return rpm

    def _is_on(self, span: Span | None) -> bool:
        return span is not None and span.holds(self.now)

    def angles(self, angles: Sample) -> Sample:
        """Roll, pitch and yaw in rad, NaN, as they were, or with one far off."""
        if not self.spoils:
            return angles
        if self._is_on(self.sensor_faults.attitude_nan):
            return [math.nan] * 3
        if not (self._last_angles and self._is_on(self.sensor_faults.attitude_stuck)):
            self._last_angles = angles
        share = self.sensor_faults.attitude_outliers
        return _struck(self._last_angles, share, TILT_SPIKE, self._tilt_random)

    def pressure(self, thrust: float) -> float:
        """Pa by which a barometer is off, with the rotors at this share of full thrust."""
        full = self.sensor_faults.thrust_pressure
        return full * thrust + float(self._air_random.standard_normal()) if full else 0.0

    def quaternion(self, q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """The quaternion or its negative, which is the same attitude."""
        share = self.sensor_faults.quaternion_flips
        if share and self._attitude_random.random() < share:
            return (-q[0], -q[1], -q[2], -q[3])
        return q

    def inertial(self, gyro: Sample, accelerometer: Sample) -> tuple[Sample, Sample]:
        """Gyro (rad/s) and accelerometer (m/s^2) with outliers, repeats and bias."""
        if not self.spoils:
            return gyro, accelerometer
        sensor_faults = self.sensor_faults
        if sensor_faults.imu_frozen:
            last = self._last_inertial
            if last is not None and self._imu_random.random() < sensor_faults.imu_frozen:
                return last
        if self._is_on(sensor_faults.imu_nan):
            return [math.nan] * 3, [math.nan] * 3
        if self._last_inertial is not None and self._is_on(sensor_faults.imu_stuck):
            return self._last_inertial
        gyro = _struck(gyro, sensor_faults.gyro_outliers, SPIKE, self._gyro_random)
        share = sensor_faults.accelerometer_outliers
        accelerometer = _struck(accelerometer, share, FORCE_SPIKE, self._force_random)
        if sensor_faults.accelerometer_bias:
            accelerometer = [a + sensor_faults.accelerometer_bias for a in accelerometer]
        self._last_inertial = gyro, accelerometer
        return gyro, accelerometer


def _struck(values: Sample, share: float, least: float, random: np.random.Generator) -> Sample:
    """Values, a share of them with one off by `least` to twice that."""
    if not share or random.random() >= share:
        return values
    axis = int(random.integers(3))
    size = least * (1.0 + random.random())
    out = list(values)
    out[axis] += size * (1.0 if random.random() < 0.5 else -1.0)
    return out
