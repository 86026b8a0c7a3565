"""The best joint choice: equal to trying everything, and honest about what was not proven."""

import math
from random import Random
from threading import Thread

import pytest
from best_by_trying import best_by_trying, outcome
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import (
    RANDOMS,
    Clock,
    Twins,
    carry_out,
    events,
    is_so,
    mostly_some,
    state_of,
    stories,
    subsets,
)

from kb import InvalidValue, KnowledgeBase, Model, OptimalPlanner, PriorityPlanner
from kb.optimal import Problem

SLOW = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)
VALUES = (0.0, 0.1, 0.3, 1.0, 2.5, -0.7)
COSTS = st.sampled_from((0.0, 0.1, 1.0))
PRIORITIES = (None, 0, 1, 2, -1)
WEIGHTS = st.dictionaries(
    st.sampled_from(("x0", "x1")), st.sampled_from((1.0, 0.5, -1.0)), min_size=1
)
BEST = "of all choices this is the best for accuracy"


def estimated_model(chance):
    """Return a small model in which there is something to choose, with estimations."""
    model = Model("random")
    attributes = [model.quality_attribute(name) for name in ("x0", "x1")]
    kinds = ("plain", "process", "lifecycle")
    for number in range(chance.randint(1, 3)):
        component = model.component(
            f"x{number}", kind=chance.choice(kinds), always_improve=is_so(chance)
        )
        for other in range(chance.randint(0, 2)):
            component.configuration(f"x{other} x{number}", priority=chance.choice(PRIORITIES))
    for number in range(chance.randint(1, 2)):
        function = model.function(f"x{number}", always_improve=is_so(chance))
        for other in range(chance.randint(1, 3)):
            parts = mostly_some(chance, model.components)
            function.design(f"x{other} x{number}", parts, priority=chance.choice(PRIORITIES))
    model.action("x0", requires=model.functions.values())
    model.action("x1", requires=["x0"])
    tables = (model.designs, model.components, model.configurations)
    causers = [causer for table in tables for causer in table.values()]
    for _ in range(chance.randint(1, 2 * len(causers))):
        kind = chance.choice(("positive", "positive", "negative", "absolute"))
        chance.choice(causers).estimate(chance.choice(attributes), chance.choice(VALUES), kind)
    for _ in range(chance.randint(0, 2)):
        chance.choice(causers).constrain(chance.choice(attributes) >= 0.5)
    return model


@st.composite
def robots(draw):
    """Draw a knowledge base of which something happened, and which an action requires."""
    model = estimated_model(draw(RANDOMS))
    twins = Twins(model, draw(st.lists(events(model), max_size=8)))
    twins.kb.request_action(draw(st.sampled_from(("x0", "x0", "x1"))))
    for name in draw(subsets(model.components)):  # what nobody uses is needed, too, or runs
        required = ("assert_required", ("component", name), True)
        twins.happen(draw(st.sampled_from((required, ("active", name, True)))))
    return twins.kb


def named(optimum):
    return dict(optimum.choice.designs), dict(optimum.choice.configurations)


@SLOW
@given(robots(), WEIGHTS, COSTS, st.sampled_from((1e-9, 1e-6, 1e-5)))
def test_best_choice_is_the_one_found_by_trying_all(kb, weights, cost, effort):
    state = state_of(kb)
    worth, choices = best_by_trying(state, weights, cost)
    best = Problem(state, weights, cost).solve()
    assert best.is_proven
    assert best.value == pytest.approx(float(worth), abs=1e-12)
    assert best.bound == best.value
    assert named(best) in choices
    hasty = Problem(state, weights, cost).solve(effort)
    if hasty is None:
        return
    assert hasty.value <= best.value <= hasty.bound
    assert not hasty.is_proven or hasty == best
    nodes = [state.network.designs[name] for name in hasty.choice.designs.values()]
    names = hasty.choice.configurations.values()
    others = [state.network.configurations[name] for name in names]
    assert float(outcome(state, nodes, others, weights, cost)) >= hasty.value - 1e-12


