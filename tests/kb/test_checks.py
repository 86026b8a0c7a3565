"""The checks of models, tried on broken, sound and random models."""

from itertools import product
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import models

from kb import KnowledgeBase, Model, ModelError, Status
from kb.checks import Severity, rules
from kb.elements import KINDS, StatusFact
from kb.planning import by_priority

VALUES = (-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5)
"""On, between and beyond the bounds that random models use."""
MOST = 1.7976931348623157e308


def sound():
    """A model without anything to find, to be broken in one place."""
    model = Model("sound")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    lamp = model.component("lamp")
    sonar = model.component("sonar")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by sonar", [lamp, sonar], priority=2)
    model.action("explore", requires=[see], constraints=[light >= 0.1])
    return model


def camera_of(model):
    return model.components["camera"]


def light_of(model):
    return model.attributes["light"]


def exclude_configurations(model):
    for name, bound in (("day", 1.0), ("night", 2.0)):
        model.configurations[name].constrain(light_of(model) <= bound)
    camera_of(model).constrain(light_of(model) > 2.0)
    model.function("keep").design("film", ["camera"], priority=1)
    model.action("photograph", requires=["keep"])


def exclude_components(model):
    model.configurations["night"].constrain(light_of(model) >= 0.7)
    model.change("night", priority=0)
    model.components["lamp"].constrain(light_of(model) < 0.5)
    model.functions["see"].design("by both", ["lamp", "camera"], priority=0)


def exclude_functions(model, **bounds):
    """Declare functions with one design for each list of constraints, and an action for them."""
    for name, alternatives in bounds.items():
        function = model.function(name)
        for number, constraints in enumerate(alternatives):
            function.design(f"{name} {number}", ["lamp"], priority=number, constraints=constraints)
    model.action("juggle", requires=list(bounds))


def agree_on_no_choice(model):
    light = light_of(model)
    wind = model.environmental_attribute("wind")
    left = ([light < 1, wind < 1], [light > 2, wind > 2])
    exclude_functions(model, left=left, right=([light < 1, wind > 2], [light > 2, wind < 1]))


def agree_in_pairs(model):
    light = light_of(model)
    wind = model.environmental_attribute("wind")
    exclude_functions(
        model, a=([light < 1], [wind < 1]), b=([light > 2], [wind < 1]), c=([wind > 2],)
    )


def hide(model):
    for design in model.designs.values():
        design.constrain(light_of(model) >= 0.3)
    model.action("hide", requires=["see"], constraints=[light_of(model) < 0.2])


def prefer_one_that_is_easier(model):
    model.change("day", priority=3)
    model.configurations["night"].constrain(light_of(model) >= 0.6)
    model.change("night", priority=4)


def prefer_one_beside_an_estimation(model):
    prefer_one_that_is_easier(model)
    model.components["lamp"].configuration("bright", {}).estimate(light_of(model), 1.0)


def restore_twice(model):
    for name in ("explore_again", "look"):
        model.action(name, requires=["see"], restores=["light"])


