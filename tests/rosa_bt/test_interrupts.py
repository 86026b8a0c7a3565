"""Ctrl-C, wherever Python lets it into a behaviour, leaves no request that nobody will release."""

import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest
from acting import rover
from interrupting import interrupted_at
from py_trees.common import Status

import rosa_bt
from kb import KnowledgeBase, Model
from rosa_bt import ForAction, RosaAction, TreeRunner

OURS = str(Path(rosa_bt.__file__).parent)
HERE = __file__


class Act(RosaAction):
    """Runs until its script says otherwise, with hooks at every place to interrupt."""

    def __init__(self, kb, action, script=()):
        super().__init__(action, kb, action)
        self.script = list(script)

    def update(self):
        return self.script.pop(0) if self.script else Status.RUNNING

    def terminate(self, new_status):
        self.script.clear()

    def save_progress(self):
        return 1


def every_instruction(case):
    """Try a case, which is made anew each time, with an interrupt at each instruction in turn.

    Return how many.
    """
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
    return [action.action for action in kb.required_actions]


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("when", ["first", "next", "success", "failure", "unfeasible"])
def test_interrupt_at_any_instruction_leaves_no_request(make, when):
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
            assert all(action.result for action in kb.history.actions), instruction
            kb.measure("light", 1.0)
            action.tick_once()  # and it can be done again
            assert "scan" in held(kb) or action.status is not Status.RUNNING, instruction

        return action.tick_once, check

    assert every_instruction(case) > 10


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
def test_request_of_an_ended_program_is_abandoned(tmp_path, how):
    store = tmp_path / "rover.sqlite3"
    command = [sys.executable, "-c", PROGRAM, str(store), how]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "['rest']\n", done.stderr
    model = Model("rover")
    model.action("rest")
    kb = KnowledgeBase(model, store=store)
    TreeRunner(Act(kb, "rest"), clock=lambda: 0.0)
    assert held(kb) == []
    assert {(action.action, action.result, action.reason) for action in kb.history.actions} == {
        ("rest", "abandoned", "the program that requested it has ended")
    }
    kb.close()
