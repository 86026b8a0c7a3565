"""Converts what files of BehaviorTree.CPP 3 say into version 4, with a note for each change."""

import re
from collections.abc import Collection
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
    ("Parallel", "threshold"): "success_count",
    ("Parallel", "success_threshold"): "success_count",
    ("Parallel", "failure_threshold"): "failure_count",
    ("SubTree", "__autoremap"): "_autoremap",
}
_CHECKS: Final = ("BlackboardCheckBool", "BlackboardCheckDouble", "BlackboardCheckInt")
_TEXT_CHECK: Final = "BlackboardCheckString"
_NO_COUNTERPART: Final = frozenset({"ConsumeQueue", "ManualSelector", "PopFromQueue", "QueueSize"})
MARKS: Final = frozenset({*_NODES, *_CHECKS, _TEXT_CHECK})
"""Nodes by which a file without BTCPP_format is known to be of version 3."""


def is_version_3(root: Element) -> bool:
    """Tell whether a file says that it is of version 3, or has nodes of version 3 and says nothing."""
    version = root.get("BTCPP_format")
    if version is not None:
        return version.split(".")[0] == "3"
    names = {name for element in root.iter() for name in (element.tag, element.get("ID"))}
    attributes = {name for element in root.iter() for name in element.attrib}
    return not MARKS.isdisjoint(names) or "__shared_blackboard" in attributes


def convert(root: Element, trees: Collection[str], note: Note) -> None:
    """Convert the trees of a file in place.

    Raises:
        XmlError: a node has no counterpart in version 4.
    """
    for element in root.findall("BehaviorTree//*"):
        _convert(element, trees, note)  # type: ignore[arg-type]  # all are of this class


def _convert(element: Element, trees: Collection[str], note: Note) -> None:
    def tell(old: str, new: str) -> None:
        note(element.where, f"version 3 is converted: {old} is {new}")

    name = element.get("ID", "") if element.tag in EXPLICIT else element.tag
    if name in _NO_COUNTERPART:
        raise element.error(f"<{name}> of version 3 has no counterpart in version 4; register it")
    is_subtree = name == "SubTree" or (name in trees and element.tag not in EXPLICIT)
    if is_subtree and name != "SubTree":
        tell(f"<{name}>", f'<SubTree ID="{name}">')
        element.tag = "SubTree"
        element.set("ID", name)
    new_name = _NODES.get(name, element.tag)
    if name in _NODES:
        tell(f"<{name}>", f"<{new_name}>")
        if element.tag in EXPLICIT:
            element.set("ID", new_name)
        else:
            element.tag = new_name
    for attribute, text in list(element.items()):
        new = _PORTS.get((new_name, attribute))
        if new is not None:
            tell(attribute, new)
            element.attrib[new] = element.attrib.pop(attribute)
        elif attribute == "__shared_blackboard":
            _share(element, text, tell)
        elif is_subtree and attribute in element.ports and text[:1] != "{":
            tell(f'{attribute}="{text}"', f'{attribute}="{{{text}}}"')
            element.set(attribute, f"{{{text}}}")
    if name == "SetBlackboard" and (key := re.fullmatch(r"{(.*)}", element.get("output_key", ""))):
        tell(f'output_key="{key[0]}"', f'output_key="{key[1]}"')
        element.set("output_key", key[1])
    if name in (*_CHECKS, _TEXT_CHECK):
        _convert_check(element, name)
        tell(f"<{name}>", f'<Precondition if="{element.get("if")}">')


def _share(element: Element, text: str, tell: Note) -> None:
    del element.attrib["__shared_blackboard"]
    if text.lower() in ("1", "true"):
        element.set("_autoremap", "true")
        tell("__shared_blackboard", "_autoremap, which shares no key that begins with _")


def _convert_check(element: Element, name: str) -> None:
    """Make a Precondition of a decorator that compares two values when its child starts."""
    sides = []
    for port in ("value_A", "value_B"):
        text = element.needed(port)
        key = re.fullmatch(r"{(\w+)}", text)
        literal = f"'{text}'" if name == _TEXT_CHECK else text
        sides.append(key[1] if key else literal)
        del element.attrib[port]
    element.set("if", " == ".join(sides))
    element.set("else", element.attrib.pop("return_on_mismatch", "FAILURE"))
    element.tag = "Precondition"
    element.attrib.pop("ID", None)
