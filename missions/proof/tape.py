"""Record what a tree asks its knowledge base and tells it in a tick, so that the tick need not be run again.

A tick depends on the state of the tree, the answers of leaves and the answers of the knowledge base alone. So it is run
once, and its record is followed in every other state of the knowledge base that gives the same answers.
"""

import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from types import MethodType
from typing import Any, Final, NamedTuple, Protocol

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase
from kb.views import ElementView, Views

Answer = tuple[str, str]
"""The name of a leaf, and the letter of what it returned: R, S or F."""

Path = tuple[tuple[Callable[..., Any], tuple[Any, ...]], ...]
"""How a value is reached from the knowledge base: attributes, items and calls, one after another."""

_OF_NO_USE: Final = ("log", "revision")
"""Not recorded: the number of events so far decides nothing, the present facts do."""
_LIVE: Final = (KnowledgeBase, Views, ElementView, MethodType)
"""Types whose objects always show the present state; all others are valid at one moment only."""


class Choice(NamedTuple):
    """A question to a leaf: its name, and the letters that it may return."""

    name: str
    letters: str


class Choices:
    """Decides what leaves answer in a tick: first by a script, then the first letter; a leaf asked again says the same.

    Attributes:
        taken: the answers since `begin`.
        others: scripts for the answers that were possible but not taken, each once.
        said: all questions with their answers: to leaves, and to the knowledge base (see `Tape`).
    """

    def __init__(self) -> None:
        self.taken: list[Answer] = []
        self.said: list[tuple[Any, object]] = []
        self._script: tuple[Answer, ...] = ()
        self.others: list[tuple[Answer, ...]] = []
        self._said: dict[Behaviour, str] = {}

    def begin(self, script: tuple[Answer, ...]) -> None:
        self.taken, self.said, self._script, self.others, self._said = [], [], script, [], {}

    def choose(self, leaf: Behaviour, letters: str) -> str:
        if leaf not in self._said:
            asked = Choice(leaf.name, letters)
            self._said[leaf] = letter = self.take(asked)
            self.said.append((asked, letter))
        return self._said[leaf]

    def take(self, asked: Choice) -> str:
        """Return the next answer, and note the other possible ones in `others`."""
        name, letters = asked
        place = len(self.taken)
        letter = self._script[place][1] if place < len(self._script) else letters[0]
        if place >= len(self._script):
            before = tuple(self.taken)
            self.others += [(*before, (name, other)) for other in letters[1:]]
        self.taken.append((name, letter))
        return letter


class _States(Protocol):
    """The states of a knowledge base, by number; see `missions.proof.memory.Memory`."""

    def read(self) -> int: ...

    def write(self, number: int) -> None: ...


class _Reached(NamedTuple):
    """What an `Asked` stands for; path: None if it cannot be reached again; at: the event up to which it is valid."""

    tape: "Tape"
    real: Any
    path: Path | None
    at: int | None = None


def _asking(does: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method that applies a function to what is stood for, and records it."""
    return lambda self, *given: _how(self).tape.ask(self, does, *given)


class Asked:
    """A proxy for a knowledge base, or for what was reached from it, that records what it is asked and told.

    It returns plain values and other proxies. A tree that uses it in any other way is always run, never followed.
    """

    __slots__ = ("__weakref__", "_how")

    def __init__(self, how: _Reached) -> None:
        object.__setattr__(self, "_how", how)

    @property  # type: ignore[misc]  # isinstance() sees the class of what it stands for
    def __class__(self) -> type:
        return type(self._how.real)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever there is
        if name == "reading":
            return self._how.tape.reading
        return (
            getattr(self._how.real, name)
            if name in _OF_NO_USE
            else self._how.tape.ask(self, getattr, name)
        )

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._how.real, name, value)
        self._how.tape.is_on = False

    def __call__(self, *given: object, **named: object) -> Any:  # noqa: ANN401  # whatever there is
        return self._how.tape.ask(self, _call, given, tuple(named.items()))

    def __iter__(self) -> Iterator[Any]:
        found = self._how.tape.ask(self, tuple)
        return iter(
            found if type(found) is tuple else [found[place] for place in range(len(found))]
        )

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
    """Return what a tree may keep from one tick to the next: a proxy that is always valid, or else the real object."""
    how = _how(asked)
    if how.at is None and how.path is not None:
        return asked
    how.tape.is_on = False
    return how.real


@dataclass(slots=True)
class _Moment:
    """A point in a recorded tick: the next question, and by answer what follows; or the state of the tree after it."""

    question: Choice | Path | None = None
    then: dict[object, "_Moment"] = field(default_factory=dict)
    after: int | None = None


class Tape:
    """Recorded ticks, as a decision tree over the answers that were given in them.

    Args:
        kb: the knowledge base.
        choices: the answers of leaves; it holds the record of the present tick.
        is_on: whether to record. Also an attribute: False as soon as something happens that cannot be recorded.

    Attributes:
        kb: the proxy for the knowledge base.
    """

    def __init__(self, kb: KnowledgeBase, choices: Choices, *, is_on: bool) -> None:
        self._kb, self._choices, self.is_on = kb, choices, is_on
        self._reached: dict[Path, Asked] = {}
        self._first: dict[int, _Moment] = {}
        self._answered: dict[tuple[int, Path], tuple[object, int]] = {}
        self.kb: Any = self._stand_in(kb, ())

    def ask(self, asked: Asked, does: Callable[..., Any], *given: object) -> Any:  # noqa: ANN401  # whatever there is
        """Apply a function to what is stood for, and record the result."""
        _, real, path, at = _how(asked)
        self.is_on = (
            self.is_on
            and path is not None
            and at in (None, self._kb.log.last)
            and _is_hashable(given)
        )
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
        """Hold the knowledge base as `KnowledgeBase.reading` does; a tree that uses it is run, not followed."""
        with self._kb.reading() as state:
            yield Asked(_Reached(self, state, None))

    def keep(self, tree: int, after: int) -> None:
        """Keep the record of the tick that was just run, from one state of the tree to another."""
        moment = self._first.setdefault(tree, _Moment())
        for question, answer in self._choices.said:
            if moment.question != question:  # new, or told with other words, which decide nothing
                moment.question, moment.then = question, {}
            moment = moment.then.setdefault(answer, _Moment())
        moment.after = after

    def follow(self, tree: int, known: int, memory: _States) -> tuple[int, int] | None:
        """Return the states of tree and knowledge base after a tick, by its record; None if it has to be run."""
        moment = self._first.get(tree) if self.is_on else None
        while moment is not None and moment.after is None:
            if isinstance(moment.question, Choice):
                answer: object = self._choices.take(moment.question)
            else:
                answer, known = self._say(moment.question or (), known, memory)
            moment = moment.then.get(answer)
        return None if moment is None or moment.after is None else (moment.after, known)

    def _say(self, path: Path, known: int, memory: _States) -> tuple[object, int]:
        """Return the answer in a state of the knowledge base, and its state afterwards."""
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
            return Asked(
                _Reached(self, real, None if hasattr(real, "__next__") else path, self._kb.log.last)
            )
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


def _call(
    real: Callable[..., object], given: Iterable[object], named: Iterable[tuple[str, object]]
) -> object:
    return real(*map(_plain, given), **{name: _plain(one) for name, one in named})


def _is_value(found: object) -> bool:
    kind = type(found)
    if issubclass(kind, tuple | frozenset):
        return all(map(_is_value, found))  # type: ignore[call-overload]  # it has items
    return found is None or issubclass(kind, int | float | str | bytes | Enum)
