"""The chain from records to results, on the article's flight."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.session.analysis import analyze_log, take_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.records import Samples, Stream
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.sampling import SampleBlock
from tests.feeding import feed

END_ONLY = ChainOptions()


def run(records, options=END_ONLY, airframe=None, **how):
    chain = Chain(airframe or load_airframe("paper"), options)
    feed(chain, records, **how)
    return chain, chain.finish()


def values(result):
    return {n: e.value for n, e in result.parameters.items() if e.value is not None}


def rounded(result):
    """What other results are, but for rounding: sums are the same, their order is not."""
    known = {n: e for n, e in result.parameters.items() if e.value is not None}
    return {n: pytest.approx(e.value, rel=1e-7, abs=1e-5 * e.std) for n, e in known.items()}


@pytest.fixture(scope="module")
def beginning(paper_records):
    return [r for r in paper_records if r.t - paper_records[0].t < 24.0]


@pytest.fixture(scope="module")
def begun(beginning):
    return run(beginning)


@pytest.mark.slow
@pytest.mark.parametrize("tick", [0.001, pytest.param(1.0, marks=pytest.mark.thorough)])
def test_size_of_blocks_does_not_matter(beginning, begun, tick):
    _, other = run(beginning, replace(END_ONLY, tick=tick), at_once=50)
    assert values(other) == rounded(begun[1])
    for name, estimate in begun[1].parameters.items():
        assert other.parameters[name].status == estimate.status


@pytest.mark.slow
def test_course_does_not_move_the_final_result(beginning, begun):
    assert begun[0].history.t.size == 0
    chain, result = run(beginning, ChainOptions(history_interval=1.0))
    assert values(result) == rounded(begun[1])
    history = chain.history
    assert len(history.t) > 17
    # Instants are those of samples, at 20 Hz.
    assert np.abs(np.diff(history.t) - 1.0).max() < 0.051
    assert np.mean(np.diff(history.t)) == pytest.approx(1.0, abs=0.001)
    assert set(history.value) == set(history.std) == set(PARAMETERS)
    # The last point is the quick fit of nearly all data: well within its own interval.
    last, known = history.value["Ixx"][-1], result.parameters["Ixx"]
    assert last == pytest.approx(known.value, abs=known.std)


def without(records, *streams):
    return [r for r in records if r.stream not in streams]


@pytest.mark.parametrize(
    ("gone", "reason"), [(Stream.IMU, "no IMU data"), (Stream.ROTOR_SPEED, "no rotor speeds")]
)
def test_what_is_missing_is_the_reason(beginning, gone, reason):
    commands = () if gone is Stream.IMU else (Stream.ROTOR_COMMAND,)
    _, result = run(without(beginning, gone, *commands))
    assert result.verdict == "refused"
    (said,) = [r for r in result.reasons if r.startswith("no ")]
    assert said.startswith(reason)
    assert set(values(result)) == {"mass"}
    assert result.parameters["mass"].status == "given"


@pytest.mark.slow
def test_without_attitude_the_accelerometer_gives_the_scale(beginning, begun):
    _, result = run(without(beginning, Stream.ATTITUDE))
    assert result.parameters["linear_drag"].value is None
    assert result.parameters["k_T"].std > begun[1].parameters["k_T"].std
    assert result.parameters["Ixx"].value == pytest.approx(0.0165, rel=0.02)


@pytest.mark.slow
def test_nothing_is_estimated_while_it_does_not_fly(beginning):
    still = (Stream.IN_AIR, Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
    grounded = [r._replace(values=(0.0,) * 4) if r.stream in still else r for r in beginning]
    chain, result = run(grounded)
    assert not chain.sampler.flying
    assert result.verdict == "refused"
    assert any("in the air" in reason for reason in result.reasons)
    assert result.telemetry["used_seconds"] == 0.0
    assert chain.sampler.attitude is not None  # shown on the ground too


@pytest.mark.slow
def test_armed_and_turning_rotors_serve_where_in_air_is_not_told(beginning, begun):
    _, result = run(without(beginning, Stream.IN_AIR))
    for name in ("Ixx", "Izz", "k_T"):
        estimate = begun[1].parameters[name]
        assert result.parameters[name].value == pytest.approx(estimate.value, abs=estimate.std)
    disarmed = [r._replace(values=(0.0,)) if r.stream is Stream.ARMED else r for r in beginning]
    _, result = run(without(disarmed, Stream.IN_AIR))
    assert result.verdict == "refused"


def test_less_than_three_seconds_claim_nothing(paper_records):
    # The grid starts after 64 samples (3.2 s) and the first window takes 0.4 s.
    first = paper_records[0].t
    _, result = run([r for r in paper_records if r.t - first < 2.5])
    assert result.verdict == "refused"
    assert "Ixx" not in values(result)


@pytest.mark.slow
def test_a_reboot_in_the_middle_costs_little(beginning):
    """The vehicle's clock starts again, below where the log began."""
    first, half = beginning[0].t, len(beginning) // 2
    second = [r._replace(t=r.t - beginning[half].t + 0.5) for r in beginning[half:]]
    before = [r._replace(t=r.t - first + 1000.0) for r in beginning[:half]]
    chain, result = run([*before, *second])
    assert result.telemetry["restarts"] == 1
    assert result.segments == ()
    assert result.parameters["mass"].status == "given"
    # 64 samples to learn the step again, and two windows.
    assert result.telemetry["used_seconds"] > 16.0
    assert chain.t == pytest.approx(beginning[-1].t - first, abs=4.0)
    assert result.parameters["Ixx"].value == pytest.approx(0.0165, rel=0.02)
    # A limit counts the time of the session, not of the clock.
    _, cut = run([*before, *second], replace(END_ONLY, end=18.0))
    assert 10.0 < cut.telemetry["used_seconds"] < 18.0


