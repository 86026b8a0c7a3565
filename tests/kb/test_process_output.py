"""What components write: kept in files of limited size that nobody else can read, and never on the console."""

import os
import signal
import stat
import time

import pytest
from models import Clock
from test_processes import python, wait_for

from kb import ConfigurationManager, KnowledgeBase, Model
from kb.exceptions import InvalidValue
from kb.processes import MOST, Output, ProcessComponents

FLOOD = "import os\nwhile True: os.write(1, b'nothing is new\\n' * 4000)"
LAST_WORDS = """
import sys
print("started")
print("\\x1b[31mno camera at /dev/video0\\x1b[0m", flush=True)
print("giving up", file=sys.stderr)
sys.exit(3)
"""


def kb_of(name="camera"):
    model = Model("rover")
    model.component(name, kind="process")
    model.function("see").design("by it", [name])
    model.action("look", requires=["see"])
    return KnowledgeBase(model, clock=Clock(0.0))


def running(processes, name="camera"):
    processes.activate(name)
    return wait_for(lambda: processes.is_active(name))


def inode(path):
    """Of a file that may be renamed at any moment."""
    try:
        return path.stat().st_ino
    except FileNotFoundError:
        return None


def test_a_flood_stays_within_the_limit_and_off_the_console(capfd, tmp_path):
    with ProcessComponents({"camera": python(FLOOD)}, output=tmp_path) as processes:
        running(processes)
        path = processes.output("camera")
        wait_for(lambda: path.with_name("camera.log.1").exists())
        before = inode(path.with_name("camera.log.1"))
        wait_for(
            lambda: inode(path.with_name("camera.log.1")) not in (None, before)
        )  # it went around once more
    assert sum(one.stat().st_size for one in tmp_path.iterdir()) <= MOST
    assert sorted(one.name for one in tmp_path.iterdir()) == ["camera.log", "camera.log.1"]
    assert {stat.S_IMODE(one.stat().st_mode) for one in tmp_path.iterdir()} == {0o600}
    assert capfd.readouterr() == ("", "")


def test_the_last_lines_are_in_the_reason_of_the_failure():
    kb = kb_of()
    with ProcessComponents({"camera": python(LAST_WORDS)}) as processes:
        manager = ConfigurationManager(kb, processes, monitors=[processes])
        kb.request_action("look")
        wait_for(lambda: (manager.update(), kb.components["camera"].status == "failure")[1])
        said = str(kb.explain("camera"))
    assert (
        "(exit status 3); it last wrote: started | [31mno camera at /dev/video0[0m | giving up"
        in said
    )


def test_an_end_between_two_monitors_has_its_reason_and_its_restart_too():
    class Ending:
        def observe(self, kb):
            if processes.is_active("camera") and not ended:
                ended.append(pid := kb.processes[-1].pid)
                os.kill(pid, signal.SIGKILL)
                os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)

    kb, ended = kb_of(), []
    with ProcessComponents(
        {"camera": python("import time; time.sleep(600)", restarts=1, back_off=0.0)}
    ) as processes:
        manager = ConfigurationManager(kb, processes, monitors=[processes, Ending()])
        kb.request_action("look")
        wait_for(lambda: (manager.update(), len(kb.processes) == 2)[1])
        assert kb.components["camera"].status != "failure"
        assert "ended by itself (SIGKILL)" in str(
            [event for event in kb.log if event.verb == "component_active"]
        )


def test_without_a_folder_the_output_is_private_and_goes_when_it_is_closed():
    with ProcessComponents(
        {"camera": python("print('hello'); import time; time.sleep(600)")}
    ) as processes:
        path = processes.output("camera")
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert not path.parent.exists()


def test_no_link_is_followed_and_what_was_there_is_kept_beside(tmp_path):
    stranger = tmp_path / "stranger"
    stranger.write_text("mine")
    folder = tmp_path / "output"
    folder.mkdir()
    (folder / "camera.log").symlink_to(stranger)
    output = Output(folder / "camera.log")
    source, sink = os.pipe()
    output.follow(os.fdopen(source, "rb", buffering=0))
    os.write(sink, b"hello\n")
    os.close(sink)
    wait_for(lambda: (folder / "camera.log").is_file() and not (folder / "camera.log").is_symlink())
    assert output.last_lines() == "hello"
    assert stranger.read_text() == "mine"
    assert (folder / "camera.log.1").readlink() == stranger


@pytest.mark.parametrize("name", ["../../x", "a/b", "..", "é" * 300, "two words"])
def test_any_name_of_a_component_gives_a_file_in_the_folder(name, tmp_path):
    with ProcessComponents(
        {name: python("print('hello'); import time; time.sleep(600)")}, output=tmp_path
    ) as processes:
        assert processes.output(name).parent == tmp_path
        running(processes, name)
        wait_for(processes.output(name).exists)


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidValue, match=r"output cannot go to .*name another folder"):
        ProcessComponents({}, output=tmp_path / "file")


def test_what_an_ended_process_left_in_the_pipe_is_in_its_last_lines(tmp_path):
    for number in range(50):  # the reader's thread may be behind
        output = Output(tmp_path / f"{number}.log")
        source, sink = os.pipe()
        output.follow(os.fdopen(source, "rb", buffering=0))
        os.write(sink, f"{number}\n".encode())
        os.close(sink)
        assert output.last_lines() == str(number)


def test_nobody_waits_for_output_that_a_child_which_left_its_group_may_still_write(tmp_path):
    output, begun, sinks = Output(tmp_path / "camera.log"), time.monotonic(), []
    for number in range(40):
        source, sink = os.pipe()
        sinks.append(sink)
        output.follow(os.fdopen(source, "rb", buffering=0))
        os.write(sink, f"{number}\n".encode())
        assert output.last_lines() == str(number)
    assert time.monotonic() < begun + 10.0
    for sink in sinks:
        os.close(sink)
