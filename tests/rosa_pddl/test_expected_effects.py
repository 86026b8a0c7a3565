"""Expected effects that are unmet: a step that did not help is not relied upon until what is in the way has gone."""

from heapq import heappop, heappush
from itertools import product

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pddl_world import FakeKb, Task, World, load_text
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import Outcome, Planner, Problem, flaw, initial_state
from rosa_pddl.belief import ExpectedEffects
from rosa_pddl.validate import ended, missing_at_start, started

# Mending serves driving; there is a dear detour on foot if the problem has a path.
DOMAIN = """(define (domain roads) (:requirements :typing :durative-actions :action-costs)
  (:types action place tool)
  (:predicates (action_feasible ?a - action) (drive_action ?a - action) (walk_action ?a - action)
               (mend_action ?a - action) (at ?p - place) (path ?a ?b - place) (used ?t - tool))
  (:functions (total-cost) - number)
  (:durative-action drive
    :parameters (?a - action ?from ?to - place)
    :duration (= ?duration 3)
    :condition (and (over all (action_feasible ?a)) (over all (drive_action ?a)) (at start (at ?from)))
    :effect (and (at start (not (at ?from))) (at end (at ?to)) (at end (increase (total-cost) 1))))
  (:durative-action walk
    :parameters (?a - action ?from ?to - place)
    :duration (= ?duration 3)
    :condition (and (over all (walk_action ?a)) (at start (at ?from)) (at start (path ?from ?to)))
    :effect (and (at start (not (at ?from))) (at end (at ?to)) (at end (increase (total-cost) 20))))
  (:durative-action mend
    :parameters (?a ?b - action ?t - tool)
    :duration (= ?duration 3)
    :condition (and (over all (action_feasible ?a)) (over all (mend_action ?a)) (at start (drive_action ?b)))
    :effect (and (at end (used ?t)) (at end (action_feasible ?b)) (at end (increase (total-cost) 2)))))
"""
PROBLEM = """(define (problem p) (:domain roads)
  (:objects drive walk mend - action home goal - place {tools} - tool)
  (:init (drive_action drive) (walk_action walk) (mend_action mend) (at home) {path} (= (total-cost) 0))
  (:goal (at goal)) (:metric minimize (total-cost)))
"""
PLANNER = Planner()
COLD = Planner()


@pytest.fixture(scope="module")
def roads(tmp_path_factory):
    """Return the domain, by the tools that there are and by whether there is a path."""
    folder = tmp_path_factory.mktemp("roads")
    return {
        (tools, path): load_text(folder, DOMAIN, PROBLEM.format(tools=tools, path=path))
        for tools in ("jack", "glue jack")
        for path in ("", "(path home goal)")
    }


class Car(World):
    """Drives if there is no fog and no flat tyre; mending repairs the tyre."""

    def __init__(self, domain):
        super().__init__(domain, PLANNER, kb=self.known, task=Work)
        self.does_mend = True

    def known(self, _):
        model = Model("car")
        fog = model.environmental_attribute("fog")
        tyre = model.component("tyre")
        roll = model.function("roll")
        roll.design("by_tyre", [tyre])
        model.action("drive", requires=[roll], constraints=[fog <= 0.5])
        model.action("walk")
        model.action("mend")
        return KnowledgeBase(model, clock=lambda: self.now_s)

    def begun(self):
        return [name for _, name, what in self.log if what == "begins"]

    def reasons(self):
        return [record.reason for record in self.executor.plans]


class Work(Task):
    def terminate(self, new_status):
        super().terminate(new_status)
        if self.step.schema == "mend" and new_status is Status.SUCCESS and self.world.does_mend:
            self.world.kb.component_recovered("tyre")


EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("fog"), st.sampled_from([0.1, 0.7, 0.9])),
        st.tuples(st.just("tyre"), st.just(0)),
        st.tuples(st.just("wait"), st.integers(1, 9)),
    ),
    max_size=10,
)