SPECIMENS = [
    (
        "function-without-designs",
        "function hear",
        "hear has no design, so action listen can never be",
        lambda model: model.action("listen", requires=[model.function("hear")]) and None,
    ),
    (
        "design-without-components",
        "function design by magic",
        "of function see has no component",
        lambda model: model.functions["see"].design("by magic", [], priority=3) and None,
    ),
    (
        "action-without-functions",
        "action wait",
        "requires no function",
        lambda model: model.action("wait") and None,
    ),
    (
        "contradictory-constraints",
        "action explore",
        "light >= 0.1 and light < 0.1, which no value satisfies",
        lambda model: model.actions["explore"].constrain(light_of(model) < 0.1) and None,
    ),
    (
        "contradictory-constraints",
        "component sonar",
        "light > 1.7976931348623157e+308, which no value satisfies",
        lambda model: model.components["sonar"].constrain(light_of(model) > MOST) and None,
    ),
    (
        "never-feasible",
        "action hide",
        "its own constraint light < 0.2 and function see (light >= 0.3) cannot be met together",
        hide,
    ),
    (
        "never-feasible",
        "component camera",
        "each of its configurations cannot be met together, whatever is measured, so action photo",
        exclude_configurations,
    ),
    (
        "never-feasible",
        "function design by both",
        "component lamp (light < 0.5) and component camera (light >= 0.5) cannot be met together",
        exclude_components,
    ),
    (
        "never-feasible",
        "action juggle",
        "function left and function right cannot be met together",
        agree_on_no_choice,
    ),
    ("never-feasible", "action juggle", "cannot be met together", agree_in_pairs),
    (
        "tied-priorities",
        "function see",
        "by camera and by sonar of function see have the same priority, 1; by camera comes first",
        lambda model: model.change("by sonar", priority=1),
    ),
    (
        "never-selected",
        "configuration night",
        "whenever it is feasible, so is day, which is preferred",
        prefer_one_that_is_easier,
    ),
    (
        "never-selected",
        "configuration night",
        "whenever it is feasible, so is day, which is preferred",
        prefer_one_beside_an_estimation,
    ),
    (
        "never-selected",
        "function design by both",
        "whenever it is feasible, so is by camera",
        lambda model: (
            model.functions["see"].design("by both", ["camera", "sonar"], priority=3) and None
        ),
    ),
    (
        "restored-twice",
        "attribute light",
        "restored by actions explore_again and look",
        restore_twice,
    ),
    (
        "unused-attribute",
        "attribute wind",
        "nothing depends on attribute wind",
        lambda model: model.quality_attribute("wind") and None,
    ),
    (
        "unused-component",
        "component radar",
        "no design uses component radar",
        lambda model: model.component("radar") and None,
    ),
    (
        "unused-function",
        "function hear",
        "no action requires function hear",
        lambda model: model.function("hear").design("by mike", ["sonar"], priority=1) and None,
    ),
    (
        "file-note",
        "model sound",
        "model.tql:3:7: 'solvd' is no status",
        lambda model: model.notes.append("model.tql:3:7: 'solvd' is no status"),
    ),
    (
        "unknown-action",
        "explor",
        "unknown action 'explor'; did you mean 'explore'?",
        lambda _: ["explor", "explore"],
    ),
    ("unmentioned-action", "action explore", "is mentioned nowhere", lambda _: []),
]
"""What is wrong in a model, and how: the code, the element and words of the only finding."""


def test_sound_model_has_nothing_to_find():
    model = sound()
    model.configurations["night"].constrain(light_of(model) < 0.5)
    model.change("night", priority=1)  # a tie of which only one is possible at a time
    model.add_fact(StatusFact(model.components["lamp"], Status.FAILURE))
    assert model.check() == ()
    assert sound().check(names=["explore"]) == ()


@pytest.mark.parametrize(("code", "element", "words", "spoil"), SPECIMENS)
def test_broken_specimen_shows_its_fault_and_no_other(code, element, words, spoil):
    model = sound()
    findings = model.check(spoil(model))
    assert [(finding.code, finding.element) for finding in findings] == [(code, element)]
    assert words in findings[0].message


def test_every_code_has_a_specimen():
    assert {code for code, *_ in SPECIMENS} == set(rules())


def test_root_is_found_and_not_what_is_between():
    model = sound()
    model.configurations["day"].constrain(light_of(model) < 0.1)
    model.configurations["night"].constrain(light_of(model) < 0.1, light_of(model) > 0.2)
    model.designs["by sonar"].constrain(light_of(model) < 0.1, light_of(model) > 0.2)
    for number in range(6):
        model.action(f"look {number}", requires=["see"])
    errors = [one for one in model.check() if one.severity is Severity.ERROR]
    assert [(error.code, error.element) for error in errors] == [
        ("contradictory-constraints", "configuration day"),
        ("contradictory-constraints", "configuration night"),
        ("contradictory-constraints", "function design by sonar"),
    ]
    assert errors[0].message.endswith(
        "so action explore, look 0, look 1 and 4 more can never be feasible"
    )


def test_finding_is_one_line():
    model = Model("broken")
    model.function("see far")
    finding = model.check()[0]
    assert str(finding) == (
        "error: function see far has no design [function-without-designs]; "
        "declare a design with the components that realise the function, or remove the function"
    )
    with pytest.raises(AttributeError):
        finding.code = "other"


def test_finding_about_a_file_has_its_place(tmp_path):
    path = tmp_path / "rover.tql"
    path.write_text(
        "insert\n  $a isa Action, has action-name 'go';\n"
        "  $f isa Function, has function-name 'move';\n"
    )
    places = {one.code: one.place for one in Model.load(path).check()}
    assert places["function-without-designs"].startswith(f"{path}:3:")
    assert places["action-without-functions"].startswith(f"{path}:2:")
    assert all(str(path) in str(one) for one in Model.load(path).check())


@pytest.mark.parametrize("names", ["explore", 3, [3], [None]])
def test_names_that_are_no_texts_are_refused(names):
    with pytest.raises(ModelError):
        sound().check(names)


