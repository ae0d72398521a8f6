"""The linter of what users read finds what it is for, and nothing in code."""

import pytest

pytest.importorskip("codespell_lib")
pytest.importorskip("proselint")

from tools import prose


def test_code_and_names_are_no_prose_and_lines_stay():
    page = "# Told\n\n```sh\ntold colour\n```\nSee `colour` and [this](colour.md).\n"
    text = prose.prose(page)
    assert text.count("\n") == page.count("\n")
    assert "colour" not in text
    assert text.startswith("# Told.")


def test_each_command_has_its_help():
    found = dict(prose.help_texts())
    assert {"gcs-sysid", "gcs-sysid-live", "gcs-sysid-airframe-new"} <= set(found)
    assert "--speak" in found["gcs-sysid-live"]


@pytest.mark.slow
def test_what_is_found():
    page = "The data do not tell Ixx.\nThe colour is is wrong, a very unique defualt.\n"
    found = "\n".join(prose.findings({"page.md": page, "good.md": "Ixx is not identifiable.\n"}))
    for word in ("page.md:1: tell", "page.md:2: colour", "defualt", "'is is'", "very unique"):
        assert word in found, word
    assert "good.md" not in found
