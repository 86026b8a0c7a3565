"""The judge of models, tried on models that are broken on purpose, on sound ones and on random ones."""

from itertools import product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import OPERATORS, compare, models

from kb import KnowledgeBase, Model, ModelError, Status
from kb.checks import Severity, listing, rules
from kb.elements import KINDS
from kb.facts import (
    ActiveFact,
    MeasurementFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.planning import by_priority

VALUES = (-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5)
"""On, between and beyond the bounds that random models use."""


def sound():
    """A model without anything to find, to be broken in one place."""
    model = Model("sound")
    light = model.environmental_attribute("light")
    camera = model.component("camera", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.2}, priority=2)
    lamp, sonar = model.component("lamp"), model.component("sonar")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by sonar", [lamp, sonar], priority=2)
    model.action("explore", requires=[see], constraints=[light >= 0.1])
    return model


def camera_of(model):
    return model.components["camera"]


def light_of(model):
    return model.attributes["light"]


# One specimen per code: what is done to the sound model, and the element and words of what is found.
SPECIMENS = {}


def specimen(code, element, *words):
    def keep(break_it):
        SPECIMENS[break_it.__name__] = (code, element, words, break_it)
        return break_it

    return keep


@specimen(
    "function-without-designs",
    "function hear",
    "hear has no design, so action explore_by_ear can never be",
)
def function_without_designs(model):
    model.action("explore_by_ear", requires=[model.function("hear")])


@specimen(
    "design-without-components", "function design by magic", "of function see has no component"
)
def design_without_components(model):
    model.designs["by camera"].constrain(light_of(model) >= 0.2)
    model.functions["see"].design("by magic", [], priority=0, constraints=[light_of(model) >= 0.9])


@specimen("action-without-functions", "action wait", "requires no function")
def action_without_functions(model):
    model.action("wait")


@specimen(
    "contradictory-constraints",
    "action explore",
    "light >= 0.1 and light < 0.1, which no value satisfies both",
)
def action_with_an_empty_interval(model):
    model.actions["explore"].constrain(light_of(model) < 0.1, light_of(model) < 0.9)


@specimen("contradictory-constraints", "configuration day", "light >= 0.5 and light <= 0.4")
def configuration_with_an_empty_interval(model):
    model.configurations["day"].constrain(light_of(model) <= 0.4)


@specimen(
    "contradictory-constraints",
    "component sonar",
    "light > 1.7976931348623157e+308, which no number satisfies",
)
def component_with_an_impossible_bound(model):
    model.components["sonar"].constrain(light_of(model) > 1.7976931348623157e308)


@specimen(
    "never-feasible",
    "action hide",
    "its own constraint light < 0.2 and function see (light >= 0.3) exclude one another",
)
def action_whose_function_needs_what_it_excludes(model):
    for design in model.designs.values():
        design.constrain(light_of(model) >= 0.3)
    model.action("hide", requires=["see"], constraints=[light_of(model) < 0.2])


@specimen(
    "never-feasible",
    "component camera",
    "its own constraint light > 2 and each of its configurations exclude one another",
    "so action photograph can never be feasible",
)
def component_that_excludes_each_of_its_configurations(model):
    for name, bound in (("day", 1.0), ("night", 2.0)):
        model.configurations[name].constrain(light_of(model) <= bound)
    camera_of(model).constrain(light_of(model) > 2.0)
    keep = model.function("keep")
    keep.design("film", ["camera"], priority=1)
    model.action("photograph", requires=[keep])


@specimen(
    "never-feasible",
    "function design by both",
    "component lamp (light < 0.5) and component camera (light >= 0.5) exclude one another",
)
def design_of_components_that_exclude_one_another(model):
    model.configurations["night"].constrain(light_of(model) >= 0.7)
    model.change(model.configurations["night"], priority=0)
    model.components["lamp"].constrain(light_of(model) < 0.5)
    model.functions["see"].design("by both", ["lamp", "camera"], priority=0)


@specimen("never-feasible", "action juggle", "function left and function right exclude one another")
def action_whose_functions_agree_on_no_choice(model):
    light, wind = light_of(model), model.environmental_attribute("wind")
    for name, bounds in (
        ("left", ([light < 1, wind < 1], [light > 2, wind > 2])),
        ("right", ([light < 1, wind > 2], [light > 2, wind < 1])),
    ):
        function = model.function(name)
        for number, constraints in enumerate(bounds):
            function.design(f"{name} {number}", ["lamp"], priority=number, constraints=constraints)
    model.action("juggle", requires=["left", "right"])


