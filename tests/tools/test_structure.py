"""The counts of `tools/structure.py` that are held, not only printed."""

import ast

import pytest

from tools.structure import SOURCE, judgements, parsed


def test_one_room_makes_statuses_verdicts_and_reasons():
    """Elsewhere, evidence makes an `Objection`."""
    writers = {name for name, tree in parsed(SOURCE).items() if judgements(tree)}
    assert {".".join(name.split(".")[:2]) for name in writers} == {"gcs_sysid.judgement"}


@pytest.mark.parametrize(
    ("line", "judges"),
    [
        ('Estimate(1.0, 0.1, "kg", "identified")', True),
        ("Estimate(1.0, 0.1, status=word)", True),
        ('replace(estimate, status="weak")', True),
        ('replace(result, verdict="partial" if lost else "identified")', True),
        ('replace(result, reasons=(*result.reasons, "more"))', True),
        ('Result(verdict="refused", parameters={})', True),
        ('Health(source, reasons=("no hover",))', True),
        ("Estimate(1.0, 0.1)", False),
        ("Estimate(e.value, e.std_data, status=e.status)", False),
        ('Result(verdict=row["verdict"], reasons=found.reasons)', False),
        ('Objection("lost", verdict="partial", cap="weak")', False),
        ('if result.verdict == "refused" and estimate.status in ("weak",): pass', False),
    ],
)
def test_who_judges_is_seen(line, judges):
    assert bool(judgements(ast.parse(line))) is judges
