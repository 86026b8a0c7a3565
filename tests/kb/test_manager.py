"""The adaptation loop against managed systems that obey at once, slowly, wrongly or never."""

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from managed_stand_ins import Broken, Scripted, base, come_to_rest, happen, rover, turn
from models import Clock, Twins, events, models

from kb import (
    ConfigurationManager,
    EventKind,
    KnowledgeBase,
    Model,
    PriorityPlanner,
    Status,
)


def start(model=None, script=None, default=None, **options):
    kb, clock = base(model or rover())
    managed = Scripted(clock, script, default)
    return kb, clock, managed, ConfigurationManager(kb, managed, **options)


def test_obedient_system_is_configured_within_a_turn():
    kb, clock, managed, manager = start()
    assert kb.request_action("explore")
    plan = manager.update()
    assert plan is kb.latest_plan
    assert plan.result == "completed"
    assert managed.log == ["configure camera {'exposure': 0.01}", "activate camera"]
    assert kb.actions["explore"].status is Status.SOLVED
    assert kb.components["camera"].parameters_in_force == {"exposure": 0.01}
    assert plan.start == plan.end == clock.now


def test_nothing_is_planned_or_commanded_while_nothing_changes():
    kb, clock, managed, manager = start()
    assert turn(manager, clock, 5) == []
    kb.request_action("explore")
    assert len(turn(manager, clock, 5)) == 1
    commands = list(managed.log)
    for value in (0.9, 0.8, 0.7, 0.6):
        kb.measure("light", value)
        assert turn(manager, clock, 3) == []
    assert managed.log == commands
    assert len(kb.plans) == 1


def test_slow_system_gets_parameters_before_activation():
    kb, clock, managed, manager = start(default=2.0)
    kb.request_action("explore")
    assert len(turn(manager, clock)) == 1
    assert managed.log == ["configure camera {'exposure': 0.01}"]
    assert not kb.components["camera"].is_active
    assert turn(manager, clock, 2) == []
    assert managed.log == ["configure camera {'exposure': 0.01}", "activate camera"]
    assert kb.pending_plan is kb.latest_plan
    assert kb.functions["see"].status is Status.UNSOLVED
    assert turn(manager, clock, 2) == []
    assert kb.latest_plan.result == "completed"
    assert managed.started_with == {"camera": {"exposure": 0.01}}
    assert kb.components["camera"].is_active


def test_loop_rests_when_every_design_fails():
    kb, clock, managed, manager = start(
        script={"activate camera": [Broken("no")], "activate lidar": [(1.0, Broken("no"))]}
    )
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    assert kb.actions["explore"].status is Status.UNFEASIBLE
    assert [plan.result for plan in kb.plans] == ["failed", "failed"]
    commands = len(managed.log)
    assert turn(manager, clock, 10) == []
    assert len(managed.log) == commands


def test_component_that_stops_to_configure_is_started_anew():
    kb, clock, managed, manager = start(rover(stops_to_configure=True))
    kb.request_action("explore")
    turn(manager, clock, 2)
    managed.log.clear()
    kb.measure("light", 0.1)
    turn(manager, clock, 3)
    assert managed.log == [
        "deactivate camera",
        "configure camera {'exposure': 0.2}",
        "activate camera",
    ]
    assert kb.components["camera"].is_active
    assert kb.latest_plan.result == "completed"


def test_crashed_component_gets_its_configuration_again():
    kb, clock, managed, manager = start()
    kb.request_action("explore")
    turn(manager, clock, 2)
    managed.log.clear()
    managed.running.clear()
    managed.parameters.clear()
    kb.component_active("camera", False)
    (plan,) = turn(manager, clock, 3)
    assert plan.activate == ("camera",)
    assert managed.log == ["configure camera {'exposure': 0.01}", "activate camera"]
    assert managed.started_with == {"camera": {"exposure": 0.01}}


def ranked(priorities, always_improve=False):
    model = Model("ranked")
    fit = model.quality_attribute("fit")
    see = model.function("see", always_improve=always_improve)
    for name, priority in priorities.items():
        component = model.component(f"part of {name}", kind="process")
        see.design(name, [component], priority=priority).constrain(fit >= 0.0)
    model.action("look", requires=[see])
    return model


@pytest.mark.parametrize(
    ("priorities", "best"),
    [
        ({"a": 2, "b": 1}, "b"),
        ({"a": None, "b": 1000}, "b"),
        ({"b": None, "a": None}, "a"),
        ({"b": 1, "a": 1, "c": 0}, "c"),
        ({"b": 1, "a": 1, "c": 2}, "a"),
        ({"a": 0, "b": -3}, "b"),
        ({"a": 0.5, "b": 0.25}, "b"),
        ({"a": -1.5, "b": -1}, "a"),
    ],
)
def test_best_priority_is_taken_none_last_and_ties_by_name(priorities, best):
    kb, clock, _, manager = start(ranked(priorities))
    kb.request_action("look")
    turn(manager, clock, 2)
    assert [design.name for design in kb.designs.values() if design.is_selected] == [best]


# stages can be replaced


class LastByName:
    """A planner that has its own taste."""

    def plan(self, kb):
        designs = {name: max(kb.selectable_designs(name)) for name in kb.adaptable_functions()}
        configurations = {
            name: max(kb.selectable_configurations(name))
            for name in kb.adaptable_components(designs.values())
            if kb.selectable_configurations(name)
        }
        return kb.select(designs, configurations) if designs or configurations else None


def test_a_planner_of_ones_own_replaces_the_stock_one():
    kb, clock, managed, manager = start(planner=LastByName())
    kb.request_action("explore")
    turn(manager, clock, 3)
    assert managed.running == {"lidar"}


# objects of this process


# laws

