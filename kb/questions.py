"""The questions that a knowledge base answers, for what is known and for "what if".

Each question is a function, and a method of both `KnowledgeBase` and `Situation`: a situation answers as the base would
if some facts were different. No question changes anything.
"""

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import Final

from kb import explanation, views
from kb.elements import Constraint, Element, finite_number, listed, meant_by, shown
from kb.exceptions import InvalidValue
from kb.forecast import Forecast, feasible_until, suppose_forecast
from kb.knowledge import Reading
from kb.measurements import verdict
from kb.network import Network, Node, Ref
from kb.planning import Choice, Obsolete, apply_selection, by_owner, decide, firsts_by_priority
from kb.planning import obsolete as all_obsolete
from kb.state import Overlay, State, propagate
from kb.status import Status
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

Meant = ElementView | Element | Constraint | Ref | str
"""An element may be given as a view of it, as itself, as what stands for it in events, or by its name."""


def is_feasible(base: Readable, action: str) -> bool:
    """Tell whether an action can be done now: its status is not "unfeasible"."""
    with base.reading() as state:
        return state.status[state.network.actions[action].index] is not Status.UNFEASIBLE


def selectable_actions(base: Readable) -> tuple[str, ...]:
    """Names of the actions that can be done now."""
    with base.reading() as state:
        return _selectable(state, state.network.actions.values())


def selectable_designs(base: Readable, function: str) -> tuple[str, ...]:
    """Names of a function's designs that can be selected now, in order of declaration."""
    with base.reading() as state:
        return _selectable(state, state.network.functions[function].parts)


def selectable_configurations(base: Readable, component: str) -> tuple[str, ...]:
    """Names of a component's configurations that can be selected now, in order of declaration."""
    with base.reading() as state:
        return _selectable(state, state.network.components[component].parts)


def best_configuration(base: Readable, action: str) -> Choice | None:
    """Return what comes first by priority for an action by itself, required or not; None while it is unfeasible."""
    with base.reading() as state:
        node = state.network.actions[action]
        if state.status[node.index] is Status.UNFEASIBLE:
            return None
        designs = firsts_by_priority(state, node.parts)
        components = dict.fromkeys(part for design in designs for part in design.parts)
        return Choice(
            dict(by_owner(designs)), dict(by_owner(firsts_by_priority(state, components)))
        )


def adaptable_functions(base: Readable) -> tuple[str, ...]:
    """Names of the functions for which a design has to be chosen, or may be chosen better."""
    with base.reading() as state:
        return _adaptable(state, "function")


def adaptable_components(
    base: Readable, designs: Iterable[str] | Mapping[str, str] = ()
) -> tuple[str, ...]:
    """Names of the components for which a configuration has to be chosen, or may be chosen better.

    With designs just chosen, by name or by function, the answer is what it will be once they are selected and what is
    obsolete is not.
    """
    names = listed("designs", designs.values() if isinstance(designs, Mapping) else designs)
    with base.reading() as state:
        supposed = Overlay(state)
        designs_chosen = [state.network.designs[name] for name in names]
        apply_selection(supposed, decide(supposed, designs_chosen))
        return _adaptable(supposed, "component")


def obsolete(base: Readable) -> Obsolete:
    """Names of the components, designs and configurations that nothing required needs any more."""
    with base.reading() as state:
        return all_obsolete(state)


def explain(base: Readable, element: Meant) -> explanation.Explanation:
    """Say why an element has the status that it has, and what would make it feasible if it is not.

    A name that several kinds share means the action before the function, component, design, configuration and
    attribute. Of an attribute it is said what is known of it, and what depends on it.
    """
    now = base.now
    with base.reading() as state:
        return explanation.explain(state, meant(base, state, element, _EXPLAINED), now)


def why(base: Readable, element: Meant) -> str:
    """Say in a sentence why an element has its status; quicker than `explain`, for it looks for no remedies."""
    now = base.now
    with base.reading() as state:
        return explanation.why(state, meant(base, state, element, _EXPLAINED), now)


def explain_choice(base: Readable, element: Meant) -> explanation.ChoiceExplanation:
    """Say why a function has the design, or a component the configuration, that it has, and not another one.

    Of a name that both kinds share the function is meant.
    """
    now = base.now
    with base.reading() as state:
        return explanation.explain_choice(
            state, meant(base, state, element, ("function", "component")), now
        )


