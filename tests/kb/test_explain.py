"""Explanations: sentences that a person reads, and causes that suffice and are not idle."""

import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from models import Clock, Twins, compare, state_of, stories

from kb import KnowledgeBase, Model, Status, UnknownName
from kb.explain import explain, explain_choice, shortest, why
from kb.planning import by_priority
from kb.status import STATUSES

SLOW = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)
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
GOOD = (Status.SATISFIED, Status.SOLVED, Status.FEASIBLE)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)


def state_after(story):
    model, events = story
    twins = Twins(model, events)
    return state_of(twins.kb)


def statused(state):
    return [
        node for node in state.network.present() if node.kind not in ("attribute", "constraint")
    ]


def nodes_of(cause, owner):
    """Return the nodes that a cause may mean: a constraint is known by its text only."""
    if cause.kind == "constraint":
        return [node for node in owner.constraints if node.name == cause.name]
    names = (cause.kind, cause.name)
    return [node for node in (*owner.requires, owner) if (node.kind, node.name) == names]


def chain_of(node, explanation):
    """Yield each node in the chain of one element, with how it is explained there."""
    yield node, explanation
    for cause in explanation.causes:
        for part in nodes_of(cause, node):
            yield from chain_of(part, cause)


def disturbed(data, state, chain):
    """Return a state in which everything that a chain does not name is as it may be."""
    named = {node for node, _ in chain}
    compared = {node.requires[0] for node in named if node.kind == "constraint"}
    other = state.copy()
    other.touch(state.network.present())
    for node in state.network.present():
        if node.kind == "attribute":
            if node not in compared:
                value = data.draw(st.sampled_from((None, -0.5, 0.25, 0.75, 1.5)))
                other.value.pop(node, None)
                if value is not None:
                    other.value[node] = value
        elif node not in named:
            if node.kind == "component":
                is_failed = data.draw(st.booleans())
                (other.failed.add if is_failed else other.failed.discard)(node)
            status = data.draw(st.sampled_from((None, *STATUSES[node.kind])))
            other.asserted.pop(node, None)
            if status is not None:
                other.asserted[node] = status
    other.infer()
    return other


@SLOW
@given(stories(max_size=20), st.data())
def test_each_reason_alone_keeps_a_status_from_being_better(story, data):
    state = state_after(story)
    troubled = [node for node in statused(state) if state.status[node] not in GOOD]
    assume(troubled)
    node = data.draw(st.sampled_from(troubled))
    explanation = explain(state, node, 0.0)
    for reason in explanation.reasons or ((),):
        chain = [(node, explanation)]
        for cause in reason:
            for part in nodes_of(cause, node):
                chain += chain_of(part, cause)
        status = disturbed(data, state, chain).status[node]
        assert BETTER.index(status) <= BETTER.index(explanation.status)


@SLOW
@given(stories(max_size=20), st.integers(0, 5))
def test_no_cause_is_idle_and_each_chain_ends_in_facts(story, number):
    state = state_after(story)
    for node in statused(state):
        explanation = explain(state, node, 0.0)
        assert why(state, node, 0.0) == explanation.sentence
        for part, cause in chain_of(node, explanation):
            assert cause.causes or cause.fact or cause.status is Status.FAILURE
            assert cause.status is state.status[part]
        other = state.copy()
        for reason in explanation.reasons:
            for part in nodes_of(reason[number % len(reason)], node):
                good = [status for status in GOOD if status in STATUSES[part.kind]]
                other.asserted[part] = good[0]
                other.touch([part])
        other.infer()
        if explanation.reasons:
            assert BETTER.index(other.status[node]) > BETTER.index(explanation.status)


# -------------------------------------------------------------------- sentences


@pytest.fixture
def clock():
    return Clock(50.0)


