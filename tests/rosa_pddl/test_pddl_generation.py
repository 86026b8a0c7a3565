"""Declared actions become PDDL that reads back as declared; a slip in a declaration is one message that names it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unified_planning.environment import get_environment
from unified_planning.io import PDDLReader

from rosa_pddl import Planner, Problem, feasible_atoms, initial_state, load_domain, parse_domain
from rosa_pddl.exceptions import PddlError
from rosa_pddl.generation import ActionSchema, Declarations, DeclaredProblem
from rosa_pddl.syntax import conditions

DRIVE = ActionSchema(
    "drive",
    parameters=("?r - rover", "?from ?to - place"),
    start=("(at ?r ?from)",),
    over_all=("(not (blocked ?to))",),
    start_effects=("(not (at ?r ?from))",),
    end_effects=("(at ?r ?to)",),
    duration_s=12.5,
    cost="(distance ?from ?to)",
)
LOOK = ActionSchema(
    "look",
    parameters=("?r - rover", "?x - crater"),
    start=("(at ?r ?x)", "(exists (?y - place) (lit ?y))"),
    end_effects=("(seen ?x)", "(when (lit base) (forall (?z - place) (not (blocked ?z))))"),
    action="explore",
    cost=2,
)
CHARGE = ActionSchema(
    "charge",
    ("?r - rover",),
    end_effects=("(full ?r)",),
    duration_s=5,
    makes_feasible=("drive", "explore"),
)
PROBLEM = DeclaredProblem(
    goal=("(seen pit)",),
    objects={"r1": "rover", "base": "place", "pit": "crater"},
    facts=("(at r1 base)", "(lit base)"),
    numbers={
        "(distance base pit)": 3.5,
        "(distance pit base)": 4,
        "(distance base base)": 0,
        "(distance pit pit)": 0,
    },
    types={"crater": "place"},
)


def declared(*schemas, problem=PROBLEM):
    return Declarations("cave", schemas or (DRIVE, LOOK, CHARGE), problem)


class Feasible:
    def __init__(self, *actions):
        self.actions = dict.fromkeys(("drive", "explore", "charge"), "")
        self.feasible = actions

    def is_feasible(self, action):
        return action in self.feasible


def planned(domain, *feasible):
    return Planner(warm=False).plan(
        Problem(domain, initial_state(domain) | feasible_atoms(domain, Feasible(*feasible)))
    )


def test_what_is_generated_reads_back_as_it_was_declared():
    domain = declared().load()
    assert domain.name == "cave"
    assert domain.rosa_actions == ("drive", "explore", "charge")
    assert domain.schemas == ("drive", "look", "charge")
    drive, look, charge = (domain.schema_of[name] for name in domain.schemas)
    assert [name for name, _ in drive.parameters] == ["a", "r", "from", "to"]
    assert [len(part) for part in (drive.start, drive.over_all, drive.end)] == [1, 3, 0]
    assert [len(part) for part in (drive.start_effects, drive.end_effects)] == [1, 1]
    assert (drive.action, look.action) == ("a", "a")
    assert [name for name, _ in charge.parameters] == ["a", "a1", "a2", "r"]
    assert domain.step("look", ["explore", "r1", "pit"]).action == "explore"


def test_plan_has_the_declared_costs_and_an_expected_effect_serves_it():
    domain = declared().load()
    result = planned(domain, "drive", "explore", "charge")
    assert [str(step) for step in result.steps] == [
        "drive(drive, r1, base, pit)",
        "look(explore, r1, pit)",
    ]
    assert result.cost == pytest.approx(5.5)
    expecting = planned(domain, "charge")
    assert [step.schema for step in expecting.steps] == ["charge", "drive", "look"]
    assert not planned(domain, "explore").outcome.is_solved


def test_without_costs_or_durations_there_is_neither_metric_nor_requirement():
    only = ActionSchema("look", ("?x - crater",), end_effects=("(seen ?x)",), action=None)
    made = declared(only, problem=DeclaredProblem(goal=("(seen pit)",), objects={"pit": "crater"}))
    assert "durative" not in made.domain_pddl
    assert "cost" not in made.domain_pddl + made.problem_pddl
    (step,) = planned(made.load()).steps
    assert (str(step), step.action) == ("look(pit)", None)


def test_objects_that_formulas_name_are_constants_of_the_domain():
    text = declared().domain_pddl
    assert "(:constants base - place)" in text
    assert "base" not in declared().problem_pddl.split("(:init")[0]


def test_predicate_gets_the_type_of_its_uses_or_any_where_they_differ():
    text = declared().domain_pddl
    assert "(at ?x1 - rover ?x2 - object)" in text  # a place, or a crater
    assert "(seen ?x1 - crater)" in text


def test_what_only_the_whole_shows_to_be_wrong_is_said_of_the_declarations():
    look = ActionSchema("look", ("?x - crater",), end_effects=("(seen ?x)",))
    twice = declared(
        look, problem=DeclaredProblem(("(seen pit)",), {"pit": "crater", "PIT": "crater"})
    )
    with pytest.raises(
        PddlError,
        match=r"problem.pddl generated from the .* of cave: the object 'PIT' was declared before",
    ):
        twice.load()


NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,5}", fullmatch=True)


@settings(max_examples=20)
@given(
    names=st.lists(NAMES, min_size=2, max_size=5, unique=True),
    chain=st.integers(1, 4),
    lasting=st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_any_chain_of_declared_actions_loads_and_its_facts_are_those_declared(
    names, chain, lasting
):
    schemas = [
        ActionSchema(
            f"do-{number}",
            ("?x - thing",),
            start=(f"(stage{number} ?x)",),
            end_effects=(f"(stage{number + 1} ?x)", f"(not (stage{number} ?x))"),
            duration_s=1.0 if lasting[number] else None,
        )
        for number in range(chain)
    ]
    objects = {f"x{name}": "thing" for name in names}
    facts = tuple(f"(stage0 {name})" for name in objects)
    problem = DeclaredProblem(
        goal=(f"(stage{chain} {next(iter(objects))})",), objects=objects, facts=facts
    )
    domain = Declarations("chain", schemas, problem).load()
    own = {f"({schema.name}_action {schema.name})" for schema in schemas}
    assert initial_state(domain) == own | set(facts)
    assert [str(one) for text in domain.goals for one in conditions(domain, text)] == list(
        problem.goal
    )


def bad(**changes):
    given = {"name": "look", "parameters": ("?x - crater",), "end_effects": ("(seen ?x)",)}
    problem = DeclaredProblem(("(seen pit)",), {"pit": "crater"})
    return lambda: declared(ActionSchema(**(given | changes)), problem=problem)


def problem(**changes):
    given = {"goal": ("(seen pit)",), "objects": {"pit": "crater"}}
    look = ActionSchema("look", ("?x - crater",), end_effects=("(seen ?x)",))
    return lambda: declared(look, problem=DeclaredProblem(**(given | changes)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (bad(name="look here"), "'look here_action', expected a name: a letter"),
        (bad(action="2nd look"), "'2nd look_action', expected a name: a letter"),
        (bad(parameters=("x - crater",)), "found 'x', expected a variable such as"),
        (bad(parameters="?x - crater"), "parameters is one text, expected several; write"),
        (
            bad(parameters=("?x - crater", "?a - robot")),
            "in look: found the parameter '\\?a' again",
        ),
        (
            bad(end_effects=("seen ?x",)),
            "found 'seen \\?x', expected a formula such as '\\(seen \\?x\\)'",
        ),
        (
            bad(end_effects=("(seen ?y)",)),
            "in look: found the variable '\\?y', expected a parameter",
        ),
        (
            bad(end_effects=("(seen pitt)",)),
            "in look: found the unknown object 'pitt', expected a declared one; nearest: pit",
        ),
        (bad(end_effects=("(seen ?x",)), "unbalanced"),
        (bad(end_effects=("(at end (seen ?x))",)), "in look: found the unknown object 'end'"),
        (
            bad(end_effects=("(increase (total-cost) 1)",)),
            "in look: found the unknown predicate 'total-cost'",
        ),
        (
            problem(objects={"pit": "crater", "look": "crater"}),
            "the object 'look' was declared before",
        ),
        (bad(end_effects=("(seen ?x)", "(seen ?x ?x)")), "found 2 arguments of 'seen', expected 1"),
        (bad(over_all=("(seen ?x)",)), "state duration_s"),
        (bad(duration_s=-1), "duration_s is -1, expected a number that is not negative"),
        (bad(cost=float("nan")), "cost is nan"),
        (problem(goal=()), "there is no goal"),
        (
            problem(goal="(seen pit)"),
            r"goal is one text, expected several; write \('\(seen pit\)',\)",
        ),
        (problem(facts="(seen pit)"), "facts is one text"),
        (bad(parameters=("?x -",)), "found '-' at the end, expected a type"),
        (
            problem(goal=("(sene pit)",)),
            "unknown predicate 'sene', expected a declared one; nearest: seen",
        ),
        (problem(facts=("(deep pit)",)), "unknown predicate 'deep'"),
        (
            problem(objects={"pit": "rover"}),
            "the arguments of 'seen' are of other types than declared: \\(seen \\?x1 - crater\\)",
        ),
        (
            problem(objects={"pit": "crater", "big pit": "crater"}),
            "the object 'big pit', expected a name",
        ),
        (problem(numbers={"(depth pit)": 3}), "unknown predicate 'depth'"),
        (lambda: Declarations("cave", [], PROBLEM), "declarations of cave: no action is declared"),
        (lambda: declared(LOOK, LOOK), "the action 'look' was declared before"),
    ],
)
def test_slip_in_a_declaration_is_said_with_what_was_expected(make, message):
    with pytest.raises(PddlError, match=message):
        make().load()


def test_domain_is_readable_whatever_the_mission_is_called():
    made = Declarations("my cave (2)", [DRIVE, LOOK, CHARGE], PROBLEM)
    read = parse_domain(made.domain_pddl, made.problem_pddl)
    assert read.name == made.load().name == "my_cave_2_"


@pytest.mark.filterwarnings(
    "ignore"
)  # unified-planning calls what is deprecated, and warns of equal names
def test_what_is_written_is_read_by_unified_planning_and_by_this_package(tmp_path, monkeypatch):
    (tmp_path / "domain.pddl").write_text(declared().domain_pddl)
    (tmp_path / "problem.pddl").write_text(declared().problem_pddl)
    # a ROSA action is called like the PDDL action that does it
    monkeypatch.setattr(get_environment(), "error_used_name", False)
    read = PDDLReader().parse_problem(str(tmp_path / "domain.pddl"), str(tmp_path / "problem.pddl"))
    domain = load_domain(tmp_path / "domain.pddl", tmp_path / "problem.pddl")
    assert len(read.actions) == len(domain.schemas) == 3
    assert (domain.rosa_actions, domain.goals) == (
        declared().load().rosa_actions,
        declared().load().goals,
    )
    assert initial_state(domain) == initial_state(declared().load())
