"""The formats by name."""

from gcs_sysid.exports import (
    ardupilot_sitl,
    crazyflow,
    gazebo_sdf,
    indi_effectiveness,
    l2f,
    mjcf,
    px4_sih,
    rotorpy,
    urdf,
)

FORMATS = {
    each.name: each
    for each in (
        px4_sih.FORMAT,
        gazebo_sdf.FORMAT,
        urdf.FORMAT,
        mjcf.FORMAT,
        rotorpy.FORMAT,
        ardupilot_sitl.FORMAT,
        crazyflow.FORMAT,
        l2f.FORMAT,
        indi_effectiveness.INDIFLIGHT_FORMAT,
        indi_effectiveness.PAPARAZZI_FORMAT,
    )
}
