"""The blackboard of a tree: one for each SubTree, with BehaviorTree.CPP's rules of which key means what."""

from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

__all__ = ["Blackboard", "key_of"]


def key_of(written: str, port: str) -> str | None:
    """Return the key that a port's text points at: `{key}`, or `{=}` for the port's own name; None for a literal."""
    if not (len(written) > 2 and written.startswith("{") and written.endswith("}")):
        return None
    inner = written[1:-1].strip()
    return port if inner == "=" else inner


class Blackboard(MutableMapping[str, Any]):
    """What the nodes of one SubTree can see; shared with nobody else but through remapped keys.

    A key is looked for, in this order: `@key` in the blackboard of the main tree; among the constants that the SubTree
    was given; under the name that it was remapped to, in the blackboard around; with autoremapping, under its own name
    there, unless it begins with an underscore; here.

    Args:
        parent: the blackboard around; None for the main tree's.
        remapping: key in here to key in the parent.
        constants: values that the SubTree was given.
        autoremap: whether all other keys are the parent's.
    """

    def __init__(
        self,
        parent: "Blackboard | None" = None,
        remapping: Mapping[str, str] | None = None,
        constants: Mapping[str, str] | None = None,
        *,
        autoremap: bool = False,
    ) -> None:
        self._parent = parent
        self._remapping = dict(remapping or {})
        self._constants = frozenset(constants or ())
        self._autoremap = autoremap
        self._values: dict[str, Any] = dict(constants or {})

    def _place(self, key: str) -> tuple[dict[str, Any], str]:
        if key.startswith("@"):
            root = self
            while root._parent is not None:
                root = root._parent
            return root._place(key[1:])
        if self._parent is None or key in self._constants:
            return self._values, key
        if key in self._remapping:
            return self._parent._place(self._remapping[key])
        if self._autoremap and not key.startswith("_"):
            return self._parent._place(key)
        return self._values, key

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401  # whatever a behaviour has written
        values, place = self._place(key)
        return values[place]

    def __setitem__(self, key: str, value: Any) -> None:  # noqa: ANN401  # whatever a behaviour writes
        values, place = self._place(key)
        values[place] = value

    def __delitem__(self, key: str) -> None:
        values, place = self._place(key)
        del values[place]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys that are kept here; those of the blackboard around are its own."""
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)
