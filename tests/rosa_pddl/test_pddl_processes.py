"""Programs of others are started, read and ended, and leave nothing behind."""

import gc
import os
import sys
import threading
from collections import Counter
from pathlib import Path

import pytest
from pddl_world import World, load_mission
from py_trees.common import Status

from rosa_pddl import Planner, Problem, initial_state
from rosa_pddl.domain import Outcome, Trouble
from rosa_pddl.engines import fast_downward_program
from rosa_pddl.engines.processes import Cancelled, ProcessHandle


def run(script, **settings):
    return ProcessHandle().ask(["/bin/sh", "-c", script], **{"limit_s": 300.0, **settings})


def programs_running():
    """The programs of the children of this process."""
    pids = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    return [target for pid in pids if (target := target_of(Path(f"/proc/{pid}/exe")))]


def target_of(link):
    """Of what may be gone at any moment."""
    try:
        return str(link.readlink())
    except OSError:
        return ""


def files():
    return Counter(target_of(link) for link in Path("/proc/self/fd").iterdir())


def opened_since(before):
    """The files that are open and were not, once what is only left to be collected is closed."""
    if files() - before:
        gc.collect()
    return files() - before


def test_a_program_is_given_its_input_and_its_output_is_read():
    text = os.urandom(3_000_000)
    ended = run("cat; echo oops >&2; exit 7", given=text)
    assert (ended.code, ended.output, ended.complaints) == (7, text, b"oops\n")


def test_a_program_that_reads_nothing_still_ends():
    assert run("exit 0", given=b"x" * 10_000_000).code == 0


def test_a_program_that_leaves_a_child_with_its_output_is_not_waited_for():
    ended = run("echo $$; sleep 1000 & echo done")
    assert ended.output.endswith(b"done\n")


def test_a_program_that_closes_its_output_is_waited_for():
    assert run("exec >&- 2>&-; sleep 0.2; exit 3").code == 3


def test_a_late_program_is_killed():
    with pytest.raises(Trouble, match=r"no answer after 0\.2 s") as raised:
        run("echo begun; sleep 1000", limit_s=0.2)
    assert raised.value.outcome is Outcome.OUT_OF_TIME
    assert [program for program in programs_running() if "sleep" in program] == []


def test_a_program_may_hold_so_much_and_no_more():
    fat = "x = bytes(1 << 29)"  # of zeros, which are promised and not written
    until = "import resource as r, time\nwhile r.getrlimit(r.RLIMIT_DATA)[0] != 1 << 27: time.sleep(0.01)\n"
    assert ProcessHandle().ask([sys.executable, "-c", fat], limit_s=300.0).code == 0
    limited = [sys.executable, "-c", until + fat]  # the limit is set just after the start
    assert b"MemoryError" in ProcessHandle(1 << 27).ask(limited, limit_s=300.0).complaints


def test_a_cancelled_handle_lets_nothing_run():
    handle = ProcessHandle()
    handle.cancel()
    with pytest.raises(Cancelled):
        handle.ask(["/bin/true"], limit_s=1.0)


def test_cancelling_ends_what_runs_and_what_waits():
    handle = ProcessHandle()
    timer = threading.Timer(0.1, handle.cancel)
    timer.start()
    with pytest.raises(Cancelled):
        handle.ask(["/bin/sleep", "1000"], limit_s=600.0)
    timer.join()


def test_what_cannot_be_started_says_so_and_leaves_nothing():
    before = files()
    with pytest.raises(Trouble, match="it cannot be started"):
        ProcessHandle().ask(["/no/such/program"], limit_s=1.0)
    assert not opened_since(before)


def test_many_replans_leave_no_process_file_or_thread(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    extended = load_mission("suave_extended")
    planner = Planner(cached=0)
    states = [
        initial_state(extended) | {f"(action_feasible {action})"}
        for action in extended.rosa_actions
    ]
    for state in states:
        planner.plan(Problem(extended, state))
    before, threads = files(), threading.active_count()
    for number in range(40):
        future = planner.start(Problem(extended, states[number % len(states)]))
        if number % 3 == 0:
            future.cancel()
        else:
            assert not future.result(120.0).outcome.is_trouble
    while threading.active_count() > threads:
        threading.Event().wait(0.01)
    assert not opened_since(before)
    assert list(tmp_path.iterdir()) == []
    assert [program for program in programs_running() if "downward" in program] == []


TROUBLES = {
    "hangs": "sleep 1000",
    "crashes": "exit 99",
    "prints garbage": "head -c 100000 /dev/urandom; exit 0",
    "eats memory": f"exec {sys.executable} -c 'x = [bytes(1 << 24) for _ in range(10**6)]'",
    "is killed": "kill -9 $$",
    "leaves children": "sleep 1000 & sleep 1000 & exit 1",
    "promises without end": "yes 'Plan length: 1 step(s).'",
}


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_search_that_misbehaves_twice_leaves_nothing_and_the_mission_goes_on(
    monkeypatch, tmp_path, trouble
):
    count, search = tmp_path / "count", tmp_path / "downward"
    search.write_text(
        f"#!/bin/sh\necho x >> {count}\n"
        f'[ $(wc -l < {count}) -gt 2 ] && exec {fast_downward_program()} "$@"\n{TROUBLES[trouble]}\n'
    )
    search.chmod(0o755)
    extended = load_mission("suave_extended")
    planner = Planner(
        cached=0, moves=0, timeout_s=30.0, budgets_s={"warm": 1.0, "cold": 29.0}, memory_mb=512
    )
    planner.plan(Problem(extended, initial_state(extended)))
    before, threads = files(), threading.active_count()
    monkeypatch.setattr("rosa_pddl.engines.fast_downward_program", lambda: search)
    count.write_text("")
    world = World(extended, planner, delay_s=None)
    for _ in range(12_000):
        if world.root.status is Status.SUCCESS:
            break
        world.executor.tick_once()
        world.tick_number += 1
        threading.Event().wait(0.01)
    assert world.root.status is Status.SUCCESS
    assert len(count.read_text().split()) >= 3
    world.executor.shutdown()
    while threading.active_count() > threads:
        threading.Event().wait(0.01)
    assert not opened_since(before)
    assert [
        program for program in programs_running() if "sleep" in program or "downward" in program
    ] == []
