"""When the vehicle counts as flying."""

import numpy as np
import pytest

from gcs_sysid.signals.flight_detection import TAKE_OFF, FlightDetector

RATE = 50.0
T = np.arange(0.0, 30.0, 1.0 / RATE)
UNKNOWN = np.full(len(T), np.nan)


def between(start, end, inside=1.0, outside=0.0):
    return np.where((start <= T) & (end > T), inside, outside)


def flown(in_air=UNKNOWN, armed=UNKNOWN, speed=UNKNOWN, height=UNKNOWN, block=10**6):
    """Times of the samples that count."""
    detector = FlightDetector()
    speeds = np.repeat(speed[:, None], 4, axis=1)
    position = np.stack([0.0 * T, 0.0 * T, -height], axis=1)
    flies = [
        detector.update(T[k], in_air[k], armed[k], speeds[k], position[k])
        for k in (slice(i, i + block) for i in range(0, len(T), block))
    ]
    return T[np.concatenate(flies)]


def spans(times, start, end):
    assert times[0] == pytest.approx(start, abs=1.5 / RATE)
    assert times[-1] == pytest.approx(end, abs=1.5 / RATE)
    assert len(times) == pytest.approx((end - start) * RATE, abs=2)


def test_the_autopilot_says_it():
    spans(flown(in_air=between(10.0, 20.0)), 10.0 + TAKE_OFF, 20.0)


def test_a_flight_that_was_on_when_the_record_began_counts_from_there():
    spans(flown(in_air=between(0.0, 20.0)), 0.0, 20.0)


@pytest.mark.parametrize("tells", ["armed", "speed"])
def test_what_stands_does_not_fly_though_the_autopilot_tells_late(tells):
    spans(flown(in_air=between(10.0, 20.5), **{tells: between(8.0, 20.0)}), 11.0, 20.0)


def test_armed_rotors_that_turn_serve_where_nothing_is_told():
    spans(flown(armed=between(8.0, 25.0), speed=between(10.0, 20.0, 500.0)), 11.0, 20.0)
    assert len(flown(armed=0.0 * T, speed=500.0 + 0.0 * T)) == 0
    assert len(flown()) == 0


def test_height_tells_idling_on_the_ground_from_flight():
    height = 37.0 + between(12.0, 20.0, 5.0)  # above wherever the autopilot counts from
    idles = {"armed": between(8.0, 25.0), "speed": between(9.0, 24.0, 500.0)}
    spans(flown(height=height, **idles), 12.0 + TAKE_OFF, 20.0)
    # Where it stood is not known when the record begins in flight.
    spans(flown(height=height, speed=500.0 + 0.0 * T), 0.0, T[-1])


def test_forged_heartbeats_do_not_land_it():
    """They say disarmed; the autopilot says that it flies, and all rotors turn."""
    forged = np.where((T > 9.0) & (np.floor(10.0 * T) % 2.0 == 0.0), 0.0, between(8.0, 20.0))
    turning = {"in_air": between(10.0, 20.0), "speed": between(9.0, 20.5, 500.0)}
    spans(flown(armed=forged, **turning), 11.0, 20.0)
    assert len(flown(armed=forged, in_air=turning["in_air"])) == 0  # nothing bears it out


@pytest.mark.parametrize("block", [1, 7, 100])
def test_size_of_blocks_does_not_matter(block):
    height = between(12.0, 20.0, 5.0)
    told = np.where(T < 3.0, np.nan, between(5.0, 12.0))
    for streams in (
        {"in_air": told, "armed": between(4.0, 11.0), "speed": between(4.0, 10.0)},
        {"armed": between(8.0, 25.0), "speed": between(9.0, 24.0, 500.0), "height": height},
    ):
        np.testing.assert_array_equal(flown(**streams, block=block), flown(**streams))


@pytest.mark.parametrize(("height", "flies"), [(0.29, False), (0.31, True)])
def test_a_third_of_a_metre_above_the_ground_is_flight(height, flies):
    heights = 12.0 + between(12.0, 20.0, height)
    found = flown(height=heights, armed=between(8.0, 25.0), speed=between(9.0, 24.0, 500.0))
    assert bool(len(found)) is flies


def test_commands_of_hardly_anything_are_rotors_that_turn():
    spans(flown(speed=between(10.0, 20.0, 0.05)), 11.0, 20.0)


def test_a_single_rotor_that_stands_is_no_landing_and_no_flight():
    detector = FlightDetector()
    speeds = np.full((len(T), 4), 500.0)
    speeds[:, 2] = 0.0
    unknown = np.full((len(T), 3), np.nan)
    assert not detector.update(T, UNKNOWN, UNKNOWN, speeds, unknown).any()
    assert FlightDetector().update(T, 0.0 * T + 1.0, UNKNOWN, speeds, unknown).all()


def test_take_off_is_a_second():
    assert TAKE_OFF == 1.0
