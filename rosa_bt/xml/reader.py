"""Makes behaviours of the elements of a file."""

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path

from py_trees.behaviour import Behaviour
from py_trees.ports import PortsMixin

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.decorators import Clock, ClockFollower
from rosa_bt.exceptions import RosaBtError, XmlError, hint, in_words
from rosa_bt.xml.blackboard import Blackboard, Declared, NodeError, Ports, convert, key_of
from rosa_bt.xml.document import MARKS, Document, Element
from rosa_bt.xml.nodes import NODES, RULES, Branch, Slot, is_plain
from rosa_bt.xml.registry import BehaviourRegistry, Registration
from rosa_bt.xml.scripts import parse_script


class SubTree(Branch, ClockFollower, is_node=False):
    """A tree of a file: below another tree, or as the root that is ticked.

    Attributes:
        blackboard: the blackboard of its nodes; a mapping.
        tree: the ID of the tree.
        models: the elements of the TreeNodesModels of the file, by ID.
        notes: what was read otherwise than it stands in the files; each was logged as a warning.
    """

    def __init__(
        self, name: str, slot: Slot, board: Blackboard, tree: str, document: Document
    ) -> None:
        super().__init__(name, [slot])
        self.blackboard = board
        self.tree = tree
        self.models = document.models
        self.notes = tuple(document.notes)

    def follow(self, clock: Clock) -> None:
        if not self.blackboard.root.has_own_clock:
            self.blackboard.root.clock = clock


def load_xml(
    text_or_path: str | Path | Iterable[str | Path],
    registry: BehaviourRegistry,
    tree: str | None = None,
    *,
    clock: Clock | None = None,
    enums: Mapping[str, int] | None = None,
) -> SubTree:
    """Make a tree from the XML of BehaviorTree.CPP 4, with its semantics.

    Args:
        text_or_path: the XML as a text, or the path of a file; or several of these, whose trees use
            one another.
        registry: the behaviours for the leaves.
        tree: ID of the tree to make; without it, the `main_tree_to_execute` of the file, or its
            only tree.
        clock: gives the time [s] to Delay, Timeout and Sleep; without it, the clock of the
            `TreeRunner`, or else the monotonic clock of this computer.
        enums: names that scripts can use, with their numbers, e.g. `{"RED": 1}`.

    Returns:
        A behaviour of py_trees. INVALID after a tick means that it was skipped.

    Raises:
        XmlError: the XML cannot be read, or the tree cannot be made; the message begins with file
            and line.
    """
    sources = [text_or_path] if isinstance(text_or_path, str | Path) else text_or_path
    document = Document(sources)
    for name, element in document.trees.items():
        if name in NODES or name in registry.entries or name == "SubTree":
            raise element.error(f"{name!r} is the name of a node; rename the tree")
    board = Blackboard(clock, enums=enums)
    return _Builder(document, registry).tree(document.main(tree), document.root, None, board)


