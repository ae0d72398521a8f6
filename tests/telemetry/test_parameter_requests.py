"""Parameters are read by name, a few a second, until they arrive or are given up."""

import pytest

from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.parameter_requests import (
    ParameterRequests,
    layout_parameters,
    wanted_parameters,
)
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from testbed.payloads import unpack

PX4 = MavlinkSystem(1, 1, 2, 12)
ARDUPILOT = MavlinkSystem(1, 1, 2, 3)


class Autopilot:
    """Answers what it has, but loses each `lossy`-th question."""

    def __init__(self, has, lossy=0):
        self.has = dict(has) if isinstance(has, dict) else dict.fromkeys(has)
        self.told = set()
        self.asked = []
        self._lossy = lossy
        self.gate = Gate(self.take)

    def take(self, raw):
        frame = read_frame(raw)
        assert frame.message_id == MESSAGE_IDS["PARAM_REQUEST_READ"]
        fields = unpack(frame.message_id, frame.payload)
        assert (fields["target_system"], fields["target_component"]) == (1, 1)
        assert fields["param_index"] == -1
        self.asked.append(fields["param_id"])
        lost = self._lossy and len(self.asked) % self._lossy == 0
        if fields["param_id"] in self.has and not lost:
            self.told.add(fields["param_id"])


def drive(requests, autopilot, vehicle, seconds, start=0.0):
    for i in range(round(seconds / 0.1)):
        values = {name: autopilot.has.get(name) or 4.0 for name in autopilot.told}
        requests.tick(start + 0.1 * i, vehicle, values)


@pytest.mark.parametrize("vehicle", [PX4, ARDUPILOT])
@pytest.mark.parametrize("lossy", [0, 3])
def test_all_that_the_vehicle_has_are_read(vehicle, lossy):
    autopilot = Autopilot(wanted_parameters(vehicle.key, 4), lossy)
    requests = ParameterRequests(autopilot.gate)
    drive(requests, autopilot, vehicle, 60.0)
    assert autopilot.told == autopilot.has.keys()
    if not lossy:
        known = [name for name in autopilot.asked if name in autopilot.has]
        assert len(known) == len(set(known))


def test_they_are_asked_for_a_few_a_second_and_those_not_there_given_up():
    autopilot = Autopilot(())
    requests = ParameterRequests(autopilot.gate)
    drive(requests, autopilot, PX4, 2.0)
    # The layout within two seconds, then four a second.
    layout = layout_parameters("px4", 4)
    assert set(autopilot.asked[: len(layout)]) == set(layout)
    drive(requests, autopilot, PX4, 3.0, start=2.0)
    assert len(layout) + 6 <= len(autopilot.asked) <= len(layout) + 14
    drive(requests, autopilot, PX4, 200.0, start=5.0)
    wanted = wanted_parameters("px4", 4)
    assert sorted(autopilot.asked) == sorted(wanted * ParameterRequests.ROUNDS)
    assert set(requests.missing) == set(wanted)


def test_the_simulators_truth_is_asked_for_where_there_is_one():
    real = Autopilot({"CA_ROTOR_COUNT"})
    drive(ParameterRequests(real.gate), real, PX4, 100.0)
    assert [name for name in real.asked if name.startswith("SIH_I")] == []
    simulated = Autopilot({"SIH_MASS", "SIH_IXX", "SIH_T_TAU"})
    drive(ParameterRequests(simulated.gate), simulated, PX4, 100.0)
    assert simulated.told == simulated.has.keys()


@pytest.mark.parametrize(
    ("vehicle", "has"),
    [
        (ARDUPILOT, {f"SERVO{n}_FUNCTION": 33 + i for i, n in enumerate((9, 10, 11, 12))}),
        (PX4, {"PWM_AUX_FUNC5": 101, "PWM_AUX_FUNC2": 102, "PWM_AUX_FUNC1": 103,
               "PWM_AUX_FUNC3": 104, "PWM_AUX_MIN5": 1100, "PWM_AUX_MAX5": 1900}),
        (PX4, {f"UAVCAN_EC_FUNC{n}": 100 + n for n in range(1, 5)}),
    ],
)  # fmt: skip
def test_motors_are_looked_for_on_outputs_beyond_the_first(vehicle, has):
    first = dict.fromkeys(layout_parameters(vehicle.key, 4), 1)
    autopilot = Autopilot(first | has)
    drive(ParameterRequests(autopilot.gate), autopilot, vehicle, 30.0)
    assert autopilot.told == autopilot.has.keys()
    usual = Autopilot({f"PWM_MAIN_FUNC{n}": 100 + n for n in range(1, 5)})
    drive(ParameterRequests(usual.gate), usual, PX4, 30.0)
    assert not any("AUX" in name for name in usual.asked)


def test_after_an_outage_those_given_up_get_another_chance():
    autopilot = Autopilot(())
    requests = ParameterRequests(autopilot.gate)
    drive(requests, autopilot, ARDUPILOT, 200.0)
    autopilot.has = dict.fromkeys(wanted_parameters("ardupilot", 4))
    autopilot.has |= {f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 5)}
    requests.again()
    drive(requests, autopilot, ARDUPILOT, 60.0, start=200.0)
    assert autopilot.told == autopilot.has.keys()
    assert requests.missing == []


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("rotors", [4, 8, 12])
def test_names_fit_their_field(autopilot, rotors):
    names = wanted_parameters(autopilot, rotors)
    assert len(set(names)) == len(names)
    assert all(len(name) <= 16 for name in names)


def test_a_vehicle_with_more_rotors_is_asked_for_all_of_them():
    autopilot = Autopilot(wanted_parameters("px4", 6))
    requests = ParameterRequests(autopilot.gate, 4)
    for i in range(300):
        told = dict.fromkeys(autopilot.told, 1.0)
        if "CA_ROTOR_COUNT" in told:
            told["CA_ROTOR_COUNT"] = 6.0
        requests.tick(0.1 * i, PX4, told)
    assert set(layout_parameters("px4", 6)) <= autopilot.told


@pytest.mark.parametrize("count", [1e9, -1.0, 13.0, float("nan")])
def test_a_count_that_cannot_be_is_not_followed(count):
    autopilot = Autopilot(("CA_ROTOR_COUNT",))
    requests = ParameterRequests(autopilot.gate, 4)
    for i in range(300):
        requests.tick(0.1 * i, PX4, {"CA_ROTOR_COUNT": count})
    rotors = {name for name in autopilot.asked if name.startswith("CA_ROTOR")}
    assert rotors <= set(wanted_parameters("px4", 4))
