"""`gcs-sysid compare`: has the vehicle changed?"""

import argparse
from pathlib import Path

from gcs_sysid.cli import output
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.comparison import Comparison, Difference, compare, comparison_sentences
from gcs_sysid.results.result_file import read_result
from gcs_sysid.results.result_view import figures, number_figures
from gcs_sysid.results.words import CHANGE, label, percent_column, scaled_unit, wrapped
from gcs_sysid.significance import Z95


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when the results do not allow an answer."""
    read = options.before, options.after
    output.check_outputs(options.json, force=options.force, sources=read)
    comparison = compare(read_result(Path(options.before)), read_result(Path(options.after)))
    document = (options.json, lambda: output.as_json(comparison.as_json()))
    output.deliver(report(comparison), document, force=options.force)
    if comparison.verdict != "cannot_tell":
        return 0
    output.say("gcs-sysid: cannot compare: no parameter is identified in both")
    return 1


def report(comparison: Comparison) -> str:
    """The comparison as lines of text."""
    before, after = comparison.before, comparison.after
    found = comparison.differences.values()
    wide = max((len(_unit(each)) for each in found), default=0) + 1
    lines = [
        f"A {before.verdict}: {before.source}",
        f"B {after.verdict}: {after.source}",
        "",
        f"{'parameter':<14}{'A':>11}{'B':>11}{'B - A':>10}{'± 95 %':>9}{'%':>7}  unit",
        *(_row(each, wide) for each in found),
        "",
        *(line for sentence in comparison_sentences(comparison) for line in wrapped(sentence)),
        "",
    ]
    for note in (*comparison.notes, *_RULES):
        lines += wrapped(note, "- ")
    return "\n".join(lines)


_RULES = (
    "verdicts hold for all parameters together: at most one comparison in a hundred of an "
    "unchanged vehicle says changed (Holm); intervals are per parameter",
    "A and B are taken as independent; correlations between parameters are not used",
)


def _unit(found: Difference) -> str:
    exponent = REGISTRY[found.name].exponent
    return found.unit if exponent is None else scaled_unit(found.unit, exponent)


def _row(found: Difference, wide: int) -> str:
    """A parameter's line, with so many columns for the unit."""
    exponent = REGISTRY[found.name].exponent
    line = f"{label(found.name):<14}"
    for estimate in (found.before, found.after):
        line += f"{figures(estimate, exponent=exponent, digits=5).value:>11}"
    if found.value is None or found.std is None or found.before is None:
        line += f"{'-':>10}{'-':>9}{'-':>7}"
    else:
        half = Z95 * found.std
        shown = number_figures(found.value, half, found.unit, exponent=exponent, digits=3)
        line += f"{shown.value:>10}{shown.half or '0':>9}{_percent(found.value, found.before):>7}"
    return f"{line}  {_unit(found):<{wide}}{CHANGE[found.verdict].sign}"


def _percent(difference: float, before: Estimate) -> str:
    """Of the value before, where that is not as good as zero."""
    low, high = before.ci95 or (0.0, 0.0)
    if before.value is None or low <= 0.0 <= high:
        return "-"
    return percent_column(difference / abs(before.value), signed=True).removesuffix(" %")
