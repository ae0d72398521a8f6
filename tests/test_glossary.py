"""Words that the glossary replaced: in nothing that users read, in no docstring or comment."""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
REPLACED = re.compile(
    r"\b(told|tells?|telling|untold|speaks?|spoken?|yardsticks?|reckon\w*|makes of|where to|"
    r"balance point|hears?|heard|courses?|(write|writes|written) over|footing|roughly|anew|learnt|"
    r"goes on|rests? on|no longer rests|cannot tell|do not tell|manoeuvre|"
    r"metres?|millimetres?|centimetres?|centres?|colours?|neighbours?|analys(?:e|ed|es|ing)|"
    r"behaviour|unmodelled|modelled|favour|licence|normalised|maximised?|organised?|recognised?)\b",
    re.IGNORECASE,
)
DOCS = re.compile(
    r"\b(told|tells?|speaks?|spoken|yardstick|reckon\w*|makes of|balance point|heard|written over|"
    r"roughly known|anew|learnt|metres?|centres?|colours?|neighbours?|analys(?:ed|es|ing)|"
    r"behaviour|modelled|held\s+against|the\s+lesser|looked\s+at\s+once|sent\s+as\s+rpm|"
    r"by\s+speeds|one\s+value\s+must\s+be\s+given|result\s+is\s+of)\b",
    re.IGNORECASE,
)
PROSE = re.compile(
    r"\b(told|tells?|telling|untold|speaks?|spoke|yardsticks?|reckon\w*|makes\s+of|where\s+to:|"
    r"balance\s+point|hears?|heard|footing|anew|learnt|held\s+against|whoever|nobody|somebody|"
    r"(?:write|writes|written)\s+over|stands?\s+in\s+for|unlearnt|"
    r"colour(?:s|ed|ing)?|neighbour(?:s|ing)?|behaviour|(?:un)?modelled|metres?|centres?|"
    r"manoeuvres?|(?:normal|marginal|linear|minim)ise[drs]?|analysed?)\b",
    re.IGNORECASE,
)
IN_FILES = {"flight_told_by"}
"""Names of JSON keys, which stay."""
SOURCES = sorted(
    path for folder in ("src/gcs_sysid", "sim_bridge") for path in (ROOT / folder).rglob("*.py")
)
ASSETS = sorted((ROOT / "src" / "gcs_sysid" / "web" / "assets").glob("*.[hj]*"))
TERMS = ROOT / "docs" / "terms.md"
"""Names what it replaced."""
PAGES = sorted({*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"} - {TERMS})


def texts(source: str) -> Iterator[tuple[int, str]]:
    """String literals that are no docstring and no name: line and text."""
    tree = ast.parse(source)
    unseen = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    unseen |= {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.Subscript)
        for part in ast.walk(node.slice)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            # One word, a path or an identifier is a key of JSON or a class of CSS.
            named = re.fullmatch(r"[\w./:#-]*", node.value)
            if id(node) not in unseen and not named:
                yield node.lineno, node.value


def test_the_search_finds_what_it_is_for():
    assert [line for line, _ in texts('"""the data tell"""\nx = "the data do not tell Izz"')] == [2]
    assert REPLACED.search("the data do not tell Izz")
    assert REPLACED.search("write over a FILE")
    assert not REPLACED.search("overwrite existing files")
    assert [text for _, text in texts('f(f"{a} is known roughly, {b}")')] == [" is known roughly, "]
    assert len(SOURCES) > 200
    assert sum(1 for path in SOURCES[::20] for _ in texts(path.read_text("utf-8"))) > 75


def test_no_two_modules_share_a_name():
    names = Counter(path.stem for path in SOURCES if not path.stem.startswith("__"))
    assert [name for name, count in names.items() if count > 1] == []


def values_of_keys(source: str) -> Iterator[tuple[int, str]]:
    """Literals that a dictionary's key may have as its value, as JSON files do: line and text."""
    for table in ast.walk(ast.parse(source)):
        for value in table.values if isinstance(table, ast.Dict) else ():
            either = [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]
            for one in either:
                if isinstance(one, ast.Constant) and isinstance(one.value, str):
                    yield one.lineno, one.value


def test_values_in_files_use_the_words_of_the_glossary():
    assert next(values_of_keys('{"verdict": "told" if x else "refused"}')) == (1, "told")
    quoted = re.compile(rf"[\"'](?:{REPLACED.pattern})[\"']", re.IGNORECASE)
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in SOURCES
        # The report's tables name groups of figures within one page, and no file has them.
        if "report" not in path.parts and quoted.search(source := path.read_text("utf-8"))
        for line, text in values_of_keys(source)
        if REPLACED.fullmatch(text)
    ]
    assert found == []


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted({path.relative_to(ROOT).parts[-2] for path in SOURCES}))
def test_messages_use_the_words_of_the_glossary(folder):
    found = [
        f"{path.relative_to(ROOT)}:{line}: {match[0]}: {text.strip()}"
        for path in SOURCES
        if path.parts[-2] == folder and REPLACED.search(source := path.read_text("utf-8"))
        for line, text in texts(source)
        # One of the three words that an answer begins with, and a verdict on a parameter.
        if (match := REPLACED.search(text.replace("CANNOT TELL", "").removeprefix("cannot tell")))
    ]
    assert found == []


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Docstrings and comments: first line and text."""
    for node in ast.walk(ast.parse(source)):
        text = node.value if isinstance(node, ast.Expr) else None
        if isinstance(text, ast.Constant) and isinstance(text.value, str):
            yield node.lineno, text.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def replaced_in_prose(source: str) -> list[str]:
    found = []
    # Most files have none of these words at all, and tokenizing them takes most of the time.
    if PROSE.search(source):
        for line, text in prose(source):
            # Names between backticks, and those of attributes at the head of their entry.
            named = re.sub(r"`[^`]*`|^ +\w+: ", " ", text, flags=re.MULTILINE)
            found += [f"{line}: {match[0]}" for match in PROSE.finditer(named)]
    return found


def test_docstrings_and_comments_use_the_words_of_the_glossary():
    assert replaced_in_prose('"""What the data\ntell."""\nx = 1  # made anew\n') == [
        "1: tell",
        "3: anew",
    ]
    assert replaced_in_prose('y = "told"\ndef tell():\n    """As `tell` does."""\n') == []
    found = [
        f"{path.relative_to(ROOT)}:{each}"
        for path in SOURCES
        for each in replaced_in_prose(path.read_text("utf-8"))
    ]
    assert found == []


NAMES = re.compile(
    r"told|tells?|untold|speaks?|spoken?|hears?|heard|(?:un)?learnt|anew|yardsticks?|reckon|footing|"
    r"colours?|neighbours?|behaviour|(?:un)?modelled|metres?|centres?|analyse|wishes|reel",
    re.IGNORECASE,
)
"""Words of identifiers that the glossary replaced. Those that have another meaning too, such as
`moments`, are left to the eye."""


def named(source: str) -> Iterator[tuple[int, str]]:
    """Names that a module gives to classes, functions, arguments, variables and attributes."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.arg(arg=name):
                yield node.lineno, name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name