@pytest.fixture
def kb(clock):
    model = Model("rover")
    light = model.environmental_attribute("light", max_age=20.0)
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 0.01}, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, constraints=[light >= 0.1])
    see = model.function("see")
    see.design("by camera", [camera])
    model.function("dream")
    model.action("explore", requires=[see], constraints=[light >= 0.25])
    model.action("look", requires=[see])
    model.action("imagine", requires=["dream"])
    return KnowledgeBase(model, clock=clock)


def measured(value, age=0.0):
    def tell(kb):
        kb.measure("light", value)
        kb._clock.now += age

    return tell


def required(kb):
    kb.request_action("look")


def selected(kb):
    required(kb)
    kb.select({"see": "by camera"})


def active(kb):
    selected(kb)
    kb.component_active("camera", True)


def working(kb):
    active(kb)
    kb.select({}, {"camera": "day"})


def dark(kb):
    working(kb)
    kb.measure("light", 0.3)


def failed(kb):
    kb.component_failed("camera")


def asserted(kb):
    kb.assert_status(kb.functions["see"], "unfeasible")


DAY = "configuration day is unfeasible because light {} violates >= 0.5 (measured {} s ago)"
NIGHT = "configuration night is unfeasible because light 0.05 violates >= 0.1 (measured 2.5 s ago)"


@pytest.mark.parametrize(
    ("tell", "kind", "name", "sentence"),
    [
        (
            measured(0.24, 1.0),
            "actions",
            "explore",
            "explore is unfeasible because light 0.24 violates >= 0.25 (measured 1.0 s ago)",
        ),
        (
            measured(0.05, 2.5),
            "components",
            "camera",
            f"camera is unfeasible because {DAY.format(0.05, 2.5)} and {NIGHT}",
        ),
        (
            failed,
            "actions",
            "look",
            "look is unfeasible because function see is unfeasible because function design by "
            "camera is unfeasible because component camera has failed",
        ),
        (
            required,
            "actions",
            "imagine",
            "imagine is unfeasible because function dream is unfeasible because it has no design",
        ),
        (
            required,
            "actions",
            "look",
            "look is unsolved because function see is unsolved because none of its designs is "
            "selected",
        ),
        (
            selected,
            "functions",
            "see",
            "see is unsolved because function design by camera is unsolved because component "
            "camera is unsolved because it is required and not active",
        ),
        (
            active,
            "components",
            "camera",
            "camera is unsolved because none of its configurations is selected",
        ),
        (
            working,
            "actions",
            "look",
            "look is solved because it is required, and all that it needs is in place",
        ),
        (
            dark,
            "actions",
            "look",
            "look is in implicit configuration error because function see is in implicit "
            "configuration error because function design by camera is in implicit configuration "
            "error because component camera is in configuration error because "
            + DAY.format(0.3, "0.0"),
        ),
        (
            asserted,
            "actions",
            "look",
            "look is unfeasible because function see is unfeasible because it is asserted so",
        ),
        (failed, "components", "camera", "camera has failed"),
        (
            measured(0.3),
            "actions",
            "look",
            "look is feasible because none of its constraints is violated and none of its "
            "functions is unfeasible",
        ),
        (
            measured(0.7, 30.0),
            "attributes",
            "light",
            "light 0.7 is stale: measured 30.0 s ago, at most 20 s",
        ),
    ],
)
def test_status_reads_as_a_sentence(kb, tell, kind, name, sentence):
    tell(kb)
    assert kb.why(getattr(kb, kind)[name]) == sentence


def test_whole_text_ends_with_what_would_help(kb):
    kb.component_failed("camera")
    words = "; it would be feasible with camera recovered"
    assert str(kb.explain("look")) == kb.why("look") + words
    assert str(kb.explain(kb.components["camera"])) == f"camera has failed{words}"
    assert str(kb.explain("explore")).endswith(words)