@pytest.mark.slow
def test_who_reboots_has_landed_and_may_have_been_changed(beginning):
    """Though nothing of the ground was recorded: a payload would be a disturbance, or missed."""
    half = len(beginning) // 2
    back = beginning[half].t - 0.5
    faster = np.sqrt(1.2)  # what a mass and an inertia larger by a fifth take
    second = [
        r._replace(t=r.t - back, values=tuple(np.multiply(r.values, faster)))
        if r.stream is Stream.ROTOR_SPEED
        else r._replace(t=r.t - back)
        for r in beginning[half:]
    ]
    _, result = run([*beginning[:half], *second])
    assert [event["channel"] for event in result.events] == ["landing"]
    mass = result.parameters["mass"]
    assert mass.value == pytest.approx(1.2 * 1.5, rel=0.005)
    assert mass.status != "given"


@pytest.mark.slow
def test_a_gap_is_bridged(beginning, begun):
    first = beginning[0].t
    _, result = run([r for r in beginning if not 12.0 < r.t - first < 15.0])
    assert result.telemetry["restarts"] == 1
    assert result.verdict == "identified"
    for name in ("Ixx", "Izz", "k_M"):
        estimate = begun[1].parameters[name]
        assert result.parameters[name].value == pytest.approx(estimate.value, abs=2 * estimate.std)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "believed"), [(1.0, True), (1.5, False)])
def test_a_prior_that_the_flight_contradicts_is_named_and_not_used(
    beginning, paper_flight, begun, share, believed
):
    k_M = paper_flight.truth["k_M"]
    airframe = replace(load_airframe("paper"), priors={"k_M": (share * k_M, 0.01 * k_M)})
    _, result = run(beginning, airframe=airframe)
    assert [o.by for o in result.objections if o.by == "priors"] == ["priors"] * (not believed)
    assert result.verdict == ("identified" if believed else "partial")
    alone = begun[1].parameters["k_M"]
    found = result.parameters["k_M"]
    if believed:
        assert found.std < alone.std
    else:
        assert found.value == pytest.approx(alone.value, rel=1e-6)
        assert result.parameters["Izz"].status == "identified"


def test_an_airframe_without_scale_is_refused():
    with pytest.raises(ValueError, match="no scale reference"):
        Chain(load_airframe("px4-quad-x"))


