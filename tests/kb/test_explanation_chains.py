"""Chains of causes: what they name suffices, none of it is idle, and nothing is missing."""

from itertools import product

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from models import Clock, Twins, state_of, stories

from kb import KnowledgeBase, Model, Status
from kb.explain import Comparison, explain, why
from kb.status import STATUSES

SLOW = settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
BETTER = (
    Status.FAILURE,
    Status.UNFEASIBLE,
    Status.CONFIGURATION_ERROR,
    Status.IMPLICIT_CONFIGURATION_ERROR,
    Status.UNSOLVED,
    Status.SOLVED,
    Status.FEASIBLE,
)
"""Statuses, each better than those before it."""
WORKING = (Status.SOLVED, Status.FEASIBLE)


def after(story):
    model, happenings = story
    twins = Twins(model)
    for event in happenings:
        twins.happen(event)
    state = state_of(twins.kb)
    nodes = [
        node for node in state.network.present() if node.kind not in ("attribute", "constraint")
    ]
    assume(nodes)
    return state, nodes


def nodes_of(cause, whole):
    """The nodes that a cause may mean: a constraint is known by its text only."""
    if cause.kind == "constraint":
        return [one for one in whole.constraints if one.name == cause.name]
    return [
        one for one in (*whole.requires, whole) if (one.kind, one.name) == (cause.kind, cause.name)
    ]


def named(node, explanation):
    """Yield each node that is in the chain of one element, with how it is explained there."""
    yield node, explanation
    for cause in explanation.causes:
        for part in nodes_of(cause, node):
            yield from named(part, cause)


def disturbed(data, state, chain):
    """Return a state in which everything that a chain does not name is as it may be."""
    told = {node for node, _ in chain}
    attributes = {one.measurement.attribute for _, one in chain if one.measurement}
    overlay, network = state.copy(), state.network
    overlay.touch(network.present())
    for node in network.present():
        if node.kind == "attribute":
            if node.name not in attributes:
                value = data.draw(st.sampled_from((None, -0.5, 0.25, 0.75, 1.5)))
                overlay.value.pop(node, None)
                if value is not None:
                    overlay.value[node] = value
        elif node not in told:
            if node.kind == "component":
                is_failed = data.draw(st.booleans())
                (overlay.failed.add if is_failed else overlay.failed.discard)(node)
            status = data.draw(st.sampled_from((None, *STATUSES[node.kind])))
            overlay.asserted.pop(node, None)
            if status is not None:
                overlay.asserted[node] = status
    overlay.infer()
    return overlay


@SLOW
@given(stories(max_size=20), st.data())
def test_each_reason_by_itself_keeps_a_status_from_being_better(story, data):
    state, nodes = after(story)
    troubled = [node for node in nodes if state.status[node] not in WORKING]
    assume(troubled)
    node = data.draw(st.sampled_from(troubled))
    explanation = explain(state, node, 0.0)
    for reason in explanation.reasons or ((),):
        chain = [(node, explanation)] if not reason else []
        for cause in reason:
            for part in nodes_of(cause, node):
                chain += named(part, cause)
        other = disturbed(data, state, [*chain, (node, explanation)])
        assert BETTER.index(other.status[node]) <= BETTER.index(explanation.status)


@SLOW
@given(stories(max_size=20), st.data())
def test_what_works_keeps_working_while_what_it_follows_from_stays(story, data):
    state, nodes = after(story)
    assume(all(sum(part in state.selected for part in node.requires) < 2 for node in nodes))
    working = [node for node in nodes if state.status[node] in WORKING]
    assume(working)
    node = data.draw(st.sampled_from(working))
    explanation = explain(state, node, 0.0)
    chain = list(named(node, explanation))
    other = disturbed(data, state, chain)
    assert other.status[node] is explanation.status


@SLOW
@given(stories(max_size=20), st.integers(0, 5))
def test_without_one_cause_of_each_reason_the_status_is_better(story, number):
    state, nodes = after(story)
    for node in nodes:
        explanation = explain(state, node, 0.0)
        if explanation.status in WORKING or not explanation.reasons:
            continue
        overlay = state.copy()
        for reason in explanation.reasons:
            for part in nodes_of(reason[number % len(reason)], node):
                good = (Status.SATISFIED, Status.SOLVED, Status.FEASIBLE)
                overlay.asserted[part] = next(one for one in good if one in STATUSES[part.kind])
                overlay.touch([part])
        overlay.infer()
        assert BETTER.index(overlay.status[node]) > BETTER.index(explanation.status)


@SLOW
@given(stories(max_size=20))
def test_every_chain_ends_in_facts_as_words_and_as_data_and_why_is_its_sentence(story):
    state, nodes = after(story)
    for node in nodes:
        explanation = explain(state, node, 0.0)
        assert why(state, node, 0.0) == explanation.sentence
        for part, cause in named(node, explanation):
            assert cause.causes or cause.fact or cause.status is Status.FAILURE
            if cause.kind == "constraint":
                assert isinstance(cause.measurement, Comparison)
                assert cause.measurement.attribute in state.network.attributes
            else:
                assert cause.measurement is None
                assert cause.status is state.status[part]


@pytest.fixture
def kb():
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=5.0)
    camera = model.component("camera")
    camera.configuration("day", constraints=[light >= 0.5])
    camera.configuration("night")
    model.function("see").design("by camera", [camera])
    model.action("look", requires=["see"], constraints=[light <= 0.9])
    return KnowledgeBase(model, clock=Clock(50.0))


def leaves(explanation):
    if not explanation.causes:
        return [explanation]
    return [end for cause in explanation.causes for end in leaves(cause)]


