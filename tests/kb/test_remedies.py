"""Remedies: each one helps, none of its facts is idle, and no smaller or other one is missing."""

import math
from itertools import combinations, product

import pytest
from hypothesis import HealthCheck, assume, given, settings
from models import NUMBERS, OPERATORS, RANDOMS, Clock, amount, compare, some_of

from kb import KnowledgeBase, Model, Status
from kb.network import Network
from kb.remedies import Measured, Repair, remedies
from kb.state import State
from kb.status import STATUSES

GRID = (-0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""The thresholds of random models, and numbers between and beyond them."""
IMPOSSIBLE = (Status.UNFEASIBLE, Status.FAILURE)
SLOW = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=60
)


def subject(fact):
    return fact.attribute if isinstance(fact, Measured) else fact


def lacks(fact):
    return isinstance(fact, Repair) and fact.what == "designed"


def changed(state, changes):
    """Return a state in which measurements, by name, and repairs, with None, have come about."""
    network, overlay = state.network, state.copy()
    for what, value in changes.items():
        if isinstance(what, Repair) and what.what == "retracted":
            node = network.find(what.element)
            overlay.asserted.pop(node, None)
        elif isinstance(what, Repair):
            node = network.find(what.element)
            overlay.failed.discard(node)
            if overlay.asserted.get(node) is Status.FAILURE:
                del overlay.asserted[node]
        else:
            node = network.attributes[what]
            overlay.value[node] = value
            overlay.stale.discard(node)
        overlay.touch([node])
    overlay.infer()
    return overlay


def values_in(interval):
    """Some values in an interval, those at its ends among them."""
    low, high = (
        math.nextafter(end, side * math.inf) if side else end
        for end, side in (interval.low, interval.high)
    )
    ends = [end for end in (low, high, low + 1.0, high - 1.0, (low + high) / 2) if end in interval]
    return [end for end in ends if math.isfinite(end)]


def ways(remedy):
    """Ways to bring a remedy about: as (what to change, to what)."""
    options = [
        values_in(fact.interval) if isinstance(fact, Measured) else [None] for fact in remedy.facts
    ]
    for values in product(*options):
        yield dict(zip(map(subject, remedy.facts), values, strict=True))


def constrained_model(chance):
    """A model in which much depends on two attributes."""
    model = Model("constrained")
    ages = {"max_age": 1.0, "when_stale": chance.choice(("not evaluated", "violated"))}
    light, dust = (
        model.environmental_attribute("light", **ages),
        model.environmental_attribute("dust"),
    )
    for component in [model.component(f"c{number}") for number in range(3)]:
        for number in range(chance.randint(0, 2)):
            component.configuration(f"{component.name}.{number}")
    for function in [model.function(f"f{number}") for number in range(2)]:
        for number in range(amount(chance, 3)):
            function.design(f"{function.name}.{number}", some_of(chance, model.components))
    model.action("all", requires=list(model.functions))
    model.action("one", requires=["f0"])
    for element in [
        *model.configurations.values(),
        *model.components.values(),
        *model.designs.values(),
        *model.actions.values(),
    ]:
        for _ in range(chance.choice((0, 0, 1, 2))):
            attribute = chance.choice((light, light, dust))
            element.constrain(compare(attribute, chance.choice(OPERATORS), chance.choice(NUMBERS)))
    return model


def what_is_wrong(chance):
    """A state, and what is unfeasible in it."""
    network = Network(constrained_model(chance))
    state = State(network)
    state.touch(network.present())
    for attribute in network.attributes.values():
        value = chance.choice((None, *GRID))
        if value is not None:
            state.value[attribute] = value
    light = network.attributes["light"]
    if light in state.value and chance.randint(0, 3) == 0:
        state.stale.add(light)
    for component in network.components.values():
        if chance.randint(0, 3) == 0:
            state.failed.add(component)
    nodes = [node for node in network.present() if node.kind != "attribute"]
    for _ in range(chance.randint(0, 2)):
        node = chance.choice(nodes)
        state.asserted[node] = chance.choice(STATUSES[node.kind])
    state.infer()
    return state, [node for node in nodes if state.status[node] in IMPOSSIBLE]


@SLOW
@given(RANDOMS)
def test_each_remedy_makes_it_feasible_and_no_fact_of_it_is_idle(chance):
    state, unfeasible = what_is_wrong(chance)
    assume(unfeasible)
    for node in unfeasible:
        found, complete = remedies(state, node)
        assert complete
        for remedy in found:
            lacks_design = any(lacks(fact) for fact in remedy.facts)
            for changes in ways(remedy):
                if not lacks_design:
                    assert changed(state, changes).status[node] not in IMPOSSIBLE, remedy
                for dropped in changes:
                    rest = {
                        what: value
                        for what, value in changes.items()
                        if what != dropped and not lacks(what)
                    }
                    assert changed(state, rest).status[node] in IMPOSSIBLE, (remedy, dropped)


def worlds(state):
    """Every world that differs from a state in measurements and repairs, as what differs and its statuses."""
    network = state.network
    repairs = []
    for node in network.present():
        asserted = state.asserted.get(node)
        if asserted in (Status.UNFEASIBLE, Status.VIOLATED):
            repairs.append(Repair("retracted", node.element))
        if node.kind == "component" and (node in state.failed or asserted is Status.FAILURE):
            repairs.append(Repair("recovered", node.element))
    assume(len(repairs) <= 4)
    attributes = list(network.attributes)
    for values in product((None, *GRID), repeat=len(attributes)):
        measured = {
            name: value for name, value in zip(attributes, values, strict=True) if value is not None
        }
        for count in range(len(repairs) + 1):
            for chosen in combinations(repairs, count):
                changes = measured | dict.fromkeys(chosen)
                yield changes, changed(state, changes)


@SLOW
@given(RANDOMS)
def test_the_remedies_are_the_smallest_sets_of_facts_that_trying_everything_finds(chance):
    state, unfeasible = what_is_wrong(chance)
    assume(unfeasible)
    tried = list(worlds(state))
    for node in unfeasible:
        good = [changes for changes, world in tried if world.status[node] not in IMPOSSIBLE]
        sets = {frozenset(changes) for changes in good}
        smallest = {one for one in sets if not any(other < one for other in sets)}
        found = [
            remedy
            for remedy in remedies(state, node)[0]
            if not any(lacks(fact) for fact in remedy.facts)
        ]
        assert {frozenset(map(subject, remedy.facts)) for remedy in found} == smallest
        for changes, world in tried:
            if frozenset(changes) in smallest:
                covered = any(
                    frozenset(map(subject, remedy.facts)) == frozenset(changes)
                    and all(
                        changes[fact.attribute] in fact.interval
                        for fact in remedy.facts
                        if isinstance(fact, Measured)
                    )
                    for remedy in found
                )
                assert covered is (world.status[node] not in IMPOSSIBLE)


@SLOW
@given(RANDOMS)
def test_remedies_come_smallest_first_and_say_each_thing_once(chance):
    state, unfeasible = what_is_wrong(chance)
    for node in unfeasible:
        found = remedies(state, node)[0]
        assert [(len(one.facts), str(one)) for one in found] == sorted(
            (len(one.facts), str(one)) for one in found
        )
        assert len(set(found)) == len(found)
        assert remedies(state, node)[0] == found
    for node in state.network.present():
        if node not in unfeasible and node.kind != "attribute":
            assert remedies(state, node) == ((), True)


def told(kb, name):
    return [str(remedy) for remedy in kb.explain(name).remedies]


@pytest.fixture
def model():
    model = Model("rover")
    model.quality_attribute("battery_level")
    model.environmental_attribute("light", max_age=5.0, when_stale="violated")
    return model


def test_a_constraint_that_is_violated_is_told_as_the_measurement_that_would_do(model):
    model.action("explore", constraints=[model.attributes["battery_level"] >= 0.25])
    kb = KnowledgeBase(model)
    kb.measure("battery_level", 0.1)
    assert told(kb, "explore") == ["battery_level >= 0.25"]
    assert str(kb.explain("explore")).endswith("; it would be feasible with battery_level >= 0.25")


def test_a_measurement_is_told_with_every_bound_that_it_must_keep(model):
    light = model.attributes["light"]
    camera = model.component("camera", constraints=[light <= 0.8])
    camera.configuration("day", constraints=[light >= 0.2])
    model.function("see").design("by camera", [camera])
    model.action("look", requires=["see"])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.1)
    assert told(kb, "look") == ["light >= 0.2 and light <= 0.8"]


def test_what_cannot_be_satisfied_without_violating_something_else_has_no_remedy(model):
    light = model.attributes["light"]
    model.action("look", constraints=[light >= 0.8, light < 0.8])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("light", 0.1)
    assert told(kb, "look") == []
    assert str(kb.explain("look")).endswith(
        "; nothing that can be measured or repaired would make it feasible"
    )


def test_a_failed_component_is_to_be_recovered_or_gone_without(model):
    model.function("move").design("by wheels", [model.component("wheels")])
    legs = model.component("legs", constraints=[model.attributes["battery_level"] >= 0.5])
    model.functions["move"].design("by legs", [legs])
    model.action("go", requires=["move"])
    kb = KnowledgeBase(model)
    kb.component_failed("wheels")
    assert told(kb, "go") == []
    kb.measure("battery_level", 0.1)
    assert told(kb, "go") == ["battery_level >= 0.5", "wheels recovered"]
    assert str(kb.explain("go")).endswith(
        "; it would be feasible with battery_level >= 0.5 or wheels recovered"
    )
    assert told(kb, kb.components["wheels"]) == ["wheels recovered"]
    kb.component_failed("legs")
    assert told(kb, "go") == ["wheels recovered", "battery_level >= 0.5 and legs recovered"]


def test_a_function_without_a_design_lacks_one(model):
    model.function("dream")
    model.action("imagine", requires=["dream"])
    assert str(KnowledgeBase(model).explain("imagine")).endswith(
        "; it would be feasible with a design for dream"
    )


def test_a_stale_measurement_that_counts_as_violated_has_to_be_taken_again(model):
    model.action("look", constraints=[model.attributes["light"] >= 0.2])
    clock = Clock()
    kb = KnowledgeBase(model, clock=clock)
    kb.measure("light", 0.3)
    clock.now += 12.0
    assert str(kb.explain("look")) == (
        "look is unfeasible because light 0.3 is stale: measured 12.0 s ago, at most 5 s; "
        "it would be feasible with light >= 0.2 measured again"
    )


def test_an_asserted_status_has_to_be_retracted_and_then_what_is_below_counts(model):
    model.component("wheels")
    model.function("move").design("by wheels", ["wheels"])
    kb = KnowledgeBase(model)
    kb.component_failed("wheels")
    kb.assert_status(kb.functions["move"], "unfeasible")
    assert told(kb, "move") == ["asserted status of move retracted and wheels recovered"]
    kb.assert_status(kb.components["wheels"], "feasible")
    assert told(kb, "move") == ["asserted status of move retracted"]


def test_more_remedies_than_can_be_told_are_counted(model):
    battery = model.attributes["battery_level"]
    wheels = [model.component(f"wheel_{number}") for number in range(20)]
    move = model.function("move")
    for wheel in wheels:
        move.design(f"by {wheel.name}", [wheel], constraints=[battery >= 0.5])
    kb = KnowledgeBase(model)
    for wheel in wheels:
        kb.component_failed(wheel.name)
    explanation = kb.explain("move")
    assert len(explanation.remedies) == 16
    assert not explanation.has_all_remedies
    assert str(explanation).endswith(
        "wheel_0 recovered or wheel_1 recovered or wheel_10 recovered or at least 13 more"
    )


def test_remedy_outside_the_range_of_an_attribute_is_not_given():
    model = Model("rover")
    volt = model.quality_attribute("volt", low=0, high=10)
    camera = model.component("camera")
    camera.configuration("day", constraints=[volt < 0])
    camera.configuration("night", constraints=[volt >= 10])
    camera.configuration("dusk", constraints=[volt > 10])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("volt", 9)
    assert told(kb, "camera") == ["volt >= 10"]


def test_action_restores_an_element_if_one_remedy_is_all_its_own():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    camera = model.component("camera")
    model.function("see").design("by camera", [camera])
    model.action("look", requires=["see"], constraints=[energy >= 0.5])
    recharge = model.action("recharge", restores=[energy])
    overhaul = model.action("overhaul", restores=[energy, "camera"])
    kb = KnowledgeBase(model, clock=Clock())
    kb.measure("energy", 0.1)
    assert kb.explain("look").is_restored_by(recharge)
    kb.component_failed("camera")
    assert not kb.explain("look").is_restored_by(recharge)
    assert kb.explain("look").is_restored_by(overhaul)
    kb.assert_status(kb.actions["look"], "unfeasible")
    assert not kb.explain("look").is_restored_by(overhaul)
