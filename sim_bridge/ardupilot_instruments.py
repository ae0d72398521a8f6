"""How ArduPilot measures: gyro and accelerometer low-passed, rotor speeds slewed."""

import math

from sim_bridge.autopilot import VehicleClock
from sim_bridge.fault_injection import RPM, FaultInjector
from sim_bridge.instruments import Instruments, Sample
from sim_bridge.sensors import Channel
from sim_bridge.simulation import Simulation

FILTER_HZ = 20.0
"""Usual INS_GYRO_FILTER and INS_ACCEL_FILTER, Hz."""

ESC_PERIOD = 0.005
"""s between readings of the rotor speeds."""

ERPM_STEP = 100.0
ROTOR_POLES = 14
"""An ESC counts electrical revolutions, in hundreds a minute: 14.3 rpm with 7 pole pairs."""


class LowPass2p:
    """ArduPilot's LowPassFilter2p on several signals: second-order Butterworth, bilinear.

    Attributes:
        cutoff: Hz; 0 lets everything pass.
    """

    def __init__(self, rate: float, cutoff: float) -> None:
        self._rate = rate
        self._state: list[tuple[float, float]] = []
        self.set_cutoff(cutoff)

    def set_cutoff(self, cutoff: float) -> None:
        """Filter with this cutoff from the next sample on."""
        # Just below half the rate the tangent runs away.
        self.cutoff = min(cutoff, 0.45 * self._rate)
        self._state = []
        ohm = math.tan(math.pi * max(self.cutoff, 1e-3) / self._rate)
        lean = 2.0 * math.cos(0.25 * math.pi) * ohm
        c = 1.0 + lean + ohm * ohm
        self._b = ohm * ohm / c
        self._a1 = 2.0 * (ohm * ohm - 1.0) / c
        self._a2 = (1.0 - lean + ohm * ohm) / c

    def __call__(self, sample: Sample) -> Sample:
        """The filtered sample; the first one is taken as having lasted for ever."""
        if self.cutoff <= 0.0:
            return sample
        b, a1, a2 = self._b, self._a1, self._a2
        if not self._state:
            still = 1.0 / (1.0 + a1 + a2)
            self._state = [(still * x, still * x) for x in sample]
        out = []
        state = []
        for x, (d1, d2) in zip(sample, self._state, strict=True):
            d0 = x - a1 * d1 - a2 * d2
            out.append(b * (d0 + 2.0 * d1 + d2))
            state.append((d0, d1))
        self._state = state
        return out


class ArduPilotInstruments(Instruments):
    """Readings that run on at every physics step, whether anybody asks or not.

    Attributes:
        gyro_filter: INS_GYRO_FILTER.
        accelerometer_filter: INS_ACCEL_FILTER.
    """

    def __init__(
        self,
        simulation: Simulation,
        channels: dict[str, Channel],
        clock: VehicleClock,
        faults: FaultInjector,
    ) -> None:
        super().__init__(simulation, channels, clock, faults)
        rate = 1.0 / simulation.step_size
        self.gyro_filter = LowPass2p(rate, FILTER_HZ)
        self.accelerometer_filter = LowPass2p(rate, FILTER_HZ)
        self._filtered: tuple[Sample, Sample] = ([0.0] * 3, [0.0] * 3)
        self._esc_ticks = round(ESC_PERIOD / simulation.step_size)
        self._read_at = 0
        self._reading: Sample = []
        self._last_reading: Sample = []

    @property
    def rotor_age(self) -> float:
        """S by which rotor speeds are older than the IMU sample sent before them."""
        # Slewed from the last reading but one to the last: one period late.
        return super().rotor_age + ESC_PERIOD

    def advance(self) -> None:
        """Take note of this physics step; call it at every one."""
        super().advance()
        gyro, accelerometer = self._with_noise(*self._true_inertial())
        self._filtered = self.gyro_filter(gyro), self.accelerometer_filter(accelerometer)
        tick = self.simulation.tick
        if tick % self._esc_ticks == 0:
            step = ERPM_STEP / (ROTOR_POLES / 2) / RPM
            reading = [step * round(s / step) for s in super().rotor_speeds()]
            self._last_reading = self._reading or reading
            self._reading = reading
            self._read_at = tick

    def inertial(self) -> tuple[Sample, Sample]:
        """Filtered gyro (rad/s) and accelerometer (m/s^2), body axes."""
        return self.faults.inertial(*self._filtered)

    def rates(self) -> Sample:
        """Body rates as the attitude filter has them: the filtered gyro, rad/s."""
        return self._filtered[0]

    def rotor_speeds(self) -> Sample:
        """Rotor speeds on their way from the last reading but one to the last, rad/s."""
        share = min(1.0, (self.simulation.tick - self._read_at) / self._esc_ticks)
        return [a + share * (b - a) for a, b in zip(self._last_reading, self._reading, strict=True)]
