"""Converts what files of BehaviorTree.CPP 3 say into version 4, with a note for each change."""

import re
from collections.abc import Iterator
from typing import Final

from rosa_bt.xml.elements import EXPLICIT, Element, Note

_NODES: Final = {
    "SubTreePlus": "SubTree",
    "SubtreePlus": "SubTree",
    "SequenceStar": "SequenceWithMemory",
    "FallbackStar": "Fallback",
    "RetryUntilSuccesful": "RetryUntilSuccessful",
}
"""Nodes of version 3 that have another name in version 4."""
_PORTS: Final = {
    "Parallel threshold": "success_count",
    "Parallel success_threshold": "success_count",
    "Parallel failure_threshold": "failure_count",
    "SubTree __autoremap": "_autoremap",
}
_CHECKS: Final = tuple(f"BlackboardCheck{kind}" for kind in ("Bool", "Double", "Int", "String"))
_NO_COUNTERPART: Final = ("ConsumeQueue", "ManualSelector", "PopFromQueue", "QueueSize")
MARKS: Final = frozenset({*_NODES, *_CHECKS})
"""Nodes by which a file without BTCPP_format is known to be of version 3."""


def is_version_3(root: Element) -> bool:
    """Tell whether a file says that it is of version 3, or has nodes of version 3 and says nothing."""
    version = root.get("BTCPP_format")
    if version is not None:
        return version.split(".")[0] == "3"
    for element in root.descendants("*"):
        if element.tag in MARKS or element.get("ID") in MARKS or _SHARED in element.attrib:
            return True
    return False


def convert(root: Element, note: Note) -> None:
    """Convert the trees of a file in place.

    Raises:
        XmlError: a node has no counterpart in version 4.
    """
    trees = [tree.get("ID") for tree in root.children if tree.tag == "BehaviorTree"]
    for tree in root.children:
        for element in tree.descendants("*") if tree.tag == "BehaviorTree" else ():
            if element is not tree:
                for before, after in _converted(element, trees):
                    note(element.where, f"version 3 is converted: {before} is {after}")


_SHARED: Final = "__shared_blackboard"


def _converted(element: Element, trees: list[str | None]) -> Iterator[tuple[str, str]]:
    """Convert an element; yield what was written, and what it is now."""
    is_explicit = element.tag in EXPLICIT
    name = element.get("ID", "") if is_explicit else element.tag
    if name in _NO_COUNTERPART:
        raise element.error(f"<{name}> of version 3 has no counterpart in version 4; register it")
    if name in trees and not is_explicit:
        element.tag = "SubTree"
        element.set("ID", name)
        yield f"<{name}>", f'<SubTree ID="{name}">'
    elif name in _NODES:
        if is_explicit:
            element.set("ID", _NODES[name])
        else:
            element.tag = _NODES[name]
        yield f"<{name}>", f"<{_NODES[name]}>"
    is_subtree = name == "SubTree" or name in trees
    for attribute, text in list(element.items()):
        renamed = _PORTS.get(f"{element.node} {attribute}")
        if renamed:
            element.attrib[renamed] = element.attrib.pop(attribute)
            yield attribute, renamed
        elif attribute == _SHARED:
            del element.attrib[_SHARED]
            if text.lower() in ("1", "true"):
                element.set("_autoremap", "true")
                yield _SHARED, "_autoremap, which shares no key that begins with _"
        elif is_subtree and attribute in element.ports and text[:1] != "{":
            element.set(attribute, f"{{{text}}}")
            yield f'{attribute}="{text}"', f'{attribute}="{{{text}}}"'
    key = element.get("output_key", "")
    if name == "SetBlackboard" and key[:1] == "{":
        element.set("output_key", key[1:-1])
        yield f'output_key="{key}"', f'output_key="{key[1:-1]}"'
    if name in _CHECKS:
        _convert_check(element, is_text=name.endswith("String"))
        yield f"<{name}>", f'<Precondition if="{element.get("if")}">'


def _convert_check(element: Element, *, is_text: bool) -> None:
    """Make a Precondition of a decorator that compares two values when its child starts."""
    sides = []
    for port in ("value_A", "value_B"):
        text = element.needed(port)
        key = re.fullmatch(r"{(\w+)}", text)
        literal = f"'{text}'" if is_text else text
        sides.append(key[1] if key else literal)
        del element.attrib[port]
    element.set("if", " == ".join(sides))
    element.set("else", element.attrib.pop("return_on_mismatch", "FAILURE"))
    element.tag = "Precondition"
    element.attrib.pop("ID", None)
