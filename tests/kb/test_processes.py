"""Components as real processes of the operating system: started, ended, crashed, and never left behind."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kb import ConfigurationManager, KnowledgeBase, Model, StagedExecutor, Status, UnknownName
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.processes import PARAMETERS, ProcessComponents, Program
from kb.processes.guardian import MARK, new_mark

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120.0

SLEEP = "import time; time.sleep(600)"
STUBBORN = """
import os, signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
code = "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"
child = subprocess.Popen([sys.executable, "-c", code])
with open(sys.argv[1] + ".part", "w") as file:
    file.write(str(child.pid))
os.rename(sys.argv[1] + ".part", sys.argv[1])
time.sleep(600)
"""


def python(code, *arguments, **options):
    return Program([sys.executable, "-c", code, *map(str, arguments)], **options)


def is_alive(pid):
    """A process that has ended and is only not buried yet counts as gone."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def is_zombie_of_ours(pid):
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return False
    return fields[0] == "Z" and int(fields[1]) == os.getpid()


def wait_for(condition, what=None):
    """Wait until something is so; how long it takes decides nothing unless it is never so."""
    give_up = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < give_up, what or "it never came"
        time.sleep(0.01)
    return found


def rover():
    model = Model("rover")
    camera = model.component("camera", kind="process", stops_to_configure=True)
    light = model.environmental_attribute("light")
    camera.configuration("day", {"rate": 5, "label": "sun"}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"rate": 1, "label": "moon"}, priority=2)
    lidar = model.component("lidar", kind="process")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by lidar", [lidar], priority=2)
    model.action("explore", requires=[see])
    return model


def managed(programs, store=None, **options):
    kb = KnowledgeBase(rover(), clock=time.monotonic, store=store)
    processes = ProcessComponents(programs)
    executor = StagedExecutor(processes, back_off=0.01, **options)
    return (
        kb,
        processes,
        ConfigurationManager(kb, processes, executor=executor, monitors=[processes]),
    )


def turned(manager, condition):
    """Take turns until something is so."""
    return wait_for(lambda: (manager.update(), condition())[1])


def is_solved(kb):
    return lambda: kb.actions["explore"].status is Status.SOLVED and kb.pending_plan is None


def test_a_required_component_runs_as_a_process_and_ends_when_nothing_requires_it():
    kb, processes, manager = managed({"camera": python(SLEEP), "lidar": python(SLEEP)})
    with processes:
        kb.request_action("explore")
        turned(manager, is_solved(kb))
        turned(manager, lambda: kb.processes)
        (process,) = kb.processes
        assert (process.component, process.end) == ("camera", None)
        assert is_alive(process.pid)
        assert os.getpgid(process.pid) == process.pid
        kb.cancel_action("explore")
        turned(manager, lambda: process.end is not None and kb.pending_plan is None)
        assert not is_alive(process.pid)
        assert not is_zombie_of_ours(process.pid)
        assert not kb.components["camera"].is_active
        assert kb.components["camera"].status is Status.FEASIBLE


def test_a_program_finds_its_parameters_in_arguments_and_environment_and_no_shell_reads_them(
    tmp_path,
):
    seen = tmp_path / "seen"
    code = f"""
import json, os, sys, time
with open({str(seen)!r} + ".part", "w") as file:
    json.dump([sys.argv[1:], os.environ["GAIN"], json.loads(os.environ["{PARAMETERS}"]), os.getcwd()], file)
os.rename({str(seen)!r} + ".part", {str(seen)!r})
time.sleep(600)
"""
    arguments = ["--rate={rate}", "{label}", "$(exit 1); * > x", "{{rate}}"]
    program = python(
        code, *arguments, environment={"GAIN": "{rate} of {label}"}, directory=tmp_path
    )
    kb, processes, manager = managed({"camera": program, "lidar": python(SLEEP)})
    with processes:
        kb.measure("light", 0.9)
        kb.request_action("explore")
        turned(manager, seen.exists)
        argv, gain, given, directory = json.loads(seen.read_text())
        assert argv == ["--rate=5", "sun", "$(exit 1); * > x", "{rate}"]
        assert gain == "5 of sun"
        assert given == {"rate": 5, "label": "sun"}
        assert directory == str(tmp_path)
        turned(manager, is_solved(kb))
        seen.unlink()
        kb.measure("light", 0.1)
        turned(manager, lambda: seen.exists() and is_solved(kb)())
        assert json.loads(seen.read_text())[0][:2] == ["--rate=1", "moon"]


