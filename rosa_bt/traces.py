"""A trace: every tick of a tree as data, what was told before it and what was decided in it; written and read as JSON.

One line for each tick. The first line says what it is a trace of; a line with a tree comes before the first tick and
whenever the tree has changed. What a tick does not mention is as in the tick before.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from rosa_bt.exceptions import TraceError
from rosa_bt.facts import Decision, Fact

__all__ = ["Node", "Tick", "Trace", "Visit", "read_trace", "written"]

VERSION: Final = 1
_ENCODER: Final = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False)
_ESCAPED: Final = re.compile("[\x85\u2028\u2029\ud800-\udfff]")
"""What ends a line, or has no place in a file; text may hold it all the same."""
T = TypeVar("T")


class Node(NamedTuple):
    """A behaviour in a tree.

    Attributes:
        depth: how many behaviours it is below; 0 for the root.
        kind: name of its class.
        name: its own name, which others may have too.
    """

    depth: int
    kind: str
    name: str


class Visit(NamedTuple):
    """A behaviour that was ticked.

    Attributes:
        node: its number in the tree, parents before children.
        status: "SUCCESS", "FAILURE", "RUNNING" or "INVALID".
        feedback: its feedback message.
    """

    node: int
    status: str
    feedback: str


class Tick(NamedTuple):
    """One tick.

    Attributes:
        number: 0 for the first.
        time: when [s].
        tree: the behaviours of the tree, parents before children; the number of one is its place.
        visited: what was ticked, in order: children before parents.
        facts: what the knowledge base was told since the tick before.
        decisions: what became of actions since the end of the tick before.
    """

    number: int
    time: float
    tree: tuple[Node, ...]
    visited: tuple[Visit, ...]
    facts: tuple[Fact, ...] = ()
    decisions: tuple[Decision, ...] = ()


@dataclass(frozen=True, slots=True)
class Trace:
    """The ticks of a tree.

    Attributes:
        model: name of the knowledge base's model.
        ticks: in order; a trace that was kept in memory may lack the first ones.
    """

    model: str
    ticks: tuple[Tick, ...]

    def __str__(self) -> str:
        return "".join(written(self.model, self.ticks))

    def write(self, path: str | Path) -> None:
        """Write the trace to a file; the same ticks are the same bytes."""
        Path(path).write_text(str(self), encoding="utf-8")


def written(model: str, ticks: Iterable[Tick], before: Tick | None = None) -> Iterator[str]:
    """Yield the lines of a trace.

    Args:
        model: name of the model; a line for it comes first unless something was written before.
        ticks: what to write.
        before: the tick that was written last.
    """
    if before is None:
        yield _line({"rosa_bt_trace": VERSION, "model": model})
    for tick in ticks:
        if before is None or tick.tree != before.tree:
            yield _line({"tree": tick.tree})
        line: dict[str, object] = {"tick": tick.number, "time": tick.time}
        if before is None or tick.visited != before.visited:
            line["visited"] = tick.visited
        if tick.facts:
            line["facts"] = tick.facts
        if tick.decisions:
            line["decisions"] = tick.decisions
        yield _line(line)
        before = tick


def read_trace(path: str | Path) -> Trace:
    """Read a trace from a file.

    Raises:
        TraceError: the file cannot be read, or is no trace; names the line.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TraceError(f"cannot read the trace {path}: {error}") from error
    if not lines:
        raise TraceError(f"{path} is empty; a trace begins with a line that says what it is")
    head = _read(lines[0], f"{path}:1", lambda line: (int(line["rosa_bt_trace"]), str(line["model"])))
    if head[0] != VERSION:
        raise TraceError(f"{path} is a trace of version {head[0]}; this program reads version {VERSION}")
    ticks: list[Tick] = []
    tree: tuple[Node, ...] = ()
    for number, text in enumerate(lines[1:], start=2):
        visited = ticks[-1].visited if ticks else ()
        found = _read(text, f"{path}:{number}", partial(_part, tree=tree, visited=visited))
        if isinstance(found, Tick):
            ticks.append(found)
        else:
            tree = found
    return Trace(head[1], tuple(ticks))


def _line(record: dict[str, object]) -> str:
    return _ESCAPED.sub(lambda found: f"\\u{ord(found[0]):04x}", _ENCODER.encode(record)) + "\n"


def _read(text: str, where: str, read: Callable[[dict[str, Any]], T]) -> T:
    try:
        return read(json.loads(text))
    except json.JSONDecodeError as error:
        raise TraceError(f"{where}:{error.colno}: not JSON ({error.msg}); one object per line is expected") from None
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise TraceError(f"{where}: no line of a trace ({type(error).__name__}: {error})") from None


def _part(line: dict[str, Any], tree: tuple[Node, ...], visited: tuple[Visit, ...]) -> Tick | tuple[Node, ...]:
    if "tree" in line:
        return tuple(Node(*node) for node in line["tree"])
    if "visited" in line:
        visited = tuple(Visit(*visit) for visit in line["visited"])
    facts = tuple(Fact(time, verb, tuple(arguments)) for time, verb, arguments in line.get("facts", ()))
    decisions = tuple(Decision(*decision) for decision in line.get("decisions", ()))
    return Tick(int(line["tick"]), float(line["time"]), tree, visited, facts, decisions)
