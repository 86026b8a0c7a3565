"""Golden traces: what a tree did the last time that somebody looked at it and found it right."""

import re
from collections.abc import Iterator
from difflib import unified_diff
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rosa_bt import Trace

MOST: Final = 40
"""How many lines of a difference are shown."""


def golden_path(test_file: Path, test: str, name: str = "") -> Path:
    """Return where the golden trace of a test is kept, or the one of a name if it has several: beside its file."""
    words = (re.sub(r"[^\w\-]+", "_", part).strip("_") for part in (test_file.stem, test, name) if part)
    return test_file.parent / "golden" / f"{'.'.join(words)}.trace"


def check_golden(trace: "Trace", path: Path, *, update: bool, command: str) -> bool:
    """Compare a trace with the golden one, or with `update` write that if it differs; return whether it was written.

    Raises:
        AssertionError: it differs, or there is none; says how, and the command with which a person has it written.
        rosa_bt.TraceError: what is there is no trace.
    """
    __tracebackhide__ = True
    from rosa_bt import Trace, read_trace

    if not isinstance(trace, Trace):
        raise TypeError(f"a golden trace is a rosa_bt.Trace, such as decisions.trace, not a {type(trace).__name__}")
    text = str(trace)
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return False
    if update:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return True
    now = list(readable(trace))
    if not path.exists():
        what, how, shown = "there is no golden trace", "write", now
    else:
        golden = list(readable(read_trace(path)))
        what, how = "not as in the golden trace", "update"
        shown = list(unified_diff(golden, now, "golden", "now", lineterm="", n=4))
    if len(shown) > MOST:
        shown[MOST:] = [f"... and {len(shown) - MOST} more lines"]
    lines = "\n".join(shown)
    raise AssertionError(f"{what} {path}\nif this is as it should be, {how} it: {command}\n\n{lines}")


def readable(trace: "Trace") -> Iterator[str]:
    """Yield a trace as lines for people: for each tick with news, what became known, was done and decided."""
    yield f"model {trace.model}"
    before = None
    for tick in trace.ticks:
        lines = [f"  event    {event.verb} {', '.join(map(str, event.arguments))}" for event in tick.events]
        if before is None or tick.tree != before.tree:
            lines += [f"  tree     {'  ' * node.depth}{node.kind} {node.name}" for node in tick.tree]
        if before is None or tick.visited != before.visited:
            for visit in tick.visited:
                feedback = f" ({visit.feedback})" if visit.feedback else ""
                lines.append(f"  ticked   {tick.tree[visit.node].name}: {visit.status}{feedback}")
        for decision in tick.decisions:
            reason = f": {decision.reason}" if decision.reason else ""
            lines.append(f"  decided  {decision.action} is {decision.what}{reason}")
        if lines:
            yield f"tick {tick.number} at {tick.time:.2f} s"
            yield from lines
        before = tick
    yield f"{len(trace.ticks)} ticks"
