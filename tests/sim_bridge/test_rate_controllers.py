"""The emulator with the autopilots' own rate controllers: from the command line, and in gusts."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.response import true_vehicle
from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from sim_bridge.cli import main
from sim_bridge.missions import MISSIONS
from sim_bridge.rate_controllers import CONTROLLERS, DEFAULTS, rate_controller
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle
from testbed.vehicles import draw


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_it_hovers_in_gusts_with_the_gains_as_shipped(autopilot):
    sim = Simulation(
        load_vehicle("paper"),
        MISSIONS["hover"],
        np.random.SeedSequence(3),
        0.05,
        step_us=1250,
        control_steps=2,
        controller=rate_controller(autopilot, "default"),
    )
    for _ in range(2400):
        sim.step()
        _, b, c, _ = sim.state.quaternion
        # sin^2 of half the tilt.
        assert b * b + c * c < math.sin(math.radians(10.0)) ** 2
    assert np.linalg.norm(sim.state.rates) < 0.5


def test_gains_of_a_file_are_flown_and_another_autopilots_refused(tmp_path, capsys):
    (tmp_path / "g.params").write_text("1\t1\tMC_ROLLRATE_P\t0.07\t9\n")
    make = rate_controller("px4", str(tmp_path / "g.params"))
    controller = make(load_vehicle("paper"), 0.0025)
    assert controller._get("MC_ROLLRATE_P") == 0.07
    assert controller._get("MC_PITCHRATE_P") == DEFAULTS["px4"]["MC_PITCHRATE_P"]
    with pytest.raises(InputError, match="has no gains of ardupilot"):
        rate_controller("ardupilot", str(tmp_path / "g.params"))
    tlog = str(tmp_path / "x.tlog")
    common = ["--mission", "hover", "--duration", "0.5", "--speed", "max", "--tlog", tlog]
    assert main([*common, "--gains", str(tmp_path / "g.params")]) == 0
    assert main([*common, "--force", "--gains", "none.params"]) == 2
    assert "none.params: cannot read" in capsys.readouterr().err


def tilt_with_indi(vehicle, given, factor=1.0):
    """Largest tilt, deg, in gusts, 5 ms late, where what is given of the effect is off by that."""
    lines = re.findall(r"^set (\w+) = (.+)$", FORMATS["indiflight"].write(given), re.MULTILINE)
    settings = {name: np.array(values.split(","), float) for name, values in lines}
    for name in settings:
        settings[name] = settings[name] / (factor if re.search("_g[12]_", name) else 1.0)
    settings["thrust_curve"] = vehicle.thrust_curve
    sim = Simulation(
        vehicle, MISSIONS["hover"], np.random.SeedSequence(3), 0.05, step_us=1250, control_steps=2,
        controller=lambda v, period: CONTROLLERS["indiflight"](v, period, settings, 2),
    )  # fmt: skip
    worst = 0.0
    for _ in range(3200):
        sim.step()
        _, b, c, _ = sim.state.quaternion
        worst = max(worst, b * b + c * c)
    return math.degrees(2.0 * math.asin(min(math.sqrt(worst), 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 4])
def test_indi_flies_with_the_effectiveness_that_is_written(number):
    vehicle = draw(number, ("quad-x", "hexa", "quad-h", "octo", "quad-plus")).vehicle
    given = true_vehicle(vehicle)
    for factor in (0.3, 1.0, 1.9):
        assert tilt_with_indi(vehicle, given, factor) < 6.0
    # What rotors do to yaw in spinning up is taken for a disturbance, and answered.
    unknown = {name: one for name, one in given.known.items() if name != "rotor_inertia"}
    if number == 0:
        assert tilt_with_indi(vehicle, replace(given, known=unknown)) > 30.0
