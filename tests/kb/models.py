"""Random models, random things that happen to them, and a base with its naive twin."""

import math

import pytest
from clocks import Clock as Clock
from hypothesis import strategies as st
from naive import Naive

from kb import InvalidValue, KnowledgeBase, Model, Status

OPERATORS = (">=", ">", "<=", "<")
NUMBERS = (0.0, 0.5, 1.0)
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


RANDOMS = st.randoms(use_true_random=False)
"""Chance that Hypothesis draws and shrinks: a tenth of the time that a strategy takes which is made
for each model."""


def amount(chance, most):
    """How many of something: none only now and then."""
    return chance.choice((*range(1, most + 1), *range(2, most + 1), 0))


def some_of(chance, names, least=0, most=3):
    """Some names, each once, in any order."""
    left = sorted(names)
    count = chance.randint(min(least, len(left)), min(most, len(left)))
    return [left.pop(chance.randrange(len(left))) for _ in range(count)]


def mostly_some(chance, names):
    return some_of(chance, names, 1) if chance.randrange(8) else []


def subsets(names, max_size=3):
    return RANDOMS.map(lambda chance: some_of(chance, names, 0, max_size))


def is_so(chance):
    return chance.choice((False, True))


def models(*, aging=False, debounced=False):
    """A small model with anything that the builder allows.

    Names are shared across kinds on purpose.

    With aging, measurements may be too old after a few seconds.
    """
    return RANDOMS.map(lambda chance: model_by(chance, aging=aging, debounced=debounced))


def model_by(chance, *, aging=False, debounced=False):
    model = Model("random")
    ages = (1.0, 3.0, 6.0, math.inf) if aging else (math.inf,)
    priorities = (None, 0, 1, 2, -1)
    attributes = [
        model.quality_attribute(
            f"x{i}",
            max_age=chance.choice(ages),
            when_stale=chance.choice(("not evaluated", "violated")),
            agreement=chance.choice(((1, 1), (2, 2), (2, 3))) if debounced else (1, 1),
        )
        for i in range(chance.randint(1, 2))
    ]
    components = [
        model.component(
            f"x{i}",
            kind=chance.choice(("plain", "process", "lifecycle")),
            always_improve=is_so(chance),
            stops_to_configure=is_so(chance),
        )
        for i in range(amount(chance, 4))
    ]
    configurations = [
        component.configuration(
            f"x{number} {component.name}",
            {"gain": float(number)},
            priority=chance.choice(priorities),
        )
        for component in components
        for number in range(amount(chance, 2))
    ]
    functions = [
        model.function(f"x{i}", always_improve=is_so(chance)) for i in range(amount(chance, 2))
    ]
    designs = [
        function.design(
            f"x{number} {function.name}",
            mostly_some(chance, model.components),
            priority=chance.choice(priorities),
        )
        for function in functions
        for number in range(amount(chance, 3))
    ]
    actions = [
        model.action(f"x{i}", requires=mostly_some(chance, model.functions))
        for i in range(amount(chance, 2))
    ]
    constrainable = [*actions, *designs, *components, *configurations]
    for _ in range(amount(chance, 5) if constrainable else 0):
        positions = some_of(chance, range(len(constrainable)), 1, 4)
        expression = compare(
            chance.choice(attributes), chance.choice(OPERATORS), chance.choice(NUMBERS)
        )
        if debounced:
            expression = expression.steady(
                hysteresis=chance.choice((0.0, 0.25)), dwell=chance.choice((0.0, 1.0, 2.5))
            )
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


def events(model, *, asserting=True, selecting=True):
    """One thing that happens to a robot of this model, as a tuple of its name and arguments."""
    named = names(model)
    options = [
        lambda chance: ("measure", chance.choice(list(model.attributes)), chance.choice(NUMBERS))
    ]
    if components := named["component"]:
        options += [
            lambda chance: ("failed", chance.choice(components)),
            lambda chance: ("recovered", chance.choice(components)),
            lambda chance: ("active", chance.choice(components), is_so(chance)),
        ]
    if actions := named["action"]:
        options += [lambda chance: ("request", chance.choice(actions))] * 3
        options.append(lambda chance: ("cancel", chance.choice(actions)))
    if selecting:
        options.append(lambda chance: ("select", choice_by(chance, model)))
        options += [lambda chance: ("adapt", chance.randint(0, 5))] * 4
        options += [lambda chance: ("carry_out_pending",)] * 3
        options.append(
            lambda chance: ("finish", chance.choice(("completed", "failed", "abandoned")))
        )
    if asserting:
        options += [assertions(model)] * 2
    return RANDOMS.map(lambda chance: chance.choice(options)(chance))


