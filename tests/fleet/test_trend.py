"""Vehicles over their flights: order, scatter, changes, and the page that shows them."""

import html.parser
import itertools
import math
import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="needs the extra fleet")

from gcs_sysid.cli.program import run
from gcs_sysid.fleet.batch import row, write_table
from gcs_sysid.fleet.jobs import Job, Task
from gcs_sysid.fleet.trend import mean, render, scatter_of, vehicles_of
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.significance import FALSE_ALARM_RATE
from tests.known_results import MASS, estimates, result_of

STD = 0.01
NAMES = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")
PAPER = load_airframe("paper")
_number = itertools.count()


def result(status="identified", verdict="identified", recorded=None, **values):
    return result_of(
        MASS | estimates(values, std=STD, statuses=dict.fromkeys(values, status)),
        verdict=verdict,
        reasons=() if verdict == "identified" else ("too quiet",),
        source="",
        telemetry={} if recorded is None else {"recorded": f"{recorded:%Y-%m-%d %H:%M} UTC"},
    )


def row_of(made, path="a.tlog", digest=None):
    job = Job(Path(path), PAPER)
    return row(job, Task(job, path, digest or str(next(_number)), 1), made.as_json(), "results/x")


def flights(values, name="Ixx"):
    """Rows of flights, a day apart, of these values of one parameter."""
    day = datetime(2026, 3, 1)
    return [
        row_of(result(recorded=day + timedelta(n), **{name: value}), f"{n}.tlog")
        for n, value in enumerate(values)
    ]


def only(rows):
    (vehicle,), unused = vehicles_of(rows)
    assert unused == []
    return vehicle


def test_order_of_time_then_those_that_do_not_tell_it():
    rows = [
        row_of(result(Ixx=1.0), "z.bin"),
        row_of(result(Ixx=1.0), "y.bin"),
        row_of(result(Ixx=1.0, recorded=datetime(2026, 3, 2)), "a.tlog"),
        row_of(result(Ixx=1.0, recorded=datetime(2026, 3, 1)), "b.tlog"),
    ]
    assert [f.row["path"] for f in only(rows).flights] == ["b.tlog", "a.tlog", "y.bin", "z.bin"]


def test_a_copy_counts_once_and_what_tells_nothing_is_apart():
    broken = row(Job(Path("c.ulg"), PAPER), None, None, None, "c.ulg is empty")
    refused = row_of(result(verdict="refused"), "d.tlog")
    copies = [row_of(result(Ixx=1.0), name, "same") for name in ("a.tlog", "b.tlog")]
    (vehicle,), unused = vehicles_of([*copies, broken, refused])
    assert [flight.row["path"] for flight in vehicle.flights] == ["a.tlog"]
    assert [r["path"] for r in unused] == ["c.ulg", "d.tlog"]


def test_flights_that_show_no_more_than_their_hover_have_a_trend_and_one_proposal():
    rows = []
    for n in range(6):
        made = result(verdict="refused").as_json()
        made["hover"] = [{"name": "CG forward", "unit": "mm", "value": 2.0 * n, "std": 0.1}]
        suggested = {"MOT_THST_EXPO": {"value": 0.5 + 0.01 * n, "std": 0.01, "std_given": 0.0,
                                       "now": 0.65}}  # fmt: skip
        made["health"] = {"verdict": "refused", "autopilot_parameters": suggested}
        job = Job(Path(f"quad-9/{n}.bin"), None, given=(("mass", 1.5),))
        rows.append(row(job, Task(job, "", str(n), 1), made, "results/x"))
    vehicle = only(rows)
    assert vehicle.name == "quad-9 1:1"
    (series,) = vehicle.hover
    assert series.values == tuple(2.0 * n for n in range(6))
    proposal, now, count = vehicle.proposed["MOT_THST_EXPO"]
    assert (now, count) == (0.65, 6)
    assert proposal.value == pytest.approx(0.525)
    assert proposal.std > 0.01 / math.sqrt(6)  # they scatter by more than each has
    page = render("fleet", [vehicle], [])
    assert "CG forward changes by 2.00" in page
    assert "MOT_THST_EXPO" in page


def test_a_step_is_found_at_its_flight_and_once():
    values = [1.0, 1.01, 0.99, 1.0, 1.2, 1.21, 1.19, 1.2]
    vehicle = only(flights(values))
    (changed,) = vehicle.changed
    assert changed.number == 5
    assert (changed.change.first, changed.change.last) == (1, 4)
    (difference,) = changed.change.differences
    assert difference.name == "Ixx"
    assert difference.value == pytest.approx(0.2)
    assert [len(era) for era in vehicle.eras] == [4, 4]
    page = render("fleet", [only(flights(values, "k_T"))], [])
    assert "the mass at flight 5 is not 1.5 kg but about" in page


