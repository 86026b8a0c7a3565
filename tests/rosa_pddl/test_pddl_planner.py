import gc
import os
import subprocess
import sys
import threading
import weakref
from concurrent.futures import CancelledError
from pathlib import Path

import pytest
from brute_force import fewest_steps
from hypothesis import given, settings
from hypothesis import strategies as st
from pddl_world import ROOMS_DOMAIN, ROOMS_PROBLEM, FakeKb, load_mission, load_text

from rosa_pddl import (
    Outcome,
    Planner,
    PlannerSettingError,
    Problem,
    SensingError,
    feasible_atoms,
    initial_state,
    parse_domain,
    worker,
)
from rosa_pddl.validate import flaw


def problem_of(domain, unfeasible=(), facts=()):
    kb = FakeKb(domain.rosa_actions)
    kb.unfeasible = set(unfeasible)
    return Problem(domain, initial_state(domain) | feasible_atoms(domain, kb) | frozenset(facts))


def names(result):
    return [step.schema for step in result.steps]


BOTH = ("search_pipeline", "inspect_pipeline")


@pytest.mark.parametrize(
    ("unfeasible", "facts", "expected"),
    [
        ((), (), ["search_pipeline", "inspect_pipeline"]),
        ((), ("(pipeline_found pipeline)",), ["inspect_pipeline"]),
        (BOTH, (), ["recharge", "search_pipeline", "inspect_pipeline"]),
        (BOTH, ("(pipeline_found pipeline)",), ["recharge", "inspect_pipeline"]),
        (("recharge",), (), ["search_pipeline", "inspect_pipeline"]),
    ],
)
def test_the_plan_of_the_extended_mission_follows_feasibility_and_facts(
    extended, unfeasible, facts, expected
):
    result = Planner().plan(problem_of(extended, unfeasible, facts))
    assert (result.outcome, names(result)) == (Outcome.SOLVED_OPTIMALLY, expected)
    assert [step.action for step in result.steps] == expected
    assert result.message == ""


def test_nothing_feasible_is_proven_unsolvable(extended):
    result = Planner().plan(problem_of(extended, (*BOTH, "recharge")))
    assert (result.outcome, result.steps) == (Outcome.UNSOLVABLE_PROVEN, ())
    assert not result.outcome.is_solved


def test_the_base_mission_cannot_recharge():
    domain = load_mission("suave")
    assert names(Planner().plan(problem_of(domain))) == ["search_pipeline", "inspect_pipeline"]
    assert Planner().plan(problem_of(domain, BOTH)).outcome is Outcome.UNSOLVABLE_PROVEN


def test_the_satisficing_engine_says_solved_only(extended):
    result = Planner("fast-downward").plan(problem_of(extended))
    assert (result.outcome, names(result)) == (
        Outcome.SOLVED,
        ["search_pipeline", "inspect_pipeline"],
    )


def test_effects_at_start_and_quantified_conditional_effects_are_planned(rooms):
    result = Planner().plan(problem_of(rooms))
    assert result.outcome is Outcome.SOLVED_OPTIMALLY
    assert names(result) == ["scan", "move", "clean", "scan"]


COSTS = """(define (domain tour) (:requirements :action-costs)
  (:predicates (half) (done)) (:functions (total-cost) - number)
  (:action first :effect (and (half) (increase (total-cost) 1)))
  (:action second :precondition (half) :effect (and (done) (increase (total-cost) 1)))
  (:action short :effect (and (done) (increase (total-cost) 5))))"""
COSTS_PROBLEM = "(define (problem p) (:domain tour) (:init (= (total-cost) 0)) (:goal (done)) %s)"


@pytest.mark.parametrize(
    ("metric", "expected"),
    [("(:metric minimize (total-cost))", ["first", "second"]), ("", ["short"])],
)
def test_the_cheapest_plan_if_there_is_a_metric_the_shortest_if_not(metric, expected, tmp_path):
    domain = load_text(tmp_path, COSTS, COSTS_PROBLEM % metric)
    assert names(Planner().plan(Problem(domain, initial_state(domain)))) == expected


