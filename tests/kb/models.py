"""Random models, random things that happen to them, and a knowledge base with its naive twin to happen to."""

import math

import pytest
from clocks import Clock as Clock
from hypothesis import strategies as st
from naive import Naive

from kb import InvalidValue, KnowledgeBase, Model, Status

OPERATORS = (">=", ">", "<=", "<")
NUMBERS = st.sampled_from((0.0, 0.5, 1.0))
KINDS = {
    "constraint": (Status.NOT_EVALUATED, Status.SATISFIED, Status.VIOLATED),
    "configuration": (Status.UNFEASIBLE, Status.FEASIBLE),
    "component": (
        Status.FAILURE,
        Status.UNFEASIBLE,
        Status.CONFIGURATION_ERROR,
        Status.UNSOLVED,
        Status.SOLVED,
        Status.FEASIBLE,
    ),
    "design": (
        Status.UNFEASIBLE,
        Status.IMPLICIT_CONFIGURATION_ERROR,
        Status.UNSOLVED,
        Status.SOLVED,
        Status.FEASIBLE,
    ),
    "function": (
        Status.UNFEASIBLE,
        Status.CONFIGURATION_ERROR,
        Status.IMPLICIT_CONFIGURATION_ERROR,
        Status.SOLVED,
        Status.UNSOLVED,
        Status.FEASIBLE,
    ),
    "action": (
        Status.UNFEASIBLE,
        Status.IMPLICIT_CONFIGURATION_ERROR,
        Status.UNSOLVED,
        Status.SOLVED,
        Status.FEASIBLE,
    ),
}


def compare(attribute, operator, value):
    return {
        ">=": attribute.__ge__,
        ">": attribute.__gt__,
        "<=": attribute.__le__,
        "<": attribute.__lt__,
    }[operator](value)


def amount(most):
    """How many of something: none only now and then."""
    return st.sampled_from((*range(1, most + 1), *range(2, most + 1), 0))


def subsets(names, max_size=3):
    if not names:
        return st.just([])
    return st.lists(st.sampled_from(sorted(names)), unique=True, max_size=max_size)


def mostly_some(names):
    some = st.lists(st.sampled_from(sorted(names)), unique=True, min_size=1, max_size=3) if names else st.just([])
    return st.integers(0, 7).flatmap(lambda chance: some if chance else st.just([]))


@st.composite
def models(draw, *, aging=False):
    """A small model with anything that the builder allows; names are shared across kinds on purpose.

    With aging, measurements may be too old after a few seconds.
    """
    model = Model("random")
    ages = st.sampled_from((1.0, 3.0, 6.0, math.inf) if aging else (math.inf,))
    attributes = [
        model.quality_attribute(
            f"x{i}", max_age=draw(ages), when_stale=draw(st.sampled_from(("not evaluated", "violated")))
        )
        for i in range(draw(st.integers(1, 2)))
    ]
    components = [
        model.component(
            f"x{i}",
            kind=draw(st.sampled_from(("plain", "process", "lifecycle"))),
            always_improve=draw(st.booleans()),
            stops_to_configure=draw(st.booleans()),
        )
        for i in range(draw(amount(4)))
    ]
    priorities = st.none() | st.integers(-1, 2)
    configurations = [
        component.configuration(f"x{number} {component.name}", {"gain": float(number)}, priority=draw(priorities))
        for component in components
        for number in range(draw(amount(2)))
    ]
    functions = [model.function(f"x{i}", always_improve=draw(st.booleans())) for i in range(draw(amount(2)))]
    designs = [
        function.design(
            f"x{number} {function.name}", draw(mostly_some(list(model.components))), priority=draw(priorities)
        )
        for function in functions
        for number in range(draw(amount(3)))
    ]
    actions = [model.action(f"x{i}", requires=draw(mostly_some(list(model.functions)))) for i in range(draw(amount(2)))]
    constrainable = [*actions, *designs, *components, *configurations]
    for _ in range(draw(amount(5)) if constrainable else 0):
        positions = draw(st.lists(st.integers(0, len(constrainable) - 1), unique=True, min_size=1, max_size=4))
        expression = compare(draw(st.sampled_from(attributes)), draw(st.sampled_from(OPERATORS)), draw(NUMBERS))
        model.constrain([constrainable[position] for position in positions], expression)
    return model


def names(model):
    return {
        "action": list(model.actions),
        "function": list(model.functions),
        "design": list(model.designs),
        "component": list(model.components),
        "configuration": list(model.configurations),
    }


def pairs(kind, listed):
    return st.tuples(st.just(kind), st.sampled_from(listed))


