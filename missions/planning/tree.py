"""From a plan to a tree that executes it: in the XML of BehaviorTree.CPP, and as py_trees behaviours.

The tree is a sequence of the steps. Each step asks for its conditions, is done only while those hold that have to hold
over all, and is believed to have had its effects; what fails, or does not hold, is the failure of the tree.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase
from missions.engine.mission import MissionError
from rosa_bt import BehaviourRegistry, RosaBtError, load_xml
from rosa_pddl import Domain, MissingBehaviourError, Schema, State, Step
from rosa_pddl.belief import Belief
from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, UpThing
from rosa_pddl.exceptions import nearest
from rosa_pddl.formulas import conditions
from rosa_pddl.syntax import Node, parse
from rosa_pddl.validate import binding_of, holds, mentioned_atoms

Factory = Callable[[Step], Behaviour]
Binding = Mapping[str, str]
Change = Callable[[State], tuple[set[str], set[str]]]
"""From a state to the atoms that become false, and those that become true."""

_TAKEN: Final = ("id", "name")
"""Attributes that mean something else in the XML, in lower case."""
_HEADS: Final = {"AND": "and", "OR": "or", "NOT": "not", "IMPLIES": "imply", "EQUALS": "="}


def plan_tree(
    domain: Domain,
    steps: Iterable[Step],
    *,
    kb: KnowledgeBase,
    behaviours: Mapping[str, Factory],
    sense: Callable[[], Mapping[str, bool]] = dict,
) -> Behaviour:
    """Make a tree that executes a plan, with the semantics of BehaviorTree.CPP; `rosa_bt.export_xml` writes it.

    What the plan executor foresees, such as a later step that has become unfeasible, the tree finds out when it comes
    to it. It does not plan anew.

    Args:
        domain: what `load_domain` returned.
        steps: the plan.
        kb: says which ROSA actions are feasible.
        behaviours: for each PDDL action, what makes the behaviour of a step; those of the plan executor.
        sense: returns the facts that are sensed now, by text such as `(lit room)`; others stay as they were.

    Raises:
        rosa_pddl.MissingBehaviourError: a PDDL action has no behaviour.
        MissionError: a name of the domain cannot be used in XML.
    """
    return load_xml(plan_xml(domain, steps), plan_registry(domain, kb=kb, behaviours=behaviours, sense=sense))


def plan_registry(
    domain: Domain,
    *,
    kb: KnowledgeBase,
    behaviours: Mapping[str, Factory],
    sense: Callable[[], Mapping[str, bool]] = dict,
) -> BehaviourRegistry:
    """Return what `rosa_bt.load_xml` needs to read such a tree from a file; the arguments are those of `plan_tree`.

    Raises:
        rosa_pddl.MissingBehaviourError: a PDDL action has no behaviour.
        MissionError: a PDDL action is called like a node of BehaviorTree.CPP.
    """
    registry = BehaviourRegistry(kb=kb, belief=Belief(domain, kb, sense))
    registry.register("Holds", _Holds, kind="condition")
    registry.register("Assume", _Assume, kind="action")
    for schema in domain.schema_of.values():
        if schema.name not in behaviours:
            hint = nearest(schema.name, behaviours)
            raise MissingBehaviourError(f"no behaviour for the PDDL action {schema.name!r} of {domain.file}; {hint}")
        try:
            registry.register(schema.name, _maker(domain, schema, behaviours[schema.name]), kind="action")
        except RosaBtError as error:
            raise MissionError(f"the PDDL action {schema.name!r} cannot be a node of a tree: {error}") from error
    return registry


def _maker(domain: Domain, schema: Schema, behaviour: Factory) -> Callable[..., Behaviour]:
    """Return what makes the behaviour of a step from its attributes; its own name is the one that it gives itself."""

    def make(name: str, **ports: Any) -> Behaviour:  # noqa: ANN401  # what attributes hold
        arguments = [str(ports[_port(parameter)]) for parameter, _ in schema.parameters]
        return behaviour(domain.step(schema.name, arguments))

    return make


def _port(parameter: str) -> str:
    """Return the attribute of a parameter, with another beginning if that name has a meaning of its own."""
    return f"p_{parameter}" if parameter.lower() in _TAKEN or parameter.startswith("_") else parameter


class _Holds(Behaviour):
    """Condition: SUCCESS while a formula such as `(and (lit hall) (not (broken hall)))` holds."""

    def __init__(self, belief: Belief, condition: str) -> None:
        super().__init__(condition)
        self._belief = belief
        self._parts = conditions(belief.domain, condition)

    def update(self) -> Status:
        state = self._belief.observe()
        missing = (one for one in self._parts if not holds(self._belief.domain, one.expression, {}, state))
        first = next(missing, None)
        self.feedback_message = "" if first is None else f"{first} does not hold"
        return Status.SUCCESS if first is None else Status.FAILURE


class _Assume(Behaviour):
    """Action: believes effects such as `(and (scanned hall) (when (lit hall) (not (lit hall))))`."""

    def __init__(self, belief: Belief, effects: str) -> None:
        super().__init__(f"assume {effects}")
        self._belief = belief
        self._changes = _changes(belief.domain, parse(effects, f"effects {effects!r}").root)

    def update(self) -> Status:
        state = self._belief.observe()
        changed = [change(state) for change in self._changes]
        self._belief.assume(set().union(*(gone for gone, _ in changed)), set().union(*(come for _, come in changed)))
        return Status.SUCCESS


def _changes(domain: Domain, effect: Node) -> list[Change]:
    """Read effects: atoms, negated ones, those that come `when` a condition holds, or several of these."""
    if effect.head == "and":
        return [change for part in effect.children[1:] for change in _changes(domain, part)]
    if effect.head == "when" and len(effect.children) == 3:
        needed = [one.expression for one in conditions(domain, str(effect.children[1]))]
        return [_conditional(domain, needed, then) for then in _changes(domain, effect.children[2])]
    is_deleted = effect.head == "not" and len(effect.children) == 2
    atom = domain.atom(str(effect.children[1] if is_deleted else effect))
    return [lambda state: ({atom}, set()) if is_deleted else (set(), {atom})]


def _conditional(domain: Domain, needed: Sequence[UpThing], then: Change) -> Change:
    return lambda state: then(state) if all(holds(domain, one, {}, state) for one in needed) else (set(), set())


def plan_xml(domain: Domain, steps: Iterable[Step]) -> str:
    """Write the tree of a plan.

    Of each step the element has the name of the PDDL action and an attribute for each parameter, e.g.
    `<move r="robby" from="hall" to="kitchen"/>`. Beside these there are `IsActionFeasible`, `Holds` (a condition on
    facts) and `Assume` (what is believed from then on).
    """
    root = Element("root", BTCPP_format="4", main_tree_to_execute="Plan")
    plan = SubElement(SubElement(root, "BehaviorTree", ID="Plan"), "Sequence", name="plan")
    fixed = set(_fixed_predicates(domain))
    plan.extend(_step(domain, step, fixed) for step in steps)
    if not len(plan):
        SubElement(plan, "AlwaysSuccess", name="nothing to do")
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _fixed_predicates(domain: Domain) -> Iterator[str]:
    """Yield the predicates about ROSA actions only that no action changes, in lower case: they say which is which."""
    schemas = domain.schema_of.values()
    effects = [effect for schema in schemas for effect in schema.start_effects + schema.end_effects]
    changed = {FEASIBLE, *(domain.outside[effect.fluent.fluent().name].lower() for effect in effects)}
    for fluent in domain.up_problem.fluents:
        kinds = {domain.outside[parameter.type.name].lower() for parameter in fluent.signature}
        name = domain.outside[fluent.name].lower()
        if kinds == {ACTION_TYPE} and name not in changed:
            yield name


def _step(domain: Domain, step: Step, fixed: set[str]) -> Element:
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)

    def asked(formulas: Iterable[UpThing], *, feasible: bool = False) -> Iterator[str]:
        """Yield the conditions worth asking for, either those that are feasibility or the others."""
        for formula in formulas:
            heads = {atom[1:-1].split()[0].lower() for atom in mentioned_atoms(domain, [formula], (), binding)}
            text = written(domain, formula, binding)
            is_feasibility = formula.is_fluent_exp() and domain.is_feasibility(text)
            if is_feasibility is feasible and heads - fixed:
                yield text

    def holding(formulas: Iterable[UpThing]) -> list[Element]:
        return [Element("Holds", condition=text) for text in dict.fromkeys(asked(formulas))]

    def assumed(effects: Iterable[UpThing]) -> list[Element]:
        texts = [text for effect in effects for text in _written_effects(domain, effect, binding)]
        return [Element("Assume", effects=_both(texts))] if texts else []

    actions = (text[1:-1].split()[1] for text in asked(schema.start + schema.over_all + schema.end, feasible=True))
    guards = [Element("IsActionFeasible", name=f"{action} feasible?", action=action) for action in actions]
    guards += holding(schema.over_all)
    attributes = {_port(name): argument for (name, _), argument in zip(schema.parameters, step.arguments, strict=True)}
    done = Element(schema.name, attributes)
    if guards:
        guards.append(done)
        done = Element("ReactiveSequence")
        done.extend(guards)
    whole = Element("Sequence", name=str(step))
    whole.extend([*holding(schema.start), *assumed(schema.start_effects), done])
    whole.extend([*holding(schema.end), *assumed(schema.end_effects)])
    return whole


def written(domain: Domain, formula: UpThing, binding: Binding) -> str:
    """Return a condition as text that can be read again; instead of a quantifier, every object is named."""
    if formula.is_parameter_exp():
        return binding[formula.parameter().name]
    if formula.is_variable_exp():
        return binding[f"?{formula.variable().name}"]
    if formula.is_object_exp():
        return domain.outside[formula.object().name]
    if formula.is_bool_constant():
        return "(and)" if formula.constant_value() else "(or)"
    if formula.is_exists() or formula.is_forall():
        bindings = _bindings(domain, formula.variables(), binding)
        parts = [written(domain, formula.arg(0), inner) for inner in bindings]
        return f"({' '.join(['or' if formula.is_exists() else 'and', *parts])})"
    parts = [written(domain, part, binding) for part in formula.args]
    if formula.is_iff():
        return "(and (imply {0} {1}) (imply {1} {0}))".format(*parts)
    head = domain.outside[formula.fluent().name] if formula.is_fluent_exp() else _HEADS[formula.node_type.name]
    return f"({' '.join([head, *parts])})"


def _written_effects(domain: Domain, effect: UpThing, binding: Binding) -> Iterator[str]:
    """Yield `ATOM`, `(not ATOM)`, or `(when CONDITION ...)` of one of these; feasibility is for planning only."""
    for inner in _bindings(domain, effect.forall, binding):
        atom = written(domain, effect.fluent, inner)
        if domain.is_feasibility(atom):
            continue
        needed = [] if effect.condition.is_true() else [written(domain, effect.condition, inner)]
        if effect.value.is_bool_constant():
            yield _when(needed, atom if effect.value.constant_value() else f"(not {atom})")
        else:
            value = written(domain, effect.value, inner)
            yield _when([*needed, value], atom)
            yield _when([*needed, f"(not {value})"], f"(not {atom})")


def _when(needed: Sequence[str], literal: str) -> str:
    if not needed:
        return literal
    return f"(when {_both(needed)} {literal})"


def _both(texts: Sequence[str]) -> str:
    return texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})"


def _bindings(domain: Domain, variables: Iterable[UpThing], binding: Binding) -> Iterator[Binding]:
    listed = list(variables)
    choices = [domain.objects_of(domain.outside[variable.type.name]) for variable in listed]
    for chosen in product(*choices):
        # marked, so that no parameter has the name of a variable
        yield {**binding, **{f"?{variable.name}": name for variable, name in zip(listed, chosen, strict=True)}}
