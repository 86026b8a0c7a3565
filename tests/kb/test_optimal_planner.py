"""The best joint choice: equal to trying everything, the same every time, and honest about what was not proven."""

import math
from random import Random
from threading import Thread

import pytest
from best_by_trying import best_by_trying, exact, outcome
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import RANDOMS, Clock, Twins, events, is_so, mostly_some, state_of, stories, subsets

from kb import (
    ConfigurationManager,
    InvalidValue,
    KnowledgeBase,
    Model,
    PriorityPlanner,
    UnknownName,
)
from kb.optimal import OptimalPlanner, Problem
from kb.planning import Criterion

SLOW = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
ATTRIBUTES = ("x0", "x1")
VALUES = (0.0, 0.1, 0.3, 1.0, 2.5, -0.7)
COSTS = st.sampled_from((0.0, 0.1, 1.0))
PRIORITIES = (None, 0, 1, 2, -1)


def estimated_models():
    """A small model in which there is something to choose, and something is estimated of it; an action needs it all."""
    return RANDOMS.map(estimated_model)


def estimated_model(chance):
    model = Model("random")
    attributes = [model.quality_attribute(name) for name in ATTRIBUTES]
    components = [
        model.component(
            f"x{i}",
            kind=chance.choice(("plain", "process", "lifecycle")),
            always_improve=is_so(chance),
        )
        for i in range(chance.randint(1, 3))
    ]
    for component in components:
        for number in range(chance.randint(0, 2)):
            component.configuration(
                f"x{number} {component.name}", priority=chance.choice(PRIORITIES)
            )
    functions = [
        model.function(f"x{i}", always_improve=is_so(chance)) for i in range(chance.randint(1, 2))
    ]
    for function in functions:
        for number in range(chance.randint(1, 3)):
            parts = mostly_some(chance, model.components)
            function.design(f"x{number} {function.name}", parts, priority=chance.choice(PRIORITIES))
    model.action("x0", requires=functions)
    model.action("x1", requires=functions[:1])
    causers = [*model.designs.values(), *components, *model.configurations.values()]
    for _ in range(chance.randint(1, 2 * len(causers))):
        kind = chance.choice(("positive", "positive", "negative", "absolute"))
        chance.choice(causers).estimate(chance.choice(attributes), chance.choice(VALUES), kind)
    for _ in range(chance.randint(0, 2)):
        chance.choice(causers).constrain(chance.choice(attributes) >= 0.5)
    return model


@st.composite
def robots(draw):
    """A knowledge base of which something happened, and which an action requires something of."""
    model = draw(estimated_models())
    twins = Twins(model)
    for event in draw(st.lists(events(model), max_size=8)):
        twins.happen(event)
    twins.kb.request_action(draw(st.sampled_from(("x0", "x0", "x1"))))
    for name in draw(subsets(model.components)):  # what nobody uses is needed, too, or runs
        twins.happen(
            draw(
                st.sampled_from(
                    (("assert_required", ("component", name), True), ("active", name, True))
                )
            )
        )
    return twins.kb


@st.composite
def criteria(draw):
    weights = st.dictionaries(
        st.sampled_from(ATTRIBUTES), st.sampled_from((1.0, 0.5, -1.0, 0.0)), min_size=1
    )
    limits = st.dictionaries(
        st.sampled_from(ATTRIBUTES), st.sampled_from((0.0, 0.4, 1.0, 2.6, 5.0))
    )
    costs = draw(COSTS | st.fixed_dictionaries({"x0": COSTS}))
    return Criterion(draw(weights), costs, draw(st.just({}) | limits))


@settings(SLOW)
@given(robots(), criteria())
def test_best_choice_is_the_one_found_by_trying_all(kb, criterion):
    expected = best_by_trying(state_of(kb), criterion)
    found = Problem(state_of(kb), criterion).solve()
    assert found.is_proven
    if expected is None:
        assert found.choice is None
        assert found.reason
        return
    worth, designs, configurations = expected
    assert found.value == pytest.approx(float(worth), abs=1e-12)
    assert (found.gap, found.resolution) == (0.0, 0.0)
    assert dict(found.choice.designs) == designs
    assert dict(found.choice.configurations) == configurations


