"""Laws of inference: the quick engine against a twin that recomputes everything from the facts."""

import collections

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from models import Twins, events, stories, subsets

from kb import KnowledgeBase, Model, Status

slow_to_generate = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


@slow_to_generate
@given(stories(), st.data())
def test_adaptable_components_are_those_after_the_chosen_designs(story, data):
    model, happenings = story
    twins = Twins(model, happenings)
    before = twins.statuses()
    for _ in range(3):
        chosen = {
            model.designs[name].function: name for name in data.draw(subsets(list(model.designs)))
        }
        supposed = twins.kb.adaptable_components(designs=chosen.values())
        assert set(supposed) == twins.naive.adaptable_components(chosen.values())
    assert twins.statuses() == before
    twins.agree()


@slow_to_generate
@given(stories(), st.data())
def test_event_lists_exactly_the_statuses_that_changed(story, data):
    model, happenings = story
    twins = Twins(model, happenings)
    told = []
    twins.kb.subscribe(told.append)
    kinds = {"function design": "design"}
    for event in data.draw(st.lists(events(model, selecting=False), max_size=6)):
        before = twins.statuses()
        told.clear()
        twins.happen(event)
        after = twins.statuses()
        expected = {
            (kind, name, before[kind, name], after[kind, name])
            for kind, name in before
            if kind != "constraint" and before[kind, name] is not after[kind, name]
        }
        assert len(told) <= 1
        changes = [change for one in told for change in one.changes if change.kind != "constraint"]
        assert collections.Counter(
            (kinds.get(change.kind, change.kind), *change[1:]) for change in changes
        ) == dict.fromkeys(expected, 1)


def test_ten_thousand_elements_are_inferred():
    model = Model("large")
    light = model.environmental_attribute("light")
    functions = []
    for number in range(1500):
        component = model.component(f"component {number}")
        for name in ("a", "b"):
            component.configuration(
                f"{name} {number}", {"gain": number}, constraints=[light >= number / 1500]
            )
        functions.append(model.function(f"function {number}"))
        functions[-1].design(f"design {number}", [component])
    model.action("everything", requires=functions)
    model.action("one", requires=functions[:1])
    kb = KnowledgeBase(model)
    kb.measure("light", 0.5)
    assert not kb.is_feasible("everything")
    assert kb.is_feasible("one")
    assert (
        len(
            [function for function in kb.functions.values() if function.status is Status.UNFEASIBLE]
        )
        == 749
    )
    kb.measure("light", 1.0)
    assert kb.is_feasible("everything")
    assert kb.request_action("everything")
    assert len(kb.adaptable_functions()) == 1500
    plan = kb.select({f"function {number}": f"design {number}" for number in range(1500)})
    assert len(plan.activate) == 1500
    assert str(kb.explain(kb.actions["everything"]))
