"""Registers behaviours under the names that files use, and makes the trees of files."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, TypeVar, overload

from py_trees.behaviour import Behaviour
from py_trees.ports import PortInformation, PortsMixin

from rosa_bt.behaviours import ActionBehaviour, HasStatus, IsActionFeasible, Measurement
from rosa_bt.composites import DoUntilUnfeasible
from rosa_bt.decorators import Clock, ClockFollower, ForAction, Retry, UntilSuccess
from rosa_bt.exceptions import RegistryError, RosaBtError, XmlError, hint, in_words
from rosa_bt.xml.blackboard import Blackboard, Declared, Ports, convert, key_of
from rosa_bt.xml.document import MARKS, NO_COUNTERPART, Document, Element
from rosa_bt.xml.nodes import NODES, RULES, OneChild, Slot, is_plain
from rosa_bt.xml.scripts import parse_script

Factory = Callable[..., Behaviour]
F = TypeVar("F", bound=Factory)

_ROLES = frozenset({"name", "child", "children", "blackboard", "behaviour_class_name"})
"""Parameters that no attribute of an element sets."""
_VARIOUS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_DEFAULTS: Mapping[str, Factory] = {
    kind.__name__: kind
    for kind in (
        *(HasStatus, IsActionFeasible, Measurement),
        *(DoUntilUnfeasible, ForAction, Retry, UntilSuccess),
    )
}


@dataclass(frozen=True)
class Registration:
    """A behaviour that is registered under a name."""

    factory: Factory
    bound: Mapping[str, Any]
    """Arguments for every factory that has a parameter of the same name."""

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        try:
            return inspect.signature(self.factory, eval_str=True).parameters
        except (NameError, TypeError):  # an annotation is known to type checkers only
            return inspect.signature(self.factory).parameters

    @property
    def child_parameters(self) -> list[str]:
        """The parameters that take one child each, in the order of the children."""
        parameters = self.parameters.items()
        return [
            name
            for name, parameter in parameters
            if name == "child" or parameter.annotation is Behaviour
        ]

    @property
    def arity(self) -> tuple[float, float]:
        """The least and the greatest number of children that it takes."""
        count = len(self.child_parameters)
        return (1, inf) if "children" in self.parameters else (count, count)

    @property
    def arguments(self) -> Declared:
        """The parameters that attributes can set, as ports."""
        roles = {*self.bound, *_ROLES, *self.child_parameters}
        arguments = {}
        for name, parameter in self.parameters.items():
            if parameter.kind not in _VARIOUS and name not in roles:
                is_required = parameter.default is parameter.empty
                has_type = parameter.annotation is not parameter.empty
                data_type = parameter.annotation if has_type else object
                arguments[name] = PortInformation(data_type, is_required)
        return arguments

    def make(self, roles: Mapping[str, Any], arguments: Mapping[str, Any]) -> Behaviour:
        """Make the behaviour of its arguments, and of the bound ones and roles that it takes."""
        names = set(self.parameters)
        if "kwargs" in names:
            names.add("name")
        offered = {**self.bound, **roles}
        return self.factory(**{key: offered[key] for key in offered.keys() & names}, **arguments)


class BehaviourRegistry:
    """The behaviours that files of trees can use, by name.

    Args:
        bound: arguments for every factory that has a parameter of the same name, e.g. `kb=kb`.
            IsActionFeasible, HasStatus, Measurement, ForAction, DoUntilUnfeasible, Retry and
            UntilSuccess are registered from the start; all but the last two need a `kb`.

    Attributes:
        entries: the registered behaviours, by name.

    Example::

        registry = BehaviourRegistry(kb=kb)

        @registry.register("search")
        class Search(RosaAction): ...
    """

    def __init__(self, **bound: Any) -> None:  # noqa: ANN401  # whatever the behaviours of the user need
        self.bound = bound
        self.entries = {name: Registration(make, bound) for name, make in _DEFAULTS.items()}

    @overload
    def register(self, name: str) -> Callable[[F], F]: ...

    @overload
    def register(self, name: str, factory: F) -> F: ...

    def register(self, name: str, factory: Factory | None = None) -> object:
        """Register a class of behaviours, or a function that makes a behaviour; also a decorator.

        A leaf is a condition, which is ticked again after it has finished even if it was not reset,
        if the file says so, or else if the class has no `initialise` and `terminate` of its own.

        The parameters `name`, `child` and `children` are set from the file, `blackboard` to that of
        the tree; those that are annotated as Behaviour take one child each. Every other parameter,
        and every port of py_trees, is an attribute, converted to its declared type.

        Args:
            name: the tag or ID in the file; a node of that name is replaced.
            factory: the class or function, which is returned as it is; without it, a decorator is
                returned.

        Raises:
            RegistryError: the name is taken.
        """
        if factory is None:
            return lambda factory: self.register(name, factory)
        if name in self.entries and self.entries[name].factory is not _DEFAULTS.get(name):
            raise RegistryError(f"{name!r} is registered already; choose another name")
        self.entries[name] = Registration(factory, self.bound)
        return factory

    def name_of(self, behaviour: Behaviour) -> str | None:
        """Return the name of its class, or its own if a function is registered under that."""
        for name, entry in self.entries.items():
            is_its = name == behaviour.name and not isinstance(entry.factory, type)
            if is_its or entry.factory is type(behaviour):
                return name
        return None


class SubTree(OneChild, ClockFollower, is_node=False):
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
        if name in NODES or name in registry.entries:
            raise element.error(f"{name!r} is the name of a node; rename the tree")
    board = Blackboard()
    board.enums = enums or {}
    board.clock = clock or board.clock
    board.has_own_clock = clock is not None
    main = tree or document.root.get("main_tree_to_execute")
    if main is None:
        if len(document.trees) != 1:
            advice = "say load_xml(..., tree=...) or write main_tree_to_execute in <root>"
            raise document.root.error(f"which tree? There are: {[*document.trees]}; {advice}")
        (main,) = document.trees
    return _Builder(document, registry).tree(main, document.root, None, board)


class _Builder:
    def __init__(self, document: Document, registry: BehaviourRegistry) -> None:
        self._document = document
        self._registry = registry
        self._path: list[str] = []  # IDs of the trees around the node that is being made

    def tree(self, tree: str, asked_by: Element, name: str | None, board: Blackboard) -> SubTree:
        trees = self._document.trees
        if tree not in trees:
            raise asked_by.error(f"no tree has the ID {tree!r}; {hint(tree, trees, 'trees')}")
        if tree in self._path:
            raise asked_by.error(f"a tree contains itself: {' -> '.join([*self._path, tree])}")
        self._path.append(tree)
        slot = self._slot(trees[tree].children[0], board)
        self._path.pop()
        return SubTree(name or tree, slot, board, tree, self._document)

    def _slot(self, element: Element, board: Blackboard) -> Slot:
        try:
            node = self._node(element, board)
            written = [rule for rule in RULES if rule in element.attrib]
            rules = {rule: parse_script(element.attrib[rule], board) for rule in written}
        except XmlError:
            raise
        except Exception as error:  # constructors of the user may raise anything
            problem = str(error) if isinstance(error, RosaBtError) else in_words(error)
            raise element.error(f"<{element.node}> cannot be made: {problem}") from error
        is_condition = is_plain(node)
        tags = {element.tag, self._document.models.get(element.node, element).tag}
        if element.node in self._registry.entries and tags & {"Action", "Condition"}:
            is_condition = "Action" not in tags
        return Slot(node, is_condition, (element.tag, element.attrib), rules)

    def _node(self, element: Element, board: Blackboard) -> Behaviour:
        tag = element.node
        entry = self._registry.entries.get(tag) or NODES.get(tag)
        if entry is None and tag != "SubTree":
            known = [*self._registry.entries, *NODES, "SubTree"]
            problem = f"is unknown; {hint(tag, known, 'nodes')}"
            if tag in NO_COUNTERPART:
                problem = "of version 3 has no counterpart in version 4; register it"
            elif tag in MARKS:
                problem = 'is of version 3; write BTCPP_format="3", or its name in version 4'
            elif tag in self._document.trees:
                problem = f'is a tree; write <SubTree ID="{tag}"/>'
            raise element.error(f"<{tag}> {problem}")
        count = len(element)
        least, most = entry.arity if entry else (0, 0)
        if not least <= count <= most:
            takes = f"{least} to {most}"
            if most == inf:
                takes = f"at least {least}"
            elif least == most:
                takes = str(least)
            raise element.error(f"children of <{tag}>: {count}; it takes {takes}")
        if entry is None:
            return self._subtree(element, board)
        name = element.get("name") or tag
        slots = [self._slot(child, board) for child in element.children]
        if isinstance(entry, Registration):
            return self._leaf(element, name, entry, slots, board)
        node = entry(name, slots) if slots else entry(name)  # type: ignore[call-arg]  # of an XmlNode
        node.prepare(Ports(node.PORTS, element.ports, board))
        return node

    def _leaf(
        self,
        element: Element,
        name: str,
        entry: Registration,
        slots: list[Slot],
        board: Blackboard,
    ) -> Behaviour:
        """Make a behaviour of the user; raise if an attribute is unknown, missing, or wrong."""
        arguments = entry.arguments
        written = element.ports
        literals = {
            name: text
            for name, text in written.items()
            if name in arguments and key_of(text, name) is None
        }
        constants = Ports(arguments, literals, board)
        branches = [OneChild(slot.node.name, [slot]) for slot in slots]
        roles: dict[str, Any] = {"name": name, "children": branches, "blackboard": board}
        roles.update(zip(entry.child_parameters, branches, strict=False))
        behaviour = entry.make(roles, {name: constants.get(name) for name in literals})
        declared = ports_of(behaviour)
        ports = Ports({**arguments, **declared}, written, board)
        late = [name for name in ports.keys if name not in declared]
        for name in late:
            if name not in vars(behaviour):
                problem = f"{type(behaviour).__name__} has no attribute {name!r} to read it into"
                advice = f"write self.{name} = {name} in its __init__, or declare a port"
                raise element.error(f"{name}={written[name]!r}: {problem}; {advice}")
        initialise = behaviour.initialise

        def read_and_initialise() -> None:
            for name in late:
                if ports.exists(name):
                    vars(behaviour)[name] = ports.get(name)
            initialise()

        if late:
            vars(behaviour)["initialise"] = read_and_initialise
        if isinstance(behaviour, PortsMixin):
            ports.connect(behaviour)
        if isinstance(behaviour, ActionBehaviour) and "action" not in ports.keys:
            action = behaviour.action
            behaviour.kb.is_feasible(action)  # raises now, if it is unknown
            if ports.literals.get("action", action) != action:
                raise element.error(f"its class does {action!r} already; leave action=... out")
        return behaviour

    def _subtree(self, element: Element, around: Blackboard) -> SubTree:
        tree = element.needed("ID")
        autoremap = convert(element.get("_autoremap", "false"), bool)
        ports = element.ports
        model = self._document.models.get(tree, element)
        for port in model.children if not autoremap else ():
            name = port.get("name", "")
            if port.tag.endswith("_port") and name not in ports:
                ports[name] = port.needed("default")
        board = Blackboard(around, ports, autoremap=autoremap)
        return self.tree(tree, element, element.get("name"), board)


def ports_of(behaviour: Behaviour) -> Declared:
    """Return the py_trees ports of a behaviour; no output needs a key."""
    if not isinstance(behaviour, PortsMixin):
        return {}
    outputs = behaviour.output_ports().items()
    return {
        **behaviour.input_ports(),
        **{name: replace(port, required=False) for name, port in outputs},
    }