@pytest.mark.slow
def test_a_wrong_airframe_is_told_apart_from_a_short_flight(beginning):
    airframe = load_airframe("paper")
    one, two, three, four = airframe.rotors
    swapped = replace(airframe, rotors=(three, two, one, four))
    result = run(beginning, airframe=swapped)[1]
    assert result.verdict == "refused"
    assert "rotors 1 and 3 look swapped" in result.reasons[0]
    turned = tuple(replace(rotor, spin=-rotor.spin) for rotor in airframe.rotors)
    result = run(beginning, airframe=replace(airframe, rotors=turned))[1]
    assert result.verdict == "partial"
    assert result.parameters["k_M"].value < 0.0
    assert "check spin in the airframe file" in "; ".join(result.reasons)


def test_a_rotor_stream_that_dies_and_comes_again_is_told():
    chain = Chain(load_airframe("paper"))
    speeds = RotorSource(RotorInput.SPEED, "ESC_STATUS", "measured speeds")
    nothing = Samples(*(np.full((4, n), np.nan) for n in (3, 3, 4, 4, 3, 3)))
    chain.rotor_selector.refused["ESC_STATUS"] = "rotor 2 reads 0 while the others move"
    for rotors in (speeds, None, None, replace(speeds, why="again"), replace(speeds, scale=2.0)):
        block = SampleBlock(np.arange(4.0), nothing, np.zeros(4, bool), 1.0, False, rotors)
        chain.learn(block)
    assert {event["kind"] for event in chain.log.of_rotors} == {"rotor_input"}
    died, again, other = (event["text"] for event in chain.log.of_rotors)
    assert died.startswith("ESC_STATUS rotor 2 reads 0 while the others move, and no other")
    assert again == "ESC_STATUS is usable again: the estimate continues"
    assert other.endswith("estimate restarts")


@pytest.mark.parametrize("never_moved", [True, False])
def test_an_estimate_from_a_dead_reading_is_discarded(never_moved):
    chain = Chain(load_airframe("paper"))
    chain.rotors = RotorSource(RotorInput.SPEED, "ESC_STATUS", "measured speeds")
    chain.fit = before = replace(chain.fit, seconds=5.0)
    chain.rotor_selector.refused["ESC_STATUS"] = "rotor 2 stands still while the others move"
    chain.rotor_selector.never_moved = never_moved
    nothing = Samples(*(np.full((4, n), np.nan) for n in (3, 3, 4, 4, 3, 3)))
    chain.learn(SampleBlock(np.arange(4.0), nothing, np.zeros(4, bool), 1.0, False, None))
    text = chain.log.of_rotors[0]["text"]
    assert ("is discarded" in text) is never_moved
    assert (chain.fit.seconds == 0.0) is never_moved
    assert (chain.fit is before) is not never_moved
    assert chain.input_lost == "ESC_STATUS rotor 2 stands still while the others move"


def test_parameters_of_later_blocks_are_known_before_the_samples():
    done = []

    class Block(str):
        def windows(self, size):
            return [self]

    log = SimpleNamespace(blocks=lambda: map(Block, "abc"), share_read=1.0)
    learning = SimpleNamespace(
        learn_parameters=lambda block: done.append(f"learn {block}"),
        take=lambda block: done.append(f"take {block}"),
        outdated=False,
    )
    assert take_log(learning, log)
    assert done == ["learn a", "learn b", "learn c", "take a", "take b", "take c"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "by"), [pytest.param("250", "command", marks=pytest.mark.thorough), ("100", "speed")]
)
def test_two_of_many_rotors_that_are_swapped_are_named(fly, rate, by):
    """The fit explains 98.4 to 99.9 % of each axis even so, by commands all but yaw."""
    flight = "--mission", "all-axes", "--rate", rate, "--seed", "3", "--duration", "10"
    octo = fly(*flight, "--airframe", "px4-octo-x", "--param", "CA_AIRFRAME=1")
    airframe = load_airframe("px4-octo-x").with_anchor("mass", octo.truth["mass"])
    airframe = replace(airframe, rotor_input=by)
    one, two, *others, eight = airframe.rotors
    result = analyze_log(octo.tlog, replace(airframe, rotors=(one, eight, *others, two)))
    assert result.verdict == "refused"
    assert "rotors 2 and 8 look swapped" in result.reasons[0]
    assert result.parameters["Ixx"].status == "unobservable"
    if by == "speed":
        assert "swapped" not in str(analyze_log(octo.tlog, airframe).reasons)