@specimen("never-feasible", "action balance", "cannot be met together")
def action_whose_functions_agree_in_pairs_only(model):
    light, wind = light_of(model), model.environmental_attribute("wind")
    for name, bounds in (
        ("a", ([light < 1], [wind < 1])),
        ("b", ([light > 2], [wind < 1])),
        ("c", ([wind > 2],)),
    ):
        function = model.function(name)
        for number, constraints in enumerate(bounds):
            function.design(f"{name} {number}", ["lamp"], priority=number, constraints=constraints)
    model.action("balance", requires=["a", "b", "c"])


@specimen(
    "tied-priorities",
    "function see",
    "by camera and by sonar",
    "the same priority, 1; by camera comes first",
)
def designs_of_equal_priority(model):
    model.change(model.designs["by sonar"], priority=1)


@specimen(
    "tied-priorities",
    "component camera",
    "day and night of component camera have no priority; day comes first",
)
def configurations_without_priority(model):
    for name in ("day", "night"):
        model.change(model.configurations[name], priority=None)


@specimen(
    "never-selected",
    "configuration night",
    "whenever it is feasible, so is day, which is preferred",
)
def configuration_behind_one_that_is_always_feasible(model):
    model.change(model.configurations["day"], priority=3)
    model.configurations["night"].constrain(light_of(model) >= 0.6)
    model.change(model.configurations["night"], priority=4)


@specimen(
    "never-selected",
    "configuration dusk",
    "dusk needs light < 0.2, but its component camera light >= 0.3",
)
def configuration_that_its_component_excludes(model):
    camera_of(model).constrain(light_of(model) >= 0.3)
    camera_of(model).configuration(
        "dusk", {"exposure": 0.1}, priority=0, constraints=[light_of(model) < 0.2]
    )


@specimen(
    "out-of-range",
    "constraint pressure <= 300",
    "is never violated: pressure is from 0 to 250 kPa (on sonar)",
)
def constraint_in_another_unit_than_the_range(model):
    pressure = model.environmental_attribute("pressure", unit="kPa", low=0, high=250)
    model.components["sonar"].constrain(pressure <= 300)


@specimen("never-selected", "function design by both", "whenever it is feasible, so is by camera")
def design_that_adds_to_a_preferred_one(model):
    model.functions["see"].design("by both", ["camera", "sonar"], priority=3)


@specimen(
    "missing-estimation",
    "function see",
    "light is estimated for some function designs",
    "not for by sonar",
)
def design_without_the_estimation_of_its_rival(model):
    camera_of(model).estimate("light", 0.1, "negative")


@specimen("missing-estimation", "component camera", "not for night")
def configuration_without_the_estimation_of_its_rival(model):
    model.configurations["day"].estimate("light", 0.1)
    model.designs["by sonar"].estimate("light", 0.0)


@specimen("missing-estimation", "action explore", "prefers light, which is estimated for nothing")
def preferred_attribute_that_nothing_estimates(model):
    model.add_fact(RequiredActionFact("explore", {"light": 1.0}))


@specimen("restored-twice", "attribute light", "restored by actions explore_again and look")
def attribute_that_two_actions_restore(model):
    for name in ("explore_again", "look"):
        model.action(name, requires=["see"], restores=["light"])


@specimen("unused-attribute", "attribute wind", "nothing depends on attribute wind")
def attribute_that_nothing_depends_on(model):
    model.quality_attribute("wind")


@specimen("unused-component", "component radar", "no design uses component radar")
def component_in_no_design(model):
    model.component("radar")


@specimen("unused-function", "function hear", "no action requires function hear")
def function_of_no_action(model):
    model.function("hear").design("by microphone", ["sonar"], priority=1)


@specimen("file-note", "model sound", "model.tql:3:7: 'solvd' is no status")
def file_with_a_note(model):
    model.notes.append("model.tql:3:7: 'solvd' is no status")


@specimen("unknown-action", "explor", "unknown action 'explor'; did you mean 'explore'?")
def action_name_that_is_misspelt(model):
    return ["explor", "explore"]