def test_a_component_that_ends_by_itself_has_failed_and_the_next_best_takes_over():
    kb, processes, manager = managed({"camera": python(SLEEP), "lidar": python(SLEEP)})
    with processes:
        kb.request_action("explore")
        turned(manager, is_solved(kb))
        turned(manager, lambda: kb.processes)
        os.kill(kb.processes[0].pid, signal.SIGSEGV)
        turned(manager, lambda: kb.components["camera"].status is Status.FAILURE)
        assert kb.processes[0].end is not None
        assert not kb.components["camera"].is_active
        turned(manager, is_solved(kb))
        assert kb.components["lidar"].is_active
        assert not is_zombie_of_ours(kb.processes[0].pid)


@pytest.mark.parametrize("status", [0, 3])
def test_a_program_that_never_stays_is_tried_a_few_times_and_then_given_up(status):
    kb, processes, manager = managed(
        {"camera": python(f"raise SystemExit({status})"), "lidar": python(SLEEP)}
    )
    with processes:
        kb.request_action("explore")
        turned(manager, lambda: is_solved(kb)() and kb.components["lidar"].is_active)
        assert kb.components["camera"].status is Status.FAILURE
        assert len([one for one in kb.processes if one.component == "camera"]) <= 3


def test_a_component_with_restarts_is_started_again_with_its_parameters_and_has_not_failed(
    tmp_path,
):
    log = tmp_path / "starts"
    code = f"""
import sys, time
with open({str(log)!r}, "a") as file:
    file.write(sys.argv[1] + "\\n")
with open({str(log)!r}) as file:
    if len(file.readlines()) < 3:
        sys.exit(1)
time.sleep(600)
"""
    camera = python(code, "{rate}", restarts=2, back_off=0.01)
    kb, processes, manager = managed({"camera": camera, "lidar": python(SLEEP)})
    failures = []
    kb.subscribe(lambda event: failures.append(event) if "has failed" in event.text else None)
    with processes:
        kb.request_action("explore")
        turned(manager, lambda: log.exists() and len(log.read_text().split()) == 3)
        turned(manager, lambda: is_solved(kb)() and len(kb.processes) == 3)
        assert log.read_text().split() == ["1", "1", "1"] or log.read_text().split() == [
            "5",
            "5",
            "5",
        ]
        assert [one.end is None for one in kb.processes] == [False, False, True]
    assert failures == []


def test_what_does_not_end_when_told_is_killed_with_all_its_group(tmp_path):
    note = tmp_path / "child"
    with ProcessComponents({"camera": python(STUBBORN, note, grace=0.1)}) as processes:
        assert processes.activate("camera").done()
        wait_for(note.exists)
        child = int(note.read_text())
        assert is_alive(child)
        assert processes.is_active("camera")
        wait_for(processes.deactivate("camera").done)
        assert not processes.is_active("camera")
        wait_for(lambda: not is_alive(child))


def test_the_whole_group_has_the_grace_not_only_its_leader(tmp_path):
    ready, last_words = tmp_path / "ready", tmp_path / "last words"
    child = f"""
import pathlib, signal, time
def end(*_):
    time.sleep(0.3)
    pathlib.Path({str(last_words)!r}).touch()
    raise SystemExit
signal.signal(signal.SIGTERM, end)
pathlib.Path({str(ready)!r}).touch()
time.sleep(600)
"""
    leader = f"import subprocess, sys, time; subprocess.Popen([sys.executable, '-c', {child!r}]); time.sleep(600)"
    with ProcessComponents({"camera": python(leader, grace=PATIENCE_S)}) as processes:
        processes.activate("camera")
        wait_for(ready.exists)
        wait_for(processes.deactivate("camera").done)
        assert last_words.exists()


