"""How things show themselves in a notebook: tables and lists in HTML, with every text escaped."""

from collections.abc import Iterable
from html import escape
from typing import Protocol


class Caused(Protocol):
    """Something that follows from other things of its kind, and says so in a sentence."""

    @property
    def sentence(self) -> str: ...
    @property
    def causes(self) -> "tuple[Caused, ...]": ...


def table(caption: str, head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table; what is None stays empty."""
    titles = "".join(f'<th scope="col">{escape(one)}</th>' for one in head)
    lines = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return f"<table><caption>{escape(caption)}</caption><thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table>"


def causes(of: Caused) -> str:
    """Return a sentence with what it follows from, to be unfolded."""
    below = "".join(f"<li>{causes(one)}</li>" for one in of.causes)
    said = escape(of.sentence)
    return f"<details><summary>{said}</summary><ul>{below}</ul></details>" if below else said


def _cell(value: object) -> str:
    return f"<td>{'' if value is None else escape(str(value))}</td>"