@pytest.mark.parametrize("seed", range(8))
def test_of_equally_good_choices_one_of_the_first_is_taken(seed):
    chance = Random(seed)
    model = Model("tied")
    model.quality_attribute("accuracy")
    parts = [model.component(f"part {number}") for number in range(4)]
    for part in parts:
        for number in range(chance.choice((0, 2, 3))):
            part.configuration(f"{number} of {part.name}", {}, priority=chance.randint(0, 2))
    for function in [model.function(f"function {number}") for number in range(3)]:
        for number in range(chance.randint(2, 4)):
            components = chance.sample(parts, chance.randint(1, 3))
            name = f"{number} of {function.name}"
            design = function.design(name, components, priority=chance.randint(0, 2))
            if chance.random() < 0.4:
                design.estimate("accuracy", 1.0, chance.choice(("positive", "absolute")))
    model.action("explore", requires=model.functions.values())
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore")
    _, choices = best_by_trying(state_of(kb), {"accuracy": 1.0})
    optimum = Problem(state_of(kb), {"accuracy": 1.0}).solve()
    assert optimum.is_proven
    assert named(optimum) in choices


def recorded(kb):
    """Record what a knowledge base is asked to select."""
    calls = []
    select = kb.select

    def selecting(designs=None, configurations=None, reason=""):
        plan = select(designs, configurations, reason)
        steps = plan and (plan.activate, plan.deactivate, plan.parameters, plan.reason)
        calls.append((dict(designs or {}), dict(configurations or {}), steps))
        return plan

    kb.select = selecting
    return calls


@SLOW
@given(stories(max_size=8, selecting=False), COSTS)
def test_choice_without_estimations_is_by_priority(story, cost):
    model, happenings = story
    calls = []
    for planner in (PriorityPlanner(), OptimalPlanner(switching_cost=cost)):
        twins = Twins(model)
        calls.append(recorded(twins.kb))
        for action in model.actions:
            if twins.kb.request_action(action, sorted(model.attributes)[0]):
                twins.naive.open_actions.add(action)
        for event in happenings:
            plan = planner.plan(twins.kb)
            if plan:
                twins.carry_out(plan)
                twins.kb.finish_plan(plan, "completed")
            twins.happen(event)
    assert calls[0] == calls[1]


@pytest.fixture
def model():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.quality_attribute("accuracy")
    model.quality_attribute("power")
    camera = model.component("camera", kind="lifecycle")
    fine = camera.configuration("fine", priority=2)
    coarse = camera.configuration("coarse", priority=1)
    lidar = model.component("lidar", kind="process", constraints=[light >= 0.2])
    see = model.function("see")
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
    return kb, carry_out(kb, planner.plan(kb))


def selected(kb):
    views = (*kb.designs.values(), *kb.configurations.values())
    return [view.name for view in views if view.is_selected]


@pytest.mark.parametrize(
    ("preference", "choice", "reason"),
    [
        ("accuracy", ["by both", "fine"], f"{BEST}, worth 2.5"),
        ({"power": -1}, ["by camera", "coarse"], "this is the best for -1 power, worth -10"),
        (
            {"accuracy": 1.0, "power": -0.03},
            ["by both", "coarse"],
            "this is the best for accuracy, -0.03 power, worth 1.15",
        ),
    ],
)
def test_preferences_go_before_priority(model, preference, choice, reason):
    kb, plan = at_work(model, OptimalPlanner(), preference)
    assert selected(kb) == choice
    assert plan.reason.endswith(reason)
    assert f"because of all choices {reason.removeprefix('of all choices ')}; not" in str(
        kb.explain_choice("see")
    )


def test_solved_robot_is_left_alone_until_preferences_change(model):
    planner = OptimalPlanner()
    kb, _ = at_work(model, planner, {"power": -1.0})
    model.change(next(iter(model.estimations)), value=0.0)
    assert planner.plan(kb) is None
    kb.cancel_action("explore")
    kb.request_action("explore", {"accuracy": 2.0, "power": 0.0})
    assert planner.plan(kb).activate == ("lidar",)
    assert selected(kb) == ["by both", "fine"]


