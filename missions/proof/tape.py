"""What a tree asks of its knowledge base and tells it in a tick, kept so that the tick need not be run again.

The state of the tree, what leaves answer and what the knowledge base says when it is asked decide a tick. So it is run
once, and followed in every other state of the knowledge base that says the same.
"""

import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from types import MethodType
from typing import Any, Final, NamedTuple, Protocol

from kb import KnowledgeBase
from kb.views import ElementView, Views
from missions.proof.surroundings import Choice, Choices

Path = tuple[tuple[Callable[..., Any], tuple[Any, ...]], ...]
"""Attributes, items and calls, one after another, beginning at the knowledge base."""

_OF_NO_USE: Final = ("log", "revision")
"""What was told so far decides nothing: what is so does."""
_LIVE: Final = (KnowledgeBase, Views, ElementView, MethodType)
"""What says how it is now, however long it is held; the rest is of one moment."""


class _States(Protocol):
    """The states of a knowledge base, by number; see `missions.proof.memory.Memory`."""

    def read(self) -> int: ...

    def write(self, number: int) -> None: ...


class _Reached(NamedTuple):
    """What is stood for: how it is reached, None if it cannot be again; and until which event, None if always."""

    tape: "Tape"
    real: Any
    path: Path | None
    at: int | None = None


def _asking(does: Callable[..., Any]) -> Callable[..., Any]:
    """Return the method by which this is asked of what is stood for."""
    return lambda self, *given: _how(self).tape.ask(self, does, *given)


class Asked:
    """Stands for a knowledge base, or what was reached from it, and notes what it is asked and told.

    What it gives are values and others of its kind. A tree that takes anything else is not followed, but run.
    """

    __slots__ = ("__weakref__", "_how")

    def __init__(self, how: _Reached) -> None:
        object.__setattr__(self, "_how", how)

    @property  # type: ignore[misc]  # what it stands for is what it says to be
    def __class__(self) -> type:
        return type(self._how.real)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever there is
        if name == "reading":
            return self._how.tape.reading
        return getattr(self._how.real, name) if name in _OF_NO_USE else self._how.tape.ask(self, getattr, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._how.real, name, value)
        self._how.tape.is_on = False

    def __call__(self, *given: object, **named: object) -> Any:  # noqa: ANN401  # whatever there is
        return self._how.tape.ask(self, _call, given, tuple(named.items()))

    def __iter__(self) -> Iterator[Any]:
        found = self._how.tape.ask(self, tuple)
        return iter(found if type(found) is tuple else [found[place] for place in range(len(found))])

    def __repr__(self) -> str:
        steps = [f"{does.__name__}{given}" for does, given in self._how.path or ()]
        return f"{self.__class__.__name__} by {', '.join(steps) or 'itself'}"

    def __eq__(self, other: object) -> bool:
        return self is other or bool(self._how.tape.ask(self, operator.eq, other))

    def __hash__(self) -> int:
        return hash(self._how.real)

    __getitem__ = _asking(operator.getitem)
    __contains__ = _asking(operator.contains)
    __len__ = _asking(len)
    __bool__ = _asking(bool)
    __str__ = _asking(str)


def settled(asked: Asked) -> object:
    """Return what a tree holds from one tick to the next: what is reached by names is asked anew each time."""
    how = _how(asked)
    if how.at is None and how.path is not None:
        return asked
    how.tape.is_on = False
    return how.real


@dataclass(slots=True)
class _Moment:
    """A moment of a tick: what is asked or chosen next, and what comes then; or the state of the tree at its end."""

    question: Choice | Path | None = None
    then: dict[object, "_Moment"] = field(default_factory=dict)
    after: int | None = None