def events(model, *, asserting=True, selecting=True):
    """One thing that happens to a robot of this model, as a tuple of its name and arguments."""
    named = names(model)
    options = [st.tuples(st.just("measure"), st.sampled_from(list(model.attributes)), NUMBERS)]
    if components := named["component"]:
        for what in ("failed", "recovered"):
            options.append(st.tuples(st.just(what), st.sampled_from(components)))
        options.append(st.tuples(st.just("active"), st.sampled_from(components), st.booleans()))
    if actions := named["action"]:
        options += [st.tuples(st.just("request"), st.sampled_from(actions))] * 3
        options.append(st.tuples(st.just("cancel"), st.sampled_from(actions)))
    if selecting:
        options.append(st.tuples(st.just("select"), choices(model)))
        options += [st.tuples(st.just("adapt"), st.integers(0, 5))] * 4
        options += [st.tuples(st.just("carry_out_pending"))] * 3
        options.append(st.tuples(st.just("finish"), st.sampled_from(("completed", "failed", "abandoned"))))
    if asserting:
        options += [assertions(model).map(tuple)] * 2  # mapped: else each kind of assertion weighs as much as an event
    return st.one_of(options)


def choices(model):
    """Any designs and configurations, whether they are selectable or not."""
    return st.tuples(subsets(list(model.designs)), subsets(list(model.configurations))).map(
        lambda chosen: (
            {model.designs[name].function: name for name in chosen[0]},
            {model.configurations[name].component: name for name in chosen[1]},
        )
    )


def assertions(model):
    named = names(model)
    elements = [pairs(kind, listed) for kind, listed in named.items() if listed]
    if model.constraints:
        elements.append(pairs("constraint", range(len(model.constraints))))
    options = []
    if elements:
        element = st.one_of(elements)
        options.append(
            element.flatmap(
                lambda one: st.tuples(st.just("assert_status"), st.just(one), st.sampled_from(KINDS[one[0]]))
            )
        )
        options.append(st.tuples(st.just("retract_status"), element))
    required = [pairs(kind, named[kind]) for kind in ("action", "function", "component") if named[kind]]
    if required:
        options.append(st.tuples(st.just("assert_required"), st.one_of(required), st.sampled_from((True, False, None))))
    selected = [pairs(kind, named[kind]) for kind in ("design", "configuration") if named[kind]]
    if selected:
        options.append(st.tuples(st.just("assert_selected"), st.one_of(selected), st.sampled_from((True, False, None))))
    return st.one_of(options) if options else st.tuples(st.just("measure"), st.just("x0"), NUMBERS)


@st.composite
def stories(draw, *, max_size=15, asserting=True, selecting=True, aging=False):
    """A model and a list of things that happen."""
    model = draw(models(aging=aging))
    happenings = st.lists(
        events(model, asserting=asserting, selecting=selecting), min_size=max_size // 2, max_size=max_size
    )
    return model, draw(happenings)


def state_of(kb):
    """The facts and statuses of a base."""
    with kb.reading() as state:
        return state


