"""Connections that are cut at random while requests and events go over them."""

import random
import threading
import time
from contextlib import closing
from typing import NamedTuple

from ros_rig import until
from rosbridge_double import RosbridgeDouble

from missions.wires.node import RosError
from missions.wires.rosbridge import Rosbridge


class Outcome(NamedTuple):
    """Requests that were acknowledged, and of these those that never arrived, or arrived twice."""

    acknowledged: int
    lost: int
    doubled: int


def requests_through_cuts(seed, *, cuts):
    """Have a node request and publish while all its connections are cut so many times."""
    rng = random.Random(seed)
    stop = threading.Event()
    arrived = []
    heard = []
    acknowledged = []

    def request():
        number = 0
        while not stop.is_set():
            number += 1
            try:
                reply = node.call("/do", "", {"number": number})
                until(reply.done, turn=node.update)
                acknowledged.append(reply.result()["number"])
            except RosError:  # it is not known whether it was done, so it is never sent again
                time.sleep(0.01)
            node.publish("/events", "", {"number": number})

    def wait():
        after = len(acknowledged)
        until(lambda: len(acknowledged) >= after + 3)

    thread = threading.Thread(target=request)
    with closing(RosbridgeDouble()) as host, closing(Rosbridge(host.url)) as node:
        host.serve("/do", "x", lambda request: arrived.append(request["number"]) or request)
        host.subscribe("/events", "", lambda message: heard.append(message["number"]))
        thread.start()
        for _ in range(cuts):
            wait()
            time.sleep(rng.uniform(0.0, 0.05))
            host.cut()
        wait()
        stop.set()
        thread.join()
    doubled = sum(len(numbers) - len(set(numbers)) for numbers in (arrived, heard))
    return Outcome(len(acknowledged), len(set(acknowledged) - set(arrived)), doubled)
