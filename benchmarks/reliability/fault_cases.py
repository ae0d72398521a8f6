"""The faults that the study of degraded flights tries, alone and together."""

from dataclasses import dataclass

from sim_bridge.line_faults import KINDS as FAULTS
from sim_bridge.line_faults import NO_FAULTS, LineFaults, make_faults, parse_fault
from sim_bridge.sensor_faults import (
    NO_SENSOR_FAULTS,
    SensorFaults,
    make_sensor_faults,
    parse_sensor_fault,
)


@dataclass(frozen=True)
class Case:
    """Faults that act together.

    Attributes:
        name: of them, in words or as on the command line.
        line: what the link does.
        sensor_faults: what vehicle and sensors do.
    """

    name: str
    line: LineFaults = NO_FAULTS
    sensor_faults: SensorFaults = NO_SENSOR_FAULTS


def case(written: str, name: str = "") -> Case:
    """From faults and traps as the command line has them, with blanks between."""
    words = written.split()
    line = [parse_fault(w) for w in words if w.partition("=")[0] in FAULTS]
    sensor_faults = [parse_sensor_fault(w) for w in words if w.partition("=")[0] not in FAULTS]
    return Case(
        name or written.replace(" ", ", "), make_faults(line), make_sensor_faults(sensor_faults)
    )


HEADLINE = case(
    "loss=0.2 reorder=0.05 scatter=20", "20 % loss, 5 % reordering, 20 ms jitter that overtakes"
)

DROPOUTS = (
    case("silence=12:2:9", "2 s of silence every 9 s"),
    case("silence=12:2:9 loss=0.2 reorder=0.05 scatter=20", "the same with the line above"),
)

CASES = (
    Case("clean"),
    # The link.
    case("loss=0.2"),
    case("loss=0.5"),
    case("bursts=0.2:30"),
    case("bursts=0.2:300"),
    case("duplicate=0.3"),
    case("reorder=0.3"),
    case("jitter=50"),
    case("scatter=20"),
    case("scatter=100"),
    case("delay=500"),
    case("corrupt=0.1"),
    case("bandwidth=50000"),
    case("silence=10:2:8"),
    case("stall=HIGHRES_IMU:10:3"),
    case("stall=ESC_STATUS:10:4"),
    case("stall=ATTITUDE:10:4 stall=ATTITUDE_QUATERNION:10:4"),
    case("stall=HEARTBEAT:5:30"),
    case("garbage=200"),
    case("forged=5"),
    case("flood=500"),
    # Sensors.
    case("gyro-outliers=0.01"),
    case("accelerometer-outliers=0.01"),
    case("attitude-outliers=0.01"),
    case("imu-frozen=0.05"),
    case("imu-nan=10:0.5:4"),
    case("imu-stuck=10:0.5:4"),
    case("imu-stuck=10:3"),
    case("attitude-nan=10:1:5"),
    case("attitude-stuck=10:1:5"),
    case("rpm-stuck=10:0.5:4"),
    case("rpm-stuck=10:4"),
    case("rpm-spikes=0.005"),
    case("rpm-repeats=0.1"),
    case("never-sent=ESC_STATUS"),
    case("rpm-dead=2"),
    case("esc-silent=2:20"),
    case("esc-silent=2:20 never-sent=ACTUATOR_OUTPUT_STATUS never-sent=SERVO_OUTPUT_RAW"),
    # Time.
    case("reboot=20"),
    case("clock-jump=20:30"),
    case("clock-jump=20:0.5"),
    case("clock-jump=20:-0.5"),
    case("clock-jump=20:-10"),
    case("wrap-us=20"),
    case("wrap-ms=20"),
    case("clock-drift=8000"),
    # Together.
    case("forwarded radio forged=5 garbage=100 loss=0.1"),
    case("loss=0.2 reorder=0.05 scatter=20 silence=10:2:8 corrupt=0.02 duplicate=0.05"),
    case("bursts=0.2:50 jitter=30 gyro-outliers=0.005 imu-frozen=0.02 skips=0.02"),
    case("loss=0.1 reboot=20 wrap-ms=10 reorder=0.05"),
    case("loss=0.1 rpm-spikes=0.005 rpm-repeats=0.05 imu-stuck=10:0.5:6 attitude-stuck=12:0.5:6"),
)
"""All but the first, which the others are compared with."""
