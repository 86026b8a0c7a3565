"""Verification: what can happen is found, what is wrong is found with the shortest story, and what is right is silent.

The whole of the mutants and of the twin's missions is in tests/benchmarks/test_proof_whole.py.
"""

import json
import operator
import os
import pickle
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path
from subprocess import PIPE
from types import SimpleNamespace

import pytest
from proof_mutants import CORRECT, FULL, MUTANTS, Act, Keeps, either, rover_model, until
from proof_replay import replayed
from proof_twin import agree, random_setup
from py_trees.behaviours import CheckBlackboardVariableValue, Running, SetBlackboardVariable
from py_trees.blackboard import Blackboard
from py_trees.common import ComparisonExpression, OneShotPolicy, Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import OneShot
from typer.testing import CliRunner

from kb import KnowledgeBase, Model, UnknownName
from kb.knowledge import Knowledge
from missions import cli
from missions.engine.mission import MissionError
from missions.engine.task_layer import by_schema
from missions.proof import Leaf, eventually, exploration, leads_to, never, verify
from missions.proof.exploration import Exploration
from missions.proof.memory import Memory
from missions.proof.rig import Rig, Setup, Surroundings, nodes
from missions.proof.rounds import CAN_COPY, Rounds
from missions.proof.story import as_test
from missions.proof.verification import prove, setup_of
from missions.suave import MISSION as SUAVE
from missions.suave.tree import InspectPipeline, SearchPipeline
from missions.suave_extended import MISSION
from missions.suave_extended.tree import Recharge
from missions.uav import MISSION as UAV
from rosa_bt import do_until_unfeasible
from rosa_bt.decorators import UntilSuccess
from rosa_pddl import PlanExecutor

NAMED = {case.name: case for case in (*MUTANTS, *CORRECT)}
PATIENCE_S = 120.0  # a busy machine is no failure


@pytest.fixture(autouse=True)
def one_processor(monkeypatch):
    """The others are for other tests; where several processes are to explore, it is said how many."""
    monkeypatch.setattr(exploration.os, "sched_getaffinity", lambda _: {0})


def proof_of(name, **given):
    case = NAMED[name]
    return verify(case.build, case.model, wanted=case.wanted, **{**FULL, **case.given, **given})


@pytest.mark.parametrize(
    "name",
    [
        "no guard",
        "guard asks for a status",
        "gives up for ever",
        "request kept",
        "no design",
        "chooses what has failed",
    ],
)
def test_seeded_bug_is_found_and_its_story_is_replayed(name):
    proof = proof_of(name)
    found = next(one for one in proof.broken if NAMED[name].broken in one.name)
    assert found.what
    stories = [(one, proof.story(one)) for one in proof.broken if one.trail is not None]
    for one, story in stories:
        assert replayed(proof.setup, story, one.trail) == story.trace
        assert len(story.trace.ticks) == len(one.trail)
    assert any(story for _, story in stories) or found.trail is None


@pytest.mark.parametrize("name", ["either", "steps that need what has failed since"])
def test_correct_mission_has_nothing_wrong(name):
    proof = proof_of(name)
    assert proof.found.is_finished
    assert not proof.broken, proof
    assert all(one.holds for one in proof.findings)


@pytest.mark.parametrize("seed", [5, 8])
def test_exploring_anew_from_the_beginning_finds_the_same(seed):
    assert agree(seed, rounds=2) > 20


def edges(setup, *, is_on=None):
    """Return all that was explored, as it is there to see, and whether ticks could be followed."""
    found = Exploration(setup)
    found.rig.tape.is_on = found.rig.tape.is_on if is_on is None else is_on
    found.explore(seconds=600.0)
    assert found.is_finished
    seen = [(one.facts, one.doing) for one in found.states]
    rounds = {
        (seen[before], step, seen[after])
        for before in range(len(found.situations))
        for step, _, after in found.following(before)
    }
    return (rounds, set(found.faults), found.transitions), found.rig.tape.is_on