OUTCOMES = st.sampled_from((None, 0.0, 1.0, 3.0, Broken("at once"), (1.0, Broken("later"))))


def live_through(model, data, ending):
    """Let random things happen to a random robot under the loop.

    Each command ends as `ending` says at last.
    """
    kb, clock = base(model)
    lines = [
        f"{verb} {name}"
        for verb in ("activate", "deactivate", "configure")
        for name in model.components
    ]
    script = {
        line: [*data.draw(st.lists(OUTCOMES, max_size=4)), data.draw(ending)] for line in lines
    }
    managed = Scripted(clock, script)
    manager = ConfigurationManager(kb, managed)

    def watch(event):
        if event.kind is EventKind.RECONFIGURATION_PLAN:
            for name in event.plan.parameters:
                assert kb.configurations[name].status is not Status.UNFEASIBLE
            for design in kb.designs.values():
                assert design.is_selected <= (
                    design.name in selected or design.status is not Status.UNFEASIBLE
                )

    kb.subscribe(watch)
    for event in data.draw(
        st.lists(events(model, asserting=False, selecting=False), min_size=5, max_size=15)
    ):
        clock.now += 1.0
        happen(kb, event)
        pending = kb.pending_plan
        selected = {design.name for design in kb.designs.values() if design.is_selected}
        plan = manager.update()
        assert plan is None or pending is None
    selected = set(model.designs)
    come_to_rest(manager, kb, clock)
    assert all(plan.result in ("completed", "failed") for plan in kb.plans)
    assert {model.components[name].kind for name in managed.running} <= {"process", "lifecycle"}


in_life = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


PASSING = (None, 1.0)
LASTING = (None, Broken("for ever"), (1.0, Broken("for ever")))


@settings(in_life, phases=[Phase.generate])
@given(models(), st.data(), st.sampled_from((PASSING, LASTING)))
def test_loop_comes_to_rest_after_any_trouble(model, data, endings):
    live_through(model, data, st.sampled_from(endings))


@in_life
@given(models(), st.data(), st.sampled_from((None, 0.0, 2.0)))
def test_obedient_system_ends_as_the_kb_says(model, data, lasts):
    twins = Twins(model)
    kb = twins.kb
    clock = twins.clock
    managed = Scripted(clock, default=lasts)
    manager = ConfigurationManager(kb, managed)
    things = events(model, asserting=False, selecting=False).filter(
        lambda event: event[0] != "active"
    )
    for event in data.draw(st.lists(things, min_size=5, max_size=15)):
        twins.happen(event)
        manager.update()
    come_to_rest(manager, kb, clock)
    commanded = {
        component.name
        for component in kb.components.values()
        if component.is_active and component.kind != "plain"
    }
    assert managed.running == commanded
    for component in kb.components.values():
        if component.is_active and component.selected_configuration is not None:
            parameters = kb.configurations[component.selected_configuration].parameters
            assert managed.parameters[component.name] == parameters
            assert component.parameters_in_force == parameters
        assert component.status not in (Status.UNSOLVED, Status.CONFIGURATION_ERROR) or any(
            kb.functions[kb.designs[name].function].status is Status.UNFEASIBLE
            for name in kb.designs
            if component.name in kb.designs[name].components
        )
    for name in managed.started_with:
        assert model.components[name].kind != "plain"


def test_component_given_up_by_a_plan_is_not_started_again():
    kb, clock, managed, manager = start(rover(stops_to_configure=True))
    kb.request_action("explore")
    turn(manager, clock, 2)
    managed.log.clear()
    plan = kb.select({"see": "by lidar"}, {"camera": "night"})
    assert (set(plan.deactivate), plan.parameters) == ({"camera", "lamp"}, ("night",))
    turn(manager, clock, 3)
    assert plan.result == "completed"
    assert managed.running == {"lidar"}
    assert "activate camera" not in managed.log


class Counting(PriorityPlanner):
    def __init__(self):
        self.asked = 0

    def plan(self, kb):
        self.asked += 1
        return super().plan(kb)


def test_planner_is_asked_only_after_a_change():
    planner = Counting()
    kb, clock, _, manager = start(planner=planner)
    kb.measure("light", 0.9)
    kb.request_action("explore")
    come_to_rest(manager, kb, clock)
    asked = planner.asked
    for value in (0.8, 0.7, 0.7):
        kb.measure("light", value)
        kb.component_active("camera", True)
        turn(manager, clock, 2)
    assert planner.asked == asked
    kb.measure("light", 0.1)
    turn(manager, clock)
    assert planner.asked > asked


def test_later_plan_does_what_an_earlier_one_left_open():
    model = Model("two plans")
    lamp = model.component("lamp", kind="lifecycle")
    for number in (1, 2):
        lamp.configuration(f"k{number}", {"power": number})
    horn = model.component("horn", kind="lifecycle")
    light = model.function("light")
    sound = model.function("sound")
    light.design("by lamp", [lamp])
    sound.design("by horn", [horn])
    model.action("shine", requires=[light])
    model.action("honk", requires=[sound])
    kb = KnowledgeBase(model, clock=Clock(0.0))

    class Robot:
        def activate(self, component):
            pass

        deactivate = activate

        def set_parameters(self, component, parameters):
            pass

    manager = ConfigurationManager(kb, Robot())
    kb.request_action("shine")
    manager.update()
    assert kb.components["lamp"].parameters_in_force == {"power": 1}
    first = kb.select({}, {"lamp": "k2"})
    kb.request_action("honk")
    second = kb.select({"sound": "by horn"})
    assert kb.history.open_plans == (first, second)
    manager.update()
    assert (first.result, second.result) == ("abandoned", "completed")
    assert kb.components["horn"].is_active
    assert kb.components["lamp"].parameters_in_force == {"power": 2}
