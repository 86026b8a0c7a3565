"""Plans of least cost within limits: judged by trying everything, and by Fast Downward where nothing is limited."""

from fractions import Fraction
from itertools import compress, product
from math import inf
from operator import itemgetter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosa_pddl import (
    Outcome,
    Planner,
    PlannerSettingError,
    Problem,
    flaw,
    initial_state,
    parse_domain,
)
from rosa_pddl.engines.processes import ProcessHandle
from rosa_pddl.search import Condition, Operation, State, Task, TaskGraph
from rosa_pddl.validate import ended, missing_at_start

# ---------------------------------------------------------------- the search alone


ATOMS = "abcd"
FACTS = st.dictionaries(st.sampled_from(ATOMS), st.booleans(), max_size=2)


def condition(facts):
    needs, denies = (
        frozenset(atom for atom, truth in facts.items() if truth is wanted)
        for wanted in (True, False)
    )
    return Condition(needs, denies)


@st.composite
def tasks(draw):
    """Return a small task with up to two resources, cycles that cost nothing, and conditional effects."""
    resources = draw(st.integers(0, 2))
    operations, amounts = [], []
    for number in range(draw(st.integers(0, 6))):
        sure = condition(draw(FACTS))
        effects = [(condition(draw(FACTS)), atom, truth) for atom, truth in draw(FACTS).items()]
        uses = tuple(draw(st.integers(0, 3)) for _ in range(resources))
        needed, cost = condition(draw(FACTS)), draw(st.integers(0, 4))
        operations.append(Operation(number, needed, sure.denies, sure.needs, tuple(effects)))
        amounts.append((cost, *uses))
    start = State(draw(st.frozensets(st.sampled_from(ATOMS))))
    limits = tuple(draw(st.integers(-1, 8)) for _ in range(resources))
    return Task(start, condition(draw(FACTS)), tuple(operations), tuple(amounts), limits)


def holds(condition, state):
    return all(atom in state.atoms for atom in condition.needs) and not any(
        atom in state.atoms for atom in condition.denies
    )


def applied(operation, state):
    """Do an operation: where an atom becomes both, it holds afterwards."""
    if not holds(operation.condition, state):
        return None
    made = [(atom, False) for atom in operation.deletes] + [(atom, True) for atom in operation.adds]
    made += [(atom, truth) for given, atom, truth in operation.effects if holds(given, state)]
    after = {atom: atom in state.atoms for atom in ATOMS}
    after.update(sorted(made, key=itemgetter(1)))
    return State(frozenset(atom for atom, truth in after.items() if truth))


def by_exhaustion(task):
    """Return the least cost to the goal, from all that can be reached with each amount used up; None if none can."""
    if any(limit < 0 for limit in task.limits):
        return None
    cost = {(task.start, (0,) * len(task.limits)): 0}
    waiting = list(cost)
    while waiting:
        state, used = key = waiting.pop()
        for operation, (costs, *uses) in zip(task.operations, task.amounts, strict=True):
            after = applied(operation, state)
            more = tuple(map(sum, zip(used, uses, strict=True)))
            if after is None or any(
                amount > limit for amount, limit in zip(more, task.limits, strict=True)
            ):
                continue
            if cost[key] + costs < cost.get((after, more), inf):
                cost[after, more] = cost[key] + costs
                waiting.append((after, more))
    reached = [spent for (state, _), spent in cost.items() if holds(task.goal, state)]
    return min(reached, default=None)


@given(tasks())
def test_the_search_finds_what_trying_everything_finds(task):
    found = TaskGraph(task).plan(task.start, task.limits)
    assert (None if found is None else found.cost) == by_exhaustion(task)
    if found is None:
        return
    state, used = task.start, [0] * len(task.limits)
    for move in found.moves:
        state = applied(task.operations[move.what], state)
        used = [a + b for a, b in zip(used, task.amounts[move.what][1:], strict=True)]
    assert holds(task.goal, state)
    assert all(amount <= limit for amount, limit in zip(used, task.limits, strict=True))


@given(tasks())
def test_what_is_lacking_at_least_never_falls_by_more_than_a_step_takes(task):
    graph = TaskGraph(task)
    for held in product([False, True], repeat=len(ATOMS)):
        state = State(frozenset(compress(ATOMS, held)))
        cost, uses = graph.least(state)
        assert not graph.is_goal(state) or (cost, *uses) == (0,) * (1 + len(uses))
        for move in graph.moves(state):
            after, lacking = graph.least(move.to)
            assert cost <= move.cost + after
            assert all(
                one <= two + three for one, two, three in zip(uses, move.uses, lacking, strict=True)
            )


