"""What a chain says where it has less than an identification."""

from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.session.reasons import data_reasons
from gcs_sysid.signals.records import Stream

SAMPLER = SimpleNamespace(seen={Stream.IMU, Stream.ATTITUDE, Stream.ROTOR_SPEED})


def chain(share):
    rotation = SimpleNamespace(r_squared=np.array([0.9, share, 0.9]), whiteners=())
    fit = SimpleNamespace(rotation=rotation, other_layout=None, seconds=30.0)
    return SimpleNamespace(sampler=SAMPLER, fit=fit, rotors="ESC_STATUS", outdated=False)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_rotors_are_blamed_only_where_something_was_flown(share):
    (reason,) = data_reasons(chain(share))
    assert reason.startswith(f"the rotors explain only {100.0 * share:.0f} % of the motion")
    assert data_reasons(chain(share), still=True) == ()
    assert data_reasons(chain(0.9)) == ()