@pytest.mark.parametrize(
    "setup", [setup_of(SUAVE, "pddl"), setup_of(UAV, failing=()), *map(random_setup, (1, 2, 3, 10))]
)
def test_tick_that_is_followed_is_as_if_it_were_run(setup):
    followed, is_on = edges(setup)
    assert is_on
    assert followed == edges(setup, is_on=False)[0]


@pytest.mark.parametrize(
    ("mission", "task", "situations", "transitions"),
    [(SUAVE, "bt", 82, 907), (SUAVE, "pddl", 168, 1598), (MISSION, "bt", 332, 5803)],
)
def test_a_mission_has_as_many_situations_as_the_page_says(mission, task, situations, transitions):
    """More of them: something that decides nothing is remembered, such as how a request was that has ended."""
    found = Exploration(setup_of(mission, task)).explore(seconds=600.0)
    assert (len(found.situations), found.transitions) == (situations, transitions)


def all_of(found):
    """Return all that an exploration has found."""
    holds = [sorted(one) for one in found.holds.values()]
    paths = [found.path(number) for number in range(len(found.situations))]
    nodes_ = sorted(one.name for one in found.rig.ticked)
    onward = [[*found.following(number)] for number in range(len(found.situations))]
    return found.situations, paths, onward, found.faults, holds, found.transitions, nodes_


BESIDE = NAMED["request beside the tree"]
SHARED = [
    setup_of(SUAVE, "pddl"),
    setup_of(MISSION, at_once=2, failing=()),
    random_setup(10),
    Setup(BESIDE.model, BESIDE.build, start=FULL["start"]),
]


ASKED = (lambda rig: bool(rig.required), lambda rig: rig.root.status is Status.RUNNING)


@cache
def all_found_alone(number):
    """Return all that one process finds of a setup, once for all tests."""
    return all_of(Exploration(SHARED[number], ASKED).explore(seconds=600.0, cores=1))


@pytest.mark.skipif(not CAN_COPY, reason="where a process cannot begin as a copy, one explores")
@pytest.mark.parametrize("number", range(len(SHARED)))
def test_several_processes_find_what_one_finds(number, monkeypatch):
    alone = all_found_alone(number)
    monkeypatch.setattr(exploration, "_ALONE_S", 0.0)
    shared = Exploration(SHARED[number], ASKED).explore(seconds=600.0, cores=2)
    assert shared.is_finished
    assert all_of(shared) == alone


@pytest.mark.parametrize("number", range(len(SHARED)))
def test_exploration_goes_on_from_a_file(number, monkeypatch):
    whole = all_found_alone(number)
    monkeypatch.setattr(exploration, "_ALONE_S", 0.0)
    found = Exploration(SHARED[number], ASKED)
    while not found.is_finished:
        before, found = found, Exploration(SHARED[number], ASKED)
        most, cores = len(before.situations) + len(whole[0]) // 3, 1 + number % 2
        found.go_on_from(before.explore(most=most, cores=cores).as_bytes())
        found.explore(most=len(found.situations))
    assert all_of(found) == whole


COPIES = """
import multiprocessing
from missions.proof import exploration
from missions.proof.exploration import Exploration
from missions.proof.verification import setup_of
from missions.suave_extended import MISSION
exploration._ALONE_S, explore = 0.0, exploration.Workers.explore
def told(self, ways):
    explore(self, ways)
    print(*(one.pid for one in multiprocessing.active_children()), flush=True)
exploration.Workers.explore = told
Exploration(setup_of(MISSION, slow=True)).explore(seconds=60.0, cores=2)
"""