def test_the_usual_scatter_between_flights_is_no_change():
    rng = np.random.default_rng(5)
    values = 1.0 + 30.0 * STD * rng.normal(size=16)
    assert only(flights(values)).changed == []
    values[8:] += 15.0
    (changed,) = only(flights(values)).changed
    assert changed.number == 9


def test_two_flights_are_taken_at_their_own_intervals():
    assert only(flights([1.0, 1.01])).changed == []
    assert [flight.number for flight in only(flights([1.0, 1.1])).changed] == [2]


def test_weak_and_given_values_make_no_change():
    rows = [row_of(result("weak", Ixx=value), f"{value}.tlog") for value in (1.0, 2.0, 3.0)]
    assert only(rows).changed == []


@pytest.mark.parametrize(("scatter", "count"), [(0.0, 12), (1.0, 5), (20.0, 12)])
def test_one_vehicle_of_twenty_at_most_is_called_changed_by_chance(scatter, count):
    rng = np.random.default_rng([count, int(scatter)])
    vehicles = 60
    alarms = 0
    for _ in range(vehicles):
        values = STD * np.hypot(1.0, scatter) * rng.normal(size=(count, len(NAMES)))
        rows = [
            row_of(result(**dict(zip(NAMES, map(float, line), strict=True))), f"{n:02d}")
            for n, line in enumerate(values)
        ]
        alarms += bool(only(rows).changed)
    # At the level itself this many or fewer come in 99 of 100 draws (binomial).
    assert alarms <= 8


def test_scatter_is_learnt_beside_a_step():
    rng = np.random.default_rng(2)
    values = rng.normal(size=400)
    values[200:] += 50.0
    variance = scatter_of([result(Ixx=float(v)) for v in values], FALSE_ALARM_RATE)["Ixx"]
    assert variance == pytest.approx(1.0, rel=0.2)


def test_mean_weighs_by_what_is_known():
    good, poor = Estimate(1.0, 0.1, "", "identified"), Estimate(4.0, 0.2, "", "identified")
    assert mean([good, poor], 0.0) == pytest.approx((1.6, 0.008))
    assert mean([good, poor], 1e6) == pytest.approx((2.5, 5e5), rel=1e-3)


class Outline(html.parser.HTMLParser):
    """Elements that are open and never closed, or closed and never opened, fail."""

    def __init__(self):
        super().__init__()
        self.open, self.count = [], {}

    def handle_starttag(self, tag, attributes):
        self.count[tag] = self.count.get(tag, 0) + 1
        for _, value in attributes:
            assert not re.match(r"(https?:)?//", value or "")
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole_and_of_text_alone():
    rows = flights([1.0, 1.01, 0.99, 1.0, 1.2, 1.21])
    rows.append(row(Job(Path("<script>.ulg"), PAPER), None, None, None, "<script>.ulg is empty"))
    vehicles, unused = vehicles_of(rows)
    page = render("<b>fleet", vehicles, unused)
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    assert outline.count["circle"] == 6
    assert outline.count["svg"] == 1  # the mass was given
    assert "script" not in outline.count
    assert "flight 5: Ixx" in page
    assert "flights 1 to 4" in page
    assert page.count("changed") >= 2
    assert render("<b>fleet", vehicles, unused) == page


def test_the_command_writes_once(tmp_path, capsys):
    write_table(tmp_path / "fleet.parquet", flights([1.0, 1.01, 0.99, 1.2]))
    target = tmp_path / "fleet.html"
    assert run(["trend", str(tmp_path), "-o", str(target)]) == 0
    first = target.read_text(encoding="utf-8")
    assert first.startswith("<!DOCTYPE html>")
    assert run(["trend", str(tmp_path / "fleet.parquet"), "-o", str(target)]) == 2
    assert "--force" in capsys.readouterr().err
    assert target.read_text(encoding="utf-8") == first
    assert run(["trend", str(tmp_path), "-o", str(target), "--force"]) == 0


def test_a_fleet_that_tells_nothing_and_no_fleet(tmp_path, capsys):
    (tmp_path / "none").mkdir()
    assert run(["trend", str(tmp_path / "none"), "-o", str(tmp_path / "a.html")]) == 2
    assert "gcs-sysid batch writes it" in capsys.readouterr().err
    write_table(tmp_path / "fleet.parquet", [row_of(result(verdict="refused"))])
    assert run(["trend", str(tmp_path), "-o", str(tmp_path / "a.html")]) == 1
    assert "too quiet" in (tmp_path / "a.html").read_text(encoding="utf-8")
    assert capsys.readouterr().out == ""
