"""What `inspect` promises of a log, held to what `analyze` then tells of it."""

from dataclasses import replace
from pathlib import Path

import pytest

from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.inspection.inspector import inspect_log, judged
from gcs_sysid.judgement.prediction import RULES
from gcs_sysid.judgement.received import TOO_MUCH_LOSS
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.signals.records import Stream
from testbed.recordings import airframe_of, rectangle

LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs"
_BY_HAND = {
    "real-quad-copter33": ("ardupilot-quad-x", 0.25, 1.5),
    "real-quad-mavlink1": ("ardupilot-quad-x", 0.25, 1.5),
    "px4-sitl": ("px4-quad-x", 0.25, 1.5),
    "quiver_00000087": ("ardupilot-quad-x", 0.75, 18.0),
}
_SUFFIXES = {".tlog", ".bin", ".ulg", ".BFL"}


def airframe_for(log: Path) -> Airframe:
    """As its files tell, or as a user would give it."""
    if log.stem in _BY_HAND:
        name, arm, mass = _BY_HAND[log.stem]
        return load_airframe(name).with_arm(arm).with_anchor("mass", mass)
    if log.stem == "px4-esc-cg":
        return rectangle("px4-quad-x", 0.17, 0.17).with_anchor("mass", 1.1)
    if log.stem == "ardupilot-sitl":
        return rectangle("ardupilot-quad-x", 0.16, 0.18).with_anchor("mass", 1.6)
    if log.stem.startswith("LOG"):
        name = "cinerat_cmd.toml" if "_cmd" in log.stem else "cinerat.toml"
        return load_airframe(str(log.with_name(name)))
    if log.stem == "crazyflie_log15":
        return load_airframe(str(log.with_name("crazyflie.toml")))
    airframe = airframe_of(log)
    return airframe if airframe.anchor() else airframe.with_anchor("mass", 1.0)


@pytest.mark.thorough
@pytest.mark.skipif(not LOGS.is_dir(), reason="no ../shared/logs beside the project")
@pytest.mark.parametrize(
    "log",
    [p for p in sorted(LOGS.rglob("*")) if p.suffix in _SUFFIXES and "field" not in p.parts],
    ids=lambda log: log.name,
)
def test_analyze_tells_of_a_recorded_flight_what_inspect_promised(log):
    airframe = airframe_for(log)
    found = inspect_log(log, airframe=airframe)
    promised, rotors = found.obtainable, found.rotor_input.chosen
    told = analyze_log(log, airframe)
    known = {n for n, p in told.parameters.items() if p.status in ("given", "identified", "zero")}
    scale = {"k_T", "T_max"} & set(told.parameters)
    if promised in ("everything", "all but Izz"):
        # That there is information; that the model lacks something, the residuals alone show.
        assert {"Ixx", "Iyy", "cg_x", "cg_y"} <= known or "not noise" in " ".join(told.reasons)
        assert scale & known
        if promised == "everything" and "Izz" not in known:
            # Neither a simulator whose yaw is no rigid body's nor slow commands in yaw are seen.
            assert any("rigid body" in r or "share one scale" in r for r in told.reasons)
    elif promised == "in part" and rotors is not None and rotors.kind == "command":
        assert told.verdict != "identified"
        assert told.parameters["T_max"].status == "weak"
        assert ReadLog(log).health(HealthOptions(airframe)).available
    elif promised == "in part":
        assert told.verdict == "partial"
        assert scale & known
        assert ReadLog(log).health(HealthOptions(airframe)).available
    else:
        assert told.verdict == "refused"
        assert promised == "health"
        assert ReadLog(log).health(HealthOptions(airframe)).available


@pytest.fixture(scope="module")
def found(fly):
    """A sound flight, inspected."""
    flight = ("--mission", "all-axes", "--rate", "100", "--duration", "16", "--seed", "3")
    return inspect_log(fly(*flight).tlog)


@pytest.mark.slow
def test_loss_and_stillness_limit_by_the_rules_of_the_analysis(found):

    def missing(percent):
        streams = [
            replace(s, missing_percent=percent) if s.stream is Stream.IMU else s
            for s in found.streams
        ]
        return judged(replace(found, streams=tuple(streams))).verdict

    most = 100.0 * TOO_MUCH_LOSS
    assert [missing(percent) for percent in (0.9 * most, 1.1 * most)] == ["yes", "partly"]
    still = replace(found.motion["yaw"], rate_rms=0.9 * RULES.still[2])
    hardly = judged(replace(found, motion={**found.motion, "yaw": still}))
    assert (hardly.verdict, hardly.obtainable) == ("partly", "all but Izz")


@pytest.mark.slow
def test_rotors_that_explain_too_little_promise_rough_inertia(found):
    assert (found.verdict, found.obtainable) == ("yes", "everything")
    rough = judged(replace(found, explained_coupled=0.8))
    assert (rough.verdict, rough.obtainable) == ("partly", "in part")
    assert any("rotors explain 80 %" in objection.reason for objection in rough.objections)
    chosen = replace(found.rotor_input.chosen, kind=RotorInput.COMMAND)
    commands = judged(replace(rough, rotor_input=replace(found.rotor_input, chosen=chosen)))
    assert commands.obtainable == "in part"
    assert any("inertia and T_max rough" in objection.reason for objection in commands.objections)
