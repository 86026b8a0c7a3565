import math

import pytest
from suave_stand_ins import Pilot, values_of

from suave_env import Settings
from suave_env.components import Agenda, FollowPipeline, Recharge, RecoverThrusters, SpiralSearch
from suave_env.monitors import Outbox
from suave_env.vehicle import Thrusters

PROMPT = Settings().replace(start_delay_s=0)
CENTRE = (-17.0, 2.4)
STRAIGHT = tuple((-15.5 - 0.5 * index, 0.0) for index in range(40))


def spiral_of(pilot, **changes):
    spiral = SpiralSearch(PROMPT.replace(**changes), pilot, CENTRE)
    spiral.active = True
    return spiral


def follower_of(pilot, path=STRAIGHT, **changes):
    outbox = Outbox(lambda *news: None)
    follower = FollowPipeline(PROMPT.replace(**changes), pilot, outbox)
    follower.take_path(path)
    start(follower)
    return follower, outbox


def start(component, time=0.0):
    component.active = True
    component.activated(time)


def stop(component, time=0.0):
    component.active = False
    component.deactivated(time)


def test_spiral_takes_one_step_per_tick():
    pilot = Pilot(obedient=True)
    spiral = spiral_of(pilot)
    for time in range(5):
        spiral.tick(time)
    growth = 2 * 2.0 * math.tan(math.radians(30)) * 0.1 / (2 * math.pi)
    expected = [
        (
            CENTRE[0] + k * growth * math.cos(0.1 * k),
            CENTRE[1] + k * growth * math.sin(0.1 * k),
            -18.0,
        )
        for k in range(1, 6)
    ]
    assert [target for _, target in pilot.sent] == [pytest.approx(point) for point in expected]


def test_spiral_stalled_in_height_is_sent_lower_each_time():
    pilot = Pilot()
    spiral = spiral_of(pilot)
    spiral.tick(0)
    x, y, _ = pilot.sent[0][1]
    pilot.position = (x, y, -17.0)
    for time in range(1, 36):
        spiral.tick(time)
    assert [target[2] for _, target in pilot.sent] == [-18.0, -18.25, -18.5, -18.75]


def test_spiral_resumes_unless_it_restarts():
    for restarts, expected in ((False, 4), (True, 1)):
        pilot = Pilot(obedient=True)
        spiral = spiral_of(pilot, spiral_restarts=restarts)
        for time in range(3):
            spiral.tick(time)
        stop(spiral)
        pilot.position = pilot.sent[-1][1] if not restarts else (-3.0, -2.0, -18.0)
        start(spiral)
        spiral.tick(10)
        _, (x, y, _) = pilot.sent[-1]
        centre = (-3.0, -2.0) if restarts else CENTRE
        assert math.dist((x, y), centre) == pytest.approx(expected * 0.03676, rel=1e-3)


@pytest.mark.parametrize(("loses", "next_point"), [(True, 11), (False, 10)])
def test_follower_resumes_the_rest_of_the_path(loses, next_point):
    pilot = Pilot(position=(-15.5, 0.0, -18.75))
    follower, _ = follower_of(pilot, follow_loses_point=loses)
    for time in range(9):
        pilot.position = (-15.5 - 0.5 * time - 0.1, 0.0, -18.75)
        follower.tick(time)
    assert pilot.sent[-1][1][0] == STRAIGHT[10][0]
    inspected = follower.distance_m
    stop(follower)
    follower.tick(9)
    start(follower)
    assert follower.distance_m == 0
    assert follower.total_m == inspected > 0
    pilot.position = (-3.0, -2.0, -18.75)
    follower.tick(10)
    assert pilot.sent[-1] == (10, (*STRAIGHT[next_point], -18.75))
    pilot.position = (*STRAIGHT[next_point], -18.75)
    follower.tick(12)
    assert follower.distance_m == pytest.approx(
        0.5
    )  # the way back to the first point does not count
    assert follower.total_m == pytest.approx(inspected + follower.distance_m)


def test_follower_publishes_the_distance_and_the_end():
    pilot = Pilot(obedient=True)
    follower, outbox = follower_of(pilot, STRAIGHT[:4])
    for time in (0, 2, 4):
        follower.tick(time)
    messages = outbox.fetch()
    assert values_of(messages, "pipeline_inspected") == [(0, "true")]
    assert values_of(messages, "distance_inspected") == [(0, "1.5")]
    assert {status["message"] for message in messages for status in message["status"]} == {
        "mission status"
    }


def recovery_of(**changes):
    agenda = Agenda()
    outbox = Outbox(lambda *news: None)
    thrusters = Thrusters(PROMPT)
    recovery = RecoverThrusters(
        PROMPT.replace(**changes), lambda number, time: thrusters.recover(number), agenda, outbox
    )
    return recovery, agenda, outbox, thrusters


def let_happen(agenda):
    while agenda.next_time < math.inf:
        agenda.happen()


def test_recovery_restores_one_thruster_every_quarter_second():
    recovery, agenda, outbox, thrusters = recovery_of()
    thrusters.fail(1)
    thrusters.fail(4)
    start(recovery, 40.0)
    while agenda.next_time < 50.5:
        agenda.happen()
    assert thrusters.failed == (4,)
    let_happen(agenda)
    assert thrusters.failed == ()
    messages = outbox.fetch()
    expected = [(50 + 0.25 * k, {f"c_thruster_{k + 1}": "RECOVERED"}) for k in range(6)]
    assert [(message["time"], message["status"][0]["values"]) for message in messages] == expected
    assert {message["status"][0]["message"] for message in messages} == {"Component status"}


@pytest.mark.parametrize(("interruptible", "published"), [(False, 6), (True, 0)])
def test_recovery_is_interrupted_only_by_its_setting(interruptible, published):
    recovery, agenda, outbox, _ = recovery_of(recovery_interruptible=interruptible)
    start(recovery)
    stop(recovery, 5.0)
    let_happen(agenda)
    assert len(outbox.fetch()) == published


def test_recharge_happens_only_at_the_station():
    pilot = Pilot(position=(-3.0, -2.51, -18.75))
    recharged = []
    node = Recharge(PROMPT, pilot, recharged.append)
    node.tick(0.0)
    assert pilot.sent == []
    start(node)
    node.tick(5.0)
    assert pilot.sent == [(5.0, (-3.0, -2.0, -18.75))]
    assert recharged == []
    pilot.position = (-2.51, -2.49, -15.0)
    node.tick(10.0)
    assert recharged == [10.0]