def test_too_many_alternatives_are_no_finding():
    model = Model("wide")
    functions = []
    for number in range(9):
        x, y = (model.quality_attribute(f"{letter}{number}") for letter in "xy")
        function = model.function(f"f{number}")
        for priority, expression in enumerate((x > 1, y > 1)):
            function.design(
                f"d{number} {priority}",
                [model.component(f"c{number} {priority}")],
                priority=priority,
            )
            model.designs[f"d{number} {priority}"].constrain(expression)
        functions.append(function)
    model.action("all", requires=functions)
    assert model.check() == ()


# Laws


@given(models(), st.lists(st.sampled_from(("x0", "x1", "y"))) | st.none())
def test_check_of_any_model_is_repeatable(model, names):
    findings = model.check(names)
    assert findings == model.check(names)
    for finding in findings:
        rule = rules()[finding.code]
        assert (finding.severity, finding.advice) == (rule.severity, rule.advice)
        assert finding.element
        assert "\n" not in str(finding)
    assert sorted(findings, key=lambda finding: finding.severity != "error") == list(findings)


def measured(model):
    """A knowledge base in each of the states that matter, everything measured."""
    kb = KnowledgeBase(model)
    for values in product(VALUES, repeat=len(model.attributes)):
        for name, value in zip(model.attributes, values, strict=True):
            kb.measure(name, value)
        yield kb


def always_unfeasible(model):
    """Kind and name of every element that no measurement makes feasible, by trying them all."""
    remaining = None
    for kb in measured(model):
        views = (kb.actions, kb.functions, kb.designs, kb.components, kb.configurations)
        kinds = ("action", "function", "function design", "component", "configuration")
        unfeasible = {
            f"{kind} {view.name}"
            for kind, table in zip(kinds, views, strict=True)
            for view in table.values()
            if view.status == "unfeasible"
        }
        remaining = unfeasible if remaining is None else remaining & unfeasible
        if not remaining:
            break
    return remaining


NEVER = ("contradictory-constraints", "function-without-designs", "never-feasible")


def beneath(model, element):
    """An element and all that it is made of."""
    parts = {
        "Action": lambda one: [model.functions[name] for name in one.functions],
        "Function": lambda one: [
            design for design in model.designs.values() if design.function == one.name
        ],
        "FunctionDesign": lambda one: [model.components[name] for name in one.components],
        "Component": lambda one: [
            each for each in model.configurations.values() if each.component == one.name
        ],
        "Configuration": lambda one: [],
    }[type(element).__name__](element)
    return [element, *(lower for part in parts for lower in beneath(model, part))]


@settings(max_examples=40)
@given(models())
def test_impossible_elements_are_those_that_trying_all_finds(model):
    told = {one.element for one in model.check() if one.code in NEVER}
    impossible = always_unfeasible(model)
    assert told <= impossible
    tables = (model.actions, model.functions, model.designs, model.components, model.configurations)
    for one in (element for table in tables for element in table.values()):
        if f"{KINDS[type(one)]} {one.name}" in impossible:
            assert told & {f"{KINDS[type(lower)]} {lower.name}" for lower in beneath(model, one)}


def first_by_priority(candidates):
    first = min(candidates, key=by_priority, default=None)
    return first and first.name


@settings(max_examples=40)
@given(models(), st.data())
def test_never_selected_choice_is_never_the_first(model, data):
    told = {one.element for one in model.check() if one.code == "never-selected"}
    kb = KnowledgeBase(model)
    for _ in range(8):
        for name in data.draw(st.sets(st.sampled_from(sorted(model.attributes)))):
            kb.measure(name, data.draw(st.sampled_from(VALUES)))
        for name in (
            data.draw(st.sets(st.sampled_from(sorted(model.components))))
            if model.components
            else ()
        ):
            (kb.component_recovered if data.draw(st.booleans()) else kb.component_failed)(name)
        for function in kb.functions.values():
            rivals = [model.designs[name] for name in kb.selectable_designs(function.name)]
            assert f"function design {first_by_priority(rivals)}" not in told
        for component in kb.components.values():
            if component.status in ("unfeasible", "failure"):
                continue
            rivals = [
                model.configurations[name] for name in kb.selectable_configurations(component.name)
            ]
            assert f"configuration {first_by_priority(rivals)}" not in told


def test_document_has_a_row_for_each_rule_in_its_words():
    text = (Path(__file__).parents[2] / "docs" / "checks.md").read_text()
    rows = [
        line
        for line in text.splitlines()
        if line.startswith("| ") and not line.startswith("| code |")
    ]
    assert rows == [
        f"| {code} | {rule.severity} | {rule.meaning} | {rule.advice} |"
        for code, rule in rules().items()
    ]