def is_alive(pid):
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.skipif(not CAN_COPY, reason="where a process cannot begin as a copy, one explores")
def test_no_process_is_left_when_the_program_is_killed_and_none_waits_for_one_that_was():
    for is_parent in (True, False):
        with subprocess.Popen(
            [sys.executable, "-c", COPIES], stdout=PIPE, stderr=PIPE, text=True
        ) as program:
            copies = [int(one) for one in program.stdout.readline().split()]
            assert all(map(is_alive, copies))
            os.kill(program.pid if is_parent else copies[0], signal.SIGKILL)
            said = program.communicate(timeout=PATIENCE_S)[1]
        assert (
            is_parent
            or "a process that explores has died; if memory ran out, use fewer --cores" in said
        )
        end = time.monotonic() + PATIENCE_S
        while any(map(is_alive, copies)) and time.monotonic() < end:
            time.sleep(0.05)
        assert not any(map(is_alive, copies))


def test_exploration_goes_on_from_no_file_of_a_tree_or_of_leaves_that_do_otherwise_now(
    tmp_path, monkeypatch
):
    case = NAMED["no guard"]
    setup = Setup(case.model, case.build, start=FULL["start"])
    kept = Exploration(setup).explore().as_bytes()
    found = Exploration(setup)
    found.go_on_from(kept)
    assert found.is_finished
    for changed in (
        replace(setup, build=NAMED["either"].build),
        replace(setup, leaves={"explore": Leaf("F")}),
    ):
        with pytest.raises(MissionError, match="changed since"):
            Exploration(changed).go_on_from(kept)
    monkeypatch.setattr(exploration, "_ALONE_S", 0.0)
    found.go_on_from(kept)
    monkeypatch.setitem(
        sys.modules, "edited", SimpleNamespace(__file__=str(tmp_path / "edited.py"))
    )
    (tmp_path / "edited.py").write_text("")
    with pytest.raises(MissionError, match="changed since"):
        Exploration(setup).go_on_from(kept)


def test_exploration_goes_on_from_no_file_in_which_a_bit_is_wrong():
    kept = bytearray(Exploration(setup_of(SUAVE)).explore(most=10).as_bytes())
    for place in range(12, len(kept), 397):
        kept[place] ^= 4
        with pytest.raises(MissionError, match="not a saved exploration"):
            Exploration(setup_of(SUAVE)).go_on_from(bytes(kept))
        kept[place] ^= 4


