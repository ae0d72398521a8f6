"""The page: head, sections, styles and script in one HTML text."""

from importlib import resources

from gcs_sysid.report import evidence_sections
from gcs_sysid.report import results_sections as findings
from gcs_sysid.report.data import ReportData
from gcs_sysid.report.health_picture import health_section
from gcs_sysid.report.page_figures import ChartData
from gcs_sysid.report.parts import Child, Column, Markup, element, facts, html_page, section, table
from gcs_sysid.results.health_view import first_answer
from gcs_sysid.results.words import PAGE, VERDICT
from gcs_sysid.strict_json import json_text

_CONTENTS = (
    ("health", "Health"),
    ("verdict", "Verdict"),
    ("parameters", "Parameters"),
    ("convergence", "Convergence"),
    ("prediction", "Prediction"),
    ("twin", "Twin"),
    ("residual", "Residual"),
    ("excitation", "Excitation"),
    ("events", "Events"),
    ("telemetry", "Telemetry"),
    ("settings", "Settings"),
)
_KEYS = (
    "Drag across a figure to zoom, double click to see all again. With the keyboard: Tab to a "
    "figure, then + and − to zoom, ← and → to move, 0 to see all."
)


def render(data: ReportData) -> str:
    """The whole report as HTML text; the same data give the same text."""
    figures = ChartData()
    sections: dict[str, Child] = {
        "health": health_section(data.health) if data.health else None,
        "verdict": findings.verdict(data),
        "parameters": findings.parameters(data),
        "convergence": findings.convergence(data, figures),
        "prediction": evidence_sections.prediction(data, figures),
        "twin": evidence_sections.twin(data),
        "residual": evidence_sections.residual(data, figures),
        "excitation": evidence_sections.excitation(data, figures),
        "events": evidence_sections.events(data, figures),
        "telemetry": evidence_sections.telemetry(data),
        "settings": _settings(data),
    }
    name = _file_name(data.result.source)
    contents = element(
        "nav",
        *(element("a", title, href=f"#{key}") for key, title in _CONTENTS if sections.get(key)),
        aria_label="Contents",
    )
    answer = first_answer(data.health or None, data.result)
    return html_page(
        f"{name}: {VERDICT[data.result.verdict].meaning.lower()}",
        asset("charts.css") + asset("report.css"),
        element("header", _heading(data, name), contents),
        element(
            "main",
            element("p", element("strong", answer.line), class_="answer"),
            element("p", answer.action),
            sections.pop("health"),
            sections.pop("verdict"),
            element("p", _KEYS, id="keys", class_="note keys"),
            element("noscript", element("p", "Figures need scripts; tables do not.")),
            *sections.values(),
        ),
        element("footer", f"gcs-sysid {data.provenance.versions.get('gcs-sysid', '')}"),
        element("script", _json(figures), type="application/json", id="data"),
        script=asset("charts.js") + asset("report.js"),
    )


def asset(name: str) -> str:
    """A file of the report's page, with the line ends of every system."""
    asset = resources.files("gcs_sysid.report") / "assets" / name
    return asset.read_text(encoding="utf-8").replace("\r\n", "\n")


def _heading(data: ReportData, name: str) -> Markup:
    vehicle = data.result.vehicle
    about = [data.airframe.name]
    if vehicle:
        address = f"{vehicle['sysid']}:{vehicle['compid']}"
        systems = map(str, data.result.telemetry.get("systems", ()))
        named = next((name for name in systems if name.endswith(f" {address}")), None)
        about.insert(0, named or f"{vehicle['autopilot']} {address}")
    duration = data.inspection.get("duration")
    if duration:
        about.append(f"{PAGE.fixed(duration, 1)} s recorded")
    return element(
        "div",
        element("p", "Identification report", class_="kind"),
        element("h1", name),
        element("p", " · ".join(about), class_="about"),
        class_="heading",
    )


def _settings(data: ReportData) -> Markup:
    """What reproduces the report."""
    made, airframe, result = data.provenance, data.airframe, data.result
    scale = result.scale
    entries: dict[str, Child] = {
        "Command": element("code", _command_line(made.command)),
        "Recording": f"{_file_name(result.source)}, {made.log_bytes} bytes",
        "SHA-256": element("code", made.log_sha256, class_="hash"),
        "Estimate": result.estimator,
        "Rotor input": result.rotor_input.words,
    }
    if scale is not None:
        entries["Scale"] = f"{scale.anchor} = {scale.value:.9g} {PAGE.unit(scale.unit)}"
    for name, prior in result.priors.items():
        entries[f"Prior on {name}"] = f"{prior['value']:.6g} ± {prior['std']:.3g}"
    entries["Airframe"] = f"{airframe.name}, {len(airframe.rotors)} rotors"
    if airframe.imu_position is not None:
        place = ", ".join(f"{PAGE.fixed(v, 4)} m" for v in airframe.imu_position)
        entries["IMU, forward, right, down"] = place
    if airframe.gyro_filter is not None:
        entries["Gyro filter given"] = f"{airframe.gyro_filter:g} Hz"
    entries |= dict(made.versions)
    rotors = [
        [
            str(i),
            f"{PAGE.fixed(r.x, 4)} m",
            f"{PAGE.fixed(r.y, 4)} m",
            "counter-clockwise" if r.spin > 0 else "clockwise",
        ]
        for i, r in enumerate(airframe.rotors, 1)
    ]
    columns = [
        Column("Motor"),
        Column("Forward", numbers=True),
        Column("Right", numbers=True),
        Column("Spin, seen from above"),
    ]
    return section(
        "settings",
        "Settings to reproduce this",
        facts(entries),
        table("Rotors of the airframe, from the geometric center", columns, rotors, layout="axes"),
    )


def _command_line(words: tuple[str, ...]) -> str:
    """The words as one types them; quoted where that is needed, in any shell's reading."""
    plain = set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_./:=+,@%\\±")
    return " ".join(
        word if word and set(word) <= plain else '"' + word.replace('"', '\\"') + '"'
        for word in words
    )


def _file_name(source: str) -> str:
    """The last part of a path of any system."""
    return source.replace("\\", "/").rstrip("/").rpartition("/")[2] or source


def _json(figures: ChartData) -> Markup:
    """The figures as JSON that cannot end the element that it is in."""
    text = json_text(figures.as_json(), separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)
