"""The builder: what it refuses, and that what it refused leaves nothing behind."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import (
    AttributeKind,
    ComponentKind,
    DuplicateName,
    EstimationKind,
    Expression,
    InvalidValue,
    KnowledgeBase,
    KnowledgeBaseError,
    Model,
    ModelError,
    Status,
    UnknownName,
)
from kb.elements import Configuration, Function, FunctionDesign


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


def contents(model):
    """All that a model holds, as plain values."""
    tables = (
        model.attributes,
        model.components,
        model.configurations,
        model.functions,
        model.designs,
        model.actions,
    )
    return (
        [[repr(one) for one in table.values()] for table in tables],
        [repr(one) for one in model.constraints],
        [repr(one) for one in model.estimations],
    )


def refuses(model, declare, error=ModelError, match=None):
    """Assert that a declaration is refused and leaves the model as it was."""
    before = contents(model)
    with pytest.raises(error, match=match):
        declare()
    assert contents(model) == before


KINDS = ("attribute", "component", "configuration", "function", "function design", "action")


def declare(model, kind, name, **options):
    return {
        "attribute": lambda: model.quality_attribute(name, **options),
        "component": lambda: model.component(name, **options),
        "configuration": lambda: model.components["camera"].configuration(name, **options),
        "function": lambda: model.function(name, **options),
        "function design": lambda: model.functions["see"].design(name, ["camera"], **options),
        "action": lambda: model.action(name, **options),
    }[kind]()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "name", ["high param >=", "a b", "ü", "1", ">= 0.5", "a" * 500, "a\nb", "'quoted'"]
)
def test_a_name_may_hold_anything_and_is_found_again(model, kind, name):
    assert declare(model, kind, name).name == name
    with pytest.raises(DuplicateName) as caught:
        declare(model, kind, name)
    assert f"{kind} {name!r}" in str(caught.value)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["", "  ", "\n", None, 5, ("a",), b"a", ["a"]])
def test_a_name_is_a_text_that_is_not_blank(model, kind, name):
    refuses(
        model,
        lambda: declare(model, kind, name),
        ModelError,
        match=rf"the name of an? {kind} is a non-empty text",
    )


@pytest.mark.parametrize("name", ["", None, 7])
def test_a_model_has_a_name(name):
    with pytest.raises(ModelError, match="name of a model"):
        Model(name)


@pytest.mark.parametrize("kind", KINDS)
def test_a_name_is_unique_within_its_kind(model, kind):
    declare(model, kind, "twice")
    refuses(
        model, lambda: declare(model, kind, "twice"), DuplicateName, match="unique within a kind"
    )


def test_a_name_is_shared_across_kinds_and_each_is_its_own_element(model):
    for kind in KINDS:
        declare(model, kind, "recharge")
    kb = KnowledgeBase(model)
    kb.component_failed("recharge")
    assert kb.components["recharge"].status is Status.FAILURE
    assert kb.actions["recharge"].status is Status.FEASIBLE
    assert kb.configurations["recharge"].status is Status.FEASIBLE
    assert kb.designs["recharge"].status is Status.FEASIBLE
    assert kb.attributes["recharge"].value is None


@pytest.mark.parametrize(
    ("declaration", "kind", "near"),
    [
        (lambda model: model.action("a", requires=["sea"]), "function", "see"),
        (lambda model: model.functions["see"].design("d", ["camra"]), "component", "camera"),
        (
            lambda model: model.declare(FunctionDesign, "d", function="se", components=["camera"]),
            "function",
            "see",
        ),
        (
            lambda model: model.declare(Configuration, "c", component="camer", parameters={}),
            "component",
            "camera",
        ),
        (lambda model: model.components["camera"].estimate("ligth", 1.0), "attribute", "light"),
        (
            lambda model: model.component("c", constraints=[Expression("lihgt", ">=", 1.0)]),
            "attribute",
            "light",
        ),
        (
            lambda model: model.actions["explore"].constrain(Expression("lite", ">=", 1.0)),
            "attribute",
            "light",
        ),
        (lambda model: model.component("c", kind="lifecicle"), "component kind", "lifecycle"),
        (
            lambda model: model.components["camera"].estimate("light", 1.0, "negativ"),
            "estimation kind",
            "negative",
        ),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(model, declaration, kind, near):
    refuses(
        model,
        lambda: declaration(model),
        UnknownName,
        match=rf"unknown {kind} .*did you mean '{near}'",
    )


def test_an_unknown_name_is_a_key_error_and_reads_well():
    with pytest.raises(KeyError) as caught:
        Model("empty").action("a", requires=["see"])
    assert str(caught.value) == "unknown function 'see'; the model has none"


def test_an_unknown_name_far_from_all_lists_what_there_is(model):
    with pytest.raises(UnknownName) as caught:
        model.action("a", requires=["zzz"])
    assert str(caught.value) == "unknown function 'zzz'; known: 'see'"


@pytest.mark.parametrize(
    "declaration",
    [
        lambda model, other: model.action("a", requires=[other.functions["see"]]),
        lambda model, other: model.functions["see"].design("d", [other.components["camera"]]),
        lambda model, other: model.declare(
            FunctionDesign, "d", function=other.functions["see"], components=["camera"]
        ),
        lambda model, other: model.declare(
            Configuration, "c", component=other.components["camera"], parameters={}
        ),
        lambda model, other: model.constrain(
            [other.actions["explore"]], model.attributes["light"] >= 1
        ),
        lambda model, other: model.add_estimation(
            model.components["camera"], other.attributes["light"], 1.0
        ),
        lambda model, other: model.add_estimation(other.components["camera"], "light", 1.0),
        lambda model, other: model.actions["explore"].constrain(other.attributes["light"] >= 1),
    ],
)
def test_an_element_of_another_model_is_refused(model, declaration):
    other = rover("other")
    untouched = contents(other)
    refuses(model, lambda: declaration(model, other), ModelError, match="other")
    assert contents(other) == untouched


@pytest.mark.parametrize(
    ("declaration", "words"),
    [
        (
            lambda model: model.declare(Configuration, "new", parameters={}),
            "configuration 'new' is not complete",
        ),
        (
            lambda model: model.declare(Configuration, "new", colour=1),
            "unknown field of configuration 'colour'",
        ),
        (
            lambda model: model.declare(Function, "new", [model.attributes["light"] >= 1]),
            "constrained can be one of",
        ),
    ],
)
def test_an_element_is_declared_by_the_fields_of_its_class(model, declaration, words):
    refuses(model, lambda: declaration(model), KnowledgeBaseError, match=words)


NO_NUMBERS = [math.nan, math.inf, -math.inf, True, False, "0.5", None, [0.5], 1j, object()]
BEYOND_FLOAT = pytest.param(10**400, id="beyond float")


@pytest.mark.parametrize("value", [*NO_NUMBERS, BEYOND_FLOAT])
def test_a_threshold_is_a_finite_number(model, value):
    light = model.attributes["light"]
    for comparison in (light.__ge__, light.__gt__, light.__le__, light.__lt__):
        with pytest.raises(InvalidValue, match="number is needed"):
            comparison(value)


@pytest.mark.parametrize("value", [*NO_NUMBERS, BEYOND_FLOAT])
def test_an_estimation_is_a_finite_number(model, value):
    refuses(
        model,
        lambda: model.components["camera"].estimate("light", value),
        InvalidValue,
        match="number is needed",
    )


def test_the_four_comparisons_and_their_mirrors_are_expressions(model):
    light = model.attributes["light"]
    assert [str(one) for one in (light >= 1, light > 1, light <= 1, light < 1)] == [
        "light >= 1",
        "light > 1",
        "light <= 1",
        "light < 1",
    ]
    assert (0.5 <= light) == (light >= 0.5)  # noqa: SIM300, the mirrored one is what is tried
    assert (0.5 > light) == (light < 0.5)  # noqa: SIM300, the mirrored one is what is tried


def test_a_chained_comparison_is_refused_with_what_to_write_instead(model):
    light = model.attributes["light"]
    with pytest.raises(ModelError, match="two constraints"):
        model.actions["explore"].constrain(0.2 <= light <= 0.8)
    with pytest.raises(ModelError, match="truth value"):
        bool(light > 0.2)
    assert model.constraints == ()


@pytest.mark.parametrize("expression", ["light >= 0.5", 0.5, None, True, ("light", ">=", 0.5)])
def test_a_constraint_is_a_comparison(model, expression):
    refuses(
        model, lambda: model.actions["explore"].constrain(expression), match="comparison such as"
    )
    for kind in ("component", "configuration", "function design", "action"):
        refuses(
            model,
            lambda kind=kind: declare(model, kind, "new", constraints=[expression]),
            match="comparison such as",
        )


def test_equality_is_no_comparison_of_the_language(model):
    light = model.attributes["light"]
    refuses(
        model, lambda: model.actions["explore"].constrain(light == 0.5), match="comparison such as"
    )


@pytest.mark.parametrize("operator", ["==", "!=", "", None, "=>"])
def test_an_expression_made_by_hand_has_one_of_the_four_operators(model, operator):
    refuses(model, lambda: model.actions["explore"].constrain(Expression("light", operator, 0.5)))


@pytest.mark.parametrize("value", [math.nan, math.inf, "0.5", None, True])
def test_an_expression_made_by_hand_has_a_finite_number(model, value):
    refuses(
        model,
        lambda: model.actions["explore"].constrain(Expression("light", ">=", value)),
        KnowledgeBaseError,
    )


def test_constraints_given_together_are_added_together_or_not_at_all(model):
    light = model.attributes["light"]
    refuses(model, lambda: model.actions["explore"].constrain(light >= 0.1, "light <= 0.9"))


@pytest.mark.parametrize("what", ["function", "attribute"])
def test_functions_and_attributes_are_not_constrained(model, what):
    element = model.functions["see"] if what == "function" else model.attributes["light"]
    refuses(model, lambda: model.constrain([element], model.attributes["light"] >= 1))


def test_a_constraint_constrains_something(model):
    refuses(model, lambda: model.constrain([], model.attributes["light"] >= 1))


@pytest.mark.parametrize("element", ["explore", None, 5])
def test_what_is_no_element_is_not_constrained(model, element):
    refuses(
        model,
        lambda: model.constrain([element], model.attributes["light"] >= 1),
        KnowledgeBaseError,
    )


@pytest.mark.parametrize("causer", ["camera", "action", "function"])
def test_an_estimation_is_caused_by_a_design_a_component_or_a_configuration(model, causer):
    given = {
        "camera": "camera",
        "action": model.actions["explore"],
        "function": model.functions["see"],
    }[causer]
    refuses(model, lambda: model.add_estimation(given, "light", 1.0), KnowledgeBaseError)


def test_shared_constraints_are_one_constraint(model):
    shared = model.constrain(
        [
            model.actions["explore"],
            model.designs["by camera"],
            model.components["camera"],
            model.configurations["day"],
        ],
        model.attributes["light"] >= 0.5,
    )
    assert model.constraints == (shared,)
    kb = KnowledgeBase(model)
    kb.measure("light", 0.1)
    for view in (
        kb.actions["explore"],
        kb.designs["by camera"],
        kb.components["camera"],
        kb.configurations["day"],
    ):
        assert view.status is Status.UNFEASIBLE
        assert [one.status for one in view.constraints] == [Status.VIOLATED]


@pytest.mark.parametrize("priority", ["1", True, False, [1], math.nan, math.inf, 10**400])
def test_a_priority_is_a_finite_number_or_none(model, priority):
    for kind in ("configuration", "function design"):
        refuses(
            model,
            lambda kind=kind: declare(model, kind, "new", priority=priority),
            match="finite number or None",
        )


@pytest.mark.parametrize(
    "value",
    [
        None,
        {"a": 1},
        {1, 2},
        b"x",
        1j,
        object(),
        [1, "a"],
        [None],
        [[1]],
        [1, True],
        [True, 1],
        lambda: 1,
    ],
)
def test_a_parameter_is_a_boolean_a_number_a_text_or_a_list_of_one_of_these(model, value):
    refuses(
        model,
        lambda: model.components["camera"].configuration("new", {"gain": value}),
        match="parameter 'gain' of configuration 'new'",
    )


@pytest.mark.parametrize(
    "value",
    [True, 1, 0.5, "text", "", [], [True, False], [1, 2], [0.5], ["a", "b"], "[3.0, 5.0]", 2**63],
)
def test_each_type_of_parameter_is_kept_as_it_is(model, value):
    configuration = model.components["camera"].configuration("new", {"gain": value})
    assert configuration.parameters == {"gain": value}
    assert type(configuration.parameters["gain"]) is type(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, [1.0, math.nan]])
def test_a_parameter_is_finite(model, value):
    refuses(
        model,
        lambda: model.components["camera"].configuration("new", {"gain": value}),
        KnowledgeBaseError,
    )


def test_a_parameter_name_is_a_text(model):
    refuses(model, lambda: model.components["camera"].configuration("new", {1: 2, "1": 3}))


@pytest.mark.parametrize(
    "declaration",
    [
        lambda model: model.action("new", constraints=model.attributes["light"] >= 1),
        lambda model: model.action("new", requires=None),
        lambda model: model.functions["see"].design("new", None),
        lambda model: model.components["camera"].configuration("new", [("gain", 1)]),
        lambda model: model.component("new", always_improve="no"),
        lambda model: model.component("new", package=5),
        lambda model: model.function("new", always_improve=1),
    ],
)
def test_a_wrong_type_is_refused_in_our_words(model, declaration):
    refuses(model, lambda: declaration(model), KnowledgeBaseError)


@pytest.mark.parametrize(
    "declaration",
    [
        lambda model: model.action("new", requires="see"),
        lambda model: model.functions["see"].design("new", "camera"),
    ],
)
def test_one_name_instead_of_a_list_is_refused_as_that(model, declaration):
    with pytest.raises(KnowledgeBaseError) as caught:
        declaration(model)
    assert "unknown" not in str(caught.value)


def test_an_element_of_another_kind_is_refused_even_if_its_name_fits(model):
    camera = model.action("camera")
    refuses(model, lambda: model.functions["see"].design("new", [camera]), KnowledgeBaseError)


def test_what_is_named_twice_is_refused_or_taken_once(model):
    try:
        parts = model.functions["see"].design("new", ["camera", "camera"]).components
    except ModelError:
        return
    assert parts == ("camera",)


def test_a_failed_declaration_leaves_nothing_half_added(model):
    light = model.attributes["light"]
    broken = [light >= 1, "nonsense"]
    for kind in ("component", "configuration", "function design", "action"):
        refuses(model, lambda kind=kind: declare(model, kind, "new", constraints=broken))
        refuses(
            model,
            lambda kind=kind: declare(
                model, kind, "new", constraints=[Expression("dark", ">=", 1.0)]
            ),
            UnknownName,
        )
        declare(model, kind, "new", constraints=[light >= 1])
    refuses(model, lambda: model.action("again", requires=["see", "sea"]), UnknownName)


def test_elements_are_frozen(model):
    elements = [
        model.attributes["light"],
        model.components["camera"],
        model.configurations["day"],
        model.functions["see"],
        model.designs["by camera"],
        model.actions["explore"],
        model.constrain([model.actions["explore"]], model.attributes["light"] >= 1),
        model.add_estimation(model.components["camera"], "light", 1.0),
    ]
    for element in elements:
        for field in dataclasses.fields(element):
            with pytest.raises(AttributeError):
                setattr(element, field.name, None)
        hash(element)


def test_a_configuration_keeps_its_own_copy_of_the_parameters(model):
    given = {"gains": [1, 2], "mode": "a"}
    configuration = model.components["camera"].configuration("new", given)
    given["mode"] = "b"
    given["gains"].append(3)
    assert configuration.parameters == {"gains": [1, 2], "mode": "a"}
    with pytest.raises(TypeError):
        configuration.parameters["mode"] = "b"


@pytest.mark.parametrize(
    "table",
    ["attributes", "components", "configurations", "functions", "designs", "actions", "tables"],
)
def test_the_tables_of_a_model_are_read_only(model, table):
    with pytest.raises(TypeError):
        getattr(model, table)["new"] = None
    with pytest.raises(TypeError):
        del getattr(model, table)[next(iter(getattr(model, table)))]


def test_kinds_and_defaults():
    model = Model("kinds")
    assert model.component("a").kind is ComponentKind.PLAIN
    assert model.component("b", kind="process").kind is ComponentKind.PROCESS
    assert model.component("c", kind=ComponentKind.LIFECYCLE).kind is ComponentKind.LIFECYCLE
    assert model.quality_attribute("q").kind is AttributeKind.QUALITY
    assert model.environmental_attribute("e").kind is AttributeKind.ENVIRONMENTAL
    model.components["a"].estimate("q", 0.5)
    assert [one.kind for one in model.estimations] == [EstimationKind.POSITIVE]
    assert model.components["a"].configuration("x").priority is None


@given(st.lists(st.text(min_size=1, max_size=6).filter(str.strip), unique=True, max_size=8))
def test_declared_elements_are_listed_in_order_of_declaration(declared):
    model = Model("order")
    for name in declared:
        model.component(name)
    assert list(model.components) == declared
    assert list(KnowledgeBase(model).components) == declared
