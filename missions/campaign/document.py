"""A report as a document that is written as Markdown and as a web page."""

import base64
import html
from collections.abc import Callable, Mapping, Sequence

__all__ = ["Document"]

STYLE = """
body { font: 15px/1.45 sans-serif; color: #222; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #ddd; padding: .25rem .7rem; text-align: right; }
th { border-bottom: 2px solid #888; } th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } code { background: #f3f3f3; padding: 0 .2rem; }
"""


class Document:
    """Headings, paragraphs, tables, commands and figures, one after the other.

    Args:
        title: of the whole.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._markdown: list[str] = [f"# {title}"]
        self._html: list[Callable[[Mapping[str, bytes]], str]] = [lambda _: f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str, level: int = 2) -> None:
        """Begin a part."""
        self._add(f"{'#' * level} {text}", f"<h{level}>{html.escape(text)}</h{level}>")

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self._add(text, f"<p>{html.escape(text)}</p>")

    def items(self, texts: Sequence[str]) -> None:
        """Add a list."""
        rows = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
        self._add("\n".join(f"- {text}" for text in texts), f"<ul>{rows}</ul>")

    def commands(self, lines: Sequence[str]) -> None:
        """Add what can be typed."""
        text = "\n".join(lines)
        self._add(f"```sh\n{text}\n```", f"<pre><code>{html.escape(text)}</code></pre>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table; the first column names the rows."""
        marks = ["---", *["---:"] * (len(head) - 1)]
        lines = [f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |" for row in (head, marks, *rows)]
        tops = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        body = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        self._add("\n".join(lines), f"<table><tr>{tops}</tr>{body}</table>")

    def figure(self, name: str, caption: str) -> None:
        """Add a picture that is kept as NAME.png and NAME.svg; the page holds the second within itself."""
        self._markdown.append(f"![{caption}]({name}.png)")

        def image(pictures: Mapping[str, bytes]) -> str:
            data = base64.b64encode(pictures[f"{name}.svg"]).decode()
            return f'<img alt="{html.escape(caption)}" src="data:image/svg+xml;base64,{data}">'

        self._html.append(image)

    def as_markdown(self) -> str:
        """Return the whole as Markdown."""
        return "\n\n".join(self._markdown) + "\n"

    def as_html(self, pictures: Mapping[str, bytes]) -> str:
        """Return the whole as a web page that needs no other file.

        Args:
            pictures: content of each picture by the name of its file.
        """
        body = "\n".join(part(pictures) for part in self._html)
        head = f'<meta charset="utf-8"><title>{html.escape(self._title)}</title><style>{STYLE}</style>'
        return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'

    def _add(self, markdown: str, page: str) -> None:
        self._markdown.append(markdown)
        self._html.append(lambda _: page)