# ---------------------------------------------------------------- from PDDL to the plan

DOMAIN = """(define (domain walk) (:requirements :typing :action-costs :numeric-fluents)
  (:types place way)
  (:predicates (at ?p - place) (leads ?w - way ?from ?to - place) (closed ?w - way))
  (:functions (total-cost) - number (length ?w - way) - number (effort ?w - way) - number
              (energy) - number (energy_full) - number (noise) - number)
  (:action go
    :parameters (?w - way ?from ?to - place)
    :precondition (and (at ?from) (leads ?w ?from ?to) (not (closed ?w)))
    :effect (and (not (at ?from)) (at ?to) (increase (total-cost) (length ?w))
                 (increase (energy) (+ (effort ?w) 0.1)) (increase (noise) 1)))
  (:action clear
    :parameters (?w - way)
    :precondition (closed ?w)
    :effect (and (not (closed ?w)) (increase (noise) 2))))
"""
PROBLEM = """(define (problem to_c) (:domain walk)
  (:objects a b c - place ab bc ac - way)
  (:init (at a) (leads ab a b) (leads bc b c) (leads ac a c) (closed ab)
         (= (length ab) 2) (= (length bc) 3) (= (length ac) 1) (= (effort ab) 0) (= (effort bc) 0) (= (effort ac) 0.2)
         (= (energy) 0) (= (noise) 0) (= (energy_full) 0.3) (= (total-cost) 0))
  (:goal (and (at c) (<= (energy) (energy_full)) (<= (noise) 9)))
  (:metric minimize (total-cost)))
"""


def walk(*edits):
    domain, problem = DOMAIN, PROBLEM
    for old, new in edits:
        assert old in domain + problem
        domain, problem = domain.replace(old, new), problem.replace(old, new)
    return parse_domain(domain, problem)


def asked(domain, planner=None, **costs):
    planner = planner or Planner("label-setting", warm=False)
    return planner.plan(
        Problem(
            domain, initial_state(domain), costs={f"({name})": is_ for name, is_ in costs.items()}
        )
    )


def ways(result):
    return [attempt.way for attempt in result.attempts]


def test_a_limit_is_kept_to_the_last_decimal():
    enough = asked(walk())
    assert (enough.outcome, enough.cost, len(enough.steps)) == (Outcome.SOLVED_OPTIMALLY, 1.0, 1)
    # a tenth and two tenths are three tenths, which binary fractions do not give
    assert 0.1 + 0.2 > 0.3
    round_about = asked(walk(), energy_full=0.2999999999)
    assert (round_about.outcome, round_about.cost, len(round_about.steps)) == (
        Outcome.SOLVED_OPTIMALLY,
        5.0,
        3,
    )
    assert asked(walk(("(<= (energy)", "(< (energy)"))).cost == 5.0
    assert (
        asked(walk(("(<= (energy) (energy_full))", "(>= (- (energy_full) 0.1) (energy))"))).cost
        == 5.0
    )


def test_that_no_plan_keeps_all_limits_is_proven():
    no_way = asked(walk(("(leads bc b c) (leads ac a c)", "")))
    for result in (
        asked(walk(), energy_full=0.05),
        asked(walk(), energy_full=0.25, noise=6),
        no_way,
    ):
        assert (result.outcome, result.message) == (
            Outcome.UNSOLVABLE_PROVEN,
            "label-setting: unsolvable proven",
        )


def test_what_was_used_up_before_counts():
    assert asked(walk(), energy=-0.1, energy_full=0.2).cost == 1.0
    assert asked(walk(), energy=0.1).cost == 5.0
    assert (
        asked(walk(("(:goal (and (at c)", "(:goal (and (at a)")), energy=0.4).outcome
        is Outcome.UNSOLVABLE_PROVEN
    )