def test_reasons_that_suffice_alone_are_apart_from_joint_ones():
    model = Model("reasons")
    light = model.environmental_attribute("light")
    camera = model.component("camera", constraints=[light >= 0.1])
    camera.configuration("day", constraints=[light >= 0.5])
    camera.configuration("night", constraints=[light >= 0.2])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.0)
    explanation = kb.explain("camera")
    names = [[cause.name for cause in reason] for reason in explanation.reasons]
    assert names == [["light >= 0.1"], ["day", "night"]]
    age = "(measured 0.0 s ago)"
    assert explanation.sentence == (
        f"camera is unfeasible because light 0 violates >= 0.1 {age}; also configuration day is "
        f"unfeasible because light 0 violates >= 0.5 {age} and configuration night is unfeasible "
        f"because light 0 violates >= 0.2 {age}"
    )


@pytest.mark.parametrize("causes", [1, 4, 5, 8])
@pytest.mark.parametrize("is_joint", [True, False])
def test_too_many_causes_are_counted(causes, is_joint):
    model = Model("many")
    names = [model.component(f"c{number}").name for number in range(causes)]
    see = model.function("see")
    for name in [] if is_joint else [*names]:
        see.design(f"by {name}", [name])
    if not is_joint:
        node = "see"
        word = " and"
    else:
        see.design("by all", names)
        node = "by all"
        word = "; also"
    kb = KnowledgeBase(model)
    for name in names:
        kb.component_failed(name)
    explanation = kb.explain(node)
    text = explanation.sentence
    assert len(explanation.causes) == causes
    assert text.count("has failed") == (causes if causes <= 4 else 3)
    assert text.endswith(f"{word} {causes - 3} more") is (causes > 4)


def test_shared_fault_is_explained_once_and_in_short():
    model = Model("shared")
    model.component("driver")
    for number in range(20):
        function = model.function(f"function {number}")
        for other in range(20):
            function.design(f"design {number}.{other}", ["driver"])
    model.action("all", requires=list(model.functions))
    kb = KnowledgeBase(model)
    kb.component_failed("driver")
    explanation = kb.explain("all")
    drivers = {id(design.causes[0]) for cause in explanation.causes for design in cause.causes}
    assert len(drivers) == 1
    assert [str(remedy) for remedy in explanation.remedies] == ["driver recovered"]
    assert "driver has failed" in explanation.sentence
    assert len(explanation.sentence) < 1500


def test_bare_name_means_the_action_first(kb):
    model = Model("recharge")
    model.component("recharge")
    model.function("recharge").design("recharge", ["recharge"])
    base = KnowledgeBase(model)
    assert base.explain("recharge").kind == "function"
    model.action("recharge")
    assert base.explain("recharge").kind == "action"
    assert base.explain(model.designs["recharge"]).kind == "function design"
    with pytest.raises(UnknownName, match="did you mean 'explore'"):
        kb.explain("explor")


# -------------------------------------------------------------------- numbers


def near(number):
    """Numbers that are hardly another one."""
    steps = st.sampled_from((0.0, 1e-12, -1e-12, 1e-7, -1e-7, 4e-4, -4e-4))
    return steps.map(lambda step: number + step * abs(number))


def sides(text, value, bound):
    """Return on which sides of a bound a written number is: below, above."""
    *words, number = text.split(" ")
    if words == ["just", "below"]:
        return (True, False) if float(number) <= bound else (value < bound, value > bound)
    if words == ["just", "above"]:
        return (False, True) if float(number) >= bound else (value < bound, value > bound)
    return float(number) < bound, float(number) > bound


@given(
    FLOATS.flatmap(
        lambda value: st.tuples(st.just(value), st.lists(near(value) | FLOATS, max_size=3))
    )
)
@example((0.25 * (1 - 1e-15), [0.25]))
def test_number_is_written_on_its_side_of_every_threshold(case):
    value, thresholds = case
    text = shortest(value, thresholds)
    for bound in thresholds:
        assert sides(text, value, bound) == (value < bound, value > bound)