@specimen("unmentioned-action", "action explore", "action explore is mentioned nowhere")
def action_that_no_name_mentions(model):
    return []


def test_sound_model_has_nothing_to_find():
    assert sound().check() == ()
    assert sound().check(names=["explore"]) == ()


@pytest.mark.parametrize("name", SPECIMENS)
def test_broken_specimen_shows_its_fault_and_no_other(name):
    code, element, words, break_it = SPECIMENS[name]
    model = sound()
    findings = model.check(break_it(model))
    assert [(one.code, one.element) for one in findings] == [(code, element)]
    for some in words:
        assert some in findings[0].message


def test_there_is_a_specimen_of_every_code():
    of_trees = {"unguarded-action"}  # has its test beside `rosa check`
    assert {code for code, *_ in SPECIMENS.values()} == set(rules()) - of_trees


LEGAL = {
    "rivals of equal priority of which only one is possible at a time": lambda model: (
        model.configurations["night"].constrain(light_of(model) < 0.5),
        model.change(model.configurations["night"], priority=1),
    ),
    "a preferred choice that is not always possible": lambda model: camera_of(model).configuration(
        "dusk", {"exposure": 0.1}, priority=0, constraints=[light_of(model) < 0.3]
    ),
    "a choice that estimations may favour": lambda model: (
        camera_of(model).configuration("dusk", {"exposure": 0.1}, priority=3),
        *(
            one.estimate("light", 0.0)
            for one in (*model.configurations.values(), model.designs["by sonar"])
        ),
    ),
    "a last resort when the measurement may be too old": lambda model: (
        camera_of(model).constrain(
            model.environmental_attribute("wind", max_age=1.0, when_stale="violated") < 9.0
        ),
        model.functions["see"].design(
            "a", ["lamp"], priority=3, constraints=[model.attributes["wind"] < 9.0]
        ),
        model.functions["see"].design(
            "b", ["lamp"], priority=4, constraints=[model.attributes["wind"] >= 9.0]
        ),
        model.functions["see"].design("c", ["lamp"], priority=5),
    ),
    "the fact that a component has failed": lambda model: model.add_fact(
        StatusFact(model.components["lamp"], Status.FAILURE)
    ),
    "a robot that is at work": lambda model: [
        model.add_fact(fact)
        for fact in (
            RequiredActionFact("explore"),
            SelectedFact(model.designs["by camera"]),
            SelectedFact(model.configurations["day"]),
            ActiveFact("camera"),
            MeasurementFact("light", 0.2, time=1.0, latest=False),
            MeasurementFact("light", 0.1),
        )
    ],
    "a component that is asserted to be required": lambda model: [
        model.add_fact(fact)
        for fact in (
            RequiredFact(model.components["camera"]),
            SelectedFact(model.configurations["day"]),
        )
    ],
    "an idle robot of which something is active": lambda model: model.add_fact(ActiveFact("sonar")),
    "required functions and actions that use what is active": lambda model: [
        model.add_fact(fact)
        for fact in (
            RequiredFact(model.functions["see"]),
            RequiredFact(model.actions["explore"]),
            ActiveFact("sonar"),
        )
    ],
}


@pytest.mark.parametrize("name", LEGAL)
def test_what_is_legal_and_meant_is_not_found(name):
    model = sound()
    LEGAL[name](model)
    assert model.check() == ()


def test_root_is_told_with_the_actions_that_depend_on_it_and_not_each_element_between():
    model = sound()
    model.configurations["day"].constrain(light_of(model) < 0.1)
    model.configurations["night"].constrain(light_of(model) < 0.1, light_of(model) > 0.2)
    model.remove(model.designs["by sonar"])
    for number in range(6):
        model.action(f"look {number}", requires=["see"])
    errors = [one for one in model.check() if one.severity is Severity.ERROR]
    assert [(one.code, one.element) for one in errors] == [
        ("contradictory-constraints", "configuration day"),
        ("contradictory-constraints", "configuration night"),
    ]
    assert errors[0].message.endswith(", so 7 actions or more can never be feasible, e.g. explore")


def test_finding_is_one_line_that_says_what_where_and_what_to_do():
    model = Model("broken")
    model.function("see\nfar")
    finding = model.check()[0]
    assert str(finding) == (
        "error: function see far has no design [function-without-designs]; "
        "declare a design with the components that realise the function, or remove the function"
    )
    with pytest.raises(AttributeError):
        finding.code = "other"