def happen(car, event, value):
    if event == "fog":
        car.kb.measure("fog", value)
    elif event == "tyre":
        car.kb.component_failed("tyre")


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(events=EVENTS, does_mend=st.booleans(), tools=st.sampled_from(["jack", "glue jack"]))
def test_whatever_happens_nothing_is_tried_twice_while_the_same_is_in_the_way(
    roads, events, does_mend, tools
):
    car = Car(roads[tools, ""])
    car.does_mend = does_mend
    happen(car, "fog", 0.9)
    for event, value in events:
        happen(car, event, value)
        for _ in range(value if event == "wait" else 1):
            car.tick()
    # in fog, mending helps nothing: once with each tool between two clearings of the fog, or once
    # at all
    cleared = sum(event == "fog" and value < 0.5 for event, value in events)
    assert car.begun().count("mend") <= (cleared + 1) * len(tools.split())


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(events=EVENTS)
def test_whatever_happened_the_goal_is_reached_once_mending_is_all_it_takes(roads, events):
    car = Car(roads["jack", ""])
    happen(car, "fog", 0.9)
    for event, value in events:
        happen(car, event, value)
        for _ in range(value if event == "wait" else 1):
            if car.tick() is Status.SUCCESS:
                return
    happen(car, "tyre", 0)
    car.tick()
    happen(car, "fog", 0.1)
    for _ in range(3):
        if car.run() is Status.SUCCESS:
            return
    raise AssertionError((car.log, car.executor.feedback_message))


def test_what_did_not_help_is_not_repeated_when_there_is_a_detour(roads):
    car = Car(roads["jack", "(path home goal)"])
    happen(car, "fog", 0.9)
    happen(car, "tyre", 0)
    assert car.run() is Status.SUCCESS
    assert car.begun() == ["mend", "walk"]
    assert car.reasons() == [
        "start",
        "mend(mend, drive, jack) did not make drive feasible: "
        "drive is unfeasible because fog 0.9 violates <= 0.5 (measured 0.4 s ago)",
    ]


def test_another_tool_may_help_where_one_did_not(roads):
    car = Car(roads["glue jack", ""])
    car.does_mend = False
    happen(car, "tyre", 0)
    car.run(until="mend")
    while len(car.begun()) < 2:
        car.tick()
    car.does_mend = True
    assert car.run() is Status.SUCCESS
    assert car.begun() == ["mend", "mend", "drive"]
    tools = [record.steps[0].arguments[-1] for record in car.executor.plans]
    assert sorted(tools) == ["glue", "jack"]


def test_without_another_plan_it_fails_and_says_what_did_not_help_until_that_has_changed(roads):
    car = Car(roads["jack", ""])
    happen(car, "fog", 0.9)
    happen(car, "tyre", 0)
    assert car.run() is Status.FAILURE
    said = car.executor.feedback_message
    assert "unsolvable proven" in said
    assert (
        "mend(mend, drive, jack) did not make drive feasible: drive is unfeasible because fog 0.9"
        in said
    )
    happen(car, "tyre", 0)  # mended in fog, it is flat again; that is no reason to mend in fog
    happen(car, "fog", 0.8)
    assert [car.tick() for _ in range(9)] == [Status.FAILURE] * 9
    assert car.executor.feedback_message == said
    happen(car, "fog", 0.1)  # drive is as unfeasible as before, but for the tyre only
    assert car.run() is Status.SUCCESS
    assert car.begun() == ["mend", "mend", "drive"]
    assert car.reasons()[-1] == "the state changed"


def test_news_that_comes_later_than_the_end_of_the_step_counts(roads):
    car = Car(roads["jack", ""])
    car.does_mend = False
    happen(car, "tyre", 0)
    while ("mend", "SUCCESS") not in [entry[1:] for entry in car.log]:
        car.tick()
    car.kb.component_recovered("tyre")
    assert car.run() is Status.SUCCESS
    assert car.begun() == ["mend", "drive"]