@pytest.mark.parametrize("seed", range(15))
def test_of_many_equally_good_choices_it_is_the_first(seed):
    random, model = Random(seed), Model("tied")
    model.quality_attribute("accuracy")
    parts = [model.component(f"part {number}") for number in range(5)]
    for part in parts:
        for number in range(random.choice((0, 2, 3))):
            part.configuration(f"{number} of {part.name}", {}, priority=random.randint(0, 2))
    for number in range(3):
        function = model.function(f"function {number}")
        for one in range(random.randint(2, 4)):
            components = random.sample(parts, random.randint(1, 3))
            design = function.design(
                f"{one} of {function.name}", components, priority=random.randint(0, 2)
            )
            if random.random() < 0.4:
                design.estimate("accuracy", 1.0, random.choice(("positive", "absolute")))
    model.action("explore", requires=model.functions.values())
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", "accuracy")
    criterion = Criterion({"accuracy": 1.0})
    _, designs, configurations = best_by_trying(state_of(kb), criterion)
    found = Problem(state_of(kb), criterion).solve()
    assert found.is_proven
    assert (dict(found.choice.designs), dict(found.choice.configurations)) == (
        designs,
        configurations,
    )


@SLOW
@given(robots(), criteria(), st.sampled_from((1e-9, 1e-6, 1e-5)))
def test_best_lies_between_value_and_bound_with_any_effort(kb, criterion, effort):
    found, best = (
        Problem(state_of(kb), criterion).solve(effort),
        Problem(state_of(kb), criterion).solve(),
    )
    if found.choice is None:
        assert found.is_proven is (best.choice is None)
        return
    assert found.value <= best.value <= found.bound
    assert found.gap == found.bound - found.value
    if found.is_proven:
        assert found == best
    designs = [state_of(kb).network.designs[name] for name in found.choice.designs.values()]
    configurations = [
        state_of(kb).network.configurations[name] for name in found.choice.configurations.values()
    ]
    worth, loads = outcome(state_of(kb), designs, configurations, criterion)
    assert float(worth) == pytest.approx(found.value, abs=1e-12)
    assert all(loads[name] <= exact(limit) for name, limit in criterion.budgets.items())
    estimated, _ = outcome(state_of(kb), designs, configurations, Criterion(criterion.weights))
    assert float(estimated) == pytest.approx(found.value + found.switching, abs=1e-12)


def recorded(kb):
    """Have a knowledge base note what is selected; returns the notes."""
    calls, select = [], kb.select

    def selecting(designs=None, configurations=None, reason=""):
        plan = select(designs, configurations, reason)
        steps = plan and (plan.activate, plan.deactivate, plan.parameters, plan.reason)
        calls.append((dict(designs or {}), dict(configurations or {}), steps))
        return plan

    kb.select = selecting
    return calls


@SLOW
@given(stories(max_size=8, selecting=False), COSTS)
def test_choice_without_a_preference_is_by_priority(story, cost):
    model, happenings = story
    preference = sorted(model.attributes)[0]
    calls = []
    for planner in (PriorityPlanner(), OptimalPlanner(switching_cost=cost)):
        twins = Twins(model)
        calls.append(recorded(twins.kb))
        for action in model.actions:
            if twins.kb.request_action(action, preference):
                twins.naive.open_actions.add(action)
        for event in happenings:
            plan = planner.plan(twins.kb)
            if plan:
                twins.carry_out(plan)
                twins.kb.finish_plan(plan, "completed")
            twins.happen(event)
    assert calls[0] == calls[1]