@pytest.mark.parametrize("operator", [">=", ">", "<=", "<"])
@given(st.integers(-20, 20), st.integers(-20, 20))
def test_numbers_of_a_comparison_agree_with_its_status(operator, value, bound):
    model = Model("one")
    light = model.environmental_attribute("light")
    model.action("go", constraints=[compare(light, operator, bound / 4)])
    kb = KnowledgeBase(model)
    kb.measure("light", value / 7)
    (constraint,) = kb.actions["go"].constraints
    _, shown, verb, sign, threshold, *_ = kb.why(constraint).split()
    holds = {"satisfies": True, "violates": False}[verb]
    truth = {
        ">=": float(shown) >= float(threshold),
        ">": float(shown) > float(threshold),
        "<=": float(shown) <= float(threshold),
        "<": float(shown) < float(threshold),
    }
    assert truth[sign] is holds is (constraint.status is Status.SATISFIED)


# -------------------------------------------------------------------- choices


@SLOW
@given(stories(max_size=20, asserting=False))
def test_choice_is_the_selected_one_or_else_the_first(story):
    model, events = story
    twins = Twins(model, events)
    state = state_of(twins.kb)
    network = state.network
    for node in (*network.functions.values(), *network.components.values()):
        choice = explain_choice(state, node, 0.0)
        possible = [part for part in node.requires if state.status[part] is not Status.UNFEASIBLE]
        selected = [part.name for part in node.requires if part in state.selected]
        first = min((part.element for part in possible), key=by_priority, default=None)
        assert choice.is_selected is bool(selected)
        assert choice.chosen in (selected or [first and first.name])
        rest = {part.name: part for part in node.requires if part.name != choice.chosen}
        assert [other.name for other in choice.alternatives] == list(rest)
        for other in choice.alternatives:
            part = rest[other.name]
            assert (other.status, other.priority) == (state.status[part], part.element.priority)
            is_unfeasible = other.reason.startswith("it is unfeasible because ")
            assert is_unfeasible is (part not in possible)


@pytest.fixture
def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", priority=1, constraints=[light >= 0.5])
    camera.configuration("dusk", priority=2)
    camera.configuration("night", priority=2)
    camera.configuration("any")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by touch", [], priority=3)
    model.function("dream")
    model.component("lamp")
    model.action("look", requires=[see])
    return KnowledgeBase(model, clock=Clock())


def choice_of(kb, name):
    choice = kb.explain_choice(name)
    return choice.reason, {other.name: other.reason for other in choice.alternatives}


def test_choice_that_nothing_requires_says_so(rover):
    assert str(rover.explain_choice("see")) == (
        "by camera would be selected for function see because it comes first, with priority number "
        "1; nothing requires the function now; not by touch: it has priority number 3, and comes "
        "after by camera"
    )


def test_alternative_is_unfeasible_or_comes_later(rover):
    rover.measure("light", 0.3)
    reason, others = choice_of(rover, "camera")
    assert reason.startswith("it comes first, with priority number 2")
    assert others == {
        "day": "it is unfeasible because light 0.3 violates >= 0.5 (measured 0.0 s ago)",
        "night": "it has priority number 2, and comes after dusk",
        "any": "it has no priority number, and comes after night",
    }


def test_selected_choice_says_what_it_comes_after(rover):
    rover.measure("light", 0.3)
    rover.request_action("look")
    rover.select({"see": "by camera"}, {"camera": "dusk"})
    rover.measure("light", 0.7)
    reason, others = choice_of(rover, "camera")
    assert reason == "it has priority number 2, and comes after day"
    assert others["day"] == "it comes first, with priority number 1"
    rover.select({}, {"camera": "day"}, "the best view")
    assert choice_of(rover, "camera")[0] == "the best view"
    assert choice_of(rover, "camera")[1]["dusk"] == "it is possible, but not part of that choice"
    rover.measure("light", 0.1)
    assert choice_of(rover, "camera")[0] == (
        "it is unfeasible because light 0.1 violates >= 0.5 (measured 0.0 s ago)"
    )
