"""Whether another layout is accused, by what given and other layouts explain."""

import numpy as np
import pytest

from gcs_sysid.estimation.checks import model_tests
from gcs_sysid.estimation.noise.whitening import WhitenedMoments
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.model.airframe import load_airframe

BASIS = ActuatorDynamics((0.0,))
GEOMETRY = load_airframe("paper").geometry
MOMENTS = WhitenedMoments(
    (np.zeros((0, 0, BASIS.width, BASIS.width)),),
    np.zeros(0, dtype=np.int64),
    np.zeros((0, BASIS.width, BASIS.width)),
    (),
    0.004,
    1,
)


def accused(monkeypatch, own, first, given=0.1):
    """What is said where the first swap explains `first` and all others nothing."""
    answers = iter([np.array(own), np.array(first)])
    monkeypatch.setattr(model_tests, "explained_by", lambda *_: next(answers, np.zeros(3)))
    found = model_tests.find_other_layout(MOMENTS, BASIS, GEOMETRY, given)
    return None if found is None else found.says


def test_a_swap_that_explains_far_more_is_named(monkeypatch):
    says = accused(monkeypatch, [0.1, 0.2, 0.3], [0.9, 0.95, 0.9])
    assert says is not None
    assert "look swapped" in says


@pytest.mark.parametrize(
    ("own", "other"),
    [
        pytest.param([0.69, 0.69, 0.9], [0.69, 0.69, 0.9], id="gusts, explained by both alike"),
        pytest.param([0.69, 0.69, 0.9], [0.9, 0.9, 0.5], id="at the cost of yaw"),
        pytest.param([0.1, 0.1, 0.1], [0.2, 0.2, 0.2], id="hardly better"),
    ],
)
def test_a_right_layout_is_not_accused(monkeypatch, own, other):
    """An octocopter in gusts explained 0.16 of its own rows and 0.69 of those that others have."""
    assert accused(monkeypatch, own, other) is None
