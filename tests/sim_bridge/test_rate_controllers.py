"""The emulator with the autopilots' own rate controllers: from the command line, and in gusts."""

import math

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from sim_bridge.cli import main
from sim_bridge.missions import MISSIONS
from sim_bridge.rate_controllers import DEFAULTS, rate_controller
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle


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
