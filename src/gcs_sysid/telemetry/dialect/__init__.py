"""The project's own MAVLink dialect.

`gcs_sysid.xml` holds the messages that the program handles; `tools/make_dialect.py` turns it
into `gcs_sysid_dialect.py` with pymavlink's generator (whose ready-made dialects lack
ESC_STATUS and ESC_INFO). `known_messages` names and checks all other messages.
"""

from gcs_sysid.telemetry.dialect import gcs_sysid_dialect as mavlink

__all__ = ["mavlink"]
