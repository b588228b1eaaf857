"""Pages of the documentation: their links, their list, their first sentence."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from support import ROOT

LAYERS = ("config", "backends", "controller", "observer", "pepper_driver")
INDEX = ROOT / "docs" / "README.md"
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "examples").rglob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]


def prose(page: Path) -> str:
    """Return the text of a page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Yield file and anchor of each link to a file of the repository."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if not target.startswith(("http://", "https://")):
            path, _, anchor = target.partition("#")
            yield ((page.parent / path).resolve() if path else page), anchor


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_a_file_and_a_heading(page: Path) -> None:
    for path, anchor in links(page):
        assert path.exists(), f"{page.relative_to(ROOT)} links to {path}"
        if anchor:
            assert anchor in anchors(path), f"{page.relative_to(ROOT)} links to #{anchor} of {path}"


def test_the_index_lists_each_page_once() -> None:
    listed = [
        path
        for path, _ in links(INDEX)
        if path.suffix == ".md" and path.parent != ROOT / "examples"
    ]
    in_tables = re.findall(r"^\| \[[^]]+\]\(([^)]+)\) \|", INDEX.read_text(), re.MULTILINE)
    pages = {page for page in PAGES if page.is_relative_to(ROOT / "docs")} - {INDEX}
    assert pages <= set(listed)
    assert len(in_tables) == len(set(in_tables)), "a page is listed twice"
    assert (ROOT / "docs" / "README.md").resolve() in {
        path for path, _ in links(ROOT / "README.md")
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_begins_with_its_title_and_a_sentence(page: Path) -> None:
    blocks = [
        block
        for block in page.read_text().split("\n\n")
        if not block.startswith("*All results here are ")  # first line of a written report
    ]
    assert re.fullmatch(r"# \S.*", blocks[0]), f"{page.name}: {blocks[0]!r}"
    assert re.match(r"[A-Z`\[*]", blocks[1]), f"{page.name}: {blocks[1]!r}"


def test_names_of_the_glossary_are_in_the_code() -> None:
    """Each word of its last column is a word of the sources."""
    files = (path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))
    words = set(re.findall(r"\w+", "\n".join(path.read_text() for path in files)))
    rows = re.findall(
        r"^\| .* \| ([^|]+) \|$", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE
    )
    names = [name for row in rows for name in re.findall(r"`([\w.]+)`", row)]
    assert len(names) > 50
    missing = [name for name in names if not words.issuperset(name.split("."))]
    assert not missing, f"docs/glossary.md: not in the code: {', '.join(missing)}"
