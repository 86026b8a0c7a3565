"""The store: nothing acknowledged is lost, whatever ends the program or the disk."""

import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from kept import KEPT, Life, answers, robot, stored
from models import Clock

from kb import KnowledgeBase, KnowledgeBaseError, Model
from kb.store import StoreError, backup_store, store_info

HERE = Path(__file__).parent
FOUR_THREADS = """
import sys, threading
from kb import KnowledgeBase, Model

model = Model("four threads")
for number in range(4):
    model.quality_attribute(f"q{number}")
kb = KnowledgeBase(model, store=sys.argv[1], keep=10**6)

def record(number):
    for value in range(10**9):
        kb.measure(f"q{number}", float(value))

for number in range(4):
    threading.Thread(target=record, args=(number,), daemon=True).start()
while True:
    kb.flush()
    print(kb.store.saved, flush=True)
"""


def meter(path, **settings):
    model = Model("meter")
    model.quality_attribute("level")
    return KnowledgeBase(model, store=path, **settings)


def killed(source, *arguments, delay):
    """Run a program and kill it; return the last number that it printed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE.parents[1]), str(HERE)))}
    command = [sys.executable, *source, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        process.stdout.readline()
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        lines = process.stdout.read().split("\n")[:-1]
    assert process.returncode == -signal.SIGKILL
    return int(lines[-1]) if lines else 0


@pytest.mark.parametrize("delay", [0.05, 0.4])
def test_kill_under_four_threads_loses_nothing_acknowledged(tmp_path, delay):
    path = tmp_path / "log.sqlite3"
    acknowledged = killed(("-c", FOUR_THREADS), path, delay=delay)
    model = Model("four threads")
    for number in range(4):
        model.quality_attribute(f"q{number}")
    kb = KnowledgeBase(model, store=path, keep=10**6)
    assert kb.log.last >= acknowledged
    kb.close()
    events = stored(path)
    numbers = [event.number for event in events]
    assert numbers == list(range(numbers[0], kb.log.last + 1))
    last = {event.subject: event.arguments[1] for event in events}
    assert {name: kb.attributes[name].value for name in last} == last


def test_reopened_base_answers_the_same_from_a_snapshot(tmp_path):
    life = Life(tmp_path / "life", 7)
    moves = life.moves()
    while life.kb.log.last < 1500:  # closing it makes a snapshot
        next(moves)
    before = answers(life.kb, ended=True)
    life.kb.close()
    again = Life(tmp_path / "life", 7)
    again.clock.now = life.clock.now
    assert answers(again.kb) == before
    again.kb.close()


def test_command_under_way_is_abandoned_when_a_store_is_opened_again(tmp_path):
    model = Model("rover")
    lidar = model.component("lidar", kind="process")
    model.function("see").design("by lidar", [lidar])
    model.action("explore", requires=[model.functions["see"]])
    kb = KnowledgeBase(model, store=tmp_path / "log")
    kb.request_action("explore")
    plan = kb.select(designs={"see": "by lidar"})
    kb.record_attempt(plan, "lidar", "activate")
    kb.close()
    with closing(KnowledgeBase(model, store=tmp_path / "log")) as kb:
        (attempt,) = kb.history.attempts
        assert (attempt.result, kb.latest_plan.result) == ("abandoned", "abandoned")


def test_history_is_bounded_by_keep(tmp_path):
    kb = meter(tmp_path / "log", keep=20)
    for number in range(12_000):
        kb.measure("level", float(number))
    kb.close()
    kb = meter(tmp_path / "log", keep=20)
    assert kb.attributes["level"].value == 11_999.0
    assert kb.attributes["level"].history[-1][1] == 11_999.0
    kb.close()
    assert len(stored(tmp_path / "log")) < 3_000


def test_burst_is_saved_whole(tmp_path):
    kb = meter(tmp_path / "log")
    for number in range(30_000):
        kb.measure("level", float(number))
    assert kb.flush(120)
    assert kb.store.error is None
    kb.close()


def test_full_disk_is_told_retried_and_close_raises(tmp_path):
    kb = meter(tmp_path / "log")
    assert kb.flush(10)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        for number in range(500):
            kb.measure("level", float(number))
        assert not kb.flush(30)
        assert "nothing has been saved since event" in kb.store.error
        with pytest.raises(StoreError, match=r"not saved; make room, and close it again"):
            kb.close()
        assert any(event.verb == "store" for event in kb.log)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    kb.close()
    assert meter(tmp_path / "log").attributes["level"].value == 499.0


def test_forked_child_may_ask_but_not_record(tmp_path):
    kb = meter(tmp_path / "log")
    kb.measure("level", 1.0)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            kb.measure("level", 2.0)
        except StoreError:
            code = 0 if kb.attributes["level"].value == 1.0 else 2
        os._exit(code)
    assert os.waitpid(child, 0)[1] == 0
    kb.close()


def test_damaged_file_is_refused_in_sqlites_words(tmp_path):
    path = tmp_path / "log"
    kb = meter(path)
    for number in range(3_000):
        kb.measure("level", float(number))
    assert kb.flush(30)
    copy = tmp_path / "copy"
    shutil.copy(path, copy)
    shutil.copy(f"{path}-wal", f"{copy}-wal")
    kb.close()
    with closing(sqlite3.connect(copy)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    content = bytearray(copy.read_bytes())
    content[8192:12288] = bytes(4096)
    copy.write_bytes(content)
    with pytest.raises(StoreError, match="damaged") as error:
        meter(copy)
    assert "Page 3" in str(error.value)
    assert copy.read_bytes() == bytes(content)


def test_store_of_another_model_is_refused(tmp_path):
    meter(tmp_path / "log").close()
    with pytest.raises(StoreError, match="another model"):
        KnowledgeBase(Model("other"), store=tmp_path / "log")


def test_store_in_use_is_refused(tmp_path):
    kb = meter(tmp_path / "log")
    with pytest.raises(StoreError, match="in use"):
        meter(tmp_path / "log")
    kb.close()


def test_closed_base_is_asked_and_records_nothing(tmp_path):
    kb = meter(tmp_path / "log")
    kb.measure("level", 1.0)
    kb.close()
    kb.close()
    assert kb.attributes["level"].value == 1.0
    with pytest.raises(KnowledgeBaseError, match="closed"):
        kb.measure("level", 2.0)


def test_backup_is_a_store_and_info_says_what_is_in_it(tmp_path):
    kb = meter(tmp_path / "log", clock=Clock(3.0))
    kb.measure("level", 1.0)
    kb.close()
    backup_store(tmp_path / "log", tmp_path / "copy")
    info = store_info(tmp_path / "copy")
    assert (info["model"], info["last event"], info["events kept"]) == ("meter", 1, "1 measure")
    assert info["state"] == "closed"
    kb = meter(tmp_path / "copy", clock=Clock(4.0))
    assert kb.attributes["level"].history == ((3.0, 1.0),)
    kb.close()
    with pytest.raises(StoreError, match="there already"):
        backup_store(tmp_path / "log", tmp_path / "copy")


def test_changed_model_goes_on_after_it_is_opened(tmp_path):
    clock = Clock(0.0)
    kb = KnowledgeBase(robot(), clock=clock, store=tmp_path / "log", keep=KEPT)
    kb.measure("light", 0.3)
    kb.model.action("film", requires=["see"])
    kb.model.change("night", priority=0)
    kb.close()
    again = KnowledgeBase(robot(), clock=clock, store=tmp_path / "log", keep=KEPT)
    assert again.selectable_actions() == kb.selectable_actions()
    assert again.model.configurations["night"].priority == 0
    again.close()
