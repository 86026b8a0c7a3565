"""An interrupt at any instruction of a call, as Ctrl-C comes."""

import dis
import gc
import sys
import threading
from functools import cache
from pathlib import Path

import kb as package

ROOM = str(Path(package.__file__).parent)


class Interrupted(BaseException):
    """What nobody expects."""


@cache
def out_of_reach(code):
    """Return where no interrupt can come: the exits of `with` and functions."""
    steps = list(dis.get_instructions(code))
    found = set()
    for place, step in enumerate(steps):
        if step.opname in ("RETURN_VALUE", "RETURN_CONST"):
            found.add(step.offset)
        following = steps[place : place + 3]
        if [one.opname for one in following] == ["LOAD_CONST"] * 3 and not any(
            one.argval for one in following
        ):
            begin = place - (
                place > 0 and steps[place - 1].opname == "SWAP"
            )  # of what is returned out of the block
            found.update(step.offset for step in steps[begin : place + 5])
    return found


LOOKS = ("CALL", "RESUME", "JUMP_BACKWARD")
"""After such instructions Python looks for signals."""


def interrupted_at(step, call, *, rooms=(ROOM,), harsher=False, handler=None):
    """Interrupt a call at one of the instructions that it runs in such files.

    Returns whether it came that far.

    As signals are, it is at one after which Python looks for them; or, harsher, at any. With a
    handler that is called there, and the call goes on.
    """
    count = 0
    before = {}
    is_interrupted = False

    def trace(frame, event, _):
        nonlocal count, is_interrupted
        if not frame.f_code.co_filename.startswith(rooms):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        if event == "opcode":
            is_looked = before.get(frame, "RESUME").startswith(LOOKS)
            if (harsher or is_looked) and frame.f_lasti not in out_of_reach(frame.f_code):
                count += 1
                if count == step:
                    sys.settrace(None)
                    is_interrupted = True
                    if handler is None:
                        raise Interrupted
                    handler()
            before[frame] = dis.opname[frame.f_code.co_code[frame.f_lasti]]
        return trace

    gc.disable()  # a finaliser would swallow what is raised in it
    sys.settrace(trace)
    try:
        call()
    except Interrupted:
        pass
    finally:
        sys.settrace(None)
        gc.enable()
    return is_interrupted


def is_free(kb, patience=60.0):
    """Tell whether another thread can tell and ask at once."""
    done = threading.Event()

    def ask():
        with kb.reading():
            done.set()

    threading.Thread(target=ask, daemon=True).start()
    return done.wait(patience)
