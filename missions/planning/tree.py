"""From a plan to a tree that executes it: in the XML of BehaviorTree.CPP, and as py_trees behaviours.

The tree is a sequence of the steps. Each step asks for its conditions, is done only while those hold that have to hold
over all, and is believed to have had its effects; what fails, or does not hold, is the failure of the tree.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase
from missions.engine.mission import MissionError
from missions.planning.formulas import written_condition, written_effects
from missions.planning.leaves import Assume, Holds
from rosa_bt import BehaviourRegistry, RosaBtError, load_xml
from rosa_pddl import Domain, MissingBehaviourError, Schema, Step
from rosa_pddl.belief import Belief
from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, UpThing
from rosa_pddl.exceptions import nearest
from rosa_pddl.validate import binding_of, mentioned_atoms

__all__ = ["plan_registry", "plan_tree", "plan_xml"]

Factory = Callable[[Step], Behaviour]

_TAKEN: Final = ("id", "name")
"""Attributes that mean something else in the XML, in lower case."""


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
    registry = plan_registry(domain, kb=kb, behaviours=behaviours, sense=sense)
    return load_xml(plan_xml(domain, steps), registry)


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
    registry.register("Holds", Holds, kind="condition")
    registry.register("Assume", Assume, kind="action")
    for schema in domain.schema_of.values():
        if schema.name not in behaviours:
            hint = nearest(schema.name, behaviours)
            raise MissingBehaviourError(f"no behaviour for the PDDL action {schema.name!r} of {domain.file}; {hint}")
        try:
            registry.register(schema.name, _maker(domain, schema, behaviours[schema.name]), kind="action")
        except RosaBtError as error:
            raise MissionError(f"the PDDL action {schema.name!r} cannot be a node of a tree: {error}") from error
    return registry


def plan_xml(domain: Domain, steps: Iterable[Step]) -> str:
    """Write the tree of a plan.

    Of each step the element has the name of the PDDL action and an attribute for each parameter, e.g.
    `<move r="robby" from="hall" to="kitchen"/>`. Beside these there are `IsActionFeasible`, `Holds` (a condition on
    facts) and `Assume` (what is believed from then on).
    """
    root = Element("root", BTCPP_format="4", main_tree_to_execute="Plan")
    plan = SubElement(SubElement(root, "BehaviorTree", ID="Plan"), "Sequence", name="plan")
    for step in steps:
        plan.append(_step(domain, step))
    if not len(plan):
        SubElement(plan, "AlwaysSuccess", name="nothing to do")
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _step(domain: Domain, step: Step) -> Element:
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    conditions = schema.start + schema.over_all + schema.end
    guards = [_feasible(domain, one, binding) for one in conditions if _is_feasibility(domain, one)]
    guards += _holds(domain, schema.over_all, binding)
    attributes = {_port(name): argument for (name, _), argument in zip(schema.parameters, step.arguments, strict=True)}
    action = Element(schema.name, attributes)
    if guards:
        guarded = Element("ReactiveSequence")
        guarded.extend([*guards, action])
    parts = [
        *_holds(domain, schema.start, binding),
        *_assume(domain, schema.start_effects, binding),
        guarded if guards else action,
        *_holds(domain, schema.end, binding),
        *_assume(domain, schema.end_effects, binding),
    ]
    whole = Element("Sequence", name=str(step))
    whole.extend(parts)
    return whole


def _holds(domain: Domain, formulas: Sequence[UpThing], binding: Mapping[str, str]) -> list[Element]:
    asked = [one for one in formulas if not _is_feasibility(domain, one) and _may_change(domain, one, binding)]
    texts = [written_condition(domain, formula, binding) for formula in asked]
    return [Element("Holds", condition=text) for text in dict.fromkeys(texts)]


def _assume(domain: Domain, effects: Iterable[UpThing], binding: Mapping[str, str]) -> list[Element]:
    """Return what is believed; expected feasibility is for planning only."""
    own = [effect for effect in effects if not _is_feasibility(domain, effect.fluent)]
    texts = written_effects(domain, own, binding)
    return [Element("Assume", effects=texts[0] if len(texts) == 1 else f"(and {' '.join(texts)})")] if texts else []


def _feasible(domain: Domain, formula: UpThing, binding: Mapping[str, str]) -> Element:
    _, action = written_condition(domain, formula, binding)[1:-1].split()
    return Element("IsActionFeasible", name=f"{action} feasible?", action=action)


def _is_feasibility(domain: Domain, formula: UpThing) -> bool:
    return bool(formula.is_fluent_exp()) and _name(domain, formula.fluent()) == FEASIBLE


def _may_change(domain: Domain, formula: UpThing, binding: Mapping[str, str]) -> bool:
    """Tell whether a condition is worth asking: not if it only says which object is which ROSA action."""
    asked = {atom[1:-1].split()[0].lower() for atom in mentioned_atoms(domain, [formula], (), binding)}
    return bool(asked - set(_naming(domain)))


def _naming(domain: Domain) -> Iterator[str]:
    """Yield the predicates about ROSA actions only that no action changes; their names in lower case."""
    schemas = domain.schema_of.values()
    changed = {
        _name(domain, effect.fluent.fluent())
        for schema in schemas
        for effect in schema.start_effects + schema.end_effects
    }
    for fluent in domain.up_problem.fluents:
        kinds = {domain.outside[parameter.type.name].lower() for parameter in fluent.signature}
        if kinds == {ACTION_TYPE} and _name(domain, fluent) not in {*changed, FEASIBLE}:
            yield _name(domain, fluent)


def _name(domain: Domain, fluent: UpThing) -> str:
    return domain.outside[fluent.name].lower()


def _port(parameter: str) -> str:
    """Return the attribute of a parameter, with another beginning if that name has a meaning of its own."""
    return f"p_{parameter}" if parameter.lower() in _TAKEN or parameter.startswith("_") else parameter


def _maker(domain: Domain, schema: Schema, behaviour: Factory) -> Callable[..., Behaviour]:
    """Return what makes the behaviour of a step from its attributes; its own name is the one that it gives itself."""

    def make(name: str, **ports: Any) -> Behaviour:  # noqa: ANN401  # what attributes hold
        arguments = [str(ports[_port(parameter)]) for parameter, _ in schema.parameters]
        return behaviour(domain.step(schema.name, arguments))

    return make
