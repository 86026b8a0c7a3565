"""What is known is a function of the facts and their times: asked or not in between, told again or not."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st
from kept import answers
from models import Clock

from kb import Event, KnowledgeBase, Model, PriorityPlanner

PAUSES = st.sampled_from((0.0, 0.25, 0.5, 1.0, 2.0, 7.0))
VALUES = st.sampled_from((0.0, 0.4, 0.5, 0.55, 0.6, 0.9))


def robot(dwell, agreement, max_age, when_stale):
    model = Model("robot")
    light = model.environmental_attribute(
        "light", agreement=agreement, max_age=max_age, when_stale=when_stale
    )
    heat = model.quality_attribute("heat", max_age=3.0)
    camera = model.component("camera", always_improve=True)
    camera.configuration(
        "day", priority=1, constraints=[(light >= 0.5).steady(hysteresis=0.1, dwell=dwell)]
    )
    camera.configuration("night", priority=2, constraints=[(heat <= 0.8).steady(dwell=1.0)])
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see], constraints=[heat <= 0.6])
    return model


FACTS = st.one_of(
    st.tuples(st.just("measure"), st.sampled_from(("light", "heat")), VALUES),
    st.tuples(st.just("measure"), st.just("light"), VALUES),
    st.tuples(st.just("component_failed"), st.just("camera")),
    st.tuples(st.just("component_recovered"), st.just("camera")),
    st.tuples(st.just("component_active"), st.just("camera"), st.booleans()),
    st.tuples(st.just("request_action"), st.just("explore")),
    st.tuples(st.just("cancel_action"), st.just("explore")),
    st.tuples(st.just("plan")),
    st.tuples(st.just("assert_for"), st.sampled_from((0.5, 1.5, 4.0))),
    st.tuples(st.just("threshold"), VALUES),
    st.tuples(st.just("max_age"), st.sampled_from((0.5, 2.0))),
    st.tuples(st.just("extend"), VALUES),
)
QUESTIONS = (
    lambda kb: kb.is_feasible("explore"),
    lambda kb: kb.revision,
    lambda kb: kb.explain("explore"),
    lambda kb: kb.situation(light=0.2).is_feasible("explore"),
    lambda kb: [configuration.status for configuration in kb.configurations.values()],
    lambda kb: kb.adaptable_components(),
    lambda kb: kb.best_configuration("explore"),
    lambda kb: kb.attributes["light"].history,
    lambda kb: list(kb.log),
)
STORIES = st.lists(
    st.tuples(PAUSES, FACTS, st.lists(st.tuples(PAUSES, st.sampled_from(QUESTIONS)))), max_size=30
)


def tell(kb, clock, fact):
    verb, *arguments = fact
    if verb == "plan":
        plan = PriorityPlanner().plan(kb)
        if plan:
            kb.finish_plan(plan, "completed")
    elif verb == "assert_for":
        kb.assert_status("camera", "failure", until=clock.now + arguments[0])
    elif verb == "threshold":
        kb.model.change(kb.model.constraints[0], value=arguments[0])
    elif verb == "max_age":
        kb.model.change("light", max_age=arguments[0])
    elif verb == "extend":
        light = kb.model.attributes["light"]
        kb.model.action(
            f"film {len(kb.actions)}", constraints=[(light >= arguments[0]).steady(dwell=1.0)]
        )
    else:
        getattr(kb, verb)(*arguments)


def through_json(event):
    return Event.from_json(json.loads(json.dumps(event.to_json())))


def known(kb):
    log = [one._replace(plan=None) for one in kb.log]
    return answers(kb), log, kb.revision


SETTINGS = st.tuples(
    st.sampled_from((0.0, 1.0, 2.5)),
    st.sampled_from(((1, 1), (2, 2), (2, 3))),
    st.sampled_from((1.0, 2.5, float("inf"))),
    st.sampled_from(("not evaluated", "violated")),
)


@settings(max_examples=40)
@given(SETTINGS, STORIES)
def test_replayed_log_with_amendments_gives_the_same(given_settings, story):
    clock, again = Clock(0.0), Clock(0.0)
    kb = KnowledgeBase(robot(*given_settings), clock=clock)
    for pause, fact, _ in story:
        clock.now += pause
        tell(kb, clock, fact)
    twin = KnowledgeBase(robot(*given_settings), clock=again)
    for event in kb.log:
        again.now = event.time
        twin.replay(through_json(event))
    again.now = clock.now
    assert known(twin) == known(kb)
    assert twin.model == kb.model


def test_recovery_after_a_lapse_is_no_news():
    clock = Clock(0.0)
    kb = KnowledgeBase(robot(0.0, (1, 1), 1.0, "violated"), clock=clock)
    kb.assert_status("camera", "failure", until=5.0)
    clock.now = 10.0
    kb.component_recovered("camera")
    assert [one.verb for one in kb.log] == ["assert_status", "lapse"]