class _Builder:
    def __init__(self, document: Document, registry: BehaviourRegistry) -> None:
        self._document = document
        self._registry = registry
        self._path: list[str] = []  # IDs of the trees around the node that is being made

    def tree(self, tree: str, asked_by: Element, name: str | None, board: Blackboard) -> SubTree:
        if tree in self._path:
            raise asked_by.error(f"a tree contains itself: {' -> '.join([*self._path, tree])}")
        self._path.append(tree)
        slot = self._slot(self._document.tree(tree, asked_by).children[0], board)
        self._path.pop()
        return SubTree(name or tree, slot, board, tree, self._document)

    def _slot(self, element: Element, board: Blackboard) -> Slot:
        try:
            slot = self._made(element, board)
            rules = [name for name in RULES if name in element.attrib]
            slot.rules = {name: parse_script(element.attrib[name], board) for name in rules}
        except XmlError:
            raise
        except Exception as error:  # constructors of the user may raise anything
            problem = str(error) if isinstance(error, RosaBtError) else in_words(error)
            raise element.error(f"<{element.node}> cannot be made: {problem}") from error
        slot.source = (element.tag, element.attrib)
        return slot

    def _made(self, element: Element, board: Blackboard) -> Slot:
        tag = element.node
        name = element.get("name") or tag
        entry = self._registry.entries.get(tag)
        if tag == "SubTree":
            return Slot(self._subtree(element, board))
        if entry is None and tag not in NODES:
            raise element.error(self._unknown(tag))
        _check_children(element, *(entry.children if entry else NODES[tag].CHILDREN))
        slots = [self._slot(child, board) for child in element.children]
        if entry is not None:
            branches = [Branch(slot.node.name, [slot]) for slot in slots]
            leaf = self._leaf(element, entry, branches, board)
            return Slot(leaf, not slots and self._is_condition(element, entry, leaf))
        kind = NODES[tag]
        node = kind(name, slots) if slots else kind(name)  # type: ignore[call-arg]  # of an XmlNode
        ports = Ports(node.PORTS, element.ports, board)
        ports.check_required()
        node.prepare(ports)
        return Slot(node, is_plain(node))

    def _leaf(
        self,
        element: Element,
        entry: Registration,
        branches: Sequence[Branch],
        board: Blackboard,
    ) -> Behaviour:
        """Make a behaviour of the user; raise if an attribute is unknown, missing, or wrong."""
        arguments = entry.arguments
        written = element.ports
        literals = dict[str, str]()
        for name, argument in arguments.items():
            text = written.get(name)
            if text is not None and key_of(text, name) is None:
                literals[name] = text
            elif argument.required:
                advice = f"write {name}=... with a value, hand it to BehaviourRegistry"
                problem = f"{name!r} is needed when the tree is made"
                raise NodeError(f"{problem}; {advice}, or declare a port in INPUT_PORTS")
        constants = Ports(arguments, literals, board)
        offered = {
            "name": element.get("name") or element.node,
            "children": branches,
            "blackboard": board,
            **dict(zip(entry.child_parameters, branches, strict=False)),
        }
        behaviour = entry.make(offered, {name: constants.get(name) for name in literals})
        inputs, outputs = ports_of(behaviour)
        declared = {**inputs, **outputs}
        ports = Ports({**arguments, **declared}, written, board)
        late = [name for name in ports.keys if name not in declared]
        for name in late:
            if name not in vars(behaviour):
                problem = f"{type(behaviour).__name__} keeps no attribute {name!r}; declare a port"
                text = f"{name}={written[name]!r} is not read: {problem}"
                self._document.note(element.where, text)
        if late:
            _read_at_start(behaviour, ports, late)
        if isinstance(behaviour, PortsMixin):
            ports.check_required({*outputs, *arguments})
            ports.connect(behaviour)
        if isinstance(behaviour, ActionBehaviour) and "action" not in ports.keys:
            name = behaviour.action
            behaviour.kb.is_feasible(name)  # raises now, not during a mission, if it is unknown
            if ports.literals.get("action", name) != name:
                problem = f"the constructor says already that 'action' is {name!r}"
                raise NodeError(f"{problem}; leave action=... out")
        return behaviour

    def _is_condition(self, element: Element, entry: Registration, leaf: Behaviour) -> bool:
        model = self._document.models.get(element.node, element)
        for kind in (entry.kind, element.tag.lower(), model.tag.lower()):
            if kind in ("action", "condition"):
                return kind == "condition"
        return is_plain(leaf)

    def _subtree(self, element: Element, around: Blackboard) -> SubTree:
        tree = element.needed("ID")
        _check_children(element, 0, 0)
        autoremap = convert(element.get("_autoremap", "false"), bool)
        defaults = {} if autoremap else self._defaults(element, tree)
        board = Blackboard(None, around, {**defaults, **element.ports}, autoremap=autoremap)
        return self.tree(tree, element, element.get("name"), board)

    def _defaults(self, element: Element, tree: str) -> dict[str, str]:
        """Return the values of ports that the model of a tree gives."""
        model = self._document.models.get(tree, element)
        defaults = {}
        for port in model.children:
            if port.tag.endswith("_port"):  # editors write other elements, too
                name = port.needed("name")
                if default := port.get("default"):
                    defaults[name] = default
                elif name not in element.ports:
                    says = f"its model ({port.where}) says"
                    raise element.error(f"the tree {tree!r} needs {name}=..., {says}")
        return defaults

    def _unknown(self, tag: str) -> str:
        if tag in MARKS:
            return f'<{tag}> is of version 3; write BTCPP_format="3", or its name in version 4'
        if tag in self._document.trees:
            return f'<{tag}> is a tree; write <SubTree ID="{tag}"/>'
        near = get_close_matches(tag, [*NODES, "SubTree"], 1)
        guess = f"did you mean the node {near[0]!r}? " if near else ""
        known = hint(tag, self._registry.entries, "registered behaviours")
        return f"<{tag}> is unknown; {guess}{known}"


def _read_at_start(behaviour: Behaviour, ports: Ports, names: Iterable[str]) -> None:
    """Let a behaviour read its attributes that are keys before each `initialise`."""
    initialise = behaviour.initialise

    def read_and_initialise() -> None:
        for name in names:
            if ports.exists(name):
                vars(behaviour)[name] = ports.get(name)
        initialise()

    vars(behaviour)["initialise"] = read_and_initialise


def ports_of(behaviour: Behaviour) -> tuple[Declared, Declared]:
    """Return the py_trees ports of a behaviour: inputs and outputs."""
    if isinstance(behaviour, PortsMixin):
        return behaviour.input_ports(), behaviour.output_ports()
    return {}, {}


def _check_children(element: Element, least: float, most: float) -> None:
    tags = [child.node for child in element.children]
    if element.node == "ReactiveSequence" and tags.count("AsyncSequence") > 1:
        problem = "a ReactiveSequence has at most one asynchronous child; use Sequence in it"
        raise element.error(problem)
    if not least <= len(tags) <= most:
        numbers = str(least) if least == most else f"{least} to {most}"
        raise element.error(f"children of <{element.node}>: {len(tags)}; it takes {numbers}")
