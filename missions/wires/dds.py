"""ROS 2 by DDS (Cyclone DDS), for a robot without a bridge: its names of topics, types and services, and its bytes.

Services are those of rmw_cyclonedds: a request and its answer begin with 16 bytes that say whose it is.
"""

import logging
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from threading import Event, RLock, Thread
from typing import Any, Final

from missions.engine.mission import MissionError
from missions.extras import needs
from missions.wires import ros
from missions.wires.node import LOOPBACK, QUEUED, Answer, Heard, Message, Outbox, Refusals, RosError
from missions.wires.typed import Field, made, response, told

_LOOK_S: Final = 0.05
"""How often it is looked who is there [s]."""
_FIND_S: Final = 3.0
"""How long a service is sought before a call fails [s]."""
_WRITE_S: Final = 1.0
"""How long a reader that does not keep up is waited for, in the thread that sends [s]."""
_AT_ONCE: Final = 500
"""Messages of one topic before the next has its turn."""
_FAST_DDS: Final = b"\x01\x0f"
"""How the identity of a participant of Fast DDS begins."""
_CONFIGURATION: Final = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="{0}" multicast="true"/>
</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99
</MaxAutoParticipantIndex><Peers><Peer address="{0}"/></Peers></Discovery></Domain></CycloneDDS>"""
_NOTHING: Final = "structure_needs_at_least_one_member"
"""What a message without fields has on the wire."""
_domains: dict[int, tuple[str, Any]] = {}
"""What this process has opened, which is done once: by number, the address and the domain."""
_log = logging.getLogger(__name__)


class Structs:
    """Types of ROS 2 as classes of cyclonedds, made of the definitions of `rosbags`."""

    def __init__(self) -> None:
        self._made: dict[tuple[str, bool], Any] = {}
        self._fields: dict[str, Mapping[str, Field]] = {}

    def fields(self, kind: str) -> Mapping[str, Field]:
        if kind not in self._fields:
            known = ros.types().store.fielddefs
            if kind not in known:
                raise RosError(
                    f"the type {kind or 'of a message'!r} is not known; name one of ROS 2's, PACKAGE/msg/TYPE"
                )
            self._fields[kind] = {name: _field(*one) for name, one in known[kind][1] if name != _NOTHING}
        return self._fields[kind]

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # a class is made here
        whole: Message = {} if self.fields(kind) else {_NOTHING: 0}
        for name, field in self.fields(kind).items():
            value = values[name] if name in values else self._empty(field)
            is_bytes = bool(field.length) and field.kind in ("byte", "char", "uint8")
            whole[name] = bytes(value) if is_bytes else value
        return self.struct(kind)(**whole)

    def with_header(self, kind: str, whose: int, number: int, message: Any) -> Any:  # noqa: ANN401  # classes are made here
        """Return a request or an answer with the header of rmw_cyclonedds."""
        return self.struct(kind, has_header=True)(whose, number, *vars(message).values())

    def struct(self, kind: str, *, has_header: bool = False) -> Any:  # noqa: ANN401  # a class is made here
        """Return the class of a type."""
        from cyclonedds.idl import make_idl_struct, types

        if (kind, has_header) not in self._made:
            package, folder, name = kind.split("/")
            header = {"rmw_guid": types.uint64, "rmw_seq": types.int64} if has_header else {}
            fields = {name: self._type(field) for name, field in self.fields(kind).items()} or {_NOTHING: types.uint8}
            full = f"{package}.{folder}.dds_.{name}_"
            self._made[kind, has_header] = make_idl_struct(f"{name}_", full, header | fields)
        return self._made[kind, has_header]

    def _type(self, field: Field) -> Any:  # noqa: ANN401  # a type of cyclonedds
        from cyclonedds.idl import types

        named = {"bool": bool, "string": str, "byte": types.uint8, "char": types.uint8}
        one = self.struct(field.kind) if "/" in field.kind else named.get(field.kind) or getattr(types, field.kind)
        if field.length is None:
            return one
        make: Any = types.array[one, field.length] if field.length else types.sequence[one]  # type: ignore[misc]  # as cyclonedds has it
        return make

    def _empty(self, field: Field) -> Any:  # noqa: ANN401  # of whatever type
        if field.length == 0:
            return []
        one = self.new(field.kind, {}) if "/" in field.kind else "" if field.kind == "string" else 0
        return one if field.length is None else [one] * field.length


def _field(node: Any, what: Any) -> Field:  # noqa: ANN401  # as `rosbags` has it
    if node.name in ("ARRAY", "SEQUENCE"):
        return Field(_field(*what[0]).kind, what[1] if node.name == "ARRAY" else 0)
    return Field(what if node.name == "NAME" else what[0])


@dataclass(eq=False)
class _Ear:
    """A reader, and what is done with what it hears."""

    topic: Any
    reader: Any
    take: Callable[[Any], object]
    condition: Any = None
    is_reliable: bool = True


@dataclass(eq=False)
class _Call:
    """A call that is to be answered, and sent when its service is there."""

    service: str
    future: "Future[Message]"
    request: Any
    until_s: float
    is_sent: bool = False


class DdsNode:
    """A node in a DDS domain, of this machine only unless told otherwise.

    Args:
        domain: number of the domain; by default that of ROS_DOMAIN_ID, or 0.
        host: address of the network interface; everybody who reaches another one than this machine's takes part, as DDS
            asks nobody for a token.

    Attributes:
        refused: how many messages made no sense, by what was wrong.

    Raises:
        MissionError: the extra `dds` is missing, or the domain cannot be opened, or is open with another address.
    """

    def __init__(self, domain: int | None = None, host: str = LOOPBACK[0]) -> None:
        with needs("dds", "DDS"):
            import rosbags  # noqa: F401  # its types are needed
            from cyclonedds import core
        self.refused = Refusals()
        self._structs, self._lock, self._closing = Structs(), RLock(), Event()
        self._participant = _participant(int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain is None else domain, host)
        self._name = f"DDS on {host}" + ("" if host in LOOPBACK else ", where nobody is asked for a token")
        self._whose = self._participant.guid.int >> 32 & 2**64 - 1
        self._numbers = count(1)
        self._ears: list[_Ear] = []
        self._writers: dict[str, Any] = {}
        self._clients: dict[str, tuple[Any, _Ear]] = {}
        self._open: dict[int, _Call] = {}
        self._watching: list[Callable[[bool, str], object]] = []
        self._is_there, self._looked_s = False, 0.0
        self._waiting = core.WaitSet(self._participant)
        self._outbox = Outbox(self._write)
        self._announce()
        self._thread = Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    @property
    def is_connected(self) -> bool:
        """Whether anybody is there who publishes what is subscribed, or who serves what is called."""
        return self._is_there

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        self._hear(f"rt{topic}", self._structs.struct(kind), lambda one: heard(told(self._structs, kind, one)))

    def publish(self, topic: str, kind: str, message: Message) -> None:
        thing = made(self._structs, kind, message)
        with self._lock:
            if topic not in self._writers:
                self._writers[topic] = self._writer(f"rt{topic}", self._structs.struct(kind))
        self._outbox.put((self._writers[topic], thing, None))

    def call(self, service: str, kind: str, request: Message) -> "Future[Message]":
        asked, number, future = f"{kind}_Request", next(self._numbers), Future[Message]()
        thing = self._structs.with_header(asked, self._whose, number, made(self._structs, asked, request))
        with self._lock:
            if service not in self._clients:
                answered = self._structs.struct(f"{kind}_Response", has_header=True)
                writer = self._writer(f"rq{service}Request", type(thing))
                ear = self._hear(f"rr{service}Reply", answered, lambda one: self._finish(f"{kind}_Response", one))
                self._clients[service] = writer, ear
            self._open[number] = _Call(service, future, thing, time.monotonic() + _FIND_S)
            self._send_call(number)
        return future

    def serve(self, service: str, kind: str, answer: Answer) -> None:
        writer = self._writer(f"rr{service}Reply", self._structs.struct(f"{kind}_Response", has_header=True))

        def take(request: Any) -> None:  # noqa: ANN401  # a class made above
            if self._is_fast_dds(ear.reader, request.sample_info.publication_handle):
                raise ValueError(f"{service} is called by Fast DDS, whose calls are not read by DDS; use rosbridge")
            said = response(self._structs, kind, answer, request, _log.warning)
            thing = self._structs.with_header(f"{kind}_Response", request.rmw_guid, request.rmw_seq, said)
            self._outbox.put((writer, thing, ear.reader))

        ear = self._hear(f"rq{service}Request", self._structs.struct(f"{kind}_Request", has_header=True), take)

    def watch(self, changed: Callable[[bool, str], object]) -> None:
        self._watching.append(changed)
        changed(self._is_there, f"{self._name}: {'others are' if self._is_there else 'nobody else is'} there")

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._outbox.close()
        for call in self._open.values():
            call.future.set_exception(RosError(f"{call.service} is not answered any more: the node is closed"))
        self._ears, self._writers, self._clients, self._open = [], {}, {}, {}
        self._participant.__del__()  # with all that it has, now; its own way to be closed

    def _hear(self, name: str, struct: Any, take: Callable[[Any], object]) -> _Ear:  # noqa: ANN401  # made above
        from cyclonedds.topic import Topic

        ear = _Ear(Topic(self._participant, name, struct), None, take)
        with self._lock:
            self._listen(ear)
            self._ears.append(ear)
        return ear

    def _listen(self, ear: _Ear) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        ear.reader = DataReader(self._participant, ear.topic, qos=_quality(is_reliable=ear.is_reliable))
        ear.condition = ReadCondition(ear.reader, ViewState.Any | InstanceState.Any | SampleState.NotRead)
        self._waiting.attach(ear.condition)

    def _writer(self, name: str, struct: Any) -> Any:  # noqa: ANN401  # of cyclonedds
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        return DataWriter(self._participant, Topic(self._participant, name, struct), qos=_quality())

    def _write(self, what: tuple[Any, Any, Any]) -> None:
        """Write, where a message is an answer when its reader is there; it may not be known yet that it is."""
        writer, thing, asking = what
        end = time.monotonic() + _WRITE_S
        while asking is not None and len(writer.matched_sub) < len(asking.matched_pub) and time.monotonic() < end:
            self._closing.wait(0.005)
        while not self._closing.is_set():
            try:
                writer.write(thing)
                return
            except Exception as error:  # who reads does not keep up, or the message cannot be written
                if time.monotonic() > end:
                    self.refused.add(error)
                    return
                self._closing.wait(0.005)

    def _run(self) -> None:
        from cyclonedds.util import duration

        while not self._closing.is_set():
            self._waiting.wait(duration(milliseconds=1000 * _LOOK_S))
            for ear in list(self._ears):
                self._drain(ear)
            if time.monotonic() > self._looked_s + _LOOK_S:
                self._look()
                self._looked_s = time.monotonic()

    def _drain(self, ear: _Ear) -> None:
        for _ in range(_AT_ONCE):
            try:
                found = ear.reader.take(1)
                if not found:
                    return
                if found[0].sample_info.valid_data:
                    ear.take(found[0])
            except Exception as error:  # of what was sent, or of who hears it; the next may be better
                self.refused.add(error)

    def _look(self) -> None:
        """See who is there; send calls that waited for that, and end those that nobody answers."""
        with self._lock:
            for ear in self._ears:
                if ear.is_reliable and ear.reader.get_requested_incompatible_qos_status().total_count:
                    self._waiting.detach(ear.condition)
                    ear.is_reliable = False  # as somebody sends who does not repeat what is lost
                    self._listen(ear)
            for number in list(self._open):
                self._send_call(number)
        is_there = any(ear.reader.matched_pub for ear in list(self._ears))
        if is_there != self._is_there:
            self._is_there = is_there
            for changed in self._watching:
                changed(is_there, f"{self._name}: {'others are there' if is_there else 'everybody else is gone'}")

    def _send_call(self, number: int) -> None:
        call = self._open[number]
        writer, ear = self._clients[call.service]
        servers = ear.reader.matched_pub
        is_there = bool(writer.matched_sub and servers)
        why = ""
        if is_there and any(self._is_fast_dds(ear.reader, one) for one in servers):
            why = f"{call.service} is served by Fast DDS, whose services are not reached by DDS; use rosbridge"
        elif is_there and not call.is_sent:
            call.is_sent = True
            self._outbox.put((writer, call.request, None))
        elif not is_there and (call.is_sent or time.monotonic() > call.until_s):
            why = f"who served {call.service} is gone" if call.is_sent else f"nobody serves {call.service}"
        if why:
            self._open.pop(number).future.set_exception(RosError(why))

    def _finish(self, kind: str, answer: Any) -> None:  # noqa: ANN401  # a class made above
        with self._lock:
            call = self._open.pop(answer.rmw_seq, None) if answer.rmw_guid == self._whose else None
        if call is not None:
            call.future.set_result(told(self._structs, kind, answer))

    def _is_fast_dds(self, reader: Any, handle: int) -> bool:  # noqa: ANN401  # of cyclonedds
        found = reader.get_matched_publication_data(handle)
        return found is not None and found.participant_key.bytes.startswith(_FAST_DDS)

    def _announce(self) -> None:
        """Be seen by `ros2 node list`."""
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
        topic = Topic(self._participant, "ros_discovery_info", self._structs.struct(kind))
        kept = Qos(Policy.Durability.TransientLocal, base=_quality())
        identity = {"data": [*self._participant.guid.bytes, *bytes(8)]}
        node = {"node_namespace": "/", "node_name": "rosa_kb"}
        self._writers["ros_discovery_info"] = DataWriter(self._participant, topic, qos=kept)
        message = made(self._structs, kind, {"gid": identity, "node_entities_info_seq": [node]})
        self._outbox.put((self._writers["ros_discovery_info"], message, None))


def _participant(domain: int, host: str) -> Any:  # noqa: ANN401  # of cyclonedds
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain, DomainParticipant

    address = LOOPBACK[0] if host in LOOPBACK else host
    try:
        if domain not in _domains:
            _domains[domain] = address, Domain(domain, _CONFIGURATION.format(address))
        if _domains[domain][0] != address:
            raise MissionError(f"this process is in the DDS domain {domain} on {_domains[domain][0]}, not on {host}")
        return DomainParticipant(domain)
    except DDSException as error:
        raise MissionError(f"the DDS domain {domain} cannot be opened on {host}: {error.msg}") from None


def _quality(*, is_reliable: bool = True) -> Any:  # noqa: ANN401  # of cyclonedds
    from cyclonedds.core import Policy, Qos

    sure = Policy.Reliability.Reliable(0) if is_reliable else Policy.Reliability.BestEffort
    own = Policy.IgnoreLocal.Participant
    return Qos(sure, own, Policy.Durability.Volatile, Policy.History.KeepLast(QUEUED))
