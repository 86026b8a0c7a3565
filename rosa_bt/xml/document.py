"""The files of trees: what they define and include."""

import logging
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from rosa_bt.exceptions import XmlError, hint
from rosa_bt.xml.blackboard import key_of
from rosa_bt.xml.elements import EXPLICIT, Element, parse, read_file
from rosa_bt.xml.nodes import RULES
from rosa_bt.xml.version_3 import convert, is_version_3

_log = logging.getLogger(__name__)
_FORBIDDEN: Final = re.compile(r"[\s./\\:*?|<>&\"'\x00-\x1f]")
MODELS: Final = (*EXPLICIT, "SubTree")


class Document:
    """The trees and models that are defined in files, or texts, and in the files that they include.

    Attributes:
        root: the outermost element of the file; of several files, of the one that names the main
            tree.
        trees: the `BehaviorTree` elements, by ID.
        models: the elements of the TreeNodesModels, by ID.
        notes: what was read otherwise than it stands, or means nothing.

    Raises:
        XmlError: a file is not of BehaviorTree.CPP, or exceeds a limit.
    """

    def __init__(self, sources: Iterable[str | Path]) -> None:
        self.notes: list[str] = []
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self._files: dict[str, Element] = {}
        roots = [self._open(source) for source in sources]
        if not roots:
            raise XmlError("<text>", "there is no text and no file; give at least one")
        mains = [root for root in roots if "main_tree_to_execute" in root.attrib]
        self.root = [*mains, *roots][0]

    def note(self, where: str, text: str) -> None:
        """Log a warning, and keep it."""
        self.notes.append(f"{where}: {text}")
        _log.warning("%s: %s", where, text)

    def main(self, name: str | None) -> str:
        """Return the ID of the tree to make: the one of this name, or the main tree of the file, or the only one."""
        name = name or self.root.get("main_tree_to_execute")
        if name is None and len(self.trees) == 1:
            (name,) = self.trees
        if name is None:
            names = ", ".join(self.trees) or "none"
            advice = "say load_xml(..., tree=...) or write main_tree_to_execute in <root>"
            raise self.root.error(f"which tree? There are: {names}; {advice}")
        self.tree(name, self.root)
        return name

    def tree(self, name: str, asked_by: Element) -> Element:
        if name not in self.trees:
            raise asked_by.error(f"no tree has the ID {name!r}; {hint(name, self.trees, 'trees')}")
        return self.trees[name]

    def _open(self, source: str | Path) -> Element:
        text = source.lstrip("\ufeff \t\r\n") if isinstance(source, str) else ""
        if text.startswith("<"):
            return self._collect(parse(text, "<text>", self.note), Path.cwd(), [])
        return self._file(Path(source), "<text>", [])

    def _file(self, path: Path, where: str, chain: list[str]) -> Element:
        """Return the outermost element of a file.

        A file is read once, even if it is included several times.
        """
        content = read_file(path, where)
        real = os.path.realpath(path)
        if real in chain:
            names = [Path(file).name for file in (*chain, real)]
            raise XmlError(where, f"files include each other: {' -> '.join(names)}")
        if real not in self._files:
            root = parse(content, str(path), self.note)
            self._files[real] = self._collect(root, path.parent, [*chain, real])
        return self._files[real]

    def _collect(self, root: Element, folder: Path, chain: list[str]) -> Element:
        """Add what a file defines and includes; return `root`, its outermost element."""
        if root.tag != "root":
            raise root.error(f"the outermost element is <root>, not <{root.tag}>")
        self._check_version(root)
        tags = [element.tag for element in root.children]
        if tags.count("TreeNodesModel") > 1:
            raise root.error("a file has one TreeNodesModel; put all its elements into the first")
        for element in root.children:
            if element.tag == "BehaviorTree":
                if len(element) != 1:
                    count = f"not {len(element)}"
                    raise element.error(f"a tree has one child, {count}; put a Sequence around")
                if tags.count("BehaviorTree") == 1:
                    element.attrib.setdefault("ID", "BehaviorTree")
                self._add(self.trees, element)
            elif element.tag == "TreeNodesModel":
                for model in element.children:
                    self._add_model(model)
            elif element.tag == "include":
                self._include(element, folder, chain)
            else:
                self.note(element.where, f"<{element.tag}> means nothing in <root>")
        return root

    def _check_version(self, root: Element) -> None:
        version = root.get("BTCPP_format")
        if is_version_3(root):
            if version is None:
                text = "it has no BTCPP_format; read as version 3, whose nodes it has"
                self.note(root.where, text)
            convert(root, self.note)
        elif version is None:
            text = 'it has no BTCPP_format; read as version 4: write BTCPP_format="4"'
            self.note(root.where, text)
            for element in root.descendants("SubTree"):
                for name, text in element.ports.items():
                    if key_of(text, name) is None:
                        meaning = f"if the file is of version 3, it means {{{text}}}"
                        self.note(element.where, f"{name}={text!r} is a text; {meaning}")
        elif version != "4":
            self.note(root.where, f"it has BTCPP_format {version!r}; read as version 4")

    def _add_model(self, model: Element) -> None:
        if model.tag not in MODELS:
            self.note(model.where, f"<{model.tag}> means nothing in <TreeNodesModel>")
            return
        for port in model.children:
            name = port.get("name", "_")
            if name[:1].isdigit() or name in (*RULES, "name", "ID", "_autoremap"):
                raise port.error(f"a port cannot be called {name!r}; write p_{name.lstrip('_')}")
        self._add(self.models, model)

    def _add(self, table: dict[str, Element], element: Element) -> None:
        name = element.needed("ID")
        if not name.isprintable():
            raise element.error(f"{name!r} cannot be printed; write another ID")
        if name in table:
            first = table[name].where
            raise element.error(f"{name!r} is defined twice, first in {first}; write another ID")
        if problem := wrong_id(name):
            self.note(element.where, f"{problem}, as BehaviorTree.CPP wants it since 4.8.4")
        table[name] = element

    def _include(self, element: Element, folder: Path, chain: list[str]) -> None:
        if "ros_pkg" in element.attrib:
            package = element.needed("ros_pkg")
            prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
            shares = [Path(prefix, "share", package) for prefix in prefixes]
            shares = [share for share in shares if share.is_dir()]
            if not shares:
                advice = "source the workspace that has it, or write the path alone"
                raise element.error(
                    f"the ROS package {package!r} is not below AMENT_PREFIX_PATH; {advice}"
                )
            folder = shares[0]
        self._file(folder / element.needed("path"), element.where, chain)


def wrong_id(name: str) -> str:
    """Return why BehaviorTree.CPP refuses an ID, and what to write instead.

    Empty if it accepts it.
    """
    match = _FORBIDDEN.search(name)
    if match:
        better = _FORBIDDEN.sub("_", name)
        return f"{name!r}: {match[0]!r} cannot stand in an ID; write {better!r} instead"
    if name == "Root":
        return "'Root': the ID is taken by the library itself; write 'Main' instead"
    return ""