def test_other_states_limits_and_numbers_are_answered_without_a_new_translation():
    domain, planner = walk(), Planner("label-setting", cached=0)
    open_now = initial_state(domain) - {"(closed ab)"}
    goals = (domain.expression("(at b)"),)
    asked_for = [
        (Problem(domain, initial_state(domain)), 1.0),
        (Problem(domain, initial_state(domain), costs={"(energy_full)": 0.25}), 5.0),
        (Problem(domain, initial_state(domain), costs={"(effort ac)": 0.3}), 5.0),
        (Problem(domain, open_now, costs={"(length ac)": 7.5}), 5.0),
        (Problem(domain, open_now, goals), 2.0),
        (Problem(domain, initial_state(domain), costs={"(energy_full)": 0}), None),
    ]
    for problem, cost in asked_for:
        result = planner.plan(problem)
        assert (ways(result), result.cost) == (["warm"], cost), result
        cold = Planner("label-setting", warm=False).plan(problem)
        assert (cold.outcome, cold.cost) == (result.outcome, result.cost)


def test_planners_that_keep_no_limits_say_so_and_the_next_one_is_tried():
    domain = walk()
    result = asked(domain, Planner(warm=False))
    assert result.outcome is Outcome.UNSUPPORTED
    assert (
        "Fast Downward keeps no limits (of energy, noise); Planner('label-setting') does"
        in result.message
    )
    second = asked(domain, Planner(warm=False, fallback=["label-setting"]))
    assert (second.outcome, second.engine, second.cost) == (
        Outcome.SOLVED_OPTIMALLY,
        "label-setting",
        1.0,
    )
    unlimited = walk((" (<= (energy) (energy_full)) (<= (noise) 9)", ""))
    assert asked(unlimited, Planner(warm=False)).cost == asked(unlimited).cost == 1.0


def test_steps_that_overlap_are_not_for_it():
    for settings_ in (
        {"engine": "label-setting"},
        {"engine": "aries", "fallback": ["label-setting"]},
    ):
        with pytest.raises(
            PlannerSettingError, match="label-setting plans one step after the other"
        ):
            Planner(overlapping=True, **settings_)


def test_numbers_that_make_no_sense_are_told_by_name():
    assert (
        "(effort ac) comes to -1"
        in asked(walk(("(+ (effort ?w) 0.1)", "(effort ?w)")), **{"effort ac": -1}).message
    )
    assert (
        "(energy_full) is nan, expected a finite number"
        in asked(walk(), energy_full=float("nan")).message
    )
    missing = asked(walk(("(= (effort bc) 0)", "")))
    assert missing.outcome is Outcome.UNSUPPORTED
    assert (
        "(effort bc) is needed but has no value; state '(= (effort bc) NUMBER)' in :init"
        in missing.message
    )


def test_a_search_beyond_its_cap_is_a_process_that_is_ended_if_late_or_too_large_and_has_a_name(
    monkeypatch,
):
    asked, ask = [], ProcessHandle.ask
    monkeypatch.setattr(
        ProcessHandle,
        "ask",
        lambda self, command, **given: asked.append(command[-1]) or ask(self, command, **given),
    )
    names = [f"s{number}" for number in range(40)]
    actions = [
        f"(:action on_{one} :effect (and ({one}) (increase (used) {2**k})))"
        for k, one in enumerate(names)
    ]
    domain = parse_domain(
        f"""(define (domain lamps) (:predicates {" ".join(f"({name})" for name in names)}) (:functions (used))
        {" ".join(actions)})""",
        f"""(define (problem p) (:domain lamps) (:init (= (used) 0))
        (:goal (and {" ".join(f"({name})" for name in names)} (<= (used) {2**40}))))""",
    )
    problem = Problem(domain, initial_state(domain))
    beyond = {"moves": 1000, "warm": False}
    for timeout_s in (
        0.5,
        4.0,
    ):  # on a busy machine nothing of a short time may be left for the process
        late = Planner("label-setting", timeout_s=timeout_s, **beyond).plan(problem)
        assert late.outcome is Outcome.OUT_OF_TIME, late
        if asked:
            break
    large = Planner("label-setting", timeout_s=300.0, memory_mb=24, **beyond).plan(problem)
    assert large.outcome is Outcome.OUT_OF_MEMORY, large
    assert [Path(program).name for program in asked] == ["search.py", "search.py"]


# ---------------------------------------------------------------- random domains