def test_starting_twice_and_ending_twice_changes_nothing():
    with ProcessComponents({"camera": python(SLEEP)}) as processes:
        assert processes.deactivate("camera").done()
        assert processes.activate("camera").done()
        assert processes.activate("camera").done()
        wait_for(processes.deactivate("camera").done)
        wait_for(processes.deactivate("camera").done)
        assert not processes.is_active("camera")


def test_a_component_that_is_started_while_it_ends_is_started_once_it_has_ended():
    with ProcessComponents({"camera": python(SLEEP)}) as processes:
        processes.activate("camera")
        processes.deactivate("camera")
        again = processes.activate("camera")
        wait_for(again.done)
        assert again.exception() is None
        assert processes.is_active("camera")


def test_parameters_reach_a_running_program_only_by_a_function_of_its_own():
    told = []
    programs = {
        "camera": python(
            SLEEP, configure=lambda parameters, pid: told.append((dict(parameters), pid))
        ),
        "lidar": python(SLEEP),
    }
    with ProcessComponents(programs) as processes:
        for name in programs:
            processes.set_parameters(name, {"rate": 1})
            processes.activate(name)
            processes.set_parameters(name, {"rate": 1})
        processes.set_parameters("camera", {"rate": 2})
        with pytest.raises(KnowledgeBaseError, match="stops_to_configure=True"):
            processes.set_parameters("lidar", {"rate": 2})
    assert told[0] == ({"rate": 1}, None)
    assert [parameters for parameters, _ in told] == [{"rate": 1}, {"rate": 1}, {"rate": 2}]
    assert isinstance(told[2][1], int)


def test_an_argument_without_its_parameter_is_refused_before_the_start():
    with ProcessComponents({"camera": python(SLEEP, "{rate}")}) as processes:
        with pytest.raises(
            KnowledgeBaseError, match=r"needs the parameter 'rate'; given are: 'rat'"
        ):
            processes.set_parameters("camera", {"rat": 1})
        with pytest.raises(
            KnowledgeBaseError, match=r"needs the parameter 'rate'; given are: none"
        ):
            processes.activate("camera")
        assert not processes.is_active("camera")


def test_a_plan_that_starts_again_what_ended_by_itself_says_so():
    kb, processes, manager = managed(
        {"camera": python(SLEEP, restarts=1, back_off=0.01), "lidar": python(SLEEP)}
    )
    with processes:
        kb.request_action("explore")
        turned(manager, lambda: is_solved(kb)() and kb.processes)
        os.kill(kb.processes[0].pid, signal.SIGTERM)
        turned(manager, lambda: len(kb.processes) == 2)
        ended = "the process of camera ended by itself (SIGTERM)"
        assert kb.latest_plan.reason == f"{ended}; camera is needed by explore"
        turned(manager, is_solved(kb))
        os.kill(kb.processes[1].pid, signal.SIGTERM)
        turned(manager, lambda: kb.components["lidar"].is_active)
        assert str(kb.explain(kb.components["camera"])).startswith(f"camera has failed ({ended})")
        assert ended in kb.latest_plan.reason


def test_a_script_without_its_interpreter_has_failed_with_what_to_do(tmp_path):
    script = tmp_path / "script"
    script.write_text("#!/nowhere/interpreter\n")
    script.chmod(0o755)
    kb, processes, manager = managed(
        {"camera": Program([str(script)]), "lidar": python(SLEEP)}, attempts=1
    )
    with processes:
        kb.request_action("explore")
        turned(manager, is_solved(kb))
    assert (
        "see whether its first line names an interpreter"
        in kb.explain(kb.components["camera"]).reason
    )


