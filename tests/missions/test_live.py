"""The live page's server: who may look, what pages get, and that no page delays the robot."""

import asyncio
import json
import math
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
import websockets
from test_page import Rover
from websockets.sync.client import connect

from missions.baselines import open_run
from missions.engine.mission import MissionError, find_mission
from missions.views.live import LiveView, Steering
from missions.views.recorder import RunRecorder

SOON_S = 120.0


def fold(rows):
    return {(track, key): value for _, track, key, value in rows}


def address(view, path="ws"):
    base, _, query = view.url.partition("?")
    return base.replace("http", "ws") + path + (f"?{query}" if query else "")


def status_of(url, method="GET", **headers):
    request = urllib.request.Request(url, headers=headers, method=method)
    try:
        with urllib.request.urlopen(request, timeout=SOON_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def talk(view, *said, until, **options):
    """Send messages to a view and return its answers, up to the first for which `until` holds."""

    async def conversation():
        heard = []
        async with websockets.connect(address(view), max_size=None, **options) as page:
            for one in said:
                await page.send(one if isinstance(one, str) else json.dumps(one))
            async with asyncio.timeout(SOON_S):  # frames come for ever
                while not (heard and until(heard[-1])):
                    heard.append(json.loads(await page.recv()))
        return heard

    return asyncio.run(conversation())


@pytest.fixture
def rover():
    return Rover()


@pytest.fixture
def view(rover):
    with LiveView(rover.kb, rover.runner, port=0) as view:
        yield view


@contextmanager
def mission(*first, kind=Steering, speed=1.0, **settings):
    """A mission under way in a thread, with a view of it that may steer it; it does `first`."""
    given = {name: str(value) for name, value in settings.items()}
    run = open_run(find_mission("suave_extended"), settings=given)
    steering = kind(run, speed)
    run.listen(steering)
    page = RunRecorder(run, 0, given, what_if=False)
    steering.breakpoints.watch(page.recorder.rows)
    for what in first:
        steering.do({"do": what})
    done = []

    def fly():
        verdict = run.run()
        page.end(verdict)
        done.append(verdict)

    thread = threading.Thread(target=fly)
    with LiveView(run.kb, port=0, recorder=page.recorder, steering=steering) as view:
        thread.start()
        try:
            yield view, run, done, steering
        finally:
            steering.do({"do": "speed", "value": 0})
            steering.do({"do": "resume"})
            thread.join()


def test_page_comes_from_this_machine_and_gets_the_present_at_once(rover, view):
    rover.kb.measure("light", 0.9)
    rover.work(1.0)
    code, text = status_of(view.url)
    assert code == 200
    assert 'id="rosa-data"' in text
    assert '"live":{"socket":"/ws"}' in text
    (hello,) = talk(view, until=lambda one: "hello" in one)
    assert hello["hello"] == view.recorder.header
    assert fold(hello["rows"]) == fold(json.loads(json.dumps(view.recorder.recorded.rows)))
    assert hello["now"] == pytest.approx(1.0)
    assert hello["may"] == []


def test_what_happens_comes_as_the_same_rows_that_a_report_has(rover, view):
    async def follow():
        async with websockets.connect(address(view), max_size=None) as page:
            rows = json.loads(await page.recv())["rows"]
            await asyncio.to_thread(rover.work, 1.0)
            rover.kb.measure("energy", 0.1)
            await asyncio.to_thread(rover.work, 2.0)
            while fold(rows) != fold(json.loads(json.dumps(view.recorder.recorded.rows))):
                rows += json.loads(await page.recv())["rows"]
            return rows

    assert ("adaptation", 1) in fold(asyncio.run(asyncio.wait_for(follow(), SOON_S)))


def test_page_that_comes_late_gets_the_past_after_the_present(rover, view):
    rover.work(2.0)
    rows = json.loads(json.dumps(view.recorder.recorded.rows))
    hello, past = talk(view, until=lambda one: "hello" not in one)
    assert fold(hello["rows"]) == fold(rows)
    assert past["rows"] == rows


def test_what_if_is_asked_of_the_knowledge_base(rover, view):
    rover.kb.measure("energy", 0.9)
    (*_, answer) = talk(
        view, {"ask": "whatif", "id": 7, "measured": {"energy": 0.1}}, until=lambda one: "id" in one
    )
    names = {value["name"]: key for key, value in view.recorder.recorded.last("element").items()}
    assert answer["id"] == 7
    assert answer["whatif"]["feasible"] == [names["charge"]]
    (*_, answer) = talk(
        view, {"ask": "whatif", "id": 8, "measured": {"engery": 0.1}}, until=lambda one: "id" in one
    )
    assert "unknown attribute 'engery'" in answer["error"]
    assert rover.kb.attributes["energy"].value == 0.9


def test_page_without_leave_may_look_and_do_nothing(view):
    for said in ({"do": "pause"}, {"do": "inject", "fault": "measure energy=0.1"}):
        (*_, answer) = talk(view, said, until=lambda one: "error" in one)
        assert "may only watch" in answer["error"]


def test_page_answers_only_get_and_head(view):
    codes = [status_of(view.url, method)[0] for method in ("GET", "HEAD", "POST", "DELETE")]
    assert codes == [200, 200, 405, 405]


def test_head_is_answered_without_the_page(view):
    place = urlsplit(view.url)
    with socket.create_connection((place.hostname, place.port)) as link:
        link.sendall(f"HEAD / HTTP/1.1\r\nHost: {place.netloc}\r\n\r\n".encode())
        answer = link.makefile("rb").read()
    assert answer.startswith(b"HTTP/1.1 200")
    assert answer.endswith(b"\r\n\r\n")


def test_nobody_else_s_page_may_look(view):
    base = view.url.rstrip("/")
    code, said = status_of(base, Origin="http://elsewhere.example")
    assert (code, "may not look at this robot" in said) == (403, True)
    code, said = status_of(base, Host="elsewhere.example")
    assert (code, "this is not elsewhere.example" in said) == (403, True)
    with pytest.raises(websockets.InvalidStatus, match="403"):
        talk(
            view, until=lambda one: True, additional_headers={"Origin": "http://elsewhere.example"}
        )


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (b"/", b"Host: one.example\r\nHost: other.example\r\n"),
        (b"/", b"Host: 127.0.0.1\r\nOrigin: http://[::1\r\n"),
        (b"//[", b"Host: 127.0.0.1\r\n"),
    ],
)
def test_who_asks_in_a_malformed_way_is_told_so(view, path, headers):
    host, port = view.url.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), timeout=SOON_S) as asking:
        asking.sendall(b"GET " + path + b" HTTP/1.1\r\n" + headers + b"\r\n")
        answer = b"".join(iter(lambda: asking.recv(4096), b"")).decode()
    assert answer.startswith("HTTP/1.1 400")
    assert "malformed; open http://127.0.0.1:" in answer