@st.composite
def domains(draw):
    """Write a small random domain with resources; what is limited, and how much, differs."""
    resources = draw(st.integers(0, 2))
    numbers = ["r0", "r1"][:resources]
    amount = st.sampled_from(["0", "0.5", "(f ?x)", "(* 2 (f ?y))"])
    literal = st.tuples(st.sampled_from(["(p ?x)", "(q ?x)", "(p ?y)", "(s)"]), st.booleans())

    def written(literals):
        return " ".join(atom if is_true else f"(not {atom})" for atom, is_true in literals)

    actions = []
    for number in range(draw(st.integers(1, 4))):
        needs = draw(st.lists(literal, max_size=2))
        every = "(forall (?z - t) (or (p ?z) (s)))" if draw(st.integers(0, 4)) == 0 else ""
        effects = draw(st.lists(literal, min_size=1, max_size=2, unique_by=lambda one: one[0]))
        when = "(when (q ?y) (s))" if draw(st.integers(0, 4)) == 0 else ""
        amounts = [f"(increase ({one}) {draw(amount)})" for one in numbers]
        cost = draw(st.sampled_from(["0", "1", "(c ?x)"]))
        actions.append(f"""(:action a{number} :parameters (?x ?y - t) :precondition (and {written(needs)} {every})
          :effect (and {written(effects)} {when} {" ".join(amounts)} (increase (total-cost) {cost})))""")
    goal = draw(st.sampled_from(["(s)", "(p o0) (not (q o1))", "(p o1) (s)", "(or (p o0) (q o1))"]))
    limits = " ".join(
        f"(<= ({one}) {draw(st.sampled_from(['0', '0.5', '1.2', '3']))})" for one in numbers
    )
    domain = f"""(define (domain d) (:types t) (:predicates (p ?x - t) (q ?x - t) (s))
      (:functions (total-cost) (c ?x - t) (f ?x - t) {" ".join(f"({one})" for one in numbers)}) {" ".join(actions)})"""
    problem = f"""(define (problem p) (:domain d) (:objects o0 o1 - t)
      (:init (p o0) {" ".join(f"(= ({one}) 0)" for one in numbers)} (= (total-cost) 0)
       (= (c o0) 1) (= (c o1) 2.5) (= (f o0) 0.3) (= (f o1) 0.6))
      (:goal (and {goal} {limits})) (:metric minimize (total-cost)))"""
    return domain, problem


def exhausted(domain):
    """Return the least cost by trying all steps from all states, as the judge of plans understands them."""
    told = {
        "c": {"o0": 1, "o1": Fraction(5, 2)},
        "f": {"o0": Fraction(3, 10), "o1": Fraction(3, 5)},
    }
    steps = [
        domain.step(name, objects)
        for name in domain.schemas
        for objects in product(domain.objects_of("t"), repeat=2)
    ]

    def amount(expression, step):
        if expression is None:
            return Fraction(0)
        if expression.is_constant():
            return Fraction(expression.constant_value())
        if expression.is_times():
            return amount(expression.arg(0), step) * amount(expression.arg(1), step)
        which = dict(zip("xy", step.arguments, strict=True))[expression.arg(0).parameter().name]
        return Fraction(told[expression.fluent().name][which])

    price = {step: amount(domain.schema_of[step.schema].cost, step) for step in steps}
    uses = {
        step: [amount(domain.schema_of[step.schema].uses.get(one), step) for one in domain.limited]
        for step in steps
    }
    limits = [Fraction(one.arg(1).constant_value()) for one in domain.limits]
    start = initial_state(domain), tuple(Fraction(0) for _ in limits)
    cost, waiting = {start: Fraction(0)}, [start]
    while waiting:
        state, used = key = waiting.pop()
        for step in steps:
            more = tuple(map(sum, zip(used, uses[step], strict=True)))
            if any(one > most for one, most in zip(more, limits, strict=True)):
                continue
            if missing_at_start(domain, step, state) is None:
                after = ended(domain, step, state), more
                if cost[key] + price[step] < cost.get(after, inf):
                    cost[after] = cost[key] + price[step]
                    waiting.append(after)
    reached = [spent for (state, _), spent in cost.items() if flaw(domain, (), state) is None]
    return min(map(float, reached), default=None)


@settings(max_examples=10)
@given(domains())
def test_in_random_domains_it_finds_what_trying_everything_finds(texts):
    domain = parse_domain(*texts)
    problem = Problem(domain, initial_state(domain))
    result = Planner("label-setting").plan(problem)
    assert not result.outcome.is_trouble, result.message
    assert result.cost == exhausted(domain)
    if not domain.limits:
        optimal = Planner().plan(problem)
        assert (optimal.outcome, optimal.cost) == (result.outcome, result.cost)