# the end, and a knowledge base with a past


class OnPurpose(Exception):
    pass


@pytest.mark.parametrize("ending", [None, OnPurpose])
def test_when_all_is_closed_the_knowledge_base_knows_that_nothing_runs(ending):
    kb, processes, manager = managed({"camera": python(SLEEP), "lidar": python(SLEEP)})
    with contextlib.suppress(OnPurpose), processes:
        kb.request_action("explore")
        turned(manager, is_solved(kb))
        if ending is not None:
            raise ending
    assert [one.end is not None for one in kb.processes] == [True]
    assert not kb.components["camera"].is_active
    assert "the process of camera was ended with all others" in str(kb.explain("explore"))


def test_a_closed_knowledge_base_is_no_error_at_the_end(tmp_path):
    kb = KnowledgeBase(rover(), clock=time.monotonic, store=tmp_path / "store")
    processes = ProcessComponents({"camera": python(SLEEP), "lidar": python(SLEEP)})
    with processes:
        processes.activate("camera")
        processes.observe(kb)
        kb.close()
    assert not processes.is_active("camera")


MISSION = """
import sys, time
sys.path.insert(0, sys.argv[2])
from test_processes import SLEEP, managed, python, is_solved, turned

kb, processes, manager = managed({"camera": python(sys.argv[3], grace=0.2), "lidar": python(SLEEP)}, store=sys.argv[1])
kb.request_action("explore")
turned(manager, lambda: is_solved(kb)() and kb.processes)
kb.flush()
print(kb.processes[0].pid, processes._guardian.pid, flush=True)
time.sleep(600)
"""
DEAF = "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"


@pytest.mark.parametrize("with_guardian", [True, False])
def test_after_a_kill_the_facts_are_put_right_and_what_is_needed_runs_again(
    with_guardian, tmp_path
):
    store = tmp_path / "store"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    command = [sys.executable, "-c", MISSION, str(store), str(Path(__file__).parent), DEAF]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as mission:
        old, guardian = map(int, mission.stdout.readline().split())
        if not with_guardian:
            os.kill(guardian, signal.SIGKILL)
        mission.kill()
    brief = {"camera": python(SLEEP, grace=0.2), "lidar": python(SLEEP, grace=0.2)}
    kb, processes, manager = managed(brief, store=store)
    with processes:
        assert [(one.pid, one.end) for one in kb.processes] == [(old, None)]
        assert kb.components["camera"].is_active
        manager.update()
        (first,) = kb.processes
        assert first.end is not None
        assert (
            kb.latest_plan.reason == "the process of camera is no more; camera is needed by explore"
        )
        turned(manager, lambda: is_solved(kb)() and len(kb.processes) == 2)
        assert not is_alive(old)
        assert is_alive(kb.processes[1].pid)
        assert kb.components["camera"].status is Status.SOLVED
    kb.close()


@pytest.mark.parametrize("mark", [None, "of this program", "not one of ours"])
def test_a_stranger_that_has_got_the_number_of_a_process_is_left_alone(mark):
    written = {None: None, "of this program": new_mark(), "not one of ours": "hello"}[mark]
    environment = {**os.environ, **({} if written is None else {MARK: written})}
    with subprocess.Popen([sys.executable, "-c", SLEEP], env=environment) as stranger:
        kb, processes, manager = managed({"camera": python(SLEEP), "lidar": python(SLEEP)})
        kb.component_started("camera", stranger.pid)
        kb.component_active("camera", True)
        with processes:
            kb.request_action("explore")
            turned(manager, lambda: is_solved(kb)() and len(kb.processes) == 2)
            assert kb.processes[0].end is not None
        assert is_alive(stranger.pid)
        stranger.kill()


