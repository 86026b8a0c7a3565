"""Remedies: each one helps, none of its facts is idle, and no smaller or other one is missing."""

import math
from itertools import combinations, product

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from models import NUMBERS, OPERATORS, RANDOMS, Clock, amount, compare, models, some_of

from kb import KnowledgeBase, Model, Status
from kb.elements import Constraint
from kb.network import Network
from kb.remedies import Interval, Repair, Requirements, remedies
from kb.state import State
from kb.status import IMPOSSIBLE, STATUSES

GRID = (-0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""The thresholds of random models, and numbers between and beyond them."""
SLOW = settings(
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=50
)
UP, DOWN = (math.nextafter(0.5, end) for end in (math.inf, -math.inf))


# -------------------------------------------------------------------- what is possible at all


@given(models(), st.integers(1, 3))
def test_conjunctions_are_exactly_what_makes_an_element_possible(model, limit):
    network = Network(model)
    nodes = [node for node in network.present() if node.kind != "attribute"]
    requirements = Requirements()
    for numbers in product(GRID, repeat=len(model.attributes)):
        values = dict(zip(model.attributes, numbers, strict=True))
        state = State(network)
        state.value.update({network.attributes[name]: value for name, value in values.items()})
        state.touch(network.present())
        state.infer()
        for node in nodes:
            conjunctions = requirements.of(node)
            assert requirements.are_all
            is_possible = any(
                all(values[what.name] in interval for what, interval in conjunction.items())
                for conjunction in conjunctions
            )
            assert is_possible is (state.status[node] not in IMPOSSIBLE)
    for node in nodes:
        every = requirements.of(node)
        for conjunction in every:
            assert [other for other in every if other.covers(conjunction)] == [conjunction]
        limited = Requirements(limit=limit)
        some = limited.of(node)
        assert len(some) <= limit
        assert all(any(other.covers(conjunction) for other in every) for conjunction in some)
        assert not limited.are_all or sorted(map(str, some)) == sorted(map(str, every))


@pytest.mark.parametrize(("functions", "complete"), [(3, True), (30, False)])
def test_too_many_conjunctions_are_cut_off(functions, complete):
    model = Model("many")
    for number in range(functions):
        attribute = model.environmental_attribute(f"a{number}")
        function = model.function(f"f{number}")
        for constraint in (attribute >= 0.5, attribute <= 0.4):
            name = f"{constraint.operator}{number}"
            function.design(name, [model.component(name, constraints=[constraint])])
    action = model.action("all", requires=list(model.functions))
    requirements = Requirements()
    assert len(requirements.of(Network(model).find(action))) == min(2**functions, 64)
    assert requirements.are_all is complete


INTERVALS = st.builds(Interval, *[st.sampled_from([*GRID, UP, DOWN])] * 2)


@given(INTERVALS, INTERVALS)
def test_intervals_meet_and_cover_as_their_numbers_do(one, other):
    fine = {*(step / 8 for step in range(-3, 12)), UP, DOWN}
    mine, theirs = ({number for number in fine if number in interval} for interval in (one, other))
    assert {number for number in fine if number in one.meet(other)} == mine & theirs
    assert one.is_empty is (not mine)
    if one.covers(other):
        assert theirs <= mine


@pytest.mark.parametrize(("operator", "bound"), list(product(OPERATORS, (0.5, -1.0))))
def test_interval_is_written_as_its_constraint(operator, bound):
    constraint = Constraint("light", operator, bound, ())
    assert Interval.of(constraint).text("light") == str(constraint)


# -------------------------------------------------------------------- what would help now


def subject(fact):
    return fact if isinstance(fact, Repair) else fact.name


def is_lacking(fact):
    return isinstance(fact, Repair) and fact.what == "designed"


def changed(state, changes):
    """Return a state in which measurements, by name, and repairs, with None, have come about."""
    other = state.copy()
    for what, value in changes.items():
        if isinstance(what, Repair):
            node = state.network.find(what.element)
            if what.what == "recovered":
                other.failed.discard(node)
            if what.what == "retracted" or other.asserted.get(node) is Status.FAILURE:
                other.asserted.pop(node)
        else:
            node = state.network.attributes[what]
            other.value[node] = value
            other.stale.discard(node)
        other.touch([node])
    other.infer()
    return other


def ways(remedy):
    """Return ways to bring a remedy about: as (what to change, to what)."""
    options = []
    for fact, interval in remedy.items():
        values = [None]
        if not isinstance(fact, Repair):
            low, high = interval
            ends = (low, high, low + 1.0, high - 1.0, (low + high) / 2)
            values = [end for end in ends if end in interval and math.isfinite(end)]
        options.append(values)
    for values in product(*options):
        yield dict(zip(map(subject, remedy), values, strict=True))


def model_with_constraints(chance):
    """Return a model in which much depends on two attributes."""
    model = Model("constrained")
    policy = chance.choice(("not evaluated", "violated"))
    light = model.environmental_attribute("light", max_age=1.0, when_stale=policy)
    dust = model.environmental_attribute("dust")
    for component in [model.component(f"c{number}") for number in range(3)]:
        for number in range(chance.randint(0, 2)):
            component.configuration(f"{component.name}.{number}")
    for function in [model.function(f"f{number}") for number in range(2)]:
        for number in range(amount(chance, 3)):
            function.design(f"{function.name}.{number}", some_of(chance, model.components))
    model.action("all", requires=list(model.functions))
    model.action("one", requires=["f0"])
    tables = (model.configurations, model.components, model.designs, model.actions)
    for element in [element for table in tables for element in table.values()]:
        for _ in range(chance.choice((0, 0, 1, 2))):
            attribute = chance.choice((light, light, dust))
            element.constrain(compare(attribute, chance.choice(OPERATORS), chance.choice(NUMBERS)))
    return model


def state_with_faults(chance):
    """Return a state, and what is unfeasible in it."""
    network = Network(model_with_constraints(chance))
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
    impossible = (Status.UNFEASIBLE, Status.FAILURE)
    return state, [node for node in nodes if state.status[node] in impossible]


@SLOW
@given(RANDOMS)
def test_each_remedy_helps_and_no_fact_of_it_is_idle(chance):
    state, unfeasible = state_with_faults(chance)
    for node in unfeasible:
        all_remedies, complete = remedies(state, node)
        assert complete
        ranks = [(len(remedy), str(remedy)) for remedy in all_remedies]
        assert ranks == sorted(set(ranks))
        for remedy in all_remedies:
            for changes in ways(remedy):
                if not any(map(is_lacking, changes)):
                    assert changed(state, changes).status[node] not in IMPOSSIBLE, remedy
                for dropped in changes:
                    rest = {
                        what: value
                        for what, value in changes.items()
                        if what != dropped and not is_lacking(what)
                    }
                    assert changed(state, rest).status[node] in IMPOSSIBLE, (remedy, dropped)
    for node in state.network.present():
        if node not in unfeasible and node.kind != "attribute":
            assert remedies(state, node) == ((), True)


def worlds(state):
    """Yield what differs in each world that differs in measurements and repairs, and that world."""
    repairs = []
    for node in state.network.present():
        asserted = state.asserted.get(node)
        if asserted in (Status.UNFEASIBLE, Status.VIOLATED):
            repairs.append(Repair("retracted", node.element))
        if node in state.failed or asserted is Status.FAILURE:
            repairs.append(Repair("recovered", node.element))
    assume(len(repairs) <= 4)
    attributes = list(state.network.attributes)
    for values in product((None, *GRID), repeat=len(attributes)):
        pairs = zip(attributes, values, strict=True)
        measured = {name: value for name, value in pairs if value is not None}
        for count in range(len(repairs) + 1):
            for chosen in combinations(repairs, count):
                changes = measured | dict.fromkeys(chosen)
                yield changes, changed(state, changes)


def is_brought_about(remedy, changes):
    return all(
        changes[fact.name] in interval
        for fact, interval in remedy.items()
        if not isinstance(fact, Repair)
    )


@SLOW
@given(RANDOMS)
def test_remedies_are_the_smallest_sets_that_trying_all_finds(chance):
    state, unfeasible = state_with_faults(chance)
    assume(unfeasible)
    tried = list(worlds(state))
    for node in unfeasible:
        good = {
            frozenset(changes) for changes, world in tried if world.status[node] not in IMPOSSIBLE
        }
        smallest = {changes for changes in good if not any(other < changes for other in good)}
        by_subjects = {}
        for remedy in remedies(state, node)[0]:
            if not any(map(is_lacking, remedy)):
                subjects = frozenset(map(subject, remedy))
                by_subjects.setdefault(subjects, []).append(remedy)
        assert by_subjects.keys() == smallest
        for changes, world in tried:
            of_these = by_subjects.get(frozenset(changes))
            if of_these:
                is_covered = any(is_brought_about(remedy, changes) for remedy in of_these)
                assert is_covered is (world.status[node] not in IMPOSSIBLE)


@pytest.fixture
def rover():
    """Return a knowledge base of a rover whose light is stale after 5 s, and then violated."""
    model = Model("rover")
    energy = model.quality_attribute("energy", low=0.0, high=1.0)
    light = model.environmental_attribute("light", max_age=5.0, when_stale="violated")
    camera = model.component("camera", constraints=[light <= 0.8])
    camera.configuration("day", constraints=[light > 0.2])
    camera.configuration("never", constraints=[energy > 1.0])
    model.function("see").design("by camera", [camera])
    wheels = model.component("wheels")
    legs = model.component("legs", constraints=[energy >= 0.5])
    move = model.function("move")
    move.design("by wheels", [wheels])
    move.design("by legs", [legs])
    model.function("dream")
    model.action("look", requires=["see"])
    model.action("go", requires=["move"])
    model.action("imagine", requires=["dream"])
    model.action("doze", constraints=[energy >= 0.8, energy < 0.8])
    model.action("recharge", restores=[energy])
    model.action("overhaul", restores=[energy, wheels])
    return KnowledgeBase(model, clock=Clock())


@pytest.mark.parametrize(
    ("values", "failed", "element", "words"),
    [
        ({"light": 0.1, "energy": 0.9}, [], "look", ["light > 0.2 and light <= 0.8"]),
        ({"energy": 0.1}, [], "doze", []),
        ({}, ["wheels"], "go", []),
        ({"energy": 0.1}, ["wheels"], "go", ["energy >= 0.5", "wheels recovered"]),
        (
            {"energy": 0.1},
            ["wheels", "legs"],
            "go",
            ["wheels recovered", "energy >= 0.5 and legs recovered"],
        ),
        ({}, ["wheels"], "wheels", ["wheels recovered"]),
        ({}, [], "imagine", ["a design for dream"]),
    ],
)
def test_remedies_in_words(rover, values, failed, element, words):
    for name, value in values.items():
        rover.measure(name, value)
    for component in failed:
        rover.component_failed(component)
    explanation = rover.explain(element)
    assert [str(remedy) for remedy in explanation.remedies] == words
    if words:
        assert str(explanation).endswith(f"; it would be feasible with {', or '.join(words)}")
    elif explanation.status is Status.UNFEASIBLE:
        assert str(explanation).endswith(
            "; nothing that can be measured or repaired would make it feasible"
        )


def test_stale_measurement_has_to_be_taken_again(rover):
    rover.measure("light", 0.3)
    rover._clock.now += 12.0
    assert str(rover.explain(rover.configurations["day"])) == (
        "day is unfeasible because light 0.3 is stale: measured 12.0 s ago, at most 5 s; "
        "it would be feasible with light > 0.2"
    )


def test_asserted_status_is_retracted_before_the_parts_count(rover):
    rover.component_failed("camera")
    rover.assert_status("see", "unfeasible")
    words = "asserted status of see retracted"
    assert [str(each) for each in rover.explain("see").remedies] == [
        f"{words} and camera recovered"
    ]
    rover.assert_status("camera", "feasible")
    assert [str(each) for each in rover.explain("see").remedies] == [words]


def test_remedies_that_are_too_many_are_counted():
    model = Model("rover")
    move = model.function("move")
    for number in range(20):
        move.design(f"by {number}", [model.component(f"wheel_{number}")])
    kb = KnowledgeBase(model)
    for name in model.components:
        kb.component_failed(name)
    explanation = kb.explain("move")
    assert (len(explanation.remedies), explanation.has_all_remedies) == (16, False)
    words = "wheel_0 recovered, or wheel_1 recovered, or wheel_10 recovered, or 13 more"
    assert str(explanation).endswith(words)


def test_action_restores_an_element_by_a_remedy_all_its_own(rover):
    recharge, overhaul = (rover.model.actions[name] for name in ("recharge", "overhaul"))
    rover.measure("energy", 0.1)
    rover.component_failed("wheels")
    assert rover.explain("go").is_restored_by(recharge)
    rover.component_failed("legs")
    assert not rover.explain("go").is_restored_by(recharge)
    assert rover.explain("go").is_restored_by(overhaul)
    rover.assert_status(rover.actions["go"], "unfeasible")
    assert not rover.explain("go").is_restored_by(overhaul)