def test_what_else_a_doubted_step_brings_about_is_still_planned_for(roads):
    car = Car(roads["jack", ""])
    happen(car, "fog", 0.9)
    assert car.run() is Status.FAILURE
    car.executor.goals.replace("(used jack)")
    car.facts = {"(used jack)": False}
    car.tick()
    car.facts = {}
    assert car.run() is Status.SUCCESS
    assert car.begun() == ["mend", "mend"]


def test_a_kb_that_does_not_explain_itself_is_believed_about_feasibility(roads):
    world = World(roads["jack", ""], PLANNER)
    world.kb.unfeasible = {"drive"}
    assert world.run() is Status.FAILURE
    assert world.executor.feedback_message.endswith(
        "mend(mend, drive, jack) did not make drive feasible: drive is unfeasible"
    )
    world.kb.unfeasible = set()
    assert world.run() is Status.SUCCESS


# ------------------------------------------------------------------ the domain without what is in doubt


def test_nothing_but_the_step_that_did_not_help_is_not_relied_upon(roads):
    domain = roads["glue jack", ""]
    kb = FakeKb(domain.rosa_actions)
    kb.unfeasible = {"drive"}
    effects = ExpectedEffects(domain, kb)
    state = initial_state(domain) | {"(action_feasible mend)", "(action_feasible walk)"}
    planner = Planner()
    for tool in ("glue", "jack"):
        result = planner.plan(Problem(effects.domain, state))
        assert result.engine == "search"
        assert flaw(effects.domain, result.steps, state) is None
        (unmet,) = effects.ended(domain.step("mend", ("mend", "drive", tool)), state)
        assert (unmet.action, effects.domain) == ("drive", effects.domain)
        assert tool not in [
            step.arguments[-1] for step in planner.plan(Problem(effects.domain, state)).steps
        ]
    assert planner.plan(Problem(effects.domain, state)).outcome is Outcome.UNSOLVABLE_PROVEN
    assert planner.plan(Problem(domain, state)).outcome is Outcome.SOLVED_OPTIMALLY
    kb.unfeasible = set()
    effects.update()
    assert (effects.domain, effects.unmet) == (domain, ())


def cheapest(domain, state, doubted):
    """Return what the goal costs if doubted steps do not make drive feasible, by trying all.

    None if it cannot be.
    """
    steps = [
        domain.step(schema.name, words)
        for schema in domain.schema_of.values()
        for words in product(*(domain.objects_of(kind) for _, kind in schema.parameters))
    ]
    price = {"mend": 2.0, "drive": 1.0, "walk": 20.0}
    best = {}
    queue = [(0.0, sorted(state))]
    while queue:
        cost, facts = heappop(queue)
        now = frozenset(facts)
        if now in best:
            continue
        best[now] = cost
        if "(at goal)" in now:
            return cost
        for step in steps:
            if missing_at_start(domain, step, now) is None:
                after = ended(domain, step, started(domain, step, now))
                if step in doubted and "(action_feasible drive)" not in now:
                    after -= {"(action_feasible drive)"}
                heappush(queue, (cost + price[step.schema], sorted(after)))
    return None


FACTS = (
    "(action_feasible drive)",
    "(action_feasible mend)",
    "(path home goal)",
    "(drive_action mend)",
    "(used jack)",
)


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    tools=st.sets(st.sampled_from(["glue", "jack"])),
    facts=st.sets(st.sampled_from(FACTS)),
)
def test_plans_without_what_is_in_doubt_are_the_cheapest_that_do_without_it(roads, tools, facts):
    domain = roads["glue jack", ""]
    doubted = [domain.step("mend", ("mend", "drive", tool)) for tool in sorted(tools)]
    state = initial_state(domain) | facts
    kb = FakeKb(domain.rosa_actions)
    kb.unfeasible = {"drive"}
    effects = ExpectedEffects(domain, kb)
    for step in doubted:
        effects.ended(step, state)
    result = PLANNER.plan(Problem(effects.domain, state))
    assert result.cost == cheapest(domain, state, doubted)
    assert result.outcome in (Outcome.SOLVED_OPTIMALLY, Outcome.UNSOLVABLE_PROVEN)
