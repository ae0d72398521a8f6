"""The page: whole, alone, safe, and with the numbers of the result."""

import base64
import hashlib
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

import gcs_sysid
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXES, PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.report.data import Prediction, Provenance, ReportData, Spectrum
from gcs_sysid.report.page import render
from gcs_sysid.results.history import History
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale
from gcs_sysid.results.snapshot import Event
from gcs_sysid.results.words import STATUS
from tests.known_results import result_of

from .reading import Page

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&\u202e\x1b[31m"
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
SECTIONS = ("health", "verdict", "parameters", "convergence", "prediction", "twin",
            "residual", "excitation", "events", "telemetry", "settings")  # fmt: skip


@pytest.fixture(scope="module")
def page(report):
    return report.page


def unpacked(page, name):
    return np.frombuffer(base64.b64decode(page.data["arrays"][name]), "<f4").astype(float)


@pytest.mark.slow
def test_sections_in_order(page):
    assert [e.attributes["id"] for e in page.all("section")] == list(SECTIONS)
    assert len(page.all("h1")) == 1
    ids = [e.attributes["id"] for e in page.elements if "id" in e.attributes]
    assert len(ids) == len(set(ids))
    for e in page.elements:
        for key in ("aria-labelledby", "aria-describedby"):
            assert e.attributes.get(key, ids[0]) in ids
    assert {e.attributes["href"] for e in page.all("a")} == {f"#{name}" for name in SECTIONS}
    verdict = page.one("section", id="verdict").text
    assert "Identified" in verdict
    assert "moments of inertia to within" in verdict


def test_nothing_is_loaded(page):
    loading = {"src", "srcset", "data", "action", "formaction", "poster", "background", "style"}
    assert not {key for e in page.elements for key in e.attributes} & loading
    assert not [key for e in page.elements for key in e.attributes if key.startswith("on")]
    assert not {e.name for e in page.elements} & {"link", "iframe", "object", "embed", "base"}
    style, script = page.one("style").text, page.all("script")[-1].text
    assert not re.search(r"url\(|@import|https?:", style)
    urls = set(re.findall(r"https?://[^\"'\s]+", script))
    assert urls == {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|eval|innerHTML|import)\b", script)


def test_policy_allows_this_style_and_script_alone(page):
    policy = page.one("meta", **{"http-equiv": "Content-Security-Policy"}).attributes["content"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    for kind, text in (("style-src", page.one("style").text),
                       ("script-src", page.all("script")[-1].text)):  # fmt: skip
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[kind] == f"'sha256-{digest}'"


def test_every_figure_has_data_a_title_and_a_place_in_the_order_of_tabs(page):
    figures, arrays = page.data["figures"], page.data["arrays"]
    holders = [e for e in page.elements if "data-figure" in e.attributes]
    assert {e.attributes["data-figure"] for e in holders} == set(figures)
    assert all(e.attributes["tabindex"] == "0" and e.attributes["aria-label"] for e in holders)
    used = set()
    for figure in figures.values():
        assert figure["title"]
        for part in (*figure.get("lines", ()), *figure.get("bands", ())):
            names = [part[key] for key in ("x", "y", "low", "high") if key in part]
            assert len({len(unpacked(page, name)) for name in names}) == 1
            assert (np.diff(unpacked(page, part["x"])) >= 0.0).all()
            used.update(names)
    assert used == set(arrays)
    for axis in AXES:
        assert {f"prediction-{axis}", f"spectrum-{axis}", f"rate-{axis}"} <= set(figures)


def test_tables_can_be_read_aloud(page):
    tables = page.all("table")
    assert len(tables) >= 6
    for table in tables:
        inside = [e for e in page.elements if table in e.parents]
        assert [e.name for e in inside].count("caption") == 1
        heads = [e for e in inside if e.name == "th"]
        assert heads
        assert all(e.attributes["scope"] in ("col", "row") for e in heads)
    pictures = page.all("svg")
    assert all(e.attributes["role"] == "img" for e in pictures)
    assert len(page.all("title")) == 1 + len(pictures)


def read(text):
    return float(text.replace("−", "-"))


def rows_of(page, caption):
    (table,) = (e.parents[-1] for e in page.all("caption") if e.text.startswith(caption))
    rows = [e for e in page.all("tr") if table in e.parents]
    return [[e.text for e in page.elements if e.parents and e.parents[-1] is row] for row in rows]


def test_parameters_are_those_of_the_result(page, report):
    head, *rows = rows_of(page, "Parameters with")
    assert head == ["Parameter", "Value ± 95 %", "95 % interval", "Status", "Based on", "Truth"]
    by_name = {name: row for name in PARAMETERS for row in rows
               if row[0] == name + PARAMETERS[name].meaning}  # fmt: skip
    assert by_name.keys() == report.result["parameters"].keys()
    for name, estimate in report.result["parameters"].items():
        _, value, interval, status, *_ = by_name[name]
        assert status == STATUS[estimate["status"]].sign + estimate["status"]
        if estimate["status"] == "given":
            assert value == "1.50000 kg"
            continue
        half = 1.959963984540054 * estimate["std"]
        low, high = estimate["ci95"]
        if low <= 0.0 <= high:
            assert value.startswith("~0 (< ")
            continue
        numbers = re.match(r"\(?([−\d.]+) ± ([\d.]+)\)?(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))? ", value)
        power = 10.0 ** int((numbers[3] or "⁰").translate(RAISED))
        shown = [power * read(text) for text in numbers.groups()[:2]]
        assert shown == pytest.approx([estimate["value"], half], rel=0.06, abs=0.06 * half)
        ends = [power * read(text) for text in re.findall(r"−?[\d.]+", interval)[:2]]
        assert ends == pytest.approx(estimate["ci95"], rel=1e-3, abs=0.1 * half)


def test_validation_is_that_of_the_result(page, report):
    found = report.result["validation"]
    _, r_squared, theil = rows_of(page, "Agreement")
    assert [float(v) for v in r_squared[1:]] == pytest.approx(
        [found["r_squared"][a] for a in AXES], abs=6e-5
    )
    assert [float(v) for v in theil[1:]] == pytest.approx(
        [found["theil"][a] for a in AXES], abs=6e-4
    )
    _, whiteness, *_ = rows_of(page, "Whiteness")
    assert [float(v) for v in whiteness[1:]] == pytest.approx(
        [found["whiteness"][a] for a in AXES], abs=6e-3
    )


def test_settings_reproduce_it(page, paper_flight, report):
    text = page.one("section", id="settings").text
    assert hashlib.sha256(paper_flight.tlog.read_bytes()).hexdigest() in text
    assert f"gcs-sysid analyze {paper_flight.tlog} --airframe paper" in text
    assert "mass = 1.5 kg" in text
    for name in ("NumPy", "SciPy", "Python"):
        assert name in text


@pytest.mark.slow
def test_its_twin_is_the_fit_to_the_first_part(page, paper_flight, paper_result):
    twin = gcs_sysid.fly_twin(paper_result, paper_flight.tlog)
    assert twin.same_flight
    row = re.search(r"Rates, 1 s ahead.*?</tr>", page.html, re.DOTALL)[0]
    shown = float(re.findall(r"<td[^>]*>([^<]*)</td>", row)[0].split()[0])
    assert shown == pytest.approx(math.degrees(twin.accuracy[1.0]["rates"].rms), rel=0.02)


# Made up, to reach what flights do not ----------------------------------------------------------


def estimate(value, std, status, **more):
    return Estimate(value, std, "kg m^2", status, **more)


def made_up(text="flight.tlog", rows=2000, instants=50):
    """A report in which every text is `text`."""
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 60.0, rows)
    y = rng.normal(size=(rows, 3))
    f = np.linspace(0.1, 18.0, 200)
    axes = dict.fromkeys(AXES, 0.9)
    before = estimate(0.016, 1e-4, "identified")
    result = Result(
        verdict="partial",
        reasons=(text, "not observable from this flight: Izz"),
        source=f"/some/where/{text}",
        vehicle={"sysid": 1, "compid": 1, "autopilot": text},
        scale=Scale("mass", 1.5, "kg", origin=text),
        estimator="offline",
        rotor_input=RotorInput.SPEED,
        parameters={
            "mass": estimate(1.5, 0.0, "given"),
            "Ixx": estimate(0.0165, 1e-4, "identified", bound=5e-5, rests_on=text),
            "Iyy": estimate(0.0165, 4e-3, "weak"),
            "Izz": estimate(None, None, "unobservable"),
            "Ixy": estimate(1e-9, 1e-3, "unobservable"),
        },
        timing={"rotor_delay": estimate(0.01, 1e-4, "identified")},
        events=({"t": 3.0, "kind": "reboot", "text": text}, {"t": 5.0, "kind": text}),
        segments=({"start": 0.0, "end": 5.0, "parameters": {"Ixx": before.as_json()}},),
        validation={
            "fitted_share": 0.6,
            **dict.fromkeys(("r_squared", "theil", "whiteness"), axes),
            "whiteness_p": {"roll": None, "pitch": 0.0, "yaw": 0.5},
        },
        priors={"k_M": {"value": 1e-6, "std": 1e-7}},
        telemetry={
            "systems": [text],
            "imu_outliers": {"spikes": 3, "frozen": 0},
            "fates": {"used": 7, "dropped": 0},
            "recorded": text,
            "messages": {text: {"count": 10, "rate": None}},
            "rotor_input": {"source": text, "why": text, "refused": {text: text}},
        },
    )
    stream = {"stream": "imu", "message": text, "offset": 0, "rate": 20.0, "gaps": 1,
              "longest_gap": 0.5, "missing_percent": 1.0, "repeats_percent": 0.0}  # fmt: skip
    inspection = {
        "reasons": [{"level": "limits", "text": text + "!", "advice": text}],
        "streams": [stream],
        "flights": [{"start": 0.0, "end": 60.0}],
    }
    history = np.linspace(0.0, 60.0, instants)
    values = {name: np.full(instants, 0.0165) + 1e-4 * rng.normal(size=instants)
              for name in PARAMETERS}  # fmt: skip
    spectrum = Spectrum(f, np.ones((200, 3)), np.ones((200, 3)))
    return ReportData(
        result=result,
        inspection=inspection,
        airframe=replace(
            load_airframe("paper"), name=text, imu_position=(0.01, -0.02, 0.0), gyro_filter=20.0
        ),
        provenance=Provenance(("gcs-sysid", "analyze", text), {text: text}, 10, "ab" * 32),
        history=History(history, values, {n: np.full(instants, 1e-4) for n in PARAMETERS}),
        prediction=Prediction(t, y, y, y + 0.1, t[1] - t[0], t > 36.0, spectrum),
        truth={"Ixx": 0.0164, "Iyy": 0.0},
        notes=(Event(1.0, text),),
    )


def test_hostile_texts_stay_texts():
    page = Page(render(made_up(HOSTILE)))
    plain = Page(render(made_up()))
    assert [e.name for e in page.elements] == [e.name for e in plain.elements]
    assert [sorted(e.attributes) for e in page.elements] == [
        sorted(e.attributes) for e in plain.elements
    ]
    assert page.words.count("<img src=x onerror=alert(2)>") >= 10
    assert not re.search("[\u202e\x1b]", page.html)
    marks = page.data["figures"]["history-Ixx"]["marks"]
    assert HOSTILE in [mark["text"] for mark in marks]
    assert "<" not in page.all("script")[0].text


def test_what_is_not_told_is_not_claimed():
    page = Page(render(made_up()))
    verdict = page.one("section", id="verdict").text
    assert "Not observable from this flight: Izz and Ixy." in verdict
    assert re.search(r"Weak: Iyy \(±.\d+.%\)\.", verdict)
    assert "Since then: Known: Ixx to within 1.2 %" in verdict
    assert verdict.count("bservable from this flight") == 1  # not again among the limitations
    rows = {row[0][:3]: row for row in rows_of(page, "Parameters with")}
    assert rows["Izz"][1:3] == ["–", "–"]
    assert rows["Ixy"][1:3] == ["–", "–"]
    assert rows["Ixx"][5] == "± 98 × 10⁻⁶"
    assert "vehicle" not in [e.attributes.get("class") for e in page.all("figure")]  # no CG


def test_a_flight_of_hours_makes_a_page_of_bounded_size():
    html = render(made_up(rows=600_000, instants=4096))
    assert len(html.encode()) < 1_500_000
    arrays = Page(html).data["arrays"]
    longest = max(len(base64.b64decode(a)) // 4 for a in arrays.values())
    assert longest <= 6002


def test_a_refused_recording_has_a_page_too():
    data = made_up("no-imu.tlog")
    result = result_of({}, verdict="refused", reasons=("no IMU data",), scale=None)
    bare = ReportData(result, {}, data.airframe, data.provenance, History(np.empty(0), {}, {}))
    page = Page(render(bare))
    assert "Not identified" in page.one("section", id="verdict").text
    assert "no IMU data" in page.one("section", id="verdict").text
    assert page.data == {"arrays": {}, "figures": {}}


def test_numbers_beyond_all_measure_do_no_harm():
    data = made_up()
    parameters = data.result.parameters | {
        "Ixx": estimate(1e-30, 1e30, "unobservable"),
        "Iyy": estimate(0.0, 1e-12, "identified"),
        "Izz": estimate(-1e200, 0.0, "weak"),
        "rotor_inertia": estimate(0.0, 0.0, "identified"),
    }
    page = Page(render(replace(data, result=replace(data.result, parameters=parameters))))
    text = page.one("section", id="parameters").text
    assert not re.search(r"\b(nan|inf)\b", text)
    assert all(len(cell) < 120 for row in rows_of(page, "Parameters with") for cell in row)


def test_json_has_no_numbers_that_json_lacks():
    data = made_up()
    value = dict(data.history.value) | {"Ixx": np.full(50, math.nan)}
    page = Page(render(replace(data, history=replace(data.history, value=value))))
    json.loads(page.all("script")[0].text, parse_constant=lambda word: pytest.fail(word))
    assert "history-Ixx" not in page.data["figures"]