def test_elsewhere_a_token_is_asked_for_at_every_door(rover):
    with LiveView(rover.kb, rover.runner, port=0, host="0.0.0.0") as view:
        port = view.url.split(":")[2].split("/")[0]
        token = view.url.partition("?token=")[2]
        assert len(token) > 15
        door = f"http://127.0.0.1:{port}/"
        assert status_of(door) == (
            403,
            "the token is missing; open the address that was printed when the view began\n",
        )
        assert status_of(f"{door}?token=guess")[1].startswith("the token is wrong")
        assert status_of(f"{door}?token=%C3%A9")[0] == 403
        assert status_of(f"{door}?token={token}")[0] == 200
        for query in ("", "?token=guess"):

            async def knock(query=query):
                async with websockets.connect(f"ws://127.0.0.1:{port}/ws{query}"):
                    pass

            with pytest.raises(websockets.InvalidStatus, match="403"):
                asyncio.run(knock())

    with LiveView(rover.kb, rover.runner, port=0, token="mine") as view:
        assert status_of(view.url.partition("?")[0])[0] == 403
        assert status_of(view.url)[0] == 200


def test_pages_are_only_so_many(view, monkeypatch):
    monkeypatch.setattr("missions.views.live._MOST_PAGES", 1)
    with connect(address(view)) as page:
        page.recv(SOON_S)
        with pytest.raises(websockets.exceptions.InvalidStatus, match="503"):
            connect(address(view)).__enter__()
    assert status_of(view.url)[0] == 200, "the page itself is no page that looks"


def test_port_in_use_is_told_in_a_sentence(rover, view):
    port = int(view.url.split(":")[2].rstrip("/"))
    with pytest.raises(
        MissionError,
        match=rf"cannot listen on 127\.0\.0\.1:{port}: Address already in use; give ano",
    ):
        LiveView(rover.kb, rover.runner, port=port)
    with pytest.raises(MissionError, match="a port must be a number from 0"):
        LiveView(rover.kb, rover.runner, port=70000)


def test_nonsense_is_answered_in_a_word_and_ten_megabytes_of_it_close_the_door(rover, view):
    for said in (
        "nonsense",
        "[]",
        "3",
        '{"ask": "whatif", "measured": 3}',
        "[" * 5000,
    ):
        (*_, answer) = talk(view, said, until=lambda one: "error" in one)
        assert (
            "not a message of a page" in answer["error"] or "may only watch" in answer["error"]
        ), said

    with (
        connect(address(view), max_size=None) as page,
        pytest.raises(websockets.ConnectionClosed) as closed,
    ):
        list(page if page.send("x" * 10_000_000) is None else ())
    assert closed.value.rcvd is None or closed.value.rcvd.code == 1009
    rover.work(1.0)
    (hello,) = talk(view, until=lambda one: "hello" in one)
    assert hello["now"] == pytest.approx(1.0)


