"""Ctrl-C, wherever Python lets it into a behaviour, leaves no request that nobody will release."""

import subprocess
import sys
import threading
from itertools import count
from pathlib import Path

import pytest
from interrupting import interrupted_at
from py_trees.behaviours import Running
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector

import rosa_bt
from kb import KnowledgeBase, Model
from rosa_bt import ForAction, RosaAction, TreeRunner

OURS = str(Path(rosa_bt.__file__).parent)
HERE = __file__


def rover() -> Model:
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("scan", constraints=[light >= 0.5])
    model.action("rest")
    return model


class Act(RosaAction):
    """Runs until its script says otherwise, with hooks of its own at every place that can be interrupted."""

    def __init__(self, kb, action, script=()):
        super().__init__(action, kb, action)
        self.script = list(script)
        self.is_on = False

    def initialise(self):
        self.is_on = True

    def update(self):
        return self.script.pop(0) if self.script else Status.RUNNING

    def terminate(self, new_status):
        self.is_on = False

    def save_progress(self):
        return 1


def every_instruction(case):
    """Try a case, which is made anew each time, with an interrupt at each instruction in turn; return how many."""
    for step in count(1):
        call, check = case()
        if not interrupted_at(step, call, rooms=(OURS, HERE)):
            return step - 1
        check(step)
    return None


MAKERS = {
    "RosaAction": lambda kb, script: Act(kb, "scan", script),
    "ForAction": lambda kb, script: ForAction("scan", kb, "scan", Act(kb, "rest", script)),
}


def held(kb):
    return [one.action for one in kb.required_actions]


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("when", ["first", "next", "success", "failure", "unfeasible"])
def test_interrupt_at_any_instruction_of_a_tick_ends_the_action_or_leaves_it_running_to_be_stopped(
    make, when
):
    def case():
        kb = KnowledgeBase(rover(), clock=lambda: 0.0)
        ends = {
            "success": [Status.RUNNING, Status.SUCCESS],
            "failure": [Status.RUNNING, Status.FAILURE],
        }
        action = make(kb, ends.get(when, []))
        if when != "first":
            action.tick_once()
        if when == "unfeasible":
            kb.measure("light", 0.0)

        def check(instruction):
            if action.status is Status.RUNNING:
                action.stop(Status.INVALID)
            assert held(kb) == [], instruction
            assert all(one.result for one in kb.history.actions), instruction
            kb.measure("light", 1.0)
            action.tick_once()  # and it can be done again
            assert "scan" in held(kb) or action.status is not Status.RUNNING, instruction

        return action.tick_once, check

    assert every_instruction(case) > 10


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_interrupt_at_any_instruction_of_a_tick_of_a_runner_leaves_nothing_open(make):
    def case():
        kb = KnowledgeBase(rover(), clock=lambda: 0.0)
        leaves = [make(kb, [Status.RUNNING, Status.FAILURE]), Act(kb, "rest")]
        runner = TreeRunner(Selector("root", memory=False, children=leaves), clock=lambda: 0.0)
        runner.tick()

        def check(instruction):
            assert held(kb) == [] or runner.status is Status.RUNNING, instruction
            runner.shutdown()
            assert held(kb) == [], instruction
            assert not any(
                one.is_on for one in runner.tree.root.iterate() if isinstance(one, Act)
            ), instruction

        return runner.tick, check

    assert every_instruction(case) > 100


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_interrupt_at_any_instruction_of_a_stop_is_made_good_by_the_next(make):
    def case():
        kb = KnowledgeBase(rover(), clock=lambda: 0.0)
        action = make(kb, [])
        action.tick_once()

        def check(instruction):
            if action.status is Status.RUNNING:
                action.stop(Status.INVALID)
            assert held(kb) == [], instruction
            assert {one.result for one in kb.history.actions} == {"abandoned"}

        return lambda: action.stop(Status.INVALID), check

    assert every_instruction(case) > 20


def test_interrupt_in_the_end_of_one_action_keeps_no_other_from_being_stopped():
    class Rude(Act):
        def terminate(self, new_status):
            raise KeyboardInterrupt

    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    policy = ParallelPolicy.SuccessOnAll(synchronise=False)
    root = Parallel(
        "all", policy=policy, children=[Rude(kb, "scan"), Act(kb, "rest"), Running("on")]
    )
    runner = TreeRunner(root, clock=lambda: 0.0)
    runner.tick()
    with pytest.raises(KeyboardInterrupt):
        runner.shutdown()
    assert held(kb) == []
    assert all(one.status is not Status.RUNNING for one in root.iterate())


def test_action_that_was_ticked_in_another_thread_is_released_by_the_shutdown_in_this_one():
    kb = KnowledgeBase(rover(), clock=lambda: 0.0)
    runner = TreeRunner(Act(kb, "scan"), clock=lambda: 0.0)
    thread = threading.Thread(target=runner.tick)
    thread.start()
    thread.join()
    assert held(kb) == ["scan"]
    runner.shutdown()
    assert held(kb) == []


PROGRAM = """
import sys
from py_trees.common import Status
from kb import KnowledgeBase, Model
from rosa_bt import RosaAction
class Act(RosaAction):
    def update(self):
        return Status.RUNNING
model = Model("rover")
model.action("rest")
kb = KnowledgeBase(model, store=sys.argv[1])
action = Act("rest", kb, "rest")
action.tick_once()
assert kb.flush(300.0)
print([one.action for one in kb.required_actions], flush=True)
if sys.argv[2] == "killed":
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("how", ["ended", "killed"])
def test_request_of_a_program_that_has_ended_is_settled_with_that_reason(tmp_path, how):
    store = tmp_path / "rover.sqlite3"
    command = [sys.executable, "-c", PROGRAM, str(store), how]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "['rest']\n", done.stderr
    model = Model("rover")
    model.action("rest")
    kb = KnowledgeBase(model, store=store)
    TreeRunner(Act(kb, "rest"), clock=lambda: 0.0)
    assert held(kb) == []
    assert {(one.action, one.result, one.reason) for one in kb.history.actions} == {
        ("rest", "abandoned", "the program that requested it has ended")
    }
    kb.close()
