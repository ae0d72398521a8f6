"""An identified vehicle as the files that simulators load."""

from gcs_sysid.exports.autopilot_simulators import ARDUPILOT_SITL, PX4_SIH, PX4_SIH_1_17
from gcs_sysid.exports.indi_effectiveness import INDIFLIGHT_FORMAT, PAPARAZZI_FORMAT
from gcs_sysid.exports.python_simulators import CRAZYFLOW, L2F, ROTORPY
from gcs_sysid.exports.xml_bodies import GAZEBO_SDF, MJCF, URDF

FORMATS = {
    each.name: each
    for each in (
        PX4_SIH, PX4_SIH_1_17, GAZEBO_SDF, URDF, MJCF, ROTORPY, ARDUPILOT_SITL, CRAZYFLOW, L2F,
        INDIFLIGHT_FORMAT, PAPARAZZI_FORMAT,
    )
}  # fmt: skip
