"""The builder: what it declares, and that what it refuses leaves nothing behind."""

import dataclasses
import math

import pytest

from kb import (
    DuplicateName,
    Expression,
    InvalidValue,
    KnowledgeBase,
    Model,
    ModelError,
    Status,
    UnknownName,
)
from kb.elements import Configuration, FunctionDesign

KINDS = ("attribute", "component", "configuration", "function", "function design", "action")
CONSTRAINABLE = ("component", "configuration", "function design", "action")


def rover(name="rover"):
    model = Model(name)
    model.environmental_attribute("light")
    camera = model.component("camera")
    camera.configuration("day", {"exposure": 0.01}, priority=1)
    see = model.function("see")
    see.design("by camera", [camera])
    model.action("explore", requires=[see])
    return model


@pytest.fixture
def model():
    return rover()


def refuses(model, declare, error=ModelError, match=None):
    """Assert that a declaration is refused and leaves the model as it was."""
    before = model.plain()
    with pytest.raises(error, match=match):
        declare()
    assert model.plain() == before


def declare(model, kind, name="new", **options):
    return {
        "attribute": lambda: model.quality_attribute(name, **options),
        "component": lambda: model.component(name, **options),
        "configuration": lambda: model.components["camera"].configuration(name, **options),
        "function": lambda: model.function(name, **options),
        "function design": lambda: model.functions["see"].design(name, ["camera"], **options),
        "action": lambda: model.action(name, **options),
    }[kind]()


@pytest.mark.parametrize("kind", KINDS)
def test_name_of_any_text_is_unique_within_its_kind(model, kind):
    for name in ("high param >=", "1", "a" * 500, "'quoted'", "camera 2"):
        assert declare(model, kind, name).name == name
        with pytest.raises(DuplicateName, match="unique within a kind"):
            declare(model, kind, name)
    for name in ("", " ", "a\nb", None, 5, ("a",), b"a"):
        match = rf"the {kind}'s name is a non-empty text"
        refuses(model, lambda name=name: declare(model, kind, name), match=match)


def test_name_shared_across_kinds_names_separate_elements(model):
    for kind in KINDS:
        declare(model, kind, "recharge")
    kb = KnowledgeBase(model)
    kb.component_failed("recharge")
    assert kb.components["recharge"].status is Status.FAILURE
    assert kb.actions["recharge"].status is Status.FEASIBLE


def test_unknown_name_is_a_key_error_that_lists_what_exists(model):
    with pytest.raises(KeyError) as caught:
        Model("empty").action("a", requires=["see"])
    assert str(caught.value) == "unknown function 'see'; the model has none"
    with pytest.raises(UnknownName) as caught:
        model.action("a", requires=["zzz"])
    assert str(caught.value) == "unknown function 'zzz'; known: 'see'"


OTHER = rover("other")
BAD_NUMBERS = [math.nan, math.inf, True, "0.5", None, [0.5], 1j, 10**400]
REFUSED = {
    "unknown function .*did you mean 'see'": lambda m: m.action("a", requires=["sea"]),
    "unknown component .*mean 'camera'": lambda m: m.functions["see"].design("d", ["camra"]),
    "unknown function 'se'": lambda m: m.declare(FunctionDesign, "d", function="se", components=[]),
    "unknown attribute 'lite'": lambda m: m.component(
        "c", constraints=[Expression("lite", ">", 1)]
    ),
    "unknown component kind .*'lifecycle'": lambda m: m.component("c", kind="lifecicle"),
    "unknown estimation kind .*'negative'": lambda m: m.components["camera"].estimate(
        "light", 1.0, "negativ"
    ),
    "unknown field of component configuration 'colour'": lambda m: m.declare(
        Configuration, "new", colour=1
    ),
    "this component configuration is not complete": lambda m: m.state(
        Configuration, {"name": "new", "parameters": {}}
    ),
    "function 'see' is of another model": lambda m: m.action(
        "a", requires=[OTHER.functions["see"]]
    ),
    "'explore' is of another model": lambda m: m.constrain(
        [OTHER.actions["explore"]], m.attributes["light"] >= 1
    ),
    "'camera' is of another model": lambda m: m.add_estimation(
        OTHER.components["camera"], "light", 1.0
    ),
    "compares an attribute of 'other'": lambda m: m.actions["explore"].constrain(
        OTHER.attributes["light"] >= 1
    ),
    "constrained can be one of Action": lambda m: m.constrain(
        [m.functions["see"]], m.attributes["light"] >= 1
    ),
    "constrains nothing": lambda m: m.constrain([], m.attributes["light"] >= 1),
    "causer of an estimation can be": lambda m: m.add_estimation(
        m.actions["explore"], "light", 1.0
    ),
    "'' is no comparison": lambda m: m.actions["explore"].constrain(Expression("light", "", 1)),
    "two constraints": lambda m: m.actions["explore"].constrain(
        0.2 <= m.attributes["light"] <= 0.8
    ),
    "comparison such as": lambda m: m.actions["explore"].constrain(
        m.attributes["light"] >= 0.1, "light <= 0.9"
    ),
    "comparison such as .*, not False": lambda m: m.actions["explore"].constrain(
        m.attributes["light"] == 0.5
    ),
    "'new' are given as a list": lambda m: m.action("new", requires="see"),
    "constraints are given as a list": lambda m: m.action(
        "new", constraints=m.attributes["light"] >= 1
    ),
    "components of 'new' are given": lambda m: m.functions["see"].design("new", None),
    "given as values by name": lambda m: m.components["camera"].configuration("new", [("g", 1)]),
    "name of a parameter": lambda m: m.components["camera"].configuration("new", {1: 2}),
    "always_improve of 'new' is True or False": lambda m: m.function("new", always_improve=1),
    "package of 'new' is a text": lambda m: m.component("new", package=5),
    "can be one of Component": lambda m: m.functions["see"].design("d", [m.actions["explore"]]),
}


