"""Times as figures, and figures as tables in markdown."""

from collections.abc import Iterable, Sequence
from statistics import quantiles

__all__ = ["percentiles", "shown", "table"]


def percentiles(times: Sequence[float]) -> tuple[float, float, float]:
    """Return the median, and what 90 and 99 of 100 stay below."""
    cuts = quantiles(times, n=100, method="inclusive")
    return cuts[49], cuts[89], cuts[98]


def shown(seconds: float) -> str:
    """Write a time with three digits that matter."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return (
                f"{seconds / size:.3g} {unit}"
                if seconds < 1000 * size
                else f"{seconds / size:.0f} {unit}"
            )
    return f"{seconds * 1e9:.0f} ns"


def table(title: str, head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Write a table in markdown; what is None is shown as not measured."""
    head = list(head)
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    cells = [["-" if cell is None else str(cell) for cell in line] for line in lines]
    return "\n".join([f"**{title}**", "", *(f"| {' | '.join(line)} |" for line in cells), ""])