def replaced_in_names(source: str) -> list[str]:
    return [
        f"{line}: {name}"
        for line, name in named(source)
        # The words of snake_case and of CamelCase.
        if any(map(NAMES.fullmatch, re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)))
    ]


def test_identifiers_use_the_words_of_the_glossary():
    assert replaced_in_names("class HeardVehicle:\n    told_at = 1.0\n    theta = 2.0\n") == [
        "1: HeardVehicle",
        "2: told_at",
    ]
    found = [
        f"{path.relative_to(ROOT)}:{each}"
        for path in SOURCES
        if NAMES.search(source := path.read_text("utf-8"))
        for each in replaced_in_names(source)
        if each.partition(": ")[2] not in IN_FILES
    ]
    assert found == []


def words_of_page(asset: Path) -> list[str]:
    """What HTML shows between its tags and in labels, and literals of a script with a space."""
    text = asset.read_text("utf-8")
    if asset.suffix == ".html":
        return re.findall(r">([^<>]*\w[^<>]*)<|(?:aria-label|title|placeholder)=\"([^\"]+)\"", text)
    literals = re.findall(r"\"[^\"\n]*\"|`[^`\n]*`", text)
    return [re.sub(r"\$\{[^}]*\}", "", literal) for literal in literals if " " in literal]


@pytest.mark.parametrize("asset", ASSETS, ids=lambda asset: asset.name)
def test_pages_in_the_browser_use_the_words_of_the_glossary(asset):
    shown = [" ".join(text) if isinstance(text, tuple) else text for text in words_of_page(asset)]
    assert len(shown) > 2
    assert [text for text in shown if REPLACED.search(text)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_use_the_words_of_the_glossary(page):
    # Code, and what stands between backticks, are names.
    text = re.sub(r"`[^`\n]*`", "", page.read_text("utf-8"))
    found = [
        f"{number}: {match[0]}: {line.strip()}"
        for number, line in enumerate(text.splitlines(), 1)
        if (match := DOCS.search(line))
    ]
    assert found == []
