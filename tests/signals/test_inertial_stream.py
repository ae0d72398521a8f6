"""What a faulty inertial sensor does to the estimate: next to nothing, and it is told."""

import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.inertial_stream import at_cg
from gcs_sysid.signals.records import Stream
from tests.feeding import feed

END_ONLY = ChainOptions()


def run(records, options=END_ONLY):
    chain = Chain(load_airframe("paper"), options)
    feed(chain, records)
    return chain, chain.finish()


@pytest.fixture(scope="module")
def records(paper_records):
    """The first mode of the article's flight, and a little of the second."""
    return [r for r in paper_records if r.t - paper_records[0].t < 24.0]


@pytest.fixture(scope="module")
def whole(records):
    return run(records)[1]


def spoilt(records, share, how, seed=1):
    """Some IMU records changed, and how many; `how` takes values, last values and a generator."""
    rng = np.random.default_rng(seed)
    out, count, last = [], 0, None
    for record in records:
        if record.stream is Stream.IMU and last is not None and rng.random() < share:
            record = record._replace(values=tuple(how(record.values, last, rng)))
            count += 1
        if record.stream is Stream.IMU:
            last = record.values
        out.append(record)
    return out, count


def spike(values, last, rng):
    struck = list(values)
    struck[rng.integers(3)] += rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 12.0)
    return struck


def repeat(values, last, rng):
    return last


def no_gyro(values, last, rng):
    return (math.nan, *values[1:])


def no_accelerometer(values, last, rng):
    return (*values[:3], math.nan, math.nan, math.nan)


def agree(result, whole, share=1.0):
    assert result.verdict == whole.verdict
    for name, estimate in whole.parameters.items():
        bar = share * estimate.std + 1e-12 * abs(estimate.value)
        assert result.parameters[name].value == pytest.approx(estimate.value, abs=bar), name
        assert result.parameters[name].std < 1.5 * estimate.std + 1e-12, name


@pytest.mark.slow
def test_clean_samples_are_not_touched(whole):
    assert whole.telemetry["imu_outliers"] == {"spikes": 0, "frozen": 0, "missing": 0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "kind"), [(spike, "spikes"), (repeat, "frozen"), (no_gyro, "missing")]
)
def test_the_estimate_holds_and_the_faults_are_told(records, whole, how, kind):
    faulty, count = spoilt(records, 0.02, how)
    assert count >= 6
    chain, result = run(faulty)
    agree(result, whole)
    told = result.telemetry["imu_outliers"]
    assert told.pop(kind) == pytest.approx(count, abs=1)
    assert not any(told.values())
    assert any("spikes" in event.text for event in chain.events) == (kind == "spikes")


@pytest.mark.slow
@pytest.mark.parametrize("share", [pytest.param(0.02, marks=pytest.mark.thorough), 1.0])
def test_an_accelerometer_that_fails_costs_nothing(records, whole, share):
    """Momentum balance gives the scale."""
    agree(run(spoilt(records, share, no_accelerometer)[0])[1], whole, 0.05)


@pytest.mark.slow
def test_a_sensor_that_stands_still_is_missing_and_holds_nothing_up(records, whole):
    first, stuck, faulty = records[0].t, None, []
    for record in records:
        if record.stream is Stream.IMU and 12.0 < record.t - first < 15.0:
            stuck = stuck or record.values
            record = record._replace(values=stuck)
        faulty.append(record)
    chain = Chain(load_airframe("paper"), END_ONLY)
    behind = 0.0
    for n in range(0, len(faulty), 50):
        some = faulty[n : n + 50]
        feed(chain, some)
        if some[-1].t - first > 5.0:
            behind = max(behind, some[-1].t - first - chain.t)
    result = chain.finish()
    assert behind < 2.0
    assert result.telemetry["imu_outliers"]["frozen"] == pytest.approx(59, abs=2)
    lost = whole.telemetry["used_seconds"] - result.telemetry["used_seconds"]
    assert 3.0 <= lost < 8.0
    assert result.parameters["Ixx"].value == pytest.approx(0.0165, rel=0.02)


def test_the_lever_arm_is_subtracted_as_rigid_bodies_have_it():
    """Against the second derivative of where the sensor is, in axes that turn at a steady rate."""
    t = np.arange(0.0, 2.0, 1e-3)
    arm = np.array([0.05, -0.03, 0.04])
    # About one axis at a time, angle 0.4 sin(5 t): all is known in closed form.
    w, dw = 2.0 * np.cos(5.0 * t), -10.0 * np.sin(5.0 * t)
    for axis in np.eye(3):
        radial = arm - axis * (arm @ axis)
        reads = dw[:, None] * np.cross(axis, arm) - (w**2)[:, None] * radial
        force = np.array([0.1, -0.2, -9.8])
        moved = at_cg(t, w[:, None] * axis, force + reads, tuple(arm), 0.03)
        np.testing.assert_allclose(moved[1:-1], np.tile(force, (len(t) - 2, 1)), atol=1e-5)


@pytest.fixture(scope="module")
def off_center(fly, tmp_path_factory):
    """A flight without velocity of a vehicle with its IMU far off, and its airframe."""
    arm = (0.15, -0.10, -0.15)
    builtin = resources.files("gcs_sysid.model") / "airframes" / "paper.toml"
    vehicle = resources.files("sim_bridge") / "vehicles" / "paper.toml"
    file = tmp_path_factory.mktemp("off-center") / "off-center.toml"
    imu = "".join(f"imu_{axis} = {value}\n" for axis, value in zip("xyz", arm, strict=True))
    file.write_text(f"{builtin.read_text()}\n[simulation]\n{vehicle.read_text()}{imu}")
    options = ("--airframe", str(file), "--mission", "all-axes", "--rate", "50", "--seed", "1")
    flight = fly(*options, "--noise", "mems", "--duration", "16")
    records = [r for r in flight.records() if r.stream is not Stream.VELOCITY]
    # The file tells where the IMU is from the CG; the airframe counts from the center.
    cg = (flight.truth["cg_x"], flight.truth["cg_y"])
    given = replace(load_airframe(str(file)), imu_position=(arm[0] + cg[0], arm[1] + cg[1], arm[2]))
    given = given.with_prior("cg_x", cg[0], 0.01).with_prior("cg_y", cg[1], 0.01)
    return flight, records, given


@pytest.mark.slow
def test_a_given_lever_arm_frees_the_accelerometer_of_it(off_center):
    flight, records, given = off_center
    errors = {}
    for airframe in (given, replace(given, imu_position=None)):
        chain = Chain(airframe, END_ONLY)
        feed(chain, records)
        found = chain.finish().parameters["k_T"]
        off = found.value - flight.truth["k_T"]
        assert abs(off) < 1.96 * found.std
        errors[airframe.imu_position] = abs(off) / flight.truth["k_T"], found.std / found.value
    (known, sure), (unknown, unsure) = errors.values()
    assert known < 0.006
    assert unknown > 0.01
    assert unsure > 1.05 * sure