def choices(model):
    """Any designs and configurations, whether they are selectable or not."""
    return RANDOMS.map(lambda chance: choice_by(chance, model))


def choice_by(chance, model):
    return (
        {model.designs[name].function: name for name in some_of(chance, model.designs)},
        {
            model.configurations[name].component: name
            for name in some_of(chance, model.configurations)
        },
    )


def assertions(model):
    """Return what makes up something that is asserted or retracted."""
    named = names(model)
    listed = {kind: some for kind, some in named.items() if some}
    if model.constraints:
        listed["constraint"] = range(len(model.constraints))
    required = [kind for kind in ("action", "function", "component") if named[kind]]
    selected = [kind for kind in ("design", "configuration") if named[kind]]

    def one_of(chance, kinds):
        kind = chance.choice(kinds)
        return kind, chance.choice(listed[kind])

    def assert_status(chance):
        element = one_of(chance, list(listed))
        return "assert_status", element, chance.choice(KINDS[element[0]])

    options = (
        [assert_status, lambda chance: ("retract_status", one_of(chance, list(listed)))]
        if listed
        else []
    )
    if required:
        options.append(
            lambda chance: (
                "assert_required",
                one_of(chance, required),
                chance.choice((True, False, None)),
            )
        )
    if selected:
        options.append(
            lambda chance: (
                "assert_selected",
                one_of(chance, selected),
                chance.choice((True, False, None)),
            )
        )
    if not options:
        return lambda chance: ("measure", "x0", chance.choice(NUMBERS))
    return lambda chance: chance.choice(options)(chance)


@st.composite
def stories(draw, *, max_size=15, asserting=True, selecting=True, aging=False):
    """A model and a list of things that happen."""
    model = draw(models(aging=aging))
    happenings = st.lists(
        events(model, asserting=asserting, selecting=selecting),
        min_size=max_size // 2,
        max_size=max_size,
    )
    return model, draw(happenings)


def state_of(kb):
    """The facts and statuses of a base."""
    with kb.reading() as state:
        return state


def carry_out(kb, plan, result="completed"):
    """Do what a plan says, and end it; return it."""
    for name in plan.deactivate:
        kb.component_active(name, False)
    for name in plan.activate:
        kb.component_active(name, True)
    kb.finish_plan(plan, result)
    return plan


class Twins:
    """A knowledge base and its naive twin; everything happens to both, `events` at once."""

    def __init__(self, model, events=()):
        self.model = model
        self.clock = Clock()
        self.kb = KnowledgeBase(model, clock=self.clock)
        self.naive = Naive(model)
        for event in events:
            self.happen(event)

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
            own = [
                constraint
                for constraint in self.model.constraints
                if any(it is holder for it in constraint.constrained)
            ]
            position = next(number for number, one in enumerate(own) if one is constraint)
            return whole.constraints[position]
        return getattr(kb or self.kb, f"{kind}s")[name]

    def elements(self):
        """Kind and name of every element that has a status."""
        listed = [
            (kind, name) for kind, all_of_it in names(self.model).items() for name in all_of_it
        ]
        return listed + [("constraint", number) for number in range(len(self.model.constraints))]

    def statuses(self):
        return {element: self.view(*element).status for element in self.elements()}

    def _measure(self, name, value):
        self.kb.measure(name, value)
        self.naive.measure(name, value)

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
        accepted = (
            name in self.naive.open_actions or self.naive.status("action", name) != "unfeasible"
        )
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
            {
                whole: part
                for whole, part in parts.items()
                if self.naive.status(kind, part) != "unfeasible"
            }
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
        """Choose for all that is adaptable.

        The number says which of what is selectable is taken.
        """
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
        (self.naive.asserted_required.add if required else self.naive.asserted_required.discard)(
            element
        )

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
        kb = kb or self.kb
        naive = naive or self.naive
        for kind, name in self.elements():
            view = self.view(kind, name, kb)
            assert (kind, name, view.status) == (kind, name, naive.status(kind, name))
            if kind in ("action", "function", "component"):
                assert (kind, name, view.is_required) == (kind, name, naive.required(kind, name))
        for kind in (
            "actions",
            "functions",
            "designs",
            "components",
            "configurations",
            "attributes",
        ):
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
            assert {action.action for action in kb.required_actions} == naive.open_actions
