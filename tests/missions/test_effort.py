"""Counting models: one rule gives the published counts, TypeQL has a statement for each element, growth is linear."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import AttributeKind, ComponentKind, Model
from kb.facts import MeasurementFact
from kb.typeql import typeql_text
from missions.agv.model import agv_model
from missions.engine.mission import MissionError
from missions.experiments.effort import MODELS, count, generated_model, law
from missions.suave.model import suave_model
from missions.suave_extended.model import suave_extended_model
from missions.uav.model import uav_model

BUILDERS = {
    "suave": suave_model,
    "suave_extended": suave_extended_model,
    "agv": agv_model,
    "uav": uav_model,
}
FEW = st.integers(0, 3)
MANY = st.integers(0, 8)


@st.composite
def models(draw):
    """Return a model whose elements are related at random."""
    model = Model("any")
    attributes = [model.quality_attribute(f"q{one}") for one in range(draw(st.integers(1, 3)))]
    components = [model.component(f"c{one}") for one in range(draw(st.integers(1, 4)))]
    constrained = []
    for number in range(draw(FEW)):
        parameters = {f"p{one}": one for one in range(draw(FEW))}
        one = draw(st.sampled_from(components)).configuration(
            f"k{number}", parameters, priority=number
        )
        constrained.append(one)
    functions = [model.function(f"f{one}") for one in range(draw(FEW))]
    for number in range(draw(FEW) if functions else 0):
        parts = draw(st.lists(st.sampled_from(components), min_size=1, unique=True))
        constrained.append(
            draw(st.sampled_from(functions)).design(f"d{number}", parts, priority=number)
        )
    estimable = [*components, *constrained]
    for number in range(draw(FEW)):
        needs = draw(st.lists(st.sampled_from(functions), unique=True)) if functions else []
        constrained.append(model.action(f"a{number}", requires=needs))
    for _ in range(draw(FEW) if constrained else 0):
        shared = draw(st.lists(st.sampled_from(constrained), min_size=1, unique=True))
        model.constrain(shared, draw(st.sampled_from(attributes)) >= draw(FEW))
    for _ in range(draw(FEW)):
        draw(st.sampled_from(estimable)).estimate(draw(st.sampled_from(attributes)), 1.0)
    return model


def inserted(model):
    """Return the statements of a model as TypeQL, but for the one that names the model."""
    _, told = typeql_text(model).split("\ninsert\n")
    return [
        line for line in told.splitlines() if line.endswith(";") and "isa RobotModel" not in line
    ]


@given(models())
def test_count_is_the_number_of_typeql_statements(model):
    assert count(model)["total"] == len(inserted(model))


@given(models())
def test_relations_are_the_statements_with_players(model):
    assert count(model)["relations"] == sum(") isa " in line for line in inserted(model))


@given(models())
def test_model_that_was_saved_and_loaded_counts_the_same(tmp_path_factory, model):
    path = tmp_path_factory.mktemp("effort") / "any.tql"
    model.save(path)
    assert count(Model.load(path)) == count(model)


@pytest.mark.parametrize("name", MODELS)
def test_one_rule_gives_the_published_counts(name):
    model = BUILDERS[name]()
    counted = count(model)
    assert (counted["entities"], counted["relations"]) == MODELS[name]
    assert counted["total"] == sum(MODELS[name])
    assert model.check() == ()


def test_constraint_that_several_elements_share_counts_once():
    model = agv_model()
    assert max(len(one.constrained) for one in model.constraints) == 5
    assert count(model)["of_relations"]["constraints"] == len(model.constraints) == 2


def test_what_is_so_from_the_start_is_not_counted():
    model = uav_model()
    before = count(model)
    model.add_fact(MeasurementFact("battery_level", 0.9, 0.0))
    assert count(model) == before


def test_empty_model_has_no_elements():
    assert count(Model("empty"))["total"] == 0


@given(MANY, MANY)
def test_generated_model_of_one_action_is_on_the_published_law(structural, parameter):
    assert count(generated_model(structural, parameter))["total"] == law(structural, parameter)


@given(MANY, MANY, st.integers(1, 5))
def test_actions_are_each_on_the_law_but_share_the_quality_attribute(
    structural, parameter, actions
):
    shared = actions - 1
    counted = count(generated_model(structural, parameter, actions))
    assert counted["total"] == actions * law(structural, parameter) - shared


@given(MANY, MANY)
def test_adaptation_adds_the_published_entities_and_relations(structural, parameter):
    base = count(generated_model(structural, parameter))
    one_structural = count(generated_model(structural + 1, parameter))
    one_parameter = count(generated_model(structural, parameter + 1))
    assert (
        one_structural["entities"] - base["entities"],
        one_structural["relations"] - base["relations"],
    ) == (2, 4)
    assert (
        one_parameter["entities"] - base["entities"],
        one_parameter["relations"] - base["relations"],
    ) == (1, 2)


@given(FEW, FEW, st.integers(1, 3))
def test_generated_model_obeys_the_assumptions_of_the_paper(structural, parameter, actions):
    model = generated_model(structural, parameter, actions)
    (quality,) = model.attributes.values()
    assert quality.kind is AttributeKind.QUALITY
    assert len({one.functions for one in model.actions.values()}) == len(model.functions) == actions
    for component in model.components.values():
        assert component.kind is ComponentKind.PROCESS
        assert component.package
        assert component.executable
    adapted = [*model.designs.values(), *model.configurations.values()]
    assert len(model.designs) == actions * (structural + 1)
    assert len(model.configurations) == actions * (structural + 1 + parameter)
    assert [one.constrained for one in model.constraints if one.attribute == quality.name]
    assert {element for one in model.constraints for element in one.constrained} == set(adapted)
    assert all(one.priority is not None for one in adapted)
    assert all(len(one.parameters) == 1 for one in model.configurations.values())
    assert model.check() == ()


@pytest.mark.parametrize(
    ("sizes", "message"), [((-1, 0), "structural is -1"), ((0, -2), "parameter is -2")]
)
def test_negative_number_of_adaptations_is_refused(sizes, message):
    with pytest.raises(MissionError, match=f"{message}; .* from 0"):
        generated_model(*sizes)


def test_model_of_no_action_is_refused():
    with pytest.raises(MissionError, match=r"actions is 0; .* from 1"):
        generated_model(0, 0, actions=0)
