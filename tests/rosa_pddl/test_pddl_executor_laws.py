"""Whatever happens, in whatever order: no tick raises, nothing unfeasible runs on, and the goal is reached at last."""

from itertools import pairwise

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pddl_world import World
from py_trees.common import Status

from rosa_pddl import Planner, ReplanningPolicy

ACTIONS = ("search_pipeline", "inspect_pipeline", "recharge")
EVENTS = st.one_of(
    st.tuples(st.just("feasible"), st.sets(st.sampled_from(ACTIONS))),
    st.tuples(
        st.just("sense"),
        st.tuples(
            st.sampled_from(["(pipeline_found pipeline)", "(recharged bluerov)"]), st.booleans()
        ),
    ),
    st.tuples(
        st.just("end"),
        st.tuples(st.sampled_from(ACTIONS), st.sampled_from([Status.FAILURE, ValueError("odd")])),
    ),
    st.tuples(
        st.just("add"), st.sampled_from(["(recharged bluerov)", "(not (recharged bluerov))"])
    ),
    st.tuples(
        st.just("soft"), st.sampled_from(["(recharged bluerov)", "(pipeline_found pipeline)"])
    ),
    st.tuples(
        st.just("replace"),
        st.sampled_from(["(pipeline_found pipeline)", "(pipeline_inspected pipeline)"]),
    ),
    st.tuples(st.just("interrupt"), st.none()),
    st.tuples(st.just("wait"), st.integers(1, 6)),
)
POLICIES = st.builds(ReplanningPolicy, at_most_every_s=st.sampled_from([0.0, 0.2, 0.5]))
PLANNER = Planner()


def happen(world, kind, what):
    goals = world.executor.goals
    if kind == "feasible":
        world.kb.unfeasible = set(ACTIONS) - what
    elif kind == "sense":
        world.facts = {what[0]: what[1]}
    elif kind == "end":
        world.events[what[0]] = what[1]
    elif kind == "add":
        goals.add(what)
    elif kind == "soft":
        goals.add(what, worth=1.5)
    elif kind == "replace":
        goals.replace(what)
    elif kind == "interrupt":
        world.executor.stop(Status.INVALID)


def check(world):
    executor = world.executor
    names = [child.name for child in executor.children]
    assert names == [str(step) for step in executor.current_steps]
    assert all(
        child.status is Status.RUNNING and child.parent is executor for child in executor.children
    )
    assert not executor.children or executor.status is Status.RUNNING
    asked = [record.at_s for record in executor.plans]
    assert all(
        later - before >= executor._policy.at_most_every_s - 1e-9
        for before, later in pairwise(asked)
    )
    begun = sum(what == "begins" for _, _, what in world.log)
    assert begun - len(executor.current_steps) == sum(what != "begins" for _, _, what in world.log)


def run(extended, policy, events):
    world = World(extended, PLANNER, policy=policy)
    world.ticks = {"search_pipeline": 4, "recharge": 2, "inspect_pipeline": 3}
    for kind, what in events:
        happen(world, kind, what)
        for _ in range(what if kind == "wait" else 1):
            world.tick()
            check(world)
            running = [step.action for step in world.executor.current_steps]
            assert not world.kb.unfeasible & set(running)
    world.kb.unfeasible = set()
    world.facts = {}
    world.events = {}
    world.executor.goals.replace("(and (recharged bluerov) (pipeline_inspected pipeline))")
    assert world.run() is Status.SUCCESS
    check(world)
    return world


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(policy=POLICIES, events=st.lists(EVENTS, max_size=12))
def test_whatever_happens_the_goal_is_reached_once_it_can_be(extended, policy, events):
    run(extended, policy, events)


@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(policy=POLICIES, events=st.lists(EVENTS, max_size=12))
def test_the_same_events_lead_to_the_same_steps_and_plans(extended, policy, events):
    first = run(extended, policy, events)
    second = run(extended, policy, events)
    assert (first.log, first.executor.plans) == (second.log, second.executor.plans)
