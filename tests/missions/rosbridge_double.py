"""A rosbridge as rosbridge_suite 2.1.0 is by its defaults; and a player of what one said.

A connection does one thing at a time: an unanswered call or a goal under way blocks it, topics
still flow. An unknown type, operation or malformed text is answered by nothing.
"""

import json
import socket
import threading
import time
from contextlib import suppress

from websockets.sync.server import serve


class Client:
    def __init__(self, websocket):
        self.websocket = websocket
        self.topics = set()
        self.services = set()
        self.waiting = {}
        self.is_over = threading.Event()

    def send(self, **message):
        with suppress(Exception):
            self.websocket.send(json.dumps(message))


class Host:
    """A port that WebSockets are accepted at; a subclass attends them."""

    def __init__(self, port=0):
        self.clients = []
        self._is_closed = False
        self._server = serve(self._attend, "127.0.0.1", port, compression=None)
        self.port = self._server.socket.getsockname()[1]
        self.url = f"ws://127.0.0.1:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self):
        self._is_closed = True  # for who connects meanwhile
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
        if self._is_closed:
            client.is_over.set()
        try:
            for text in websocket:
                with suppress(ValueError, LookupError, TypeError, AttributeError, RecursionError):
                    self.do(client, json.loads(text))
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
        self.services = {}
        self.latched = {}
        self.actions = {}
        self.hearers = {}
        self.goals = {}
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
        number = f"{len(client.waiting)}"
        answered = threading.Event()
        answer = {}
        client.waiting[number] = lambda message: (answer.update(message), answered.set())
        client.send(op="call_service", id=number, service=service, args=request)
        assert answered.wait(60.0)
        return answer

    # ---------------------------------------------------------------- what clients ask

    def do(self, client, message):
        getattr(self, f"_{message['op']}", lambda *_: None)(client, message)

    def _subscribe(self, client, message):
        topic = message["topic"]
        client.topics.add(topic)
        if self.latched.get(topic) is not None:
            client.send(op="publish", topic=topic, msg=self.latched[topic])

    def _publish(self, client, message):
        self.publish(message["topic"], "", message["msg"])

    def _advertise_service(self, client, message):
        client.services.add(message["service"])

    def _service_response(self, client, message):
        client.waiting.pop(message["id"])(message)

    def _call_service(self, client, message):
        service = message["service"]
        answer = {"values": f"Service {service} does not exist", "result": False}
        if any(service in other.services for other in list(self.clients)):
            answer = self.call(service, message["args"])
        elif service in self.services:
            answer = self.services[service](message["args"])
            if answer is None:
                client.is_over.wait()  # blocked for good
            if "result" not in answer or "values" not in answer:
                answer = {"values": answer, "result": True}
        about = {"op": "service_response", "service": service, "id": message["id"]}
        client.send(**about, values=answer["values"], result=answer["result"])

    def _send_action_goal(self, client, message):
        action = message["action"]
        over = threading.Event()
        server = self.actions.get(action)

        def end(status, values):
            about = {"op": "action_result", "action": action, "id": message["id"], "result": True}
            client.send(**about, values=values, status=status)
            over.set()

        def show(values):
            client.send(op="action_feedback", action=action, values=values)

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
        self._left = [message for message in case if message["from"] != "world"]
        self._ids = {}
        super().__init__()

    def _next(self):
        requests = (message["json"] for message in self._left if message["from"] == "client")
        return next(requests, {"op": ""})

    def do(self, client, message):
        operation = message["op"]
        service = message.get("service", "")
        if service.endswith("cancel_goal"):  # the client asks for signs of life
            answer = {"values": {"return_code": 2, "goals_canceling": []}, "result": True}
            client.send(op="service_response", service=service, id=message["id"], **answer)
            return
        while self._next()["op"] == "subscribe" != operation:
            time.sleep(0.002)  # that comes on another connection
        recorded = self._next()
        if recorded["op"] != operation:
            return
        while self._left.pop(0)["from"] != "client":
            pass
        if operation == "send_action_goal":
            self._ids[recorded["id"]] = client, message["id"]
        while self._left and self._left[0]["from"] == "server":
            answer = self._left.pop(0)["json"]
            owner, number = self._ids.get(answer.get("id"), (client, answer.get("id")))
            if answer["op"] == "action_feedback":
                owner = next(reversed(self._ids.values()))[0]
            owner.send(**answer | ({"id": number} if number else {}))