def test_file_of_another_mission_is_not_gone_on_from():
    text = Exploration(setup_of(SUAVE)).explore(most=20).as_bytes()
    for other in (
        setup_of(MISSION),
        setup_of(SUAVE, "pddl"),
        setup_of(SUAVE, failures=2),
        setup_of(SUAVE, slow=True),
    ):
        with pytest.raises(MissionError, match="of another mission"):
            Exploration(other).go_on_from(text)
    for broken in (b"", b"{}", text[: len(text) // 2], pickle.dumps((1, 2)), pickle.dumps(Path())):
        with pytest.raises(MissionError, match="not a saved exploration"):
            Exploration(setup_of(SUAVE)).go_on_from(broken)


def test_mission_that_does_otherwise_now_is_not_gone_on_with():
    done = []

    class Moody(Act):
        def update(self):
            return Status.SUCCESS if done else Status.RUNNING

    setup = Setup(
        rover_model(),
        lambda kb: until(Moody("explore", kb, "explore")),
        leaves={"explore": Leaf("")},
    )
    text = Exploration(setup).explore(most=4).as_bytes()
    Exploration(setup).go_on_from(text)
    done.append(True)
    with pytest.raises(MissionError, match="changed since"):
        Exploration(setup).go_on_from(text)


def test_what_is_on_the_blackboard_belongs_to_a_situation():
    def once(kb):
        done = CheckBlackboardVariableValue(
            "done?", ComparisonExpression("explored", True, operator.eq)
        )
        note = SetBlackboardVariable("note", "explored", True, overwrite=True)
        return until(
            Selector(
                "mission",
                memory=False,
                children=[
                    Sequence("after", memory=False, children=[done, Act("charge", kb, "charge")]),
                    Sequence("first", memory=False, children=[Act("explore", kb, "explore"), note]),
                ],
            )
        )

    Blackboard.set("explored", True)
    try:
        for _ in range(2):
            proof = verify(once, rover_model(), **FULL)
            never_ticked = next(
                one for one in proof.findings if one.name == "every node of the tree can be reached"
            )
            assert never_ticked.holds is False
            assert never_ticked.what == "never ticked: charge", (
                "the mission ends as soon as it is noted"
            )
    finally:
        Blackboard.clear()


class Peculiar(Act):
    """Takes from the knowledge base what is no value and is not asked anew, each in its own way."""

    def __init__(self, kb, way):
        super().__init__("explore", kb, "explore")
        self.way, self.view = way, kb.actions["explore"]

    def update(self):
        if self.way == "asks a situation":
            return (
                Status.SUCCESS
                if self.kb.situation(measure={"energy": 0.0}).is_feasible("charge")
                else Status.RUNNING
            )
        if self.way == "reads the state":
            with self.kb.reading() as state:
                return Status.SUCCESS if any(state.failed) else Status.RUNNING
        if self.way == "prefers by weight":
            self.kb.request_action("charge", {"energy": 1.0})
        elif self.way == "asks for what is not there":
            with suppress(UnknownName):
                self.kb.is_feasible("fly")
        return (
            Status.SUCCESS
            if self.view.status != "solved" or self.view in self.kb.actions.values()
            else Status.FAILURE
        )


@pytest.mark.parametrize(
    ("way", "is_followed"),
    [
        ("asks a situation", False),
        ("reads the state", False),
        ("prefers by weight", False),
        ("asks for what is not there", False),
        ("asks views", True),
    ],
)
def test_tree_that_takes_more_than_values_is_run_each_time(way, is_followed):
    setup = Setup(
        rover_model(),
        lambda kb: until(Peculiar(kb, way)),
        leaves={"explore": Leaf("")},
        start=FULL["start"],
    )
    found, is_on = edges(setup)
    assert is_on is is_followed
    assert found == edges(setup, is_on=False)[0]


def test_stories_are_the_shortest():
    proof = proof_of("no guard")
    (found,) = (one for one in proof.broken if "unfeasible" in one.name)
    assert len(found.trail) == 2, "it begins, and then the energy drops"
    assert [str(change) for change in found.trail[1].changes] == ["energy is measured 0.125"]
    story = proof.story(found)
    assert story.wrong == ("explore is requested while it is unfeasible",)
    assert "  2. energy is measured 0.125; explore RUNNING" in story.lines


def test_later_reaction_is_allowed_if_it_is_stated():
    def slowly(kb):
        return until(
            do_until_unfeasible(
                Act("explore", kb, "explore", even_if_unfeasible=True), Act("c", kb, "charge")
            )
        )

    once = verify(slowly, rover_model(), start=FULL["start"], leaves={"explore": Leaf("F")})
    assert not [one for one in once.broken if "unfeasible" in one.name]
    always_ = verify(lambda kb: NAMED["no guard"].build(kb), rover_model(), reaction=3, **FULL)
    (found,) = (one for one in always_.broken if "unfeasible" in one.name)
    assert found.name.endswith("longer than 3 ticks")
    assert len(found.trail) == 4


def test_state_is_read_and_written_back():
    found = Exploration(
        Setup(MISSION.model, lambda kb: MISSION.tree(kb, None), surroundings={"failures": 0})
    )
    found.explore(most=60)
    assert len(found.situations) >= 60
    rig = found.load(0)
    tree, known = Memory([rig.root], apart=[rig.kb]), Memory([rig.kb])
    before = tree.read(), known.read()
    rig.choices.begin(())
    rig.runner.tick()
    rig.settle()
    assert tree.read() != before[0]
    assert known.read() != before[1]
    tree.write(before[0])
    known.write(before[1])
    assert (tree.read(), known.read()) == before
    assert rig.required == ()


def test_state_is_that_without_an_event_that_was_interrupted():
    kb = KnowledgeBase(rover_model()())
    known, memory = kb._knowledge, Memory([kb])
    number = memory.read()
    known._open()
    known.state.put(known.state.failed, 0, True)
    assert memory.read() == number


def test_what_is_left_out_of_a_state_is_not_left_from_another():
    """How an earlier round ended made uav's task seem to give way: `gave_way` looks at all that has failed."""
    root = Sequence("root", memory=True, children=[Running("find"), Running("analyse")])
    memory = Memory([root])
    number = memory.read()
    root.children[1].status = Status.FAILURE
    assert memory.read() == number
    assert root.children[1].status is Status.INVALID


def test_what_cannot_be_restored_is_named():
    class Walks(Act):
        def stop(self, new_status):
            super().stop(new_status)
            self.way = iter([1, 2])

    with pytest.raises(MissionError, match=r"list_iterator.* cannot be restored"):
        verify(lambda kb: either(kb, Walks("explore", kb, "explore")), rover_model(), **FULL)


def test_bookkeeping_that_a_class_does_not_have_is_named():
    class Walks(Act):
        BOOKKEEPING = "steps"

    with pytest.raises(MissionError, match="Walks has no steps"):
        verify(lambda kb: either(kb, Walks("explore", kb, "explore")), rover_model(), **FULL)


def test_nothing_of_what_a_knowledge_base_knows_is_left_out():
    """What has come to these classes since has its place in `missions/proof/memory.py`, or is named here."""
    known = Rig(setup_of(MISSION)).kb
    (found,) = (one for one in vars(known).values() if isinstance(one, Knowledge))
    past = "attempts answers processes plans open_plans requests records ended last_end begins rejected"
    said = "changed_by feasibility serials reasons histories revision now in_words heard version visited"
    apart = "model network log clock telling alarms pending adaptable obsolete lacking users columns state measurements"
    held = "progress parameters recent since"
    parts = (found, found.state, found.measurements, found.records)
    names = {name for part in parts for name in vars(part) if not name.startswith("_")}
    assert names - set(found.state.columns) == set(f"{past} {said} {apart} {held}".split())


def test_bounds_are_told_and_exploring_goes_on_from_there():
    case = NAMED["either"]
    proof = verify(case.build, case.model, most=10, **FULL)
    assert not proof.found.is_finished
    assert str(proof).startswith("up to ")
    assert {one.holds for one in proof.findings} == {None}
    whole = verify(case.build, case.model, **FULL).found
    while not proof.found.is_finished:
        proof.found.explore(most=len(proof.found.situations) + 10)
    assert len(proof.found.situations) == len(whole.situations)
    assert proof.found.transitions == whole.transitions


def test_components_that_are_alike_stand_for_one_another():
    def model():
        made = Model("boat")
        thrusters = [made.component(f"thruster_{number}") for number in range(4)]
        made.function("move").design("all", thrusters)
        made.action("explore", requires=["move"])
        return made

    def tree(kb):
        return UntilSuccess("u", Act("explore", kb, "explore"))

    few, all_ = verify(tree, model), verify(tree, model, symmetric=False)
    assert len(few.found.situations) < len(all_.found.situations)
    assert [one.holds for one in few.findings] == [one.holds for one in all_.findings]


def test_of_changes_that_come_together_one_order_stands_for_all(monkeypatch):
    case = NAMED["gives way"]
    setup = Setup(
        case.model,
        case.build,
        start=FULL["start"],
        surroundings={"at_once": 2, "failing": ("camera",)},
    )
    one, in_order = Exploration(setup).explore(), Surroundings.changes

    def in_every_order(self):
        return (order for together in in_order(self) for order in permutations(together))

    monkeypatch.setattr(Surroundings, "changes", in_every_order)
    every = Exploration(setup).explore()
    assert one.is_finished
    assert (len(one.situations), one.transitions) == (len(every.situations), every.transitions)


def test_failures_that_end_the_mission_are_told():
    proof = proof_of("either", failures=2)
    reaches = {one.facts: one.reaches for one in proof.consequences}
    assert reaches["wheels fails",] == "nothing"
    assert reaches["camera fails",] == "the goal"
    assert reaches["camera fails", "radar fails"] == "nothing"


def greenhouse():
    made = Model("greenhouse")
    tank, energy = (made.quality_attribute(name, low=0.0, high=1.0) for name in ("tank", "energy"))
    made.action("scan", constraints=[energy >= 0.25])
    made.action("water", constraints=[tank >= 0.25, energy >= 0.25])
    made.action("charge")
    made.action("refill")
    return made


def in_stages(kb):
    """Charge in the first stage, only refill in the second."""
    scan = do_until_unfeasible(Act("scan", kb, "scan"), Act("charge", kb, "charge"))
    water = do_until_unfeasible(Act("water", kb, "water"), Act("refill", kb, "refill"))
    return Sequence("work", memory=True, children=[scan, water])


@pytest.mark.parametrize(
    ("build", "is_stuck"),
    [
        (in_stages, False),
        (lambda kb: OneShot("once", Act("scan", kb, "scan"), OneShotPolicy.ON_COMPLETION), False),
        (lambda kb: until(OneShot("once", in_stages(kb), OneShotPolicy.ON_COMPLETION)), True),
    ],
    ids=[
        "what an earlier stage would do",
        "given up for good at the root",
        "given up for good below a retry",
    ],
)
def test_mission_is_stuck_if_another_situation_of_its_stage_leads_on(build, is_stuck):
    """In the second stage low energy is not charged: begun anew it would be, but that is another stage."""
    effects = {
        "charge": Leaf(effects={"S": {"energy": 1.0}}),
        "refill": Leaf(effects={"S": {"tank": 1.0}}),
    }
    leaves = {} if is_stuck or build is not in_stages else effects
    proof = verify(build, greenhouse, leaves=leaves)
    (stuck,) = (one for one in proof.findings if "not stuck" in one.name)
    assert stuck.holds is not is_stuck, stuck


def test_what_a_user_wants_is_checked():
    case = NAMED["either"]
    wanted = (
        never("never dark", lambda rig: rig.measured("light") == 0.25),
        eventually("explores still", lambda rig: rig.is_required("explore")),
        leads_to(
            "at once",
            lambda rig: rig.is_required("charge"),
            lambda rig: rig.is_required("explore"),
            within=1,
        ),
    )
    proof = verify(case.build, case.model, wanted=wanted, **FULL)
    verdicts = {one.name: one.holds for one in proof.findings[-3:]}
    assert verdicts["never dark"] is False
    assert verdicts["at once"] is False
    assert "explores still" in verdicts


def test_page_shows_the_way_to_the_goal_that_was_stated(tmp_path):
    page = tmp_path / "way.html"
    proof = verify(
        NAMED["either"].build, rover_model(), goal=lambda rig: rig.is_required("charge"), **FULL
    )
    assert not proof.broken, proof
    proof.report(page)
    assert "charge is requested" in page.read_text()
    assert proof.found.load(min(proof.found.goals)).is_required("charge")


def test_unknown_leaf_is_refused_with_those_there_are():
    with pytest.raises(UnknownName, match="'explore'"):
        verify(NAMED["either"].build, rover_model(), leaves={"explor": Leaf("R")})


def test_saved_test_fails_while_the_bug_is_there():
    proof = proof_of("no guard")
    found = next(one for one in proof.broken if one.trail)
    setup = "import proof_mutants\nfrom missions.proof.rig import Setup\n"
    setup += (
        "Setup(proof_mutants.rover_model(), proof_mutants.{}, start=proof_mutants.FULL['start'])"
    )
    for build, is_broken in (("MUTANTS[0].build", True), ("either", False)):
        namespace = {}
        exec(as_test(setup.format(build), found.name, found.what, found.trail), namespace)
        (test,) = (value for name, value in namespace.items() if name.startswith("test_"))
        with pytest.raises(AssertionError) if is_broken else nullcontext():
            test()


def test_command_tells_what_holds_and_writes_it(tmp_path):
    path, page = tmp_path / "proof.json", tmp_path / "proof.html"
    done = CliRunner().invoke(
        cli.app, ["verify", "suave", "--json", str(path), "--report", str(page)]
    )
    assert done.exit_code == 0, done.output
    assert "yes  every adaptation of the model can occur" in done.output
    table = [line.split() for line in done.output.splitlines()]
    assert ["follow_pipeline", "fails", "nothing", "search_pipeline"] in table
    assert '["follow_pipeline fails","","nothing; does search_pipeline"]' in page.read_text()
    written = json.loads(path.read_text())
    assert f"{written['megabytes']} MB" in done.output
    assert written["finished"]
    assert all(one["holds"] for one in written["findings"])


def test_command_fails_and_writes_page_and_test_of_the_first_story(tmp_path, monkeypatch):
    (tmp_path / "broken_rover.py").write_text(
        "from dataclasses import replace\nimport proof_mutants\nfrom missions.suave import MISSION as SUAVE\n"
        "MISSION = replace(SUAVE, name='rover', model=proof_mutants.rover_model(),\n"
        "    tree=lambda kb, percepts: proof_mutants.MUTANTS[0].build(kb))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    page, test = tmp_path / "story.html", tmp_path / "test_story.py"
    options = ["--report", str(page), "--test", str(test), "--failures", "0"]
    done = CliRunner().invoke(cli.app, ["verify", "broken_rover:MISSION", *options])
    assert done.exit_code == 1, done.output
    assert "NO   nothing is requested while unfeasible" in done.output
    assert "explore is still requested" in page.read_text()
    assert "setup_of(find_mission('broken_rover:MISSION')" in test.read_text()


def test_command_that_does_not_finish_exits_with_3_writes_no_test_and_says_what_to_do(tmp_path):
    test = tmp_path / "test_story.py"
    done = CliRunner().invoke(cli.app, ["verify", "suave", "--most", "20", "--test", str(test)])
    assert done.exit_code == 3, done.output
    *_, about_test, last = done.output.splitlines()
    assert about_test == "nothing is broken: no test is written"
    assert (
        "raise --seconds or --most, go on with --resume, or look for fewer failures at once with --failures"
        in last
    )
    assert not test.exists()


def test_command_goes_on_from_a_file_also_after_an_interrupt(tmp_path, monkeypatch):
    kept, ticks, ticked = tmp_path / "kept.json", Rounds.ticks, []

    def ticks_interrupted(rounds, moment):
        ticked.append(moment)
        if len(ticked) == 40:
            signal.raise_signal(signal.SIGINT)
        return ticks(rounds, moment)

    def verify_suave(*options):
        return CliRunner().invoke(
            cli.app, ["verify", "suave", "--cores", "1", "--resume", str(kept), *options]
        )

    whole = verify_suave("--resume", str(tmp_path / "other.json"))
    monkeypatch.setattr(Rounds, "ticks", ticks_interrupted)
    first = verify_suave()
    assert first.exit_code == 3, first.output
    assert len(ticked) < 60
    done = verify_suave()
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[1:] == whole.output.splitlines()[1:]
    assert (
        done.output.split(" s, ")[0].rpartition(",")[0]
        == whole.output.split(" s, ")[0].rpartition(",")[0]
    )
    kept.write_text("{}")
    assert f"cannot go on from {kept}: it is not a saved exploration" in str(
        verify_suave().exception
    )
    assert kept.read_text() == "{}"
    kept.unlink()
    kept.mkdir()
    assert f"{kept}: it is a directory" in str(verify_suave().exception)


def test_file_that_cannot_be_written_is_found_out_before_anything_is_explored(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("missions.commands.check.prove", None)
    for option in ("--json", "--report", "--test", "--resume"):
        done = CliRunner().invoke(
            cli.app, ["verify", "suave", option, str(tmp_path / "nowhere" / "file")]
        )
        assert "nowhere/file: No such file or directory" in str(done.exception)


def test_mission_in_which_nothing_can_fail_has_no_table_of_what_that_leads_to(
    tmp_path, monkeypatch
):
    (tmp_path / "calm.py").write_text(
        "from dataclasses import replace\nfrom py_trees.behaviours import Success\nfrom kb import Model\n"
        "from missions.suave import MISSION as SUAVE\n"
        "MISSION = replace(SUAVE, model=lambda: Model('calm'), tree=lambda kb, percepts: Success('done'))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    done = CliRunner().invoke(cli.app, ["verify", "calm:MISSION"])
    assert done.exit_code == 0, done.output
    assert "if for good" not in done.output


def test_fewer_failures_than_none_are_refused():
    done = CliRunner().invoke(cli.app, ["verify", "suave", "--failures", "-1"])
    assert done.exit_code == 2
    assert "greater than or equal to 0" in done.output


def test_unknown_action_that_excludes_another_is_refused():
    done = CliRunner().invoke(
        cli.app, ["verify", "suave", "--exclusive", "search_pipelin, inspect_pipeline"]
    )
    assert isinstance(done.exception, UnknownName)
    assert "unknown action 'search_pipelin'; did you mean 'search_pipeline'" in str(done.exception)


def test_design_for_failures_is_not_missing_where_nothing_fails():
    assert not prove(setup_of(SUAVE, failures=0)).broken
    (missing,) = prove(setup_of(SUAVE, failing=("spiral_search",))).broken
    assert missing.what == "never: function design thruster_recovery"


def seen_of_a_plan(rig):
    (executor,) = (one for one in nodes(rig.root) if isinstance(one, PlanExecutor))
    tables = (rig.kb.actions, rig.kb.designs, rig.kb.components)
    statuses = [(name, str(one.status)) for table in tables for name, one in table.items()]
    running = sorted(one.action for one in rig.doing if one.status.name == "RUNNING")
    plan = (executor.current_steps, executor.state)
    return rig.root.status, plan, rig.required, rig.unfeasible, running, statuses


def test_plan_executor_put_into_a_situation_is_as_after_the_rounds_that_lead_there():
    setup = setup_of(MISSION, "pddl")
    found = Exploration(setup).explore(most=120)
    assert any(
        found.path(number)[-1].answers == (("search", "F"),)
        for number in range(1, len(found.situations))
    )
    for number in range(0, len(found.situations), 5):
        anew = Rig(setup)
        anew.begin()
        for second, step in enumerate(found.path(number), start=1):
            anew.clock = float(second)
            for change in step.changes:
                change.tell(anew.kb)
            anew.settle()
            anew.choices.begin(step.answers)
            anew.runner.tick()
            anew.settle()
            assert tuple(anew.choices.taken) == step.answers
        assert seen_of_a_plan(anew) == seen_of_a_plan(found.load(number))


def test_plans_of_a_mission_are_verified():
    done = CliRunner().invoke(cli.app, ["verify", "suave", "--task", "pddl"])
    assert done.exit_code == 0, done.output
    assert "yes  every node of the tree can be reached" in done.output
    assert "spiral_search fails the goal from some situations inspect_pipeline" in " ".join(
        done.output.split()
    )


class KeepsSearching(Keeps, SearchPipeline):
    def __init__(self, kb, percepts):
        SearchPipeline.__init__(self, kb, percepts)


class FindsNothing(SearchPipeline):
    schema = replace(SearchPipeline.schema, end_effects=())


@pytest.mark.parametrize(
    ("search", "broken"),
    [(KeepsSearching, "every request is released"), (FindsNothing, "the goal is reached")],
)
def test_bug_of_a_planned_mission_is_found_and_its_story_is_replayed(search, broken):
    proof = prove(
        setup_of(replace(MISSION, actions=by_schema(search, InspectPipeline, Recharge)), "pddl"),
        lambda found: found.explore(most=150),
    )
    found = next((one for one in proof.findings if one.name.startswith(broken)), None)
    assert found.holds is not True
    for one in proof.broken:
        if one.trail is not None:
            assert replayed(proof.setup, proof.story(one), one.trail) == proof.story(one).trace
