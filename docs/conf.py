"""How Sphinx makes the site of these pages: `make site`, without a network, into build/site."""

import re
import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from typer.main import get_command

sys.path.insert(0, str(Path(__file__).parents[1]))
from missions import cli

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


def commands() -> str:
    """Return a section for each command of `rosa`, with its arguments and options."""
    group = get_command(cli.app)
    context = group.make_context("rosa", [], resilient_parsing=True)
    sections = []
    for name in cli.COMMANDS:
        _, command, _ = group.resolve_command(context, [name])
        sections += section(f"rosa {name}", command)
        for below, inner in getattr(command, "commands", {}).items():
            sections += section(f"rosa {name} {below}", inner)
    return "\n".join(sections)


def section(title: str, command: Any) -> list[str]:  # noqa: ANN401  # typer's own click is private
    """Return the lines of a section about one command."""
    lines = [f"## `{title}`", "", command.help or "", ""]
    rows = []
    for parameter in command.params:
        if parameter.name == "help":
            continue
        name = (
            ", ".join(parameter.opts) if parameter.param_type_name == "option" else parameter.name
        )
        words = (getattr(parameter, "help", None) or "").replace("|", "\\|")
        default = parameter.default
        if isinstance(default, str | int | float) and not isinstance(default, bool):
            words += f" Default: {default}."
        rows.append(f"| `{name}` | {words} |")
    return [*lines, *(["| argument or option | meaning |", "|---|---|"] if rows else []), *rows, ""]


OUTSIDE = re.compile(r"\[([^]]+)\]\(\.\./([^)]+)\)")


def name_what_is_not_here(app: Sphinx, page: str, source: list[str]) -> None:
    """Folders of the repository, to which its own pages link, are named on the site."""

    def named(link: re.Match[str]) -> str:
        text, path = link.groups()
        if path == "README.md":
            return f"[{text}](index.md)"
        return f"{text} (in `{path}`)" if (Path(app.srcdir).parent / path).is_dir() else link[0]

    source[0] = OUTSIDE.sub(named, source[0])
    if page == "commands":
        source[0] += "\n" + commands()
    if page == "index":
        source[0] += "\n" + contents(
            (Path(app.srcdir).parent / "README.md").read_text(encoding="utf-8")
        )


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", name_what_is_not_here)
