"""The six tables, line by line, against an independent transcription of them."""

import itertools

import pytest

from kb import Status
from kb.status import (
    OPERATORS,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

# Each table is what the semantics says, read downwards: (status, whether the line holds for a case).

CONSTRAINT = [
    ("not evaluated", lambda it: it["measured"] is None),
    ("satisfied", lambda it: eval(f"{it['measured']} {it['relation']} {it['threshold']}", {})),
    ("violated", lambda it: True),
]
CONFIGURATION = [
    ("unfeasible", lambda it: "violated" in it["constraints"]),
    ("feasible", lambda it: True),
]
COMPONENT = [
    ("failure", lambda it: it["failed"]),
    (
        "unfeasible",
        lambda it: (
            (
                len(it["configurations"]) > 0
                and not [one for one in it["configurations"] if one[0] != "unfeasible"]
            )
            or "violated" in it["constraints"]
        ),
    ),
    (
        "configuration error",
        lambda it: it["required"] and ("unfeasible", True) in it["configurations"],
    ),
    (
        "unsolved",
        lambda it: (
            (it["required"] and not it["active"])
            or (
                it["required"]
                and it["active"]
                and len(it["configurations"]) > 0
                and True not in [selected for _, selected in it["configurations"]]
            )
        ),
    ),
    ("solved", lambda it: it["required"]),
    ("feasible", lambda it: True),
]
DESIGN = [
    (
        "unfeasible",
        lambda it: (
            "violated" in it["constraints"]
            or "failure" in it["components"]
            or "unfeasible" in it["components"]
        ),
    ),
    (
        "implicit configuration error",
        lambda it: it["selected"] and "configuration error" in it["components"],
    ),
    (
        "unsolved",
        lambda it: it["selected"] and [one for one in it["components"] if one != "solved"],
    ),
    ("solved", lambda it: it["selected"]),
    ("feasible", lambda it: True),
]


def chosen(it):
    return [status for status, selected in it["designs"] if selected]


FUNCTION = [
    (
        "unfeasible",
        lambda it: (
            not it["designs"]
            or not [status for status, _ in it["designs"] if status != "unfeasible"]
        ),
    ),
    ("configuration error", lambda it: it["required"] and "unfeasible" in chosen(it)),
    (
        "implicit configuration error",
        lambda it: it["required"] and "implicit configuration error" in chosen(it),
    ),
    ("solved", lambda it: it["required"] and "solved" in chosen(it)),
    ("unsolved", lambda it: it["required"]),
    ("feasible", lambda it: True),
]
ACTION = [
    ("unfeasible", lambda it: "violated" in it["constraints"] or "unfeasible" in it["functions"]),
    (
        "implicit configuration error",
        lambda it: (
            it["required"]
            and (
                "configuration error" in it["functions"]
                or "implicit configuration error" in it["functions"]
            )
        ),
    ),
    ("unsolved", lambda it: it["required"] and [one for one in it["functions"] if one != "solved"]),
    ("solved", lambda it: it["required"]),
    ("feasible", lambda it: True),
]

BOTH = (False, True)
CONSTRAINED = ("not evaluated", "satisfied", "violated")


def some(options, most):
    """Every combination with repetition of none up to `most` of the options."""
    listed = list(options)
    sizes = range(most + 1)
    return [one for size in sizes for one in itertools.combinations_with_replacement(listed, size)]


def cases(**spaces):
    return [
        dict(zip(spaces, values, strict=True)) for values in itertools.product(*spaces.values())
    ]


def of(case, parts):
    """A case as a table is asked about it: the statuses of the parts, and of those selected of them."""
    chosen = [status for status, is_selected in case[parts] if is_selected]
    return {**case, parts: [status for status, _ in case[parts]], "selected": chosen}


CONSTRAINTS = some(CONSTRAINED, 2)
STATUSES_OF = {
    "configuration": ("unfeasible", "feasible"),
    "component": tuple(status for status, _ in COMPONENT),
    "design": tuple(status for status, _ in DESIGN),
    "function": tuple(status for status, _ in FUNCTION),
}
TABLES = {
    "constraint": (
        lambda it: constraint_status(it["measured"], it["relation"], it["threshold"]),
        CONSTRAINT,
        cases(
            measured=(None, -1.5, -0.0, 0.0, 0.25, 1e300),
            relation=tuple(OPERATORS),
            threshold=(-1.5, 0.0, 0.25),
        ),
    ),
    "configuration": (
        lambda it: configuration_status(it["constraints"]),
        CONFIGURATION,
        cases(constraints=some(CONSTRAINED, 3)),
    ),
    "component": (
        lambda it: component_status(**of(it, "configurations")),
        COMPONENT,
        cases(
            failed=BOTH,
            constraints=CONSTRAINTS,
            configurations=some(itertools.product(STATUSES_OF["configuration"], BOTH), 3),
            required=BOTH,
            active=BOTH,
        ),
    ),
    "design": (
        lambda it: design_status(**it),
        DESIGN,
        cases(constraints=CONSTRAINTS, components=some(STATUSES_OF["component"], 3), selected=BOTH),
    ),
    "function": (
        lambda it: function_status(**of(it, "designs")),
        FUNCTION,
        cases(designs=some(itertools.product(STATUSES_OF["design"], BOTH), 3), required=BOTH),
    ),
    "action": (
        lambda it: action_status(**it),
        ACTION,
        cases(constraints=CONSTRAINTS, functions=some(STATUSES_OF["function"], 3), required=BOTH),
    ),
}
LINES = [(kind, number) for kind, (_, lines, _) in TABLES.items() for number in range(len(lines))]
PRECEDENCES = [
    (kind, first, later)
    for kind, (_, lines, _) in TABLES.items()
    for first, later in itertools.combinations(range(len(lines)), 2)
]
NEVER_TOGETHER = {
    ("constraint", 0, 1),  # what is not measured satisfies nothing
    (
        "function",
        0,
        2,
    ),  # a selected design that is unfeasible is not in implicit configuration error
    ("function", 0, 3),  # nor is it solved
}


def as_statuses(case):
    """Replace words by statuses, wherever they are."""
    if isinstance(case, dict):
        return {
            key: value if key == "relation" else as_statuses(value) for key, value in case.items()
        }
    if isinstance(case, tuple):
        return tuple(as_statuses(one) for one in case)
    return Status(case) if isinstance(case, str) else case


def first_line(lines, case):
    return next(number for number, (_, holds) in enumerate(lines) if holds(case))


@pytest.mark.parametrize("kind", TABLES)
def test_status_is_that_of_the_first_line_that_holds(kind):
    table, lines, space = TABLES[kind]
    assert len(space) >= 20
    for case in space:
        assert table(as_statuses(case)) == lines[first_line(lines, case)][0], case


@pytest.mark.parametrize(("kind", "line"), LINES)
def test_each_line_of_a_table_decides_at_least_one_case(kind, line):
    table, lines, space = TABLES[kind]
    decided = [case for case in space if first_line(lines, case) == line]
    assert decided
    assert {table(as_statuses(case)) for case in decided} == {lines[line][0]}


@pytest.mark.parametrize(("kind", "first", "later"), PRECEDENCES)
def test_a_line_comes_before_each_later_one_that_holds_too(kind, first, later):
    table, lines, space = TABLES[kind]

    def both_hold(case):
        if kind == "constraint" and case["measured"] is None:
            return later == 2 and first == 0
        return first_line(lines, case) == first and lines[later][1](case)

    both = [case for case in space if both_hold(case)]
    if (kind, first, later) in NEVER_TOGETHER:
        assert not both
        return
    assert both
    assert {table(as_statuses(case)) for case in both} == {lines[first][0]}


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_gives_a_status_object_and_never_a_bare_word(kind):
    table, _, space = TABLES[kind]
    assert all(type(table(as_statuses(case))) is Status for case in space)


@pytest.mark.parametrize("kind", ["configuration", "component", "design", "function", "action"])
def test_the_order_of_parts_does_not_matter(kind):
    table, _, space = TABLES[kind]
    collections = [key for key, value in space[0].items() if isinstance(value, tuple)]
    assert collections
    for case in space:
        mirrored = {
            key: value[::-1] if key in collections else value for key, value in case.items()
        }
        assert table(as_statuses(case)) is table(as_statuses(mirrored)), case


def test_unknown_is_not_violated():
    assert configuration_status([Status.NOT_EVALUATED]) is Status.FEASIBLE
    assert constraint_status(None, ">=", 0.25) is Status.NOT_EVALUATED


def test_a_required_action_that_requires_no_function_is_solved():
    assert action_status(constraints=(), functions=(), required=True) is Status.SOLVED


def test_a_selected_design_without_components_is_solved():
    assert design_status(constraints=(), components=(), selected=True) is Status.SOLVED


def test_a_function_without_designs_is_unfeasible():
    assert function_status(designs=(), selected=(), required=False) is Status.UNFEASIBLE