@pytest.mark.parametrize(("speed", "expected"), [(0.1, ["walk"]), (0.3, ["drive"])])
def test_costs_are_computed_from_numbers_as_they_are_now(speed, expected):
    domain = parse_domain(
        """(define (domain d) (:predicates (there)) (:functions (total-cost) (way) (speed) (effort))
        (:action walk :parameters () :effect (and (there) (increase (total-cost) (* (way) (effort)))))
        (:action drive :parameters () :effect (and (there) (increase (total-cost) (/ (way) (speed))))))""",
        """(define (problem p) (:domain d) (:init (= (way) 3) (= (effort) 4)) (:goal (there))
        (:metric minimize (total-cost)))""",
    )
    found = Planner().plan(Problem(domain, frozenset(), costs={"(speed)": speed}))
    assert (names(found), found.cost) == (expected, 12.0 if speed == 0.1 else 10.0)


def test_durations_as_metric_come_down_to_the_number_of_steps(tmp_path):
    domain = load_text(
        tmp_path, ROOMS_DOMAIN, ROOMS_PROBLEM.rstrip()[:-1] + "(:metric minimize (total-time)))"
    )
    assert names(Planner().plan(problem_of(domain))) == ["scan", "move", "clean", "scan"]


# ------------------------------------------------------------------ trouble


