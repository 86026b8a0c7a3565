"""How Sphinx makes the site of these pages: `make site`, without a network, into build/site."""

import re
from pathlib import Path

from sphinx.application import Sphinx

project = "rosa-taca"
author = "The rosa-taca authors"
project_copyright = "the rosa-taca authors, Apache-2.0"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
autodoc_default_options = {"members": True, "imported-members": True, "member-order": "bysource"}
napoleon_use_ivar = True  # a field of a named tuple is described once
suppress_warnings = ["ref.python"]  # two classes may have a field of one name

html_theme = "furo"
html_title = "rosa-taca"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False

CAPTIONS = {
    **{
        "first": "Begin",
        "knowledge": "What the robot knows",
        "tasks": "What it does",
        "seen": "Seen",
    },
    **{"connected": "Connected", "measured": "Measured", "project": "The project"},
}
MORE = {
    "Coming from": ["coming_from/*"],
    "Reference": ["api/*"],
    "The project": ["changelog", "contributing", "security"],
}
"""What the README lists under which word, and what it does not list, in the order of the site."""


def contents(readme: str) -> str:
    """Return the lists of the site's pages, by the README's."""
    found = {
        CAPTIONS[word]: re.findall(r"\(docs/(\w+)\.md\)", row)
        for word, row in re.findall(r"\*\*(\w+)\*\* (\[.*)", readme)
    }
    project = {"The project": found.pop("The project") + MORE["The project"]}
    lists = {**found, **MORE, **project}
    head = "```{{toctree}}\n:caption: {}\n:hidden:\n:glob:\n\n{}\n```\n"
    return "\n".join(head.format(caption, "\n".join(pages)) for caption, pages in lists.items())


OUTSIDE = re.compile(r"\[([^]]+)\]\(\.\./([^)]+)\)")


def name_what_is_not_here(app: Sphinx, page: str, source: list[str]) -> None:
    """Folders of the repository, to which its own pages link, are named on the site."""

    def named(link: re.Match[str]) -> str:
        text, path = link.groups()
        if path == "README.md":
            return f"[{text}](index.md)"
        return f"{text} (in `{path}`)" if (Path(app.srcdir).parent / path).is_dir() else link[0]

    source[0] = OUTSIDE.sub(named, source[0])
    if page == "index":
        source[0] += "\n" + contents(
            (Path(app.srcdir).parent / "README.md").read_text(encoding="utf-8")
        )


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", name_what_is_not_here)
