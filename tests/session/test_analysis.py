"""Two flights a known mass apart: which pairs tell it. The analysis of each is made up here."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session import analysis

PATHS = Path("light.tlog"), Path("heavy.tlog")


@dataclass
class Made:
    """What a made-up analysis tells."""

    value: float | None
    std: float | None = 0.01

    @property
    def std_data(self):
        return self.std

    @property
    def parameters(self):
        return {"k_T": self}


def pair(monkeypatch, light, heavy):
    """The results of a pair whose flights tell this k_T at a mass of 1, and the anchors asked."""
    per_mass = {PATHS[0]: light, PATHS[1]: heavy}
    anchors = []

    def analyze_log(path, airframe, wanted, options, progress, anchor):
        anchors.append(anchor)
        if anchor.kind == "mass":
            return per_mass[path]
        return replace(per_mass[path], value=7.0, std=0.3)

    monkeypatch.setattr(analysis, "analyze_log", analyze_log)
    return analysis.analyze_pair(PATHS, 0.3, load_airframe("paper")), anchors


@pytest.mark.parametrize(("apart", "enough"), [(0.149, False), (0.151, True)])
def test_flights_must_differ_by_three_deviations(monkeypatch, apart, enough):
    # 0.03 and 0.04 are 0.05 together.
    flights = Made(2.0, 0.03), Made(2.0 - apart, 0.04)
    if enough:
        results, _ = pair(monkeypatch, *flights)
        assert len(results) == 2
    else:
        with pytest.raises(InputError, match="is not heavier"):
            pair(monkeypatch, *flights)


def test_the_light_flight_comes_first(monkeypatch):
    with pytest.raises(InputError, match="light flight first"):
        pair(monkeypatch, Made(1.5), Made(2.0))


@pytest.mark.parametrize("nothing", [Made(None), Made(2.0, None)])
@pytest.mark.parametrize("first", [True, False])
def test_both_flights_must_tell_thrust_over_mass(monkeypatch, nothing, first):
    flights = (nothing, Made(1.0)) if first else (Made(3.0), nothing)
    with pytest.raises(InputError, match="too short"):
        pair(monkeypatch, *flights)


def test_the_first_flight_rests_on_the_mass_and_the_second_on_its_thrust(monkeypatch):
    _, (light, heavy, first, second) = pair(monkeypatch, Made(2.0, 0.03), Made(1.6, 0.04))
    assert (light.kind, light.value, light.std) == (heavy.kind, heavy.value, heavy.std)
    assert (light.kind, light.value) == ("mass", 1.0)
    assert (first.kind, first.value, first.loaded) == ("added_mass", 0.3, (1.6, 0.04))
    assert (second.kind, second.value, second.std) == ("k_T", 7.0, 0.3)
    assert second.origin == "two flights, 0.3 kg apart"