@SLOW
@given(estimated_models(), st.data(), st.sampled_from((0.4, 1.0, 2.6)))
def test_no_plan_leads_beyond_a_budget(model, data, limit):
    twins = Twins(model)
    planner = OptimalPlanner(budgets={"x0": limit}, switching_cost=0.1)
    if twins.kb.request_action("x0", {"x0": 1.0, "x1": -0.5}):
        twins.naive.open_actions.add("x0")
    for event in data.draw(st.lists(events(model, asserting=False, selecting=False), max_size=5)):
        adaptable = kb_is_adaptable(twins.kb)
        plan = planner.plan(twins.kb)
        if plan:
            twins.carry_out(plan)
            twins.kb.finish_plan(plan, "completed")
        if adaptable and planner.latest.choice:
            _, loads = outcome(state_of(twins.kb), (), (), Criterion({}, 0.0, {"x0": limit}))
            assert loads["x0"] <= exact(limit)
        elif adaptable:
            assert plan is None or not (plan.activate or plan.parameters)
        twins.happen(event)


def kb_is_adaptable(kb):
    return bool(kb.adaptable_functions() or kb.adaptable_components())


@pytest.fixture
def model():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.quality_attribute("accuracy")
    model.quality_attribute("power")
    camera = model.component("camera", kind="lifecycle", always_improve=True)
    fine = camera.configuration("fine", priority=2)
    coarse = camera.configuration("coarse", priority=1)
    lidar = model.component("lidar", kind="process", constraints=[light >= 0.2])
    see = model.function("see", always_improve=True)
    by_camera = see.design("by camera", [camera], priority=1)
    by_both = see.design("by both", [camera, lidar], priority=2)
    model.action("explore", requires=[see])
    by_camera.estimate("accuracy", 1.0)
    by_both.estimate("accuracy", 2.0)
    fine.estimate("accuracy", 0.5)
    coarse.estimate("accuracy", 0.2)
    fine.estimate("power", 30.0)
    coarse.estimate("power", 10.0)
    lidar.estimate("power", 25.0)
    return model


def at_work(model, planner, preference="accuracy"):
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", preference)
    return kb, carried_out(kb, planner)


def carried_out(kb, planner):
    plan = planner.plan(kb)
    if plan:
        for active, names in ((False, plan.deactivate), (True, plan.activate)):
            for name in names:
                kb.component_active(name, active)
        kb.finish_plan(plan, "completed")
    return plan


def selected(kb):
    return [
        one.name for one in (*kb.designs.values(), *kb.configurations.values()) if one.is_selected
    ]


def test_preferred_attribute_goes_before_priority(model):
    kb, _ = at_work(model, planner := OptimalPlanner())
    assert selected(kb) == ["by both", "fine"]
    assert planner.latest.value == 2.5
    assert planner.latest.is_proven
    assert planner.latest.reason == "of all choices this is the best for accuracy, worth 2.5"


def test_budget_that_nothing_fits_is_said_and_nothing_is_planned(model):
    kb, plan = at_work(model, planner := OptimalPlanner(budgets={"power": 9.5}))
    assert plan is None
    assert kb.plans == ()
    assert planner.latest.choice is planner.latest.gap is None
    assert planner.latest.reason == "power would be 10 at least, more than 9.5"


def content(model):
    """Let a model be of a robot that is not to be improved while it works."""
    model.change(model.functions["see"], always_improve=False)
    model.change(model.components["camera"], always_improve=False)
    return model


def test_solved_robot_is_left_alone(model):
    model.designs["by both"].constrain(model.attributes["light"] <= 0.8)
    kb = KnowledgeBase(content(model), clock=Clock())
    kb.measure("light", 0.9)
    kb.request_action("explore", "accuracy")
    carried_out(kb, planner := OptimalPlanner())
    assert selected(kb) == ["by camera", "fine"]
    kb.measure("light", 0.5)
    assert planner.plan(kb) is None
    kb.component_active("camera", False)
    carried_out(kb, planner)
    assert selected(kb) == ["by both", "fine"]