def test_what_runs_already_goes_on_when_another_knowledge_base_looks(tmp_path):
    kb, processes, manager = managed(
        {"camera": python(SLEEP), "lidar": python(SLEEP)}, store=tmp_path / "store"
    )
    with processes:
        kb.request_action("explore")
        turned(manager, lambda: is_solved(kb)() and kb.processes)
        kb.close()
        again = KnowledgeBase(rover(), clock=time.monotonic, store=tmp_path / "store")
        processes.observe(again)
        (process,) = again.processes
        assert process.end is None
        assert again.actions["explore"].status is Status.SOLVED
    assert process.end is not None
    again.close()


# nothing is left behind


SCRIPT = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background ignores it
from kb.processes import ProcessComponents
from kb.processes import Program

note, ending = sys.argv[1:]
code = '''
import os, subprocess, sys, time
sleep = [sys.executable, "-c", "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"]
children = [subprocess.Popen(sleep), subprocess.Popen(sleep, start_new_session=True)]
with open(sys.argv[1] + ".part", "w") as file:
    file.write(" ".join(str(pid) for pid in (os.getpid(), *(child.pid for child in children))))
os.rename(sys.argv[1] + ".part", sys.argv[1])
time.sleep(600)
'''
processes = ProcessComponents({"node": Program([sys.executable, "-c", code, note], grace=0.2)})
processes.activate("node")
while not os.path.exists(note):
    time.sleep(0.01)
if ending == "fork":
    child = os.fork()
    if child == 0:
        sys.exit()
    os.waitpid(child, 0)
    assert processes.is_active("node")
if ending == "error":
    raise RuntimeError("on purpose")
if ending == "close":
    processes.close()
if ending in ("SIGTERM", "SIGKILL", "SIGINT"):
    time.sleep(600)