def test_frozen_page_holds_up_nobody_and_hears_how_much_it_has_missed(rover, view):
    """One page stops reading; another gets every row.

    The frozen one is given the present when it reads again.
    """
    host, port = view.url.removeprefix("http://").rstrip("/").split(":")

    async def follow():
        frozen = socket.create_connection((host, int(port)))
        frozen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        slow = await websockets.connect(address(view), sock=frozen, max_size=None, max_queue=1)
        async with websockets.connect(address(view), max_size=None) as page:
            await page.recv()
            count = len(json.loads(await page.recv())["rows"])  # the past
            text = "x" * 1000
            for step in range(
                20
            ):  # 20,000 rows of a busy robot, as fast as the page that reads gets them
                for key in range(1000):
                    view.recorder.put("signal", f"s{key}", f"{text}{step}")
                while count < view.recorder.rows.next:
                    count += len(json.loads(await page.recv())["rows"])
                assert count == view.recorder.rows.next
            last = {}
            while "dropped" not in last:
                last = json.loads(await slow.recv())
            assert fold(last["rows"])["signal", "s999"] == f"{text}19"
            await slow.close()
            return last["dropped"]

    assert asyncio.run(asyncio.wait_for(follow(), SOON_S)) > 5000


def test_battery_fault_from_a_page_is_answered_with_its_chain():
    # it is paused, so that it is the first adaptation
    with mission("pause", duration=60) as (view, run, _, _):
        answers = talk(
            view,
            {"do": "inject", "fault": "measure battery_level=0.2"},
            {"do": "resume"},
            until=lambda one: ("adaptation", 1) in fold(one.get("rows", ())),
        )
        chain = fold(answers[-1]["rows"])["adaptation", 1]["chain"]
        assert chain[0]["words"] == "battery_level is 0.2"
        assert [link["what"] for link in chain] == [
            "news",
            "status",
            "end",
            "request",
            "plan",
            "force",
        ]
        assert run.kb.attributes["battery_level"].value == 0.2
        assert answers[-1]["state"]["held"] == {"battery_level": 0.2}


def test_held_run_stands_still_goes_by_ticks_and_takes_no_tick_more():
    stands = threading.Event()

    class Held(Steering):
        def _left(self, simulated):
            left = super()._left(simulated)
            if left == math.inf:
                stands.set()
            return left

    with mission(kind=Held, duration=100) as (view, run, done, _):
        talk(view, {"do": "pause"}, until=lambda one: one.get("state", {}).get("paused"))
        assert stands.wait(SOON_S)
        before = run.world.now
        time.sleep(0.2)  # in which it would do two ticks
        assert run.world.now == before
        talk(
            view, {"do": "step"}, until=lambda one: one.get("now", 0) > before + 0.05
        )  # news may come before the tick
        assert run.world.now == pytest.approx(before + 0.1)
        assert not done


def test_injected_failure_and_recovery_are_heard_and_what_is_held_is_released():
    with mission(duration=100) as (view, *_):

        def until(track, text):
            return lambda one: any(
                row[1] == track and text in json.dumps(row[3]) for row in one.get("rows", ())
            )

        talk(
            view,
            {"do": "inject", "fault": "fail c_thruster_2"},
            until=until("event", "c_thruster_2 has failed"),
        )
        talk(
            view,
            {"do": "inject", "fault": "recover c_thruster_2"},
            until=until("event", "c_thruster_2 is recovered"),
        )
        said = {"do": "inject", "fault": "measure water_visibility=0.5"}
        talk(
            view,
            said,
            until=lambda one: one.get("state", {}).get("held") == {"water_visibility": 0.5},
        )
        talk(
            view,
            {"do": "inject", "fault": "release water_visibility"},
            until=lambda one: one["state"]["held"] == {},
        )
        for wrong, words in (
            ({"do": "inject", "fault": "fail thruster"}, "unknown component 'thruster'"),
            ({"do": "inject", "fault": "measure battery=1"}, "unknown attribute 'battery'"),
            ({"do": "inject", "fault": "measure battery_level=low"}, "takes ATTRIBUTE=VALUE"),
            ({"do": "speed", "value": -1}, "a speed must be from 0"),
            ({"do": "jump"}, "known are pause, resume, step, speed, break and inject"),
        ):
            (*_, answer) = talk(view, wrong, until=lambda one: "error" in one)
            assert words in answer["error"]


def test_view_that_is_closed_has_given_every_page_the_last_rows(rover):
    view = LiveView(rover.kb, rover.runner, port=0)

    async def follow():
        async with websockets.connect(address(view), max_size=None) as page:
            rows = json.loads(await page.recv())["rows"]
            rover.work(1.0)
            closing = asyncio.create_task(asyncio.to_thread(view.close))
            async for frame in page:
                rows += json.loads(frame).get("rows", [])
            await closing
            return rows

    assert fold(asyncio.run(follow()))["now", 0] == "end"
    view.close()


def test_missing_extra_is_told_with_what_brings_it(rover, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "websockets", None)
    with pytest.raises(
        MissionError, match=r"the live page needs websockets.*pip install 'rosa-taca\[live\]'"
    ):
        LiveView(rover.kb, rover.runner, port=0)