def outline(state: State) -> str:
    """Say in short what the actions of a state are."""
    actions = state.network.actions.values()
    feasible = sum(state.status[action.index] is not Status.UNFEASIBLE for action in actions)
    required = [action.name for action in actions if state.required[action.index]]
    words = f"{feasible} of {len(actions)} actions feasible"
    return f"{words}, required: {', '.join(required)}" if required else words


def meant(
    base: Readable, state: State, element: Meant, kinds: Iterable[str], *, unique: bool = False
) -> Node:
    """Return the node that is meant; a bare name is looked for in the given kinds, in this order.

    Raises:
        AmbiguousName: several kinds have such a name, and that is not allowed.
    """
    network = state.network
    if isinstance(element, ElementView):
        if element.base is not base:
            raise InvalidValue(
                f"{element!r} is a view of another knowledge base; take it from this one"
            )
        element = element.element
    if isinstance(element, Element) and network.model is not element.model:
        raise InvalidValue(f"{element.name!r} belongs to another model, {element.model.name!r}")
    if isinstance(element, Element | Constraint | tuple):
        node = network.referred(element) if isinstance(element, tuple) else network.find(element)
        if node.kind not in kinds:
            raise InvalidValue(f"{node!r} cannot be meant here; allowed are {', '.join(kinds)}")
        return node
    searched = {kind: network.kinds[kind] for kind in kinds if kind != "constraint"}
    return meant_by(
        element, searched, " or ".join(searched), "pass the view meant, e.g. kb." if unique else ""
    )


def preferred(
    network: Network, given: str | Mapping[str, float] | None
) -> str | Mapping[str, float] | None:
    """Return a preference as the name of an attribute, or finite weights by name; any other is refused."""
    if given is None or not isinstance(given, Mapping):
        return None if given is None else network.attributes[given].name
    weights = {network.attributes[name].name: finite_number(one) for name, one in given.items()}
    return MappingProxyType(weights)


