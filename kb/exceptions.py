"""What can go wrong in the knowledge base; each message names what was given, what exists and what to do."""

from collections.abc import Iterable
from difflib import get_close_matches

_MANY = 5000
"""Of more names than this, only those that begin alike are compared with an unknown one."""


class KnowledgeBaseError(Exception):
    """Base of every error that this package raises on purpose."""


class ModelError(KnowledgeBaseError, ValueError):
    """A model is declared in a way that has no meaning."""


class DuplicateName(ModelError):
    """A name is given twice within one kind of element."""


class InvalidValue(KnowledgeBaseError, ValueError):
    """A value is outside what is allowed; the facts are as they were."""


class Unselectable(InvalidValue):
    """A design or configuration is to be selected that is unfeasible now; nothing is selected."""


class ProtocolError(KnowledgeBaseError, TypeError):
    """A managed system, planner, executor or monitor is not what its protocol says: a slip in a program."""


class AmbiguousName(KnowledgeBaseError, ValueError):
    """A bare name stands for elements of several kinds."""


class UnknownName(KnowledgeBaseError, KeyError):
    """A name that nothing of that kind has.

    Args:
        kind: what was looked for, e.g. "action".
        name: what was given.
        known: the names that exist; the message lists the nearest ones first.
    """

    def __init__(self, kind: str, name: object, known: Iterable[str]) -> None:
        names = list(dict.fromkeys(known))
        begin = str(name)[:2].casefold()
        likely = names if len(names) <= _MANY else [one for one in names if one.casefold().startswith(begin)]
        near = get_close_matches(str(name), likely, n=3)
        if near:
            hint = f"did you mean {' or '.join(repr(match) for match in near)}?"
        elif names:
            shown = ", ".join(repr(known_name) for known_name in names[:8])
            hint = f"known: {shown}{', ...' if len(names) > 8 else ''}"
        else:
            hint = "the model has none"
        super().__init__(f"unknown {kind} {name!r}; {hint}")

    def __str__(self) -> str:
        return str(self.args[0])