def test_an_engine_that_is_not_installed_is_named_with_what_to_install(extended, monkeypatch):
    monkeypatch.setattr("rosa_pddl.engines.fast_downward_command", tuple)
    result = Planner(moves=0).plan(problem_of(extended))
    assert result.outcome is Outcome.ENGINE_MISSING
    assert "pip install up-fast-downward" in result.message
    assert Planner().missing() in result.message


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"engine": "fast-downwards"}, "nearest: fast-downward"),
        ({"engine": "lama"}, "ours are fast-downward-opt, fast-downward and kairos"),
        ({"engine": ""}, "no planning engine ''"),
        ({"engine": 3}, "no planning engine 3"),
        ({"timeout_s": "x"}, "timeout_s is 'x', expected seconds"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused_with_what_would_do(settings, words):
    with pytest.raises(PlannerSettingError, match=words):
        Planner(**settings)


def test_an_engine_that_needs_more_time_is_told_with_others_to_try(extended):
    result = Planner(timeout_s=1e-6, moves=0).plan(problem_of(extended))
    assert result.outcome is Outcome.OUT_OF_TIME
    assert "another engine may be quicker: 'fast-downward'" in result.message


@pytest.mark.parametrize(("goal", "cost"), [("c", 5.0), ("a", None)])
def test_steps_whose_cost_has_no_value_are_left_to_kairos(goal, cost):
    domain = """(define (domain shop) (:types place)
      (:predicates (at ?p - place) (been ?p - place)) (:functions (total-cost) (toll ?a ?b - place))
      (:action go :parameters (?a ?b - place) :precondition (at ?a)
        :effect (and (not (at ?a)) (at ?b) (been ?b) (increase (total-cost) (toll ?a ?b)))))"""
    problem = f"""(define (problem p) (:domain shop) (:objects a b c - place)
      (:init (at a) (= (toll a b) 2) (= (toll b c) 3)) (:goal (been {goal}))
      (:metric minimize (total-cost)))"""
    result = Planner().plan(problem_of(parse_domain(domain, problem)))
    assert (result.cost, result.outcome.is_solved) == (cost, cost is not None)
    assert cost or "(toll a a) is needed but has no value" in result.message


def test_what_is_only_left_out_is_no_proof():
    domain = parse_domain(
        "(define (domain d) (:predicates (lit)) (:action light :effect (lit)))",
        "(define (problem p) (:domain d) (:init) (:goal (lit)))",
    )
    problem = Problem(domain, frozenset(), weights={domain.step("light", ()): 0})
    result = Planner().plan(problem)
    assert result.outcome is Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
    assert "without the steps that are left out" in result.message


def program(tmp_path, script):
    file = tmp_path / "program"
    file.write_text(f"#!/bin/sh\n{script}\n")
    file.chmod(0o755)
    return file


@pytest.mark.parametrize(
    ("script", "outcome", "words"),
    [
        ("echo no plan here", Outcome.ENGINE_CRASHED, "no plan here"),
        ("echo oh dear >&2; exit 35", Outcome.ENGINE_CRASHED, "oh dear"),
        ("exit 12", Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN, ""),
        ("exit 22", Outcome.OUT_OF_MEMORY, "exit code 22"),
        ("exit 23", Outcome.OUT_OF_TIME, "exit code 23"),
        ("echo not this; exit 34", Outcome.UNSUPPORTED, "not this"),
        ("echo oh dear; kill -9 $$", Outcome.ENGINE_CRASHED, "ended with exit code -9"),
    ],
)
def test_whatever_fast_downward_does_has_a_name(monkeypatch, tmp_path, script, outcome, words):
    search = program(tmp_path, script)
    monkeypatch.setattr(worker, "fast_downward_command", lambda: (str(search),))
    monkeypatch.chdir(tmp_path)
    answer = worker.solve(
        {"engine": "fast-downward-opt", "domain": "", "problem": "", "limit_s": 1.0}
    )
    assert Outcome(answer["outcome"]) is outcome
    assert words in answer["message"]
    assert answer["plan"] == []


@pytest.fixture
def slow(tmp_path, monkeypatch):
    """An engine with a child that never ends, so that a kill has to reach the whole group."""
    script = tmp_path / "slow.py"
    script.write_text(
        f"""import subprocess
child = subprocess.Popen(["sleep", "1000"])
print(child.pid, file=open({str(tmp_path / "child")!r}, "w"), flush=True)
child.wait()
"""
    )
    monkeypatch.setattr("rosa_pddl.engines.WORKER", script)


def is_alive(pid):
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def is_begun(tmp_path):
    return (tmp_path / "child").exists() and (tmp_path / "child").read_text().endswith("\n")


def child_of(tmp_path):
    for _ in range(12_000):
        if is_begun(tmp_path):
            return int((tmp_path / "child").read_text())
        threading.Event().wait(0.01)
    raise AssertionError("the engine never began")


def wait_until_dead(pid):
    for _ in range(12_000):
        if not is_alive(pid):
            return
        threading.Event().wait(0.01)
    raise AssertionError(f"process {pid} lives on")


def test_out_of_time_ends_every_process_of_the_engine(extended, slow, tmp_path):
    for timeout_s in (
        0.5,
        4.0,
        32.0,
        256.0,
    ):  # on a busy machine the engine may not begin in a short time
        result = Planner(timeout_s=timeout_s, moves=0).plan(problem_of(extended))
        assert result.outcome is Outcome.OUT_OF_TIME
        if is_begun(tmp_path):
            break
    wait_until_dead(child_of(tmp_path))


def test_cancelling_ends_every_process_of_the_engine(extended, slow, tmp_path):
    before = set(threading.enumerate())
    future = Planner(moves=0, timeout_s=1000.0).start(problem_of(extended))
    thread = next(
        thread
        for thread in set(threading.enumerate()) - before
        if thread.name.startswith("planner fast")
    )
    child = child_of(tmp_path)
    assert future.cancel()
    thread.join(120.0)
    assert not thread.is_alive()
    wait_until_dead(child)
    with pytest.raises(CancelledError):
        future.result()


def test_closing_the_planner_ends_what_runs(extended, slow, tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    planner = Planner(moves=0, timeout_s=1000.0)
    future = planner.start(problem_of(extended))
    child = child_of(tmp_path)
    planner.close()
    assert "closed" in future.result(120.0).message
    wait_until_dead(child)
    assert list(folder.iterdir()) == []


def test_domain_that_was_grounded_is_kept_as_its_identity_counts():
    # another domain at the same place in memory would get its steps
    planner = Planner()
    domain = parse_domain(
        "(define (domain d) (:predicates (p) (q)) (:action go :precondition (p) :effect (q)))",
        "(define (problem e) (:domain d) (:init (p)) (:goal (q)))",
    )
    assert planner.plan(problem_of(domain)).outcome.is_solved
    reference = weakref.ref(domain)
    del domain
    gc.collect()
    assert reference() is not None


def test_planning_prints_nothing(extended, capfd):
    assert Planner().plan(problem_of(extended)).outcome.is_solved
    assert capfd.readouterr() == ("", "")


def test_the_plan_does_not_depend_on_the_hash_seed(tmp_path):
    objects = " ".join(f"x{number}" for number in range(6))
    domain = """(define (domain many) (:types thing) (:predicates (used ?x - thing) (done))
      (:action use :parameters (?x - thing) :effect (and (used ?x) (done))))"""
    problem = (
        f"(define (problem p) (:domain many) (:objects {objects} - thing) (:init ) (:goal (done)))"
    )
    load_text(tmp_path, domain, problem)
    code = (
        "from rosa_pddl import *; d = load_domain('domain.pddl', 'problem.pddl');"
        "print(*Planner().plan(Problem(d, initial_state(d))).steps)"
    )
    outputs = set()
    for seed in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONHASHSEED": seed,
            "PYTHONPATH": str(Path(__file__).parents[2]),
        }
        run = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert run.stdout.startswith("use(x"), run.stderr
        outputs.add(run.stdout)
    assert len(outputs) == 1


def test_what_is_searched_here_is_loaded_and_planned_without_the_engines_of_unified_planning():
    code = (
        "import sys; from pathlib import Path; import missions.suave_extended as m; from rosa_pddl import *\n"
        "folder = Path(m.__file__).parent; d = load_domain(folder / 'domain.pddl', folder / 'problem.pddl')\n"
        "assert Planner().plan(Problem(d, initial_state(d))).outcome is Outcome.UNSOLVABLE_PROVEN\n"
        "print([name for name in ('unified_planning.engines', 'scipy.stats') if name in sys.modules])"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert run.stdout.strip() == "[]", run.stdout + run.stderr


# ------------------------------------------------------------------ laws


@settings(max_examples=8, deadline=None)
@given(data=st.data())
@pytest.mark.parametrize("which", ["rooms", "extended"])
def test_plans_are_as_short_as_those_of_the_naive_twin(request, which, data):
    domain = request.getfixturevalue(which)
    changeable = {
        "rooms": ["(lit hall)", "(broken hall)", "(scanned hall)"],
        "extended": ["(pipeline_found pipeline)"],
    }
    facts = data.draw(st.sets(st.sampled_from(changeable[which])))
    unfeasible = data.draw(st.sets(st.sampled_from(domain.rosa_actions)))
    problem = problem_of(domain, unfeasible, facts)
    result = Planner().plan(problem)
    expected = fewest_steps(domain, problem.state)
    assert result.outcome is (
        Outcome.UNSOLVABLE_PROVEN if expected is None else Outcome.SOLVED_OPTIMALLY
    )
    assert len(result.steps) == (expected or 0)
    assert expected is None or flaw(domain, result.steps, problem.state) is None


def test_cost_that_is_no_number_is_refused_by_its_name():
    domain = parse_domain(
        "(define (domain d) (:predicates (done)) (:functions (far)) (:action go :effect (done)))",
        "(define (problem p) (:domain d) (:goal (done)))",
    )
    for wrong in (None, "3", [3]):
        with pytest.raises(SensingError, match=r"\(far\) is .*, expected a finite number"):
            Problem(domain, initial_state(domain), costs={"(far)": wrong})