def test_what_is_solved_is_followed_down_to_the_measurements(kb):
    kb.measure("light", 0.7)
    kb.request_action("look")
    kb.select({"see": "by camera"}, {"camera": "day"})
    kb.component_active("camera", True)
    explanation = kb.explain("look")
    assert (
        str(explanation)
        == "look is solved because it is required, and all that it needs is in place"
    )
    assert [end.fact for end in leaves(explanation)] == [
        "light 0.7 satisfies <= 0.9 (measured 0.0 s ago)",
        "light 0.7 satisfies >= 0.5 (measured 0.0 s ago)",
    ]
    assert leaves(explanation)[0].measurement == Comparison("light", "<=", 0.9, 0.7, 50.0, False)


def test_what_is_feasible_is_followed_down_a_way_that_is_possible(kb):
    kb.measure("light", 0.3)
    explanation = kb.explain("look")
    (reason,) = explanation.reasons
    assert [(cause.kind, cause.name) for cause in reason] == [
        ("constraint", "light <= 0.9"),
        ("function", "see"),
    ]
    assert [(end.kind, end.name) for end in leaves(explanation)] == [
        ("constraint", "light <= 0.9"),
        ("configuration", "night"),
    ]


def test_a_part_that_is_only_not_unfeasible_is_explained_as_that():
    model = Model("two")
    model.component("camera")
    model.function("see").design("by camera", ["camera"])
    model.action("look", requires=["see"])
    model.action("film", requires=["see"])
    kb = KnowledgeBase(model)
    kb.request_action("film")
    (see,) = kb.explain("look").causes
    assert see.status is Status.UNSOLVED
    assert see.sentence == "see is not unfeasible because it has a design that is not unfeasible"
    (see,) = kb.explain("film").causes
    assert see.sentence == "see is unsolved because none of its designs is selected"


def test_reasons_that_suffice_by_themselves_are_told_apart_from_those_that_only_count_together():
    model = Model("reasons")
    light = model.environmental_attribute("light")
    camera = model.component("camera", constraints=[light >= 0.1])
    camera.configuration("day", constraints=[light >= 0.5])
    camera.configuration("night", constraints=[light >= 0.2])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.0)
    explanation = kb.explain("camera")
    assert [[cause.name for cause in reason] for reason in explanation.reasons] == [
        ["light >= 0.1"],
        ["day", "night"],
    ]
    age = "(measured 0.0 s ago)"
    assert explanation.sentence == (
        f"camera is unfeasible because light 0 violates >= 0.1 {age}; also configuration day is unfeasible because "
        f"light 0 violates >= 0.5 {age} and configuration night is unfeasible because light 0 violates >= 0.2 {age}"
    )


def test_configurations_are_no_reason_while_one_of_them_is_possible():
    model = Model("reasons")
    light = model.environmental_attribute("light")
    camera = model.component("camera", constraints=[light >= 0.1])
    camera.configuration("day", constraints=[light >= 0.5])
    camera.configuration("night")
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.0)
    assert [cause.name for cause in kb.explain("camera").causes] == ["light >= 0.1"]


def test_only_the_selected_design_explains_an_error_of_its_function():
    model = Model("error")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", constraints=[light >= 0.5])
    camera.configuration("night")
    see = model.function("see")
    see.design("by camera", [camera])
    see.design("by lidar", [])
    model.action("look", requires=[see])
    kb = KnowledgeBase(model, clock=Clock())
    kb.request_action("look")
    kb.select({"see": "by camera"}, {"camera": "day"})
    kb.measure("light", 0.1)
    kb.assert_status(kb.designs["by lidar"], "implicit configuration error")
    explanation = kb.explain("see")
    assert explanation.status is Status.IMPLICIT_CONFIGURATION_ERROR
    assert [cause.name for cause in explanation.causes] == ["by camera"]


def test_a_stale_measurement_is_told_with_its_age(kb):
    kb.measure("light", 0.95)
    assert "light 0.95 violates <= 0.9" in kb.explain("look").sentence
    kb._clock.now += 12.0
    (constraint,) = kb.actions["look"].constraints
    assert str(kb.explain(constraint)) == "light 0.95 is stale: measured 12.0 s ago, at most 5 s"
    assert kb.explain(constraint).measurement.is_stale
    assert kb.explain(constraint).status is Status.NOT_EVALUATED


@pytest.mark.parametrize(("causes", "count"), list(product(range(1, 9), (True, False))))
def test_causes_that_are_too_many_to_tell_are_counted(causes, count):
    model = Model("many")
    for number in range(causes):
        model.component(f"c{number}")
    together = model.function("see")
    if count:
        together.design("by all", list(model.components))
    else:
        for name in model.components:
            together.design(f"by {name}", [name])
    kb = KnowledgeBase(model)
    for name in model.components:
        kb.component_failed(name)
    explained = kb.explain(kb.designs["by all"] if count else kb.functions["see"])
    text = explained.sentence
    assert len(explained.causes) == causes
    assert text.count("has failed") == (causes if causes <= 4 else 3)
    assert text.endswith(f"{'; also' if count else ' and'} {causes - 3} more") is (causes > 4)


def test_what_many_elements_share_is_explained_once():
    model = Model("shared")
    model.component("driver")
    for number in range(30):
        for one in range(30):
            design = f"design {number}.{one}"
            model.function(f"function {number}") if one == 0 else None
            model.functions[f"function {number}"].design(design, ["driver"])
    model.action("all", requires=list(model.functions))
    kb = KnowledgeBase(model)
    kb.component_failed("driver")
    explanation = kb.explain("all")
    drivers = {
        id(design.causes[0]) for function in explanation.causes for design in function.causes
    }
    assert len(drivers) == 1
    assert [str(remedy) for remedy in explanation.remedies] == ["driver recovered"]