def test_finding_about_an_element_from_a_file_says_where_it_stands(tmp_path):
    path = tmp_path / "rover.tql"
    path.write_text(
        "insert\n  $a isa Action, has action-name 'go';\n  $f isa Function, has function-name 'move';\n"
    )
    places = {one.code: one.place for one in Model.load(path).check()}
    assert places["function-without-designs"].startswith(f"{path}:3:")
    assert places["action-without-functions"].startswith(f"{path}:2:")
    assert all(str(path) in str(one) for one in Model.load(path).check())


def test_errors_come_before_warnings_and_the_rest_in_order_of_declaration():
    model = Model("broken")
    for name in ("b", "a"):
        model.quality_attribute(name)
        model.function(name)
    assert [one.element for one in model.check()] == [
        *("function b", "function a", "attribute b", "attribute a", "function b", "function a"),
    ]


def test_long_lists_of_names_are_cut():
    assert listing([]) == ""
    assert listing(["a"]) == "a"
    assert listing(["a", "b"]) == "a and b"
    assert listing("abcd") == "a, b, c and d"
    assert listing("abcdefg") == "a, b, c and 4 more"


@pytest.mark.parametrize("names", ["explore", 3, [3], [None]])
def test_names_that_are_no_list_of_texts_are_refused(names):
    with pytest.raises(ModelError):
        sound().check(names)


def test_too_many_alternatives_to_look_at_are_no_finding():
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
def test_judging_never_fails_and_is_always_the_same(model, names):
    findings = model.check(names)
    assert findings == model.check(names)
    for one in findings:
        rule = rules()[one.code]
        assert (one.severity, one.advice) == (rule.severity, rule.advice)
        assert one.element
        assert "\n" not in str(one)
    assert sorted(findings, key=lambda one: one.severity != "error") == list(findings)


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


@given(models())
def test_what_is_said_to_be_impossible_is_so_and_all_that_is_so_has_its_root_told(model):
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


@given(models(), st.data())
def test_what_is_said_to_be_never_selected_is_never_the_first_choice(model, data):
    told = {one.element: one.message for one in model.check() if one.code == "never-selected"}
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
        unmeasured = [name for name, view in kb.attributes.items() if view.value is None]
        for function in kb.functions.values():
            rivals = [model.designs[name] for name in kb.selectable_designs(function.name)]
            assert f"function design {first_by_priority(rivals)}" not in told
        for component in kb.components.values():
            if component.status in ("unfeasible", "failure"):
                continue
            rivals = [
                model.configurations[name] for name in kb.selectable_configurations(component.name)
            ]
            why = told.get(f"configuration {first_by_priority(rivals)}")
            if (
                why is not None
            ):  # its component excludes it, but by an attribute that nothing is known of
                assert any(f" needs {name} " in why for name in unmeasured)


BOUND = st.tuples(st.sampled_from(OPERATORS), st.sampled_from((0.0, 0.5, 1.0)))


@given(st.lists(st.lists(BOUND, max_size=2), min_size=2, max_size=5), st.lists(BOUND, max_size=1))
def test_configurations_over_one_attribute_that_are_so_reported_are_never_selected(
    rivals, of_component
):
    model = Model("one attribute")
    x = model.quality_attribute("x")
    component = model.component("c", constraints=[compare(x, *bound) for bound in of_component])
    for number, bounds in enumerate(rivals):
        component.configuration(
            str(number), priority=number, constraints=[compare(x, *bound) for bound in bounds]
        )
    findings = model.check()
    told = {
        one.element
        for one in findings
        if one.code in ("never-selected", "contradictory-constraints")
    }
    told |= {one.element for one in findings if one.code == "never-feasible"}
    kb = KnowledgeBase(model)
    chosen = {
        first_by_priority(model.configurations.values())
    }  # nothing measured: all are feasible
    for value in VALUES:
        kb.measure("x", value)
        if kb.components["c"].status != "unfeasible":
            chosen.add(
                first_by_priority(
                    model.configurations[name] for name in kb.selectable_configurations("c")
                )
            )
    for number in range(1, len(rivals)):
        never = str(number) not in chosen
        if "component c" not in told:
            assert never or f"configuration {number}" not in told


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
