"""An event is in or out: whatever interrupts a call, the base answers as if it had been told, or had not."""

import sys

import pytest
from kept import answers, robot
from models import Clock

from kb import KnowledgeBase, PriorityPlanner

CALLS = {
    "measure": lambda kb: kb.measure("light", 0.3),
    "measure debounced": lambda kb: kb.measure("energy", 0.05),
    "fail": lambda kb: kb.component_failed("camera", "rain"),
    "request": lambda kb: kb.request_action("rest"),
    "cancel": lambda kb: kb.cancel_action("explore", "failed", "too dark"),
    "select": lambda kb: PriorityPlanner().plan(kb),
    "finish": lambda kb: kb.finish_plan(1, "completed"),
    "assert": lambda kb: kb.assert_status("lidar", "failure", "seen", until=9.0),
    "time": lambda kb: pass_time(kb),
}


def pass_time(kb):
    kb._clock.now = 60.0
    return kb.revision


def base():
    clock = Clock(1.0)
    kb = KnowledgeBase(robot(), clock=clock)
    for value in (0.9, 0.8, 0.7):
        kb.measure("energy", value)
    kb.measure("light", 0.9)
    kb.request_action("explore")
    PriorityPlanner().plan(kb)
    kb.component_active("camera", True)
    kb.measure("light", 0.2)
    clock.now = 3.0
    return kb


def known(kb):
    return answers(kb), [one[:6] for one in kb.log], kb.revision


class Interrupted(BaseException):
    pass


def interrupted_at(step, kb, call):
    """Interrupt a call at one of the lines that it runs, as a signal would; returns whether it came that far."""
    count = 0

    def trace(frame, event, _):
        nonlocal count
        if not frame.f_code.co_filename.endswith(".py") or "/kb/" not in frame.f_code.co_filename:
            return None
        if event == "line":
            count += 1
            if count == step:
                sys.settrace(None)
                raise Interrupted
        return trace

    sys.settrace(trace)
    try:
        call(kb)
    except Interrupted:
        return True
    finally:
        sys.settrace(None)
    return False


@pytest.mark.parametrize("name", CALLS)
def test_interrupted_anywhere_it_is_as_if_told_or_not(name):
    call = CALLS[name]
    told, step, outs = base(), 0, 0
    call(told)
    wanted = known(told)
    while True:
        step += 3  # not each line, to be done in time
        kb = base()
        before = known(kb)
        if not interrupted_at(step, kb, call):
            break
        after = known(kb)
        if name == "time":
            pass_time(kb)
            assert known(kb) == wanted
            continue
        is_out = after == before
        outs += is_out
        assert is_out or after == wanted, f"interrupted at line {step}"
        if is_out:
            call(kb)
            assert known(kb) == wanted
    assert outs or name == "time"