@pytest.mark.parametrize("preference", ["accuracy", {"accuracy": 2.0, "power": 0.0}])
def test_changed_preference_leads_to_a_new_choice(model, preference):
    kb, _ = at_work(content(model), planner := OptimalPlanner(), {"power": -1.0})
    assert selected(kb) == ["by camera", "coarse"]
    kb.cancel_action("explore")
    kb.request_action("explore", preference)
    assert planner.plan(kb).activate == ("lidar",)
    assert selected(kb) == ["by both", "fine"]


def test_facts_and_the_model_may_change_during_the_search(model, monkeypatch):
    kb, planner, solved = KnowledgeBase(model, clock=Clock()), OptimalPlanner(), []
    kb.request_action("explore", "accuracy")

    class Slow(Problem):
        def solve(self, effort):
            telling = Thread(target=kb.measure, args=("power", float(len(solved))))
            telling.start()
            telling.join(60.0)
            solved.append(telling.is_alive())
            model.remove("coarse")
            return super().solve(effort)

    monkeypatch.setattr("kb.optimal.Problem", Slow)
    assert carried_out(kb, planner) is not None
    assert solved == [False]
    assert "coarse" not in selected(kb)


def intricate(size=8):
    """Return a robot for which finding the best choice takes some effort."""
    model = Model("intricate")
    for name in ("accuracy", "power"):
        model.quality_attribute(name)
    parts = [model.component(f"part {number}") for number in range(size)]
    for number, part in enumerate(parts):
        part.estimate("power", 3.0 + number % 4)
        part.estimate("accuracy", number**2 % 3 / 10, "negative")
    for one in range(size):
        function = model.function(f"function {one}")
        for two in range(3):
            needed = [parts[(3 * one + 5 * two) % size], parts[(one + two**2 + 1) % size]]
            design = function.design(f"design {two} of {function.name}", needed, priority=two)
            design.estimate("accuracy", 1.0 + (7 * one + 3 * two) % 5 / 10)
    model.action("explore", requires=model.functions.values())
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", "accuracy")
    return kb


def test_with_too_little_effort_the_gap_is_said():
    kb, criterion = intricate(20), Criterion({"accuracy": 1.0}, budgets={"power": 54.0})
    best = Problem(state_of(kb), criterion).solve()
    found = Problem(state_of(kb), criterion).solve(2e-3)
    assert best.is_proven
    assert not found.is_proven
    assert found.value < best.value < found.bound
    assert found.gap == pytest.approx(found.bound - found.value)
    assert found.reason == (
        f"this is the best for accuracy within power 54 that an effort of 0.002 found, worth {found.value:g}; "
        f"none is worth more than {found.bound:g} (a gap of {found.gap:g})"
    )


def test_without_any_effort_the_choice_is_by_priority():
    kb = intricate()
    planner = OptimalPlanner(effort=1e-9)
    assert Problem(state_of(kb), Criterion({"accuracy": 1.0})).solve(1e-9).choice is None
    carried_out(kb, planner)
    assert planner.latest is None
    assert {name for name in selected(kb) if name.startswith("design")} == {
        f"design 0 of function {one}" for one in range(8)
    }


def test_numbers_too_far_apart_are_rounded_and_it_says_so(model):
    model.designs["by both"].estimate("accuracy", 1e9)
    model.designs["by camera"].estimate("accuracy", 1e9 + 1e-6)
    model.components["lidar"].estimate("accuracy", 1e-9)
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", "accuracy")
    found = Problem(state_of(kb), Criterion({"accuracy": 1.0})).solve()
    assert 0.0 < found.resolution < 1.0
    assert found.value == pytest.approx(1e9 + 2.5, abs=found.resolution)
    assert found.is_proven
    assert (
        f"no choice is better than this one by more than {found.resolution:.12g}, to which"
        in found.reason
    )


def test_what_is_not_in_the_model_is_an_error_that_names_what_is(model):
    kb = KnowledgeBase(model, clock=Clock())
    with pytest.raises(UnknownName, match="did you mean 'power'"):
        OptimalPlanner(budgets={"powr": 1.0}).plan(kb)
    with pytest.raises(UnknownName, match="did you mean 'lidar'"):
        OptimalPlanner(switching_cost={"lidr": 1.0}).plan(kb)


