"""Visitors: what is seen of a tree while it is ticked."""

from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Final, Self, TextIO

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.visitors import VisitorBase

from kb import KnowledgeBase
from rosa_bt.facts import Listener
from rosa_bt.traces import Node, Tick, Trace, Visit, written

__all__ = ["TraceVisitor"]

KEPT: Final = 10_000


class TraceVisitor(VisitorBase):
    """Writes down every tick: what was told before it, what was ticked, with which feedback, and what was decided.

    Add it to the visitors of a tree before its first tick. The same run gives the same trace, to the byte. Memory is
    bounded: the last ticks are kept, and with a file, all are in the file.

    Args:
        kb: the knowledge base that the tree asks and tells.
        path: a file to write to as well, one line for each tick; anew.
        keep: how many ticks to keep in memory; the last ones.
    """

    def __init__(self, kb: KnowledgeBase, path: str | Path | None = None, *, keep: int = KEPT) -> None:
        super().__init__(full=False)
        if keep < 1:
            raise ValueError(f"keep is a number of ticks from 1, not {keep!r}")
        self._kb = kb
        self._listener = Listener(kb)
        self._file: TextIO | None = None if path is None else Path(path).open("w", encoding="utf-8")  # noqa: SIM115  # closed by close()
        self._ticks: deque[Tick] = deque(maxlen=keep)
        self._count = 0
        self._tree: tuple[Node, ...] = ()
        self._numbers: dict[Behaviour, int] = {}
        self._seen: list[tuple[Behaviour, Status, str]] = []
        self._seen_before: list[tuple[Behaviour, Status, str]] = []
        self._visited: tuple[Visit, ...] = ()

    @property
    def trace(self) -> Trace:
        """The ticks that are kept."""
        return Trace(self._kb.model.name, tuple(self._ticks))

    def initialise(self) -> None:
        """Begin a tick; from now on it is the tree that tells."""
        self._seen = []
        self._facts = self._listener.take_facts()
        self._listener.is_deaf = True

    def run(self, behaviour: Behaviour) -> None:
        """See a behaviour that was ticked."""
        self._seen.append((behaviour, behaviour.status, behaviour.feedback_message))

    def finalise(self) -> None:
        """Write the tick down."""
        self._listener.is_deaf = False
        if self._seen != self._seen_before:
            self._number()
            self._visited = tuple(Visit(self._numbers[node], status.name, text) for node, status, text in self._seen)
            self._seen_before = self._seen
        decisions = self._listener.take_decisions()
        tick = Tick(self._count, float(self._kb.now), self._tree, self._visited, self._facts, decisions)
        if self._file is not None:
            self._file.writelines(written(self._kb.model.name, [tick], self._ticks[-1] if self._ticks else None))
        self._ticks.append(tick)
        self._count += 1

    def close(self) -> None:
        """Hear no more of the knowledge base, and close the file."""
        self._listener.stop()
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _number(self) -> None:
        """Number the behaviours of the tree, parents before children, if there are new ones."""
        if all(node in self._numbers for node, _, _ in self._seen):
            return
        root = self._seen[-1][0]
        shown: list[Node] = []
        pending = [(root, 0)]
        self._numbers = {}
        while pending:
            behaviour, depth = pending.pop()
            self._numbers[behaviour] = len(shown)
            shown.append(Node(depth, type(behaviour).__name__, behaviour.name))
            pending += [(child, depth + 1) for child in reversed(behaviour.children)]
        for behaviour, _, _ in self._seen:  # a step of a plan may be over, and gone, when the tick is
            if behaviour not in self._numbers:
                self._numbers[behaviour] = len(shown)
                shown.append(Node(1, type(behaviour).__name__, behaviour.name))
        self._tree = tuple(shown)
