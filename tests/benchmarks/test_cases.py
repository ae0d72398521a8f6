"""What studies make of a flight, on flights of seconds; needs the others' estimators."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("filterpy", reason="the bench extra")
pytest.importorskip("statsmodels", reason="the bench extra")

from benchmarks.accuracy import cases, changes, peers
from benchmarks.accuracy.estimators import online, true_theta
from gcs_sysid.model import rigid_body as rb
from testbed.article_flights import exact, fly, measure

CORE = [*range(rb.CG_Y + 1), rb.MOMENT_RATIO]
TRUE = true_theta()[CORE]


@pytest.fixture(scope="module")
def flight():
    """All axes at once, so that a few seconds tell everything."""
    return fly("all-axes", 100, 8.0)


@pytest.mark.parametrize("peer", [peers.nonlinear_least_squares, peers._least_squares])
def test_peers_find_the_truth_where_there_is_no_noise(flight, peer):
    theta, _ = peer(exact(flight), flight.interval, 5)
    assert np.abs(theta - TRUE) / np.abs(TRUE) == pytest.approx(np.zeros(9), abs=0.02)


@pytest.mark.slow
def test_recursive_least_squares_end_where_plain_ones_do(flight):
    samples = exact(flight)
    recursive, _ = peers.recursive_least_squares(samples, flight.interval, 5)
    plain, _ = peers._least_squares(samples, flight.interval, 5)
    assert recursive == pytest.approx(plain, rel=1e-3)


def test_unscented_filter_comes_nearer_than_it_starts():
    flight = fly("all-axes", 20, 8.0)
    samples = measure(flight, "white", 0.002, 1, rounded=False)
    theta, std = peers.unscented_filter(samples, flight.interval, 0.1)
    moments = slice(0, 3)
    before = np.abs(peers.START[moments] / TRUE[moments] - 1.0)
    after = np.abs(theta[moments] / TRUE[moments] - 1.0)
    assert np.all(after < 0.2 * before)
    assert np.all(std > 0.0)


def test_peers_get_the_same_thrust_as_ours(flight):
    samples = measure(flight, "white", 0.002, 1)
    fit = online(samples, flight.interval)
    ours = cases.outcome(fit)
    theirs = peers._physical(TRUE, np.zeros(9), fit)
    assert theirs["error"][8] == pytest.approx(ours["error"][8], rel=1e-3)


def test_a_course_counts_wrong_claims_only_while_they_are_claimed():
    t = np.arange(8) * 0.1
    errors, std = np.full((8, 10), 1.0), np.full((8, 10), 1.0)
    identified = np.ones((8, 10), dtype=bool)
    errors[2, 0] = 3.0  # outside, and claimed
    errors[3, 1], identified[3, 1] = 3.0, False  # outside, not claimed
    errors[-1, 2] = -3.0  # outside at the end
    errors[:4, 3] = 9.0  # late, and claimed
    found = cases.followed(t, errors, std, identified)
    assert found["wrong refits"] == [1, 0, 1, 4, *[0] * 6]
    assert found["identified refits"] == [8, 7, *[8] * 8]
    assert found["wrong at end"] == [False, False, True, *[False] * 7]
    assert found["any wrong at any refit"] is True
    assert found["settled"][3] == pytest.approx(0.4)
    assert found["t"][-1] == pytest.approx(0.7)
    assert len(found["t"]) == len(found["error"])


def test_only_what_this_version_kept_is_read(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the bench extra")
    from benchmarks.accuracy.__main__ import VERSION, kept

    for name, version in (("mems", VERSION), ("white", VERSION - 1)):
        text = json.dumps({"version": version, "seeds": 1, "outcomes": []})
        (tmp_path / f"{name}.json").write_text(text)
    assert list(kept(tmp_path)) == ["mems"]
    assert "white.json is of another version" in capsys.readouterr().err


def test_rounding_differs_from_seed_to_seed(flight):
    first, second = (measure(flight, "none", 0.0, seed).speeds for seed in (1, 2))
    assert np.abs(first - second).max() > 0.01
    assert np.abs(first - flight.speeds[0]).max() <= 0.5 * 2.0 * np.pi / 60.0 + 1e-9


def test_motion_tells_how_far_a_vehicle_leans(flight):
    n = 600
    t = changes.AT - 3.0 + 0.01 * np.arange(n)
    tilt = np.where(t < changes.AT, 0.1, 0.5)
    quaternion = np.zeros((1, n, 4))
    quaternion[0, :, 0], quaternion[0, :, 1] = np.cos(tilt / 2.0), np.sin(tilt / 2.0)
    some = replace(
        flight,
        t=t,
        quaternion=quaternion,
        velocity=np.zeros((1, n, 3)),
        commands=np.full((1, n, 4), 0.6),
    )
    found = changes.motion(some)
    assert found["tilt"] == pytest.approx(np.degrees([0.1, 0.5]))
    assert found["command"] == [0.6, 0.6]