def _selectable(state: State, nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(node.name for node in nodes if state.status[node.index] is not Status.UNFEASIBLE)


def _adaptable(state: State, kind: str) -> tuple[str, ...]:
    return tuple(node.name for node in state.adaptable.nodes() if node.kind == kind)


_Assumption = tuple[str, Node, float | Forecast | None]
"""What is supposed, of which element, and the value of what is measured or forecast."""


def suppose(
    base: Readable,
    measured: Mapping[str, float | None] | None = None,
    /,
    *,
    failed: Iterable[str] = (),
    recovered: Iterable[str] = (),
    requested: Iterable[str] = (),
    at: float | None = None,
    **attributes: float | None,
) -> "Situation":
    """Return a situation, "what if", that answers the same questions; the facts are neither changed nor copied.

    Args:
        base: what the situation starts from; what is supposed here overrides what is known or supposed there.
        measured: values by name of attribute, for names that are no Python names; None is "not measured".
        failed: names of components supposed to have failed.
        recovered: names of components supposed not to have.
        requested: names of actions supposed to be required, even if they are unfeasible.
        at: a time from now on [s, by the clock]. Attributes are forecast for it, as if all actions that are required,
            or supposed to be, were done until then. A forecast only adds caution: what is violated now stays violated,
            and what the worse end of a forecast's interval violates is violated then.
        attributes: values by name of attribute, e.g. `light=0.3`.
    """
    if not isinstance(measured, Mapping | None):
        raise InvalidValue(
            f"what is supposed to be measured is given as values by name, not as {measured!r}"
        )
    values = {**(measured or {}), **attributes}
    listings = {"failed": failed, "recovered": recovered, "requested": requested}
    for what, names in listings.items():
        listings[what] = (
            (names,) if isinstance(names, str) else listed(f"names supposed to be {what}", names)
        )
    then, now = (None, 0.0) if at is None else (finite_number(at), base.now)
    with base.reading() as state:
        network = state.network
        supposed: list[_Assumption] = []
        for name, value in values.items():
            node = network.attributes[name]
            given = (
                None if value is None else number(f"{name} cannot be supposed to be", value, node)
            )
            supposed.append(("measured", node, given))
        for what, names in listings.items():
            table = network.actions if what == "requested" else network.components
            supposed += [(what, table[name], None) for name in names]
        if then is not None:
            of = base.forecast
            if then < now:
                raise InvalidValue(
                    f"a situation is that of a time from now on, {now!r} s by the clock; not {at!r}"
                )
            doing = of.doing(None).union(
                node.name for what, node, _ in supposed if what == "requested"
            )
            for node in (node for name, node in network.attributes.items() if name not in values):
                supposed.append(("forecast", node, of.at(node.name, then, now, doing)))
    return Situation(base, state, supposed, at)


class Situation:
    """A knowledge base as it would be if some facts were different; made by `KnowledgeBase.situation`.

    The facts are neither changed nor copied. What the base learns later holds here too, under the same assumptions.
    """

    _overlay: Overlay

    def __init__(
        self,
        base: Readable,
        state: State,
        assumptions: Iterable[_Assumption],
        at: float | None = None,
    ) -> None:
        self._base, self._at = base, at
        self.forecast = base.forecast
        self._network = network = state.network
        self._assumptions = tuple(assumptions)
        self._seen: tuple[State | None, int, int] = (None, -1, -1)
        self._held = Reading(base.reading(), self._layered)
        self.actions = views.Views(self, network.actions, views.ActionView)
        self.functions = views.Views(self, network.functions, views.FunctionView)
        self.components = views.Views(self, network.components, views.ComponentView)
        self.designs = views.Views(self, network.designs, views.DesignView)
        self.configurations = views.Views(self, network.configurations, views.ConfigurationView)
        self.attributes = views.Views(self, network.attributes, views.AttributeView)

    is_feasible = is_feasible
    selectable_actions = selectable_actions
    selectable_designs = selectable_designs
    selectable_configurations = selectable_configurations
    best_configuration = best_configuration
    adaptable_functions = adaptable_functions
    adaptable_components = adaptable_components
    obsolete = obsolete
    explain = explain
    why = why
    explain_choice = explain_choice
    situation = suppose
    feasible_until = feasible_until

    @property
    def now(self) -> float:
        """The time for which it was made, or else the time by the clock [s]."""
        return self._base.now if self._at is None else self._at

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""
        self._base.reading()  # makes the events that are due
        return self._held

    def _layered(self, below: State) -> State:
        seen = (below, below.version, self._network.revision)
        if self._seen != seen:
            self._overlay, self._seen = self._supposed(below), seen
        return self._overlay

    def __repr__(self) -> str:
        with self.reading() as state:
            return f"<Situation of {self._network.model.name!r}: {outline(state)}>"

    def _supposed(self, below: State) -> Overlay:
        state = Overlay(below)
        touched: list[Node] = []
        for what, node, value in self._assumptions:
            self._network.find(node.element)
            if isinstance(value, Forecast):
                touched += suppose_forecast(state, node, value)
            elif what == "measured":
                touched += _suppose_measured(state, node, value)
            else:
                touched.append(node)
            if what == "requested":
                state.requested[node.index] = True
            elif what in ("failed", "recovered"):
                state.failed[node.index] = what == "failed"
                if what == "recovered" and state.asserted[node.index] is Status.FAILURE:
                    state.asserted[node.index] = None
        propagate(state, touched)
        return state


def _suppose_measured(state: State, attribute: Node, value: float | None) -> list[Node]:
    """Enter a value without a time of measurement; returns the constraints whose status it may change."""
    index, thresholds = attribute.index, state.network.thresholds(attribute)
    before, was_stale = state.value[index], state.stale[index]
    state.value[index], state.time[index], state.stale[index] = value, None, False
    if was_forecast := bool(state.reason("forecast", attribute).text):
        state.give_reason("forecast", attribute)
        for one in attribute.constraints:
            state.verdict[one.index] = None
    for one in thresholds.steady:
        known = (
            None if value is None else verdict(one.constraint, [value], 1, state.verdict[one.index])
        )
        state.verdict[one.index] = known  # as once it has been measured for long enough
    if before is None or value is None or was_stale or was_forecast:
        return attribute.constraints
    return [*thresholds.steady, *thresholds.crossed(before, value)]


def number(refusal: str, value: object, attribute: Node) -> float:
    """Return a value as a number in the attribute's range; `refusal` begins the message of the error otherwise."""
    try:
        return attribute.attribute.checked(value)
    except InvalidValue as error:
        raise InvalidValue(f"{refusal} {shown(value)}: {error}") from None