class Tape:
    """Ticks as they were run, by what was said in them.

    Args:
        kb: the knowledge base.
        choices: what leaves answer; they hold what was said.
        is_on: whether all that the tree takes from it is noted; an attribute too, False from when something is not.

    Attributes:
        kb: what stands for the knowledge base.
    """

    def __init__(self, kb: KnowledgeBase, choices: Choices, *, is_on: bool) -> None:
        self._kb, self._choices, self.is_on = kb, choices, is_on
        self._reached: dict[Path, Asked] = {}
        self._first: dict[int, _Moment] = {}
        self._answered: dict[tuple[int, Path], tuple[object, int]] = {}
        self.kb: Any = self._stand_in(kb, ())

    def ask(self, asked: Asked, does: Callable[..., Any], *given: object) -> Any:  # noqa: ANN401  # whatever there is
        """Do something with what is stood for, and note what came of it."""
        _, real, path, at = _how(asked)
        self.is_on = self.is_on and path is not None and at in (None, self._kb.log.last) and _is_hashable(given)
        try:
            found = does(real, *map(_plain, given))
        except Exception:
            self.is_on = False
            raise
        if not self.is_on or path is None:
            return found
        path = (*path, (does, given))
        is_value = _is_value(found)
        self._choices.said.append((path, found if is_value else type(found)))
        return found if is_value else self._stand_in(found, path)

    @contextmanager
    def reading(self) -> Iterator[Asked]:
        """Have nothing change meanwhile."""
        with self._kb.reading() as state:
            yield Asked(_Reached(self, state, None))

    def keep(self, tree: int, after: int) -> None:
        """Keep the tick that was run last: in which state the tree was, and in which it is."""
        moment = self._first.setdefault(tree, _Moment())
        for question, answer in self._choices.said:
            if moment.question != question:  # not yet known, or told with other words, which decide nothing
                moment.question, moment.then = question, {}
            moment = moment.then.setdefault(answer, _Moment())
        moment.after = after

    def follow(self, tree: int, known: int, memory: _States) -> tuple[int, int] | None:
        """Return the states of tree and knowledge base after a tick, or None where it has to be run to know that."""
        moment = self._first.get(tree) if self.is_on else None
        while moment is not None and moment.after is None:
            if isinstance(moment.question, Choice):
                answer: object = self._choices.take(moment.question)
            else:
                answer, known = self._say(moment.question or (), known, memory)
            moment = moment.then.get(answer)
        return None if moment is None or moment.after is None else (moment.after, known)

    def _say(self, path: Path, known: int, memory: _States) -> tuple[object, int]:
        """Return what is answered in a state of the knowledge base, and in which it is then."""
        said = self._answered.get((known, path))
        if said is not None:
            return said
        memory.write(known)
        last, found = self._kb.log.last, self._kb
        for does, given in path:
            found = does(found, *map(_plain, given))
        after = known if self._kb.log.last == last else memory.read()
        said = self._answered[known, path] = (found if _is_value(found) else type(found)), after
        return said

    def _stand_in(self, real: object, path: Path) -> Asked:
        if not isinstance(real, _LIVE):
            return Asked(_Reached(self, real, None if hasattr(real, "__next__") else path, self._kb.log.last))
        return self._reached.setdefault(path, Asked(_Reached(self, real, path)))


def _plain(given: object) -> Any:  # noqa: ANN401  # whatever there is
    return _how(given).real if type(given) is Asked else given


def _how(asked: Asked) -> _Reached:
    return object.__getattribute__(asked, "_how")  # type: ignore[no-any-return]  # its only slot


def _is_hashable(given: object) -> bool:
    try:
        return hash(given) is not None
    except TypeError:
        return False


def _call(real: Callable[..., object], given: Iterable[object], named: Iterable[tuple[str, object]]) -> object:
    return real(*map(_plain, given), **{name: _plain(one) for name, one in named})


def _is_value(found: object) -> bool:
    kind = type(found)
    if issubclass(kind, tuple | frozenset):
        return all(map(_is_value, found))  # type: ignore[call-overload]  # it has items
    return found is None or issubclass(kind, int | float | str | bytes | Enum)
