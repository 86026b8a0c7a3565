"""The errors of the knowledge base.

Each message says what was given, what exists and what to do.
"""

from collections.abc import Iterable
from difflib import get_close_matches


class KnowledgeBaseError(Exception):
    """Base of every error that this package raises on purpose."""


class ModelError(KnowledgeBaseError, ValueError):
    """A declaration in a model is not valid."""


class DuplicateName(ModelError):
    """Two elements of one kind have the same name."""


class InvalidValue(KnowledgeBaseError, ValueError):
    """A value is not allowed; no fact has changed."""


class Unselectable(InvalidValue):
    """A design or configuration cannot be selected because it is unfeasible now.

    Nothing is selected.
    """


class ProtocolError(KnowledgeBaseError, TypeError):
    """A managed system, planner, executor or monitor does not follow its protocol."""


class AmbiguousName(KnowledgeBaseError, ValueError):
    """A name is given without its kind, and elements of several kinds have it."""


class UnknownName(KnowledgeBaseError, KeyError):
    """No element of this kind has the given name.

    Args:
        kind: the kind of element that was looked for, e.g. "action".
        name: the name that was given.
        known: the names that exist; the message lists the nearest ones first.
        is_a: the kind of element that has this name.
    """

    def __init__(self, kind: str, name: object, known: Iterable[str], is_a: str = "") -> None:
        names = list(dict.fromkeys(known))
        near = get_close_matches(str(name), names, n=3)
        if near:
            hint = f"did you mean {' or '.join(repr(match) for match in near)}?"
        elif names:
            shown = ", ".join(repr(known_name) for known_name in names[:8])
            hint = f"known: {shown}{', ...' if len(names) > 8 else ''}"
        else:
            hint = "the model has none"
        article = "an" if is_a.startswith("a") else "a"
        which = f", which is {article} {is_a}" if is_a else ""
        super().__init__(f"unknown {kind} {name!r}{which}; {hint}")

    def __str__(self) -> str:
        return str(self.args[0])
