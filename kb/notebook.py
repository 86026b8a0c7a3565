"""How things show themselves in a notebook: tables and lists in HTML, with every text escaped."""

from collections.abc import Iterable
from html import escape


def table(caption: str, head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table; what is None stays empty."""
    titles = "".join(f'<th scope="col">{escape(one)}</th>' for one in head)
    lines = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return f"<table><caption>{escape(caption)}</caption><thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table>"


def _cell(value: object) -> str:
    return f"<td>{'' if value is None else escape(str(value))}</td>"
