"""A rosbridge as rosbridge_suite 2.1.0 is by its defaults; and a player of what one said.

A connection does one thing at a time: an unanswered call or a goal under way blocks it, topics
still flow. An unknown type, operation or malformed text is answered by nothing.
"""

import json
import socket
import threading
from contextlib import suppress

from websockets.sync.server import serve

from missions.wires.node import RosError


class Client:
    """A connection; `said` is all that it sent."""

    def __init__(self, websocket):
        self.websocket, self.said, self.topics, self.services = websocket, [], set(), set()
        self.waiting, self.is_over = {}, threading.Event()

    def send(self, **message):
        with suppress(Exception):
            self.websocket.send(json.dumps(message))


class Host:
    """A port that WebSockets are accepted at; a subclass attends them."""

    def __init__(self, port=0):
        self.clients = []
        self._server = serve(self._attend, "127.0.0.1", port, compression=None)
        self.port = self._server.socket.getsockname()[1]
        self.url = f"ws://127.0.0.1:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self):
        for client in list(self.clients):
            client.is_over.set()
        self.cut()
        self._server.shutdown()
        self._thread.join()

    def cut(self):
        """Break all connections, as a killed rosbridge does."""
        for client in list(self.clients):
            with suppress(OSError):
                client.websocket.socket.shutdown(socket.SHUT_RDWR)

    def _attend(self, websocket):
        client = Client(websocket)
        self.clients.append(client)
        try:
            for text in websocket:
                with suppress(ValueError, LookupError, TypeError, AttributeError, RecursionError):
                    message = json.loads(text)
                    client.said.append(message)
                    self.do(client, message)
        except Exception:
            pass
        finally:
            client.is_over.set()
            self.clients.remove(client)

    def do(self, client, message):
        raise NotImplementedError


class RosbridgeDouble(Host):
    """The graph behind it has services (functions), topics and action servers."""

    def __init__(self, port=0):
        self.services, self.latched, self.actions, self.hearers, self.goals = {}, {}, {}, {}, {}
        super().__init__(port)

    # ---------------------------------------------------------------- the graph

    def serve(self, service, kind, answer):
        self.services[service] = answer

    def unserve(self, service):
        self.services.pop(service, None)

    def advertise(self, topic, kind, *, is_latched=False):
        if is_latched:
            self.latched.setdefault(topic, None)

    def unadvertise(self, topic):
        self.latched.pop(topic, None)

    def has_hearer(self, topic):
        return any(topic in client.topics for client in list(self.clients))

    def subscribe(self, topic, kind, hearer):
        self.hearers.setdefault(topic, []).append(hearer)

    def publish(self, topic, kind, message):
        if topic in self.latched:
            self.latched[topic] = message
        for client in list(self.clients):
            if topic in client.topics:
                client.send(op="publish", topic=topic, msg=message)
        for hearer in self.hearers.get(topic, ()):
            hearer(message)

    def call(self, service, request):
        """Call a service of a client, as a node of the graph does."""
        (client,) = [client for client in self.clients if service in client.services]
        number, answered, answer = f"{len(client.waiting)}", threading.Event(), {}
        client.waiting[number] = lambda message: (answer.update(message), answered.set())
        client.send(op="call_service", id=number, service=service, args=request)
        assert answered.wait(60.0)
        return answer

    # ---------------------------------------------------------------- what clients say

    def do(self, client, message):
        getattr(self, f"_{message['op']}", lambda *_: None)(client, message)

    def _subscribe(self, client, message):
        client.topics.add(message["topic"])
        if self.latched.get(message["topic"]) is not None:
            client.send(op="publish", topic=message["topic"], msg=self.latched[message["topic"]])

    def _publish(self, client, message):
        self.publish(message["topic"], "", message["msg"])

    def _advertise_service(self, client, message):
        client.services.add(message["service"])

    def _service_response(self, client, message):
        client.waiting.pop(message["id"])(message)

    def _call_service(self, client, message):
        service = message["service"]
        answered = {"op": "service_response", "service": service, "id": message["id"]}
        owner = next((one for one in list(self.clients) if service in one.services), None)
        if owner is not None:
            answer = self.call(service, message["args"])
            client.send(**answered, values=answer["values"], result=answer["result"])
        elif service not in self.services:
            client.send(**answered, values=f"Service {service} does not exist", result=False)
        else:
            try:
                values = self.services[service](message["args"])
            except RosError as error:
                client.send(**answered, values=str(error), result=False)
                return
            if values is None:
                client.is_over.wait()  # blocked for good
            client.send(**answered, values=values, result=True)

    def _send_action_goal(self, client, message):
        server, over = self.actions.get(message["action"]), threading.Event()
        about = {"action": message["action"]}

        def end(status, values):
            client.send(
                op="action_result",
                **about,
                values=values,
                status=status,
                result=True,
                id=message["id"],
            )
            over.set()

        def show(values):
            client.send(op="action_feedback", **about, values=values)

        key = None if server is None else server.begin(message["args"], show, end)
        self.goals[message["id"]] = key
        while not over.wait(0.01) and not client.is_over.is_set():
            pass  # the connection is busy with its goal; if that is rejected, for good

    def _cancel_action_goal(self, client, message):
        key = self.goals.get(message["id"])
        if key:
            self.actions[message["action"]].cancel(key)


class Player(Host):
    """Plays what a real rosbridge said in a case, whenever a client asks as then."""

    def __init__(self, case):
        self._left = [one for one in case if one["from"] != "world"]
        self._ids = {}
        super().__init__()

    def do(self, client, message):
        if message.get("service", "").endswith("cancel_goal"):  # the client asks for signs of life
            values = {"return_code": 2, "goals_canceling": []}
            client.send(
                op="service_response",
                service=message["service"],
                id=message["id"],
                values=values,
                result=True,
            )
            return
        recorded = next((one for one in self._left if one["from"] == "client"), None)
        if recorded is None or recorded["json"]["op"] != message["op"]:
            return
        self._left = self._left[self._left.index(recorded) + 1 :]
        if message["op"] == "send_action_goal":
            self._ids[recorded["json"]["id"]] = client, message["id"]
        while self._left and self._left[0]["from"] == "server":
            said = self._left.pop(0)["json"]
            owner, number = self._ids.get(said.get("id"), (client, said.get("id")))
            if said["op"] == "action_feedback":
                owner = next(reversed(self._ids.values()))[0]
            owner.send(**{**said, **({"id": number} if number else {})})