@pytest.mark.parametrize(("cost", "changes"), [(0.4, True), (0.6, False)])
def test_smaller_gain_than_the_switching_cost_changes_nothing(model, cost, changes):
    kb, _ = at_work(model, OptimalPlanner(), {"power": -1.0})
    kb.cancel_action("explore")
    kb.request_action("explore", {"accuracy": 0.5})
    planner = OptimalPlanner(switching_cost=cost)
    planner.plan(kb)  # it notes the preferences
    kb.model.change("see", always_improve=True)
    planner.plan(kb)
    assert ("by both" in selected(kb)) is changes
    assert planner.latest.is_proven


def test_restarted_component_says_what_stopped(model):
    planner = OptimalPlanner()
    kb, _ = at_work(model, planner)
    kb.component_active("lidar", False, "the process of lidar ended by itself")
    plan = carry_out(kb, planner.plan(kb))
    assert plan.activate == ("lidar",)
    assert plan.reason.endswith(
        "; the process of lidar ended by itself; lidar is needed by explore"
    )
    assert kb.designs["by both"].reason.startswith(BEST)


def test_facts_and_model_may_change_during_the_search(model, monkeypatch):
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", "accuracy")
    blocked = []

    class Slow(Problem):
        def solve(self, effort):
            measuring = Thread(target=kb.measure, args=("power", 1.0))
            measuring.start()
            measuring.join(60.0)
            blocked.append(measuring.is_alive())
            model.change("coarse", priority=9)
            return super().solve(effort)

    monkeypatch.setattr("kb.optimal.Problem", Slow)
    carry_out(kb, OptimalPlanner().plan(kb))
    assert blocked == [False]
    assert "coarse" not in selected(kb)


def intricate(size=20):
    """Return a robot for which finding the best choice takes some effort."""
    model = Model("intricate")
    model.quality_attribute("accuracy")
    parts = [model.component(f"part {number}") for number in range(size)]
    for number, part in enumerate(parts):
        part.estimate("accuracy", 0.3 + number**2 % 7 / 10, "negative")
    for number in range(size):
        function = model.function(f"function {number}")
        for other in range(3):
            needed = {(3 * number + 5 * other) % size, (number + other**2 + 1) % size}
            names = [f"part {part}" for part in sorted(needed)]
            design = function.design(f"design {other} of {number}", names, priority=other)
            design.estimate("accuracy", 1.0 + (7 * number + 3 * other) % 5 / 10)
    model.action("explore", requires=model.functions.values())
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("explore", "accuracy")
    return kb


def test_too_little_effort_is_said():
    kb = intricate()
    best = Problem(state_of(kb), {"accuracy": 1.0}).solve()
    assert best.is_proven
    for effort in (3e-4, 1e-3, 2e-3, 4e-3):
        optimum = Problem(state_of(kb), {"accuracy": 1.0}).solve(effort)
        if optimum is not None and not optimum.is_proven:
            break
    assert not optimum.is_proven
    assert optimum.value <= best.value <= optimum.bound
    assert optimum.choice.reason == (
        f"of all choices this is the best found with an effort of {effort:g} for accuracy, worth "
        f"{optimum.value:.12g}"
    )


def test_without_any_effort_the_choice_is_by_priority():
    kb = intricate(8)
    planner = OptimalPlanner(effort=1e-9)
    carry_out(kb, planner.plan(kb))
    assert planner.latest is None
    assert selected(kb) == [f"design 0 of {number}" for number in range(8)]


@pytest.mark.parametrize(
    "options", [{"switching_cost": -1.0}, {"effort": 0.0}, {"effort": math.inf}]
)
def test_setting_without_a_meaning_is_refused(options):
    with pytest.raises(InvalidValue):
        OptimalPlanner(**options)