@pytest.mark.parametrize(
    "settings",
    [
        {"switching_cost": -1.0},
        {"budgets": {"power": math.nan}},
        {"budgets": 3},
        {"effort": 0.0},
        {"effort": math.inf},
    ],
)
def test_setting_without_a_meaning_is_refused(settings):
    with pytest.raises(InvalidValue):
        OptimalPlanner(**settings)


class Meter:
    """A robot that does at once what it is told, and measures what it uses."""

    def __init__(self):
        self.uses = {}
        self.most = 0.0

    def activate(self, component):
        pass

    def deactivate(self, component):
        del self.uses[component]

    def set_parameters(self, component, parameters):
        self.uses[component] = parameters["power"]
        self.most = max(self.most, sum(self.uses.values()))


class Slow(Meter):
    """Takes as long as it is told, fails as often as it is told, and its meter counts from the command on."""

    def __init__(self, clock, chance):
        super().__init__()
        self.clock, self.chance, self.given = clock, chance, {}

    def doing(self, effect):
        if self.chance.random() < 0.25:
            raise RuntimeError("jammed")
        return Lasting(self.clock, self.clock.now + self.chance.choice((0.0, 1.0, 3.0)), effect)

    def activate(self, component):
        def effect():
            self.uses[component] = self.given[component]
            self.most = max(self.most, sum(self.uses.values()))

        return self.doing(effect)

    def deactivate(self, component):
        return self.doing(lambda: self.uses.pop(component, None))

    def set_parameters(self, component, parameters):
        def effect():
            self.given[component] = parameters["power"]
            if component in self.uses:
                self.activate_again(component)

        return self.doing(effect)

    def activate_again(self, component):
        self.uses[component] = self.given[component]
        self.most = max(self.most, sum(self.uses.values()))

    def is_active(self, component):
        return component in self.uses


class Lasting:
    def __init__(self, clock, ends, effect):
        self.clock, self.ends, self.effect = clock, ends, effect

    def done(self):
        if self.clock.now < self.ends:
            return False
        effect, self.effect = self.effect, lambda: None
        effect()
        return True

    def exception(self):
        return None


def three_parts(limit):
    model = Model("three")
    for name in ("power", "x0", "x1", "x2"):
        model.quality_attribute(name)
    parts = [
        model.component(f"part {number}", kind="process", always_improve=True)
        for number in range(3)
    ]
    for part, attribute in zip(parts, ("x0", "x1", "x2"), strict=True):
        for power in (1.0, 4.0, 9.0):
            one = part.configuration(f"{part.name} at {power:g}", {"power": power})
            one.estimate("power", power)
            one.estimate(attribute, power)
    for number, part in enumerate(parts):
        work = model.function(f"work {number}", always_improve=True)
        work.design(f"by {part.name}", [part])
        work.design(f"without {part.name}", [model.component(f"hand {number}")])
        model.action(f"explore {number}", requires=[work])
    return model, OptimalPlanner(budgets={"power": limit})


@settings(SLOW, max_examples=20)
@given(RANDOMS, st.sampled_from((10.0, 14.0)))
def test_budget_holds_on_the_way_in_a_slow_failing_system(chance, limit):
    model, planner = three_parts(limit)
    clock = Clock()
    kb, meter = KnowledgeBase(model, clock=clock), Slow(clock, chance)
    manager = ConfigurationManager(kb, meter, planner=planner)
    for _ in range(60):
        clock.now += 1.0
        number = chance.randrange(3)
        if chance.random() < 0.1:
            kb.cancel_action(f"explore {number}")
            kb.component_recovered(f"part {number}")
        elif chance.random() < 0.2:
            kb.request_action(f"explore {number}", {f"x{number}": chance.choice((0.1, 1.0, 10.0))})
        manager.update()
        assert meter.most <= limit