class Twins:
    """A knowledge base and its naive twin; everything happens to both."""

    def __init__(self, model):
        self.model = model
        self.clock = Clock()
        self.kb = KnowledgeBase(model, clock=self.clock)
        self.naive = Naive(model)

    def happen(self, event):
        self.pass_time(1.0)
        getattr(self, f"_{event[0]}")(*event[1:])

    def pass_time(self, seconds):
        self.clock.now += seconds
        self.naive.now = self.clock.now

    def view(self, kind, name, kb=None):
        if kind == "constraint":
            constraint = self.model.constraints[name]
            holder = constraint.constrained[0]
            kinds = {"Action": "action", "FunctionDesign": "design", "Component": "component"}
            whole = self.view(kinds.get(type(holder).__name__, "configuration"), holder.name, kb)
            own = [one for one in self.model.constraints if any(it is holder for it in one.constrained)]
            position = next(number for number, one in enumerate(own) if one is constraint)
            return whole.constraints[position]
        return getattr(kb or self.kb, f"{kind}s")[name]

    def elements(self):
        """Kind and name of every element that has a status."""
        listed = [(kind, name) for kind, all_of_it in names(self.model).items() for name in all_of_it]
        return listed + [("constraint", number) for number in range(len(self.model.constraints))]

    def statuses(self):
        return {one: self.view(*one).status for one in self.elements()}

    def _measure(self, name, value):
        self.kb.measure(name, value)
        self.naive.value[name] = value
        self.naive.time[name] = self.clock.now

    def _failed(self, name):
        self.kb.component_failed(name)
        self.naive.failed.add(name)

    def _recovered(self, name):
        self.kb.component_recovered(name)
        self.naive.failed.discard(name)
        if self.naive.asserted.get(("component", name)) == "failure":
            del self.naive.asserted["component", name]

    def _active(self, name, active):
        self.kb.component_active(name, active)
        (self.naive.active.add if active else self.naive.active.discard)(name)

    def _request(self, name):
        accepted = name in self.naive.open_actions or self.naive.status("action", name) != "unfeasible"
        reply = self.kb.request_action(name)
        assert bool(reply) is accepted
        assert reply.reason
        if accepted:
            self.naive.open_actions.add(name)

    def _cancel(self, name):
        self.kb.cancel_action(name)
        self.naive.open_actions.discard(name)

    def possible(self, chosen):
        """What of a choice is feasible; the base refuses the whole as long as something is not."""
        kinds = ("design", "configuration")
        possible = tuple(
            {whole: part for whole, part in parts.items() if self.naive.status(kind, part) != "unfeasible"}
            for kind, parts in zip(kinds, chosen, strict=True)
        )
        if possible != tuple(chosen):
            revision = self.kb.revision
            with pytest.raises(InvalidValue, match=r"cannot be selected: .* unfeasible"):
                self.kb.select(*chosen)
            assert self.kb.revision == revision
        return possible

    def _select(self, chosen):
        chosen = self.possible(chosen)
        plan = self.kb.select(*chosen)
        expected = self.naive.select(*chosen)
        if expected is None:
            assert plan is None
            return
        assert plan is self.kb.latest_plan
        for part in ("activate", "deactivate", "parameters"):
            given = getattr(plan, part)
            assert isinstance(given, tuple)
            assert len(set(given)) == len(given)
            assert (part, set(given)) == (part, set(getattr(expected, part)))

    def _adapt(self, number):
        """Choose for all that is adaptable; the number says which of what is selectable is taken."""
        designs = {}
        for function in sorted(self.naive.adaptable_functions()):
            if options := sorted(self.naive.selectable_designs(function)):
                designs[function] = options[number % len(options)]
        configurations = {}
        for component in sorted(self.naive.adaptable_components(designs.values())):
            if options := sorted(self.naive.selectable_configurations(component)):
                configurations[component] = options[number % len(options)]
        self._select((designs, configurations))

    def _carry_out_pending(self):
        plan = self.kb.pending_plan
        if plan is not None:
            self.carry_out(plan)
            self.kb.finish_plan(plan, "completed")

    def _finish(self, result):
        plan = self.kb.pending_plan
        if plan is not None:
            self.kb.finish_plan(plan, result)

    def _assert_status(self, element, status):
        self.kb.assert_status(self.view(*element), status)
        self.naive.asserted[element] = status

    def _retract_status(self, element):
        self.kb.retract_status(self.view(*element))
        self.naive.asserted.pop(element, None)

    def _assert_required(self, element, required):
        self.kb.assert_required(self.view(*element), required)
        (self.naive.asserted_required.add if required else self.naive.asserted_required.discard)(element)

    def _assert_selected(self, element, selected):
        self.kb.assert_selected(self.view(*element), selected)
        marked = self.naive.designs if element[0] == "design" else self.naive.configurations
        (marked.add if selected else marked.discard)(element[1])

    def carry_out(self, plan):
        for name in plan.deactivate:
            self._active(name, False)
        for name in plan.activate:
            self._active(name, True)

    def agree(self, kb=None, naive=None):
        """Assert that the quick one answers every question as the naive one does."""
        kb, naive = kb or self.kb, naive or self.naive
        for kind, name in self.elements():
            view = self.view(kind, name, kb)
            assert (kind, name, view.status) == (kind, name, naive.status(kind, name))
            if kind in ("action", "function", "component"):
                assert (kind, name, view.is_required) == (kind, name, naive.required(kind, name))
        for kind in ("actions", "functions", "designs", "components", "configurations", "attributes"):
            assert len(getattr(kb, kind)) == len(getattr(self.model, kind))
        assert set(kb.adaptable_functions()) == naive.adaptable_functions()
        assert set(kb.selectable_actions()) == naive.selectable_actions()
        for name in self.model.actions:
            assert kb.is_feasible(name) is (name in naive.selectable_actions())
        for name in self.model.functions:
            assert set(kb.selectable_designs(name)) == naive.selectable_designs(name)
        for name in self.model.components:
            assert set(kb.selectable_configurations(name)) == naive.selectable_configurations(name)
            assert kb.components[name].is_active is (name in naive.active)
        for name in self.model.designs:
            assert kb.designs[name].is_selected is (name in naive.designs)
        for name in self.model.configurations:
            assert kb.configurations[name].is_selected is (name in naive.configurations)
        obsolete = kb.obsolete()
        assert set(obsolete.components) == naive.obsolete_components()
        assert set(obsolete.designs) == naive.obsolete_designs()
        assert set(obsolete.configurations) == naive.obsolete_configurations()
        if kb is self.kb:
            assert {one.action for one in kb.required_actions} == naive.open_actions
