"""A wire that is cut at random while requests and events go over it, and what came of them."""

import random
import socket
import threading
import time
from contextlib import suppress
from typing import NamedTuple

from rosbridge_double import RosbridgeDouble

from missions.wires.node import RosError
from missions.wires.rosbridge import Rosbridge


class Outcome(NamedTuple):
    """How many requests were acknowledged, and of these how many the other side never got, or got twice."""

    acknowledged: int
    lost: int
    doubled: int


class Wire:
    """Passes on bytes between a port of its own and another, until it is cut; then it passes on anew."""

    def __init__(self, port, own=0):
        self._to, self._pairs = port, []
        self._listening = socket.create_server(("127.0.0.1", own))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
            except OSError:
                return
            self._pairs.append((near, far))
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    def _pass_on(self, one, other):
        try:
            while data := one.recv(4096):
                other.sendall(data)
        except OSError:
            pass
        finally:
            one.close()
            other.close()

    def cut(self):
        while self._pairs:
            for one in self._pairs.pop():
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def close(self):
        with suppress(OSError):
            self._listening.shutdown(
                socket.SHUT_RDWR
            )  # who waits for the next is woken, and lets go of the port
        self._listening.close()
        self.cut()


def requests_through_cuts(seed, *, cuts):
    """Have a node request and publish over a wire that is cut so many times, at random."""
    rng, server = random.Random(seed), RosbridgeDouble()
    got, heard = [], []
    server.serve("/do", "x", lambda one: got.append(one["number"]) or {"number": one["number"]})
    server.subscribe("/events", "", lambda one: heard.append(one["number"]))
    wire = Wire(server.port)
    node, acknowledged, stop = Rosbridge(f"ws://127.0.0.1:{wire.port}"), [], threading.Event()

    def request():
        number = 0
        while not stop.is_set():
            number += 1
            try:
                acknowledged.append(node.call("/do", "", {"number": number}).result(60)["number"])
            except RosError:
                time.sleep(
                    0.01
                )  # it is not known whether it was done: it is told as failed and never sent again
            node.publish("/events", "", {"number": number})

    thread = threading.Thread(target=request)
    thread.start()
    try:
        for _ in range(cuts):
            is_back, after = time.monotonic() + 60, len(acknowledged)
            while len(acknowledged) < after + 3 and time.monotonic() < is_back:
                time.sleep(0.005)
            time.sleep(rng.uniform(0.0, 0.05))
            wire.cut()
        after = len(acknowledged)
        while len(acknowledged) < after + 3:
            time.sleep(0.005)
    finally:
        stop.set()
        thread.join()
        node.close()
        wire.close()
        server.close()
    twice = len(got) - len(set(got)) + len(heard) - len(set(heard))
    return Outcome(len(acknowledged), len(set(acknowledged) - set(got)), twice)
