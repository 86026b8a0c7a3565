"""The questions that a knowledge base answers, for what is known and for "what if".

Each question is a method of `Situation`, and thereby one of `KnowledgeBase`: a situation answers
as the base would if some facts were different. No question changes anything.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Final, TypeVar

from kb import explain as explanation
from kb import views
from kb.elements import Constraint, Element, listed, meant_by
from kb.exceptions import InvalidValue
from kb.network import Node, Ref
from kb.planning import Choice, Obsolete, by_owner, firsts_by_priority
from kb.state import State, in_order
from kb.status import UNFEASIBLE
from kb.views import ElementView, Readable

ELEMENTS: Final = (
    "action",
    "function",
    "component",
    "function design",
    "configuration",
    "constraint",
)
"""The kinds of elements that have a status; all but constraints have a name too."""
_EXPLAINED: Final = (*ELEMENTS, "attribute")

T = TypeVar("T")
ElementLike = ElementView | Element | Constraint | Ref | str
"""An element may be given as a view of it, as itself, as what stands for it in events, or by its
name."""


def outline(state: State) -> str:
    """Say in short what the actions of a state are."""
    actions = state.network.actions.values()
    feasible = sum(state.status[action] is not UNFEASIBLE for action in actions)
    required = [action.name for action in actions if state.is_required(action)]
    words = f"{feasible} of {len(actions)} actions feasible"
    return f"{words}, required: {', '.join(required)}" if required else words


def resolve(
    state: State, element: ElementLike, kinds: Iterable[str], *, unique: bool = False
) -> Node:
    """Return the node that is meant; a bare name is looked for in the given kinds, in this order.

    Raises:
        AmbiguousName: several kinds have such a name, and that is not allowed.
    """
    network = state.network
    if isinstance(element, ElementView):
        element = element.element
    if isinstance(element, Element | Constraint | tuple):
        node = network.referred(element) if isinstance(element, tuple) else network.find(element)
        if node.kind not in kinds:
            raise InvalidValue(f"{node!r} cannot be meant here; allowed are {', '.join(kinds)}")
        return node
    searched = {kind: network.kinds[kind] for kind in kinds if kind != "constraint"}
    advice = "pass the view meant, e.g. kb." if unique else ""
    return meant_by(element, searched, " or ".join(searched), advice)


def _selectable(state: State, nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(node.name for node in nodes if state.status[node] is not UNFEASIBLE)


def _adaptable(state: State, kind: str) -> tuple[str, ...]:
    return tuple(node.name for node in in_order(state.adaptable) if node.kind == kind)


def _explained(
    base: Readable,
    element: ElementLike,
    kinds: Iterable[str],
    explain: Callable[[State, Node, float], T],
) -> T:
    now = base.now
    with base.reading() as state:
        return explain(state, resolve(state, element, kinds), now)


class Situation:
    """A knowledge base as it would be if some facts were different, at one moment.

    It is made by `KnowledgeBase.situation`, and is a copy: nothing that is recorded later changes
    it.
    """

    def __init__(self, state: State, now: float) -> None:
        self._state = state
        self.now = now  # the time at which it was made [s]

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only, of the model as it was."""
        return nullcontext(self._state)

    def __repr__(self) -> str:
        return f"<Situation of {self._state.network.model.name!r}: {outline(self._state)}>"

    actions = views.ViewsOf(views.ActionView)
    functions = views.ViewsOf(views.FunctionView)
    components = views.ViewsOf(views.ComponentView)
    designs = views.ViewsOf(views.DesignView)
    configurations = views.ViewsOf(views.ConfigurationView)
    attributes = views.ViewsOf(views.AttributeView)

    def is_feasible(self: Readable, action: str) -> bool:
        """Tell whether an action can be done now: its status is not "unfeasible"."""
        with self.reading() as state:
            return state.status[state.network.actions[action]] is not UNFEASIBLE

    def selectable_actions(self: Readable) -> tuple[str, ...]:
        """Names of the actions that can be done now."""
        with self.reading() as state:
            return _selectable(state, state.network.actions.values())

    def selectable_designs(self: Readable, function: str) -> tuple[str, ...]:
        """Names of the designs that can be selected now, in order of declaration."""
        with self.reading() as state:
            return _selectable(state, state.network.functions[function].requires)

    def selectable_configurations(self: Readable, component: str) -> tuple[str, ...]:
        """Names of the configurations that can be selected now, in order of declaration."""
        with self.reading() as state:
            return _selectable(state, state.network.components[component].requires)

    def best_configuration(self: Readable, action: str) -> Choice | None:
        """Return what comes first by priority for an action by itself, required or not.

        None while it is unfeasible.
        """
        with self.reading() as state:
            node = state.network.actions[action]
            if state.status[node] is UNFEASIBLE:
                return None
            designs = firsts_by_priority(state, node.requires)
            components = dict.fromkeys(part for design in designs for part in design.requires)
            return Choice(
                dict(by_owner(designs)), dict(by_owner(firsts_by_priority(state, components)))
            )

    def adaptable_functions(self: Readable) -> tuple[str, ...]:
        """Names of the functions for which a design has to be chosen, or may be chosen better."""
        with self.reading() as state:
            return _adaptable(state, "function")

    def adaptable_components(
        self: Readable, designs: Iterable[str] | Mapping[str, str] = ()
    ) -> tuple[str, ...]:
        """Names of the components whose configuration has to be chosen, or may be chosen better.

        With designs just chosen, by name or by function, the answer is what it will be once they
        are selected and what is obsolete is not.
        """
        names = listed("designs", designs.values() if isinstance(designs, Mapping) else designs)
        with self.reading() as state:
            flips, _ = state.decide([state.network.designs[name] for name in names])
            return _adaptable(state.after(flips), "component")

    def obsolete(self: Readable) -> Obsolete:
        """Names of the components, designs and configurations that nothing required needs."""
        with self.reading() as state:
            nodes = state.obsolete()
        kinds = "component", "function design", "configuration"
        return Obsolete(
            *(tuple(node.name for node in nodes if node.kind == kind) for kind in kinds)
        )

    def explain(self: Readable, element: ElementLike) -> explanation.Explanation:
        """Say why an element has its status, and what would make it feasible if it is not.

        A name that several kinds share means the action before the function, component, design,
        configuration and attribute. Of an attribute it is said what is known of it.
        """
        return _explained(self, element, _EXPLAINED, explanation.explain)

    def why(self: Readable, element: ElementLike) -> str:
        """Say in a sentence why an element has its status.

        Quicker than `explain`, for it looks for no remedies.
        """
        return _explained(self, element, _EXPLAINED, explanation.why)

    def explain_choice(self: Readable, element: ElementLike) -> explanation.ChoiceExplanation:
        """Say why a function has this design, or a component this configuration, and no other.

        Of a name that both kinds share the function is meant.
        """
        return _explained(self, element, ("function", "component"), explanation.explain_choice)

    def situation(
        self: Readable,
        measured: Mapping[str, float | None] | None = None,
        /,
        *,
        failed: Iterable[str] = (),
        recovered: Iterable[str] = (),
        requested: Iterable[str] = (),
        **attributes: float | None,
    ) -> "Situation":
        """Return a situation, "what if": a copy in which some facts differ.

        It answers the same questions.

        Args:
            measured: values by name of attribute, for names that are no Python names; None is "not
                measured".
            failed: names of components supposed to have failed.
            recovered: names of components supposed not to have.
            requested: names of actions supposed to be required, even if they are unfeasible.
            attributes: values by name of attribute, e.g. `light=0.3`.
        """
        values = {**(measured or {}), **attributes}
        now = self.now
        with self.reading() as present:
            state = present.copy()
            network = state.network
            for name in failed:
                state.set_flag("failed", network.components[name], True)
            for name in recovered:
                state.set_flag("failed", network.components[name], False)
            for name in requested:
                state.set_flag("requested", network.actions[name], True)
            for name, value in values.items():
                node = network.attributes[name]
                if value is not None:
                    value = node.attribute.checked(value, "be supposed to be")
                state.suppose_measurement(node, value)
            state.infer()
        return Situation(state, now)