"""


@pytest.mark.parametrize(
    "ending", ["end", "close", "error", "fork", "SIGINT", "SIGTERM", "SIGKILL"]
)
def test_nothing_is_left_behind_however_this_process_ends(ending, tmp_path):
    note = tmp_path / "pids"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SCRIPT, str(note), ending]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as script:
        wait_for(note.exists)
        pids = [int(pid) for pid in note.read_text().split()]
        assert len(pids) == 3
        if ending.startswith("SIG"):
            assert all(is_alive(pid) for pid in pids)
            script.send_signal(getattr(signal, ending))
        try:
            _, complaint = script.communicate(timeout=PATIENCE_S)
        finally:
            script.kill()
        assert "AssertionError" not in complaint
        for pid in pids:
            wait_for(lambda: not is_alive(pid), f"{pid} of {pids} is left behind")  # noqa: B023  # used at once


FINDER = """
import sys, time
from kb import KnowledgeBase, Model
from kb.processes import ProcessComponents
from kb.processes import Program
model = Model("rover")
model.component("camera", kind="process")
kb = KnowledgeBase(model)
kb.component_started("camera", int(sys.argv[1]))
ProcessComponents({"camera": Program([sys.executable], grace=0.5)}).observe(kb)
print("found", flush=True)
time.sleep(600)
"""


def test_what_was_left_over_is_ended_even_if_who_has_found_it_is_killed_meanwhile(tmp_path):
    gone = [
        sys.executable,
        "-c",
        "from kb.processes.guardian import new_mark; print(new_mark(), end='')",
    ]
    mark = subprocess.run(gone, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    note, stubborn = tmp_path / "child", [sys.executable, "-c", STUBBORN, str(tmp_path / "child")]
    with subprocess.Popen(stubborn, env={**os.environ, MARK: mark}) as left:
        wait_for(note.exists)
        command = [sys.executable, "-c", FINDER, str(left.pid)]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as finder:
            assert finder.stdout.readline() == "found\n"
            finder.kill()
        try:
            wait_for(
                lambda: not is_alive(left.pid) and not is_alive(int(note.read_text())),
                "it is left behind",
            )
        finally:
            left.kill()


def test_what_is_closed_starts_nothing_any_more():
    processes = ProcessComponents({"camera": python(SLEEP)})
    processes.activate("camera")
    processes.close()
    processes.close()
    assert not processes.is_active("camera")
    with pytest.raises(KnowledgeBaseError, match="closed for good"):
        processes.activate("camera")


# bad input


def test_a_program_is_found_from_the_directory_in_which_it_is_run(tmp_path, monkeypatch):
    (tmp_path / "run.sh").symlink_to(sys.executable)
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path)
    Program(["./run.sh"]).check()
    Program(["../run.sh"], directory="sub").check()
    with pytest.raises(InvalidValue, match=r"no executable '\./run.sh' is found"):
        Program(["./run.sh"], directory="sub").check()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"arguments": ["no_such_program_xyz"]}, "no executable 'no_such_program_xyz' is found"),
        ({"arguments": ["./nowhere/program"]}, "correct the path"),
        ({"arguments": ["{data}"]}, "chmod +x it"),
        ({"arguments": ["/"]}, "no executable '/' is found"),
        ({"arguments": [sys.executable], "directory": "nowhere"}, "no working directory 'nowhere'"),
        ({"arguments": [sys.executable], "directory": sys.executable}, "create it or name another"),
        ({"arguments": sys.executable}, "no shell takes them apart"),
        ({"arguments": []}, "begins with the executable"),
        ({"arguments": 5}, "begins with the executable"),
        ({"arguments": {sys.executable}}, "begins with the executable"),
        ({"arguments": [sys.executable, 3]}, "are text without null characters, not 3"),
        ({"arguments": [sys.executable, "a\0b"]}, "null characters"),
        ({"arguments": [sys.executable], "environment": {"RATE": 3}}, "variables are text"),
        ({"arguments": [sys.executable], "environment": {3: "x"}}, "variables are text"),
        ({"arguments": [sys.executable], "environment": {"A=B": "x"}}, "have no '='"),
        ({"arguments": [sys.executable], "environment": ["x"]}, "mapping of text to text"),
        ({"arguments": [sys.executable], "restarts": -1}, "whole number from 0"),
        ({"arguments": [sys.executable], "grace": float("nan")}, "finite number of seconds"),
        ({"arguments": [sys.executable], "back_off": "1"}, "finite number of seconds"),
    ],
)
def test_a_program_that_cannot_be_run_is_refused_with_what_to_do(options, words, tmp_path):
    data = tmp_path / "data"
    data.write_text("no program")
    if options["arguments"] == ["{data}"]:
        options = {"arguments": [str(data)]}
    with pytest.raises(InvalidValue) as caught:
        ProcessComponents({"camera": Program(**options)})
    assert words in str(caught.value)


def test_names_that_nothing_has_are_refused():
    with ProcessComponents({"camera": python(SLEEP)}) as processes:
        with pytest.raises(UnknownName, match="did you mean 'camera'"):
            processes.activate("camra")
        kb = KnowledgeBase(Model("empty"), clock=lambda: 0.0)
        with pytest.raises(UnknownName, match="unknown component 'camera'"):
            processes.observe(kb)
        processes.observe(kb)
    with pytest.raises(InvalidValue, match="is run as a"):
        ProcessComponents({"camera": [sys.executable]})


VALUES = st.one_of(
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(),
    st.lists(st.integers()),
)


@given(st.dictionaries(st.text(min_size=1), VALUES))
def test_parameters_survive_the_environment(parameters):
    assert json.loads(Program(["x"]).variables(parameters)[PARAMETERS]) == parameters


@given(st.text(st.characters(exclude_characters="\0")), st.integers())
def test_text_around_a_place_stays_as_it_is(text, number):
    plain = text.replace("{", "(").replace("}", ")")
    program = Program([f"x{plain}", f"{plain}{{rate}}{plain}"])
    assert program.command({"rate": number}) == [f"x{plain}", f"{plain}{number}{plain}"]
