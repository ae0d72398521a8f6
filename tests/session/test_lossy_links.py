"""What a bad link and wild sensors do to the estimate: wider intervals that hold."""

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.rotor_speed_stream import RotorBuffer, wild_rows
from gcs_sysid.signals.time_base import TimeBase
from gcs_sysid.significance import Z95
from tests.feeding import feed, grid_of

GAP = 0.04
SECONDS = 15


def run(records):
    chain = Chain(load_airframe("paper"), ChainOptions())
    feed(chain, records)
    return chain, chain.finish()


@pytest.fixture(scope="module")
def lossy(fly):
    """A flight at 100 Hz of which a fifth is lost, the rest late by up to 20 ms."""
    faults = ("--fault", "loss=0.2", "--fault", "reorder=0.05", "--fault", "scatter=20")
    flight = fly("--mission", "all-axes", "--rate", "100", "--duration", str(SECONDS), *faults)
    return flight, flight.records()


@pytest.mark.slow
def test_losses_and_wild_rotor_speeds_cost_little_more_than_what_is_lost(lossy):
    flight, records = lossy
    rng = np.random.default_rng(1)
    spoilt, wild = [], 0
    for record in records:
        if record.source == "ESC_STATUS" and rng.random() < 0.005:
            speeds = list(record.values)
            speeds[rng.integers(4)] = 2500.0
            record = record._replace(values=tuple(speeds))
            wild += 1
        spoilt.append(record)
    chain, result = run(spoilt)
    assert result.verdict == "identified"
    for name in ("Ixx", "Iyy", "Izz", "cg_x", "cg_y", "k_T", "k_M"):
        estimate = result.parameters[name]
        assert abs(estimate.value - flight.truth[name]) < 2.0 * Z95 * estimate.std, name
    assert chain.fit.seconds > 0.7 * SECONDS
    assert result.telemetry["grid_rate"] == pytest.approx(100.0)
    assert result.telemetry["restarts"] == 0
    assert 3 <= result.telemetry["rotor_outliers"] <= wild


def imu_times(share, seconds=12.0, rate=250.0):
    random = np.random.default_rng(3)
    times = np.arange(round(seconds * rate)) / rate
    return times[random.random(len(times)) >= share]


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_losses_do_not_look_like_another_rate(share):
    base = TimeBase()
    imu = [
        Record(Stream.IMU, float(t), (0.1, 0.2, 0.3, 0.0, 0.0, float(t))) for t in imu_times(share)
    ]
    assert list(grid_of(base, imu, 5))
    assert base.restarts == 0


def speeds_of(times):
    """Four rotors that are worked hard, and a step at 1 s."""
    phases = np.arange(4.0)
    smooth = 500.0 + 150.0 * np.sin(2.0 * np.pi * 2.7 * times[:, None] + phases)
    return np.where(times[:, None] < 1.0, smooth, smooth + 200.0)


@pytest.mark.parametrize("rate", [20.0, 50.0, 250.0])
def test_motion_is_not_wild_and_single_values_are(rate):
    t = np.arange(round(2.0 * rate)) / rate
    v = speeds_of(t)
    gap = max(GAP, 2.6 / rate)
    assert not wild_rows(t, v, gap).any()
    dead = np.where(t[:, None] > 1.5, v * [1.0, 1.0, 0.0, 1.0], v)
    assert not wild_rows(t, dead, gap).any()
    at = len(t) // 4
    v[at, 2] = 2500.0  # at 20 Hz, a 0 in such motion could be motion
    assert np.flatnonzero(wild_rows(t, v, gap)).tolist() == [at]
    # Beside a gap nothing is judged.
    kept = np.abs(t - t[at + 1]) > 0.5 * gap + 0.5 / rate
    kept[at] = True
    assert not wild_rows(t[kept], v[kept], 1.2 / rate).any()


def give(buffer, t, v):
    """Samples, with a tick after them."""
    buffer.extend(np.array(t), np.array(v), np.array([len(t)]))


def asked(buffer, grid):
    """What a buffer tells at its last tick."""
    return buffer.at(grid, np.zeros(len(grid), int))


def test_a_verdict_does_not_depend_on_when_it_is_asked_for():
    t = np.arange(500) / 250.0
    v = speeds_of(t)
    v[100, 0], v[300, 1] = 0.0, 3000.0
    one, late = RotorBuffer(4), RotorBuffer(4)
    grid, given = t[5:480] + 0.001, []
    for time, speeds in zip(t, v, strict=True):
        give(one, [time], [speeds])
        give(late, [time], [speeds])
        settled = one.settled(np.array([time]))
        ready = grid[(grid <= settled) & (grid > (given[-1][0] if given else 0.0))]
        given += [(float(g), asked(one, ready[i : i + 1])[0]) for i, g in enumerate(ready)]
    times, values = zip(*given, strict=True)
    np.testing.assert_array_equal(np.array(values), asked(late, np.array(times)))
    assert late.wild == 2
    assert np.nanmax(np.abs(np.diff(values, axis=0))) < 250.0


def moving(seconds=6.0, rate=250.0, seed=7):
    """Times and whole rpm of four rotors, as an ESC tells them."""
    t = np.arange(round(seconds * rate)) / rate
    noise = np.random.default_rng(seed).normal(0.0, 5.0, (len(t), 4))
    return t, np.round(speeds_of(t) * 9.55 + noise)


def given_out(t, v, grid):
    """What a stream gives at grid times, each asked for as soon as it is settled."""
    buffer, values, done = RotorBuffer(v.shape[1]), np.full((len(grid), v.shape[1]), np.nan), 0
    for start in range(0, len(t), 25):
        part = slice(start, start + 25)
        give(buffer, t[part], v[part])
        upto = int(np.searchsorted(grid, buffer.settled(t[part][-1:])[0], side="right"))
        if upto > done:
            values[done:upto] = asked(buffer, grid[done:upto])
            buffer.forget_before(grid[upto - 1])
            done = upto
    return buffer, values[:done]


def test_speeds_that_stand_still_under_new_stamps_are_taken_for_lost():
    t, v = moving()
    v[1000:1125] = v[999]
    buffer, values = given_out(t, v, t[5:] + 0.001)
    lost = np.isnan(values).any(axis=1)
    times = (t[5:] + 0.001)[: len(values)]
    np.testing.assert_array_equal(lost, (times > t[999]) & (times < t[1125]))
    assert buffer.still == 125
    assert buffer.wild == 0


@pytest.mark.slow
def test_a_stream_that_often_repeats_itself_is_no_fault():
    t, v = moving()
    v = v[np.arange(len(v)) // 4 * 4]  # readings at a quarter of the rate
    v[1000:1125] = v[999]
    buffer, values = given_out(t, v, t[5:] + 0.001)
    assert buffer.still == 0
    assert np.isfinite(values).all()