@pytest.mark.parametrize("message", REFUSED)
def test_declaration_that_is_wrong_is_refused(model, message):
    refuses(model, lambda: REFUSED[message](model), (ModelError, UnknownName), message)


@pytest.mark.parametrize("value", BAD_NUMBERS, ids=lambda value: f"{value!r:.9}")
def test_number_that_is_not_finite_is_refused(model, value):
    light = model.attributes["light"]
    for compare in (light.__ge__, light.__gt__, light.__le__, light.__lt__):
        with pytest.raises(InvalidValue, match="number is needed"):
            compare(value)
    refuses(model, lambda: model.components["camera"].estimate("light", value), InvalidValue)
    refuses(model, lambda: Expression("light", ">=", value), InvalidValue)
    for kind in ("configuration", "function design") if value is not None else ():
        match = "finite number or None"
        refuses(model, lambda kind=kind: declare(model, kind, priority=value), match=match)


@pytest.mark.parametrize("kind", CONSTRAINABLE)
def test_constraint_that_is_refused_refuses_its_element(model, kind):
    light = model.attributes["light"]
    for broken in ([light >= 1, "light >= 0.5"], [0.5], [None]):
        match = "comparison such as"
        refuses(model, lambda it=broken: declare(model, kind, constraints=it), match=match)
    assert declare(model, kind, constraints=[light >= 1]) in model.constraints[0].constrained


def test_comparisons_and_their_mirrors_are_expressions(model):
    light = model.attributes["light"]
    comparisons = (light >= 1, light > 1, light <= 1, light < 1)
    assert [str(each) for each in comparisons] == [
        "light >= 1",
        "light > 1",
        "light <= 1",
        "light < 1",
    ]
    assert (0.5 <= light) == (light >= 0.5)  # noqa: SIM300, the mirrored one is what is tried
    with pytest.raises(ModelError, match="truth value"):
        bool(light > 0.2)


def test_shared_constraint_applies_to_all_its_elements(model):
    elements = [model.actions["explore"], model.designs["by camera"], model.components["camera"]]
    (shared,) = model.constrain([*elements, "day"], model.attributes["light"] >= 0.5)
    assert model.constraints == (shared,)
    kb = KnowledgeBase(model)
    kb.measure("light", 0.1)
    for view in (kb.actions["explore"], kb.designs["by camera"], kb.configurations["day"]):
        assert view.status is Status.UNFEASIBLE


BAD_PARAMETERS = [None, {"a": 1}, {1}, b"x", Ellipsis, [1, "a"], [None], [[1]], [True, 1]]


@pytest.mark.parametrize("value", [*BAD_PARAMETERS, math.nan, [1.0, math.inf]], ids=repr)
def test_parameter_of_another_type_is_refused(model, value):
    camera = model.components["camera"]
    match = "parameter 'gain' of configuration 'new'"
    refuses(model, lambda: camera.configuration("new", {"gain": value}), match=match)


@pytest.mark.parametrize("value", [True, 1, 0.5, "", [], [True], [1, 2], ["a"], 2**63], ids=repr)
def test_parameter_is_a_copy_that_cannot_change(model, value):
    given = {"gain": value, "mode": ["a"]}
    configuration = model.components["camera"].configuration("new", given)
    given["mode"].append("b")
    assert configuration.parameters == {"gain": value, "mode": ["a"]}
    assert type(configuration.parameters["gain"]) is type(value)
    with pytest.raises(TypeError):
        configuration.parameters["mode"] = "b"


def test_elements_and_tables_are_frozen(model):
    model.constrain(["explore"], model.attributes["light"] >= 1)
    model.components["camera"].estimate("light", 1.0)
    for table in model.tables.values():
        (element,) = table.values()
        for field in dataclasses.fields(element):
            with pytest.raises(AttributeError):
                setattr(element, field.name, None)
        with pytest.raises(TypeError):
            table["new"] = None


def test_components_named_twice_are_taken_once_in_order(model):
    model.component("lidar")
    assert model.functions["see"].design("d", ["lidar", "camera", "lidar"]).components == (
        "lidar",
        "camera",
    )
    assert list(KnowledgeBase(model).components) == ["camera", "lidar"]
