"""A wire that is cut at random while requests and events go over it, and what came of them."""

import random
import socket
import threading
import time
from contextlib import suppress
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


class Wire:
    """Passes on bytes to another port, until it is cut; then it passes on anew."""

    def __init__(self, port):
        self._to, self._sockets = port, []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                self._sockets += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    def _pass_on(self, source, target):
        with suppress(OSError):
            while data := source.recv(4096):
                target.sendall(data)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)  # wakes who receives
            end.close()

    def cut(self):
        while self._sockets:
            with suppress(OSError):
                self._sockets.pop().shutdown(socket.SHUT_RDWR)

    def close(self):
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # wakes who accepts
        self._listening.close()
        self.cut()


def requests_through_cuts(seed, *, cuts):
    """Have a node request and publish over a wire that is cut so many times, at random."""
    rng, server = random.Random(seed), RosbridgeDouble()
    arrived, heard, acknowledged = [], [], []
    server.serve("/do", "x", lambda request: arrived.append(request["number"]) or request)
    server.subscribe("/events", "", lambda message: heard.append(message["number"]))
    wire, stop = Wire(server.port), threading.Event()
    node = Rosbridge(f"ws://127.0.0.1:{wire.port}")

    def request():
        number = 0
        while not stop.is_set():
            number += 1
            try:
                acknowledged.append(node.call("/do", "", {"number": number}).result(60)["number"])
            except RosError:  # it is not known whether it was done, so it is never sent again
                time.sleep(0.01)
            node.publish("/events", "", {"number": number})

    def wait():
        after = len(acknowledged)
        until(lambda: len(acknowledged) >= after + 3)

    thread = threading.Thread(target=request)
    thread.start()
    try:
        for _ in range(cuts):
            wait()
            time.sleep(rng.uniform(0.0, 0.05))
            wire.cut()
        wait()
    finally:
        stop.set()
        thread.join()
        for part in (node, wire, server):
            part.close()
    doubled = sum(len(numbers) - len(set(numbers)) for numbers in (arrived, heard))
    return Outcome(len(acknowledged), len(set(acknowledged) - set(arrived)), doubled)
