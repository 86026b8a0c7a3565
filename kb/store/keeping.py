"""Keeping what is told: in a store, on disk; and asking about all of it, with a store or without."""

import sqlite3
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from threading import Lock
from typing import TYPE_CHECKING, Final
from weakref import WeakMethod, finalize

from kb.elements import finite_number
from kb.events import Event
from kb.exceptions import InvalidValue
from kb.individuals import Individual, element_id, individuals
from kb.inference.network import Network, Node
from kb.rdfxml import metamodel
from kb.store.journal import Group, Journal, Measured
from kb.store.recovery import Past, base_of
from kb.store.writer import measurement
from kb.telling import Telling

if TYPE_CHECKING:
    from kb.owl import Answer, Book

__all__ = ["KEPT", "Keeping"]

KEPT: Final = 10_000
"""How many measurements of each attribute are kept; the newest."""

_UNSAVED: Final = 10_000
"""How many calls that changed something are remembered for queries, without a store; beside the measurements."""

_APART: Final = 10**12
"""What the numbers of measurements begin with where they are not counted among the facts."""


class Keeping(Telling):
    """Everything that has to do with keeping what is told.

    Args:
        network: what depends on what.
        clock: gives the time [s].
        past: the open store, if there is one.
        keep: how many measurements of each attribute are kept.
    """

    def __init__(self, network: Network, clock: Callable[[], float], past: Past | None, keep: int) -> None:
        super().__init__(network, clock)
        self._keep = keep
        self._store = past.store if past else None
        self._book: Book | None = None
        self._book_of = (0, 0, 0)
        self._is_copy = False
        self._asking = Lock()
        self._journal = Journal(network.model, most=_UNSAVED)
        if past:
            self._journal = Journal(network.model, keeps_measurements=True)
            self._journal.serials, self._journal.told = past.serials, past.store.saved

    @property
    def told(self) -> int:
        """The number of the last fact; each that a store has to keep is counted."""
        return self._journal.told

    @property
    def saved(self) -> int:
        """The number of the last fact that is on disk; 0 without a store."""
        return self._store.saved if self._store else 0

    @property
    def store_error(self) -> str | None:
        """Why nothing is saved at present, or any more; None while all is well."""
        return self._store.error if self._store else None

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all that was told by now is on disk; returns whether it is.

        A subscriber must not wait so: it holds the base, and the writer needs that.

        Args:
            timeout: how long to wait at most [s].
        """
        return self._store is not None and self._store.flush(timeout)

    def close(self) -> None:
        """Save what is left and give the store back; what was in it is copied first, for it can still be asked for."""
        if self._store is None or self._store.is_closed:
            return
        with self._asking:
            self._store.finish()
            if self._book is None or self._is_copy:
                self._book = self._new_book(list(individuals(self._network.model, self._journal.serials)))
                self._book_of, self._is_copy = (0, 0, 0), False
            self._store.release()
        with self._lock:
            self._keep_in_memory()

    def query(self, sparql: str, timeout: float = 10.0) -> "list[tuple[Answer, ...]]":
        """Answer a SPARQL query over the model, all that was told, and the statuses that follow from it.

        Args:
            sparql: a SELECT; `:` and `rosa:` stand for the words of ROSA.
            timeout: how long it may take [s].

        Returns:
            One tuple for each answer: numbers, texts, booleans, None; an individual is given as its IRI.

        Raises:
            InvalidValue: it is no query, or would change something.
            KnowledgeBaseError: it was stopped at its time-out.
        """
        if finite_number(timeout) <= 0:
            raise InvalidValue(f"a timeout is a time in seconds above 0, not {timeout!r}")
        with self._asking:
            return self._current_book(timeout).ask(sparql, timeout)

    def _begin_to_save(self) -> None:
        """Have the store write from now on, for as long as the base is there or until it is closed."""
        if self._store is not None:
            news = WeakMethod(self._tell_of_saving)
            self._journal.heard = self._store.wake
            self._store.start(self._journal, self._lock, lambda text: called(text) if (called := news()) else None)
            finalize(self, self._store.close)

    def _tell_of_saving(self, text: str) -> None:
        with self._lock:
            if self._store is None or self._store.is_given_up:
                self._keep_in_memory()
            if self._publisher:
                self._publisher.publish(Event(0, self._clock(), "store", (text,), words=text))

    def _keep_in_memory(self) -> None:
        self._journal.keeps_measurements = False
        self._journal.heard = lambda: None
        self._journal.waiting = deque(self._journal.waiting, _UNSAVED)

    def _current_book(self, timeout: float) -> "Book":
        """Return a book in memory in which all is written that is known now."""
        if self._journal.keeps_measurements:
            self.flush(timeout)
        with self._lock:
            saving = self._journal.keeps_measurements
            samples = () if saving else tuple(self._samples())
            now = (self._journal.told, self.revision, len(samples))
            if self._book is not None and now == self._book_of and saving == self._is_copy:
                return self._book
            inferred = [self._inferred(node) for node in self._elements()]
            model = list(individuals(self._network.model, self._journal.serials))
            waiting = list(self._journal.waiting)
            if not saving:
                self._journal.waiting.clear()
        if self._book is None or saving or self._is_copy:
            self._book = self._new_book(model)
        self._book.write_model(model)
        self._book.write(_later(waiting, self._book.number if saving else -1))
        if not saving:
            self._book.forget_measurements()
            self._book.write(measurement(one) for one in samples)
        self._book.write_inferred(inferred)
        self._book.commit()
        self._book_of, self._is_copy = now, saving
        return self._book

    def _new_book(self, model: list[Individual]) -> "Book":
        """Return a book in memory with what the store holds, if there is one that can be read."""
        from kb.owl import Book

        if self._book is not None:
            self._book.close()
            self._book = None
        book = Book(base_of(self._network.model))
        try:
            if self._store is not None:
                self._store.copy_to(book)
                return book
        except sqlite3.Error:
            book.close()
            book = Book(base_of(self._network.model))
        book.describe(metamodel(), model)
        return book

    def _samples(self) -> Iterator[Measured]:
        number = _APART
        for node in self._network.attributes.values():
            for time, value in self._history_of(node).samples()[-self._keep :]:
                number += 1
                yield Measured(number, node.name, value, time)

    def _elements(self) -> Iterator[Node]:
        network = self._network
        for table in (network.actions, network.functions, network.components, network.designs, network.configurations):
            yield from table.values()
        yield from network.constraints.values()

    def _inferred(self, node: Node) -> Individual:
        state = self._known
        values: dict[str, tuple[str | bool, ...]] = {"status": (str(state.status[node.index]),)}
        if node.kind in ("action", "function", "component"):
            values["isRequired"] = (state.required[node.index],)
        return Individual("", element_id(node.element, self._journal.serials), values)


def _later(told: Sequence[Measured | Group], number: int) -> Iterator[Individual]:
    """Yield what was told after a fact; before all facts, measurements are written otherwise."""
    for one in told:
        if isinstance(one, Group):
            yield from one.entries if one.last > number else ()
        elif 0 <= number < one.number:
            yield measurement(one)
