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

# Each table is what the semantics says, read downwards: (status, whether the line holds for a
# case).

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
    return [
        combination
        for size in sizes
        for combination in itertools.combinations_with_replacement(listed, size)
    ]


def cases(**spaces):
    return [
        dict(zip(spaces, values, strict=True)) for values in itertools.product(*spaces.values())
    ]


def of(case, parts):
    """A case as a table is asked: the statuses of the parts, and of the selected ones."""
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
    numbers = set()
    for case in space:
        number = first_line(lines, case)
        status = table(as_statuses(case))
        assert status == lines[number][0], case
        assert type(status) is Status
        numbers.add(number)
    assert numbers == set(range(len(lines)))  # each line decides a case
