"""ROS 2 by DDS (Cyclone DDS), for a robot without a bridge: ROS 2's names of topics, types and services, and its CDR.

Services are those of rmw_cyclonedds: a request and its response begin with 16 bytes, the client's id and a number.
"""

import os
from collections.abc import Callable
from threading import Event, Thread
from time import monotonic
from typing import Any, Final

from missions.engine.mission import MissionError, needs
from missions.wires.node import (
    LOOPBACK,
    QUEUED,
    Client,
    Field,
    Message,
    Outbox,
    Reader,
    RosError,
    TypedNode,
    made,
)
from missions.wires.ros import NOTHING, Types, types

_LOOK_S: Final = 0.05
"""The period of looking which other nodes are there [s]."""
_WRITE_S: Final = 1.0
"""How long the sending thread waits for a reader that does not keep up [s]."""
_AT_ONCE: Final = 500
"""How many messages of a topic are read before the next topic has its turn."""
_FAST_DDS: Final = b"\x01\x0f"
"""The first bytes of the id of a Fast DDS participant."""
_CONFIGURATION: Final = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="{0}" multicast="true"/>
</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99
</MaxAutoParticipantIndex><Peers><Peer address="{0}"/></Peers></Discovery></Domain></CycloneDDS>"""
_domains: dict[int, tuple[str, Any]] = {}
"""The domains that this process has opened, which can be done once: address and domain by number."""


class Structs(Types):
    """ROS 2's types as classes of cyclonedds, made from the definitions in `rosbags`."""

    def __init__(self) -> None:
        super().__init__(types().store)
        self._made: dict[tuple[str, bool], Any] = {}

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # a class is made here
        one = super().new(kind, values)
        for name, field in self.fields(kind).items():
            if field.length and field.kind in ("byte", "char", "uint8"):
                setattr(one, name, bytes(getattr(one, name)))
        return one

    def with_header(self, kind: str, whose: int, number: int, message: Any) -> Any:  # noqa: ANN401  # classes are made here
        """Return a request or response with the header of rmw_cyclonedds: client id `whose` and request number."""
        return self.find(kind, has_header=True)(whose, number, *vars(message).values())

    def find(self, kind: str, *, has_header: bool = False) -> Any:  # noqa: ANN401  # a class is made here
        from cyclonedds.idl import make_idl_struct
        from cyclonedds.idl.types import int64, uint8, uint64

        if (kind, has_header) not in self._made:
            named = self.fields(kind)
            package, folder, name = kind.split("/")
            header = {"rmw_guid": uint64, "rmw_seq": int64} if has_header else {}
            fields = {name: self._type(field) for name, field in named.items()} or {NOTHING: uint8}
            full = f"{package}.{folder}.dds_.{name}_"
            self._made[kind, has_header] = make_idl_struct(f"{name}_", full, header | fields)
        return self._made[kind, has_header]

    def _type(self, field: Field) -> Any:  # noqa: ANN401  # a type of cyclonedds
        from cyclonedds.idl import types as idl

        named = {"bool": bool, "string": str, "byte": idl.uint8, "char": idl.uint8}
        one = (
            self.find(field.kind)
            if "/" in field.kind
            else named.get(field.kind) or getattr(idl, field.kind)
        )
        if field.length is None:
            return one
        make: Any = idl.array[one, field.length] if field.length else idl.sequence[one]  # type: ignore[misc]  # as cyclonedds has it
        return make


class DdsNode(TypedNode):
    """A node in a DDS domain, of this machine only unless set otherwise.

    Args:
        domain: number of the domain; by default that of ROS_DOMAIN_ID, or 0.
        host: address of the network interface; on any other than loopback, whoever reaches it takes part, as DDS has no
            tokens.

    Raises:
        MissionError: the extra `dds` is missing, the domain cannot be opened, or it is open on another address.
    """

    topics = "rt"

    def __init__(self, domain: int | None = None, host: str = LOOPBACK[0]) -> None:
        with needs("dds", "DDS"):
            import rosbags  # noqa: F401  # DdsNode needs its types
            from cyclonedds import core
        name = f"DDS on {host}" + (
            "" if host in LOOPBACK else ", where nobody is asked for a token"
        )
        self._structs = Structs()
        super().__init__(name, self._structs)
        self._closing = Event()
        self._participant = _participant(
            int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain is None else domain, host
        )
        self._whose = self._participant.guid.int >> 32 & 2**64 - 1
        self._waiting = core.WaitSet(self._participant)
        self._outbox = Outbox(self._send)
        self._announce()
        self._thread = Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._outbox.close()
        self._closing.set()
        self._thread.join()
        super().close()
        self._participant.__del__()  # cyclonedds has no other way to close a participant at once

    def _open_reader(self, reader: Reader) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        if reader.opened is not None:
            topic, condition, _ = reader.opened
            self._waiting.detach(condition)
        else:
            topic = Topic(self._participant, reader.topic, reader.kind)
        opened = DataReader(self._participant, topic, qos=_quality(is_reliable=reader.is_reliable))
        condition = ReadCondition(opened, ViewState.Any | InstanceState.Any | SampleState.NotRead)
        self._waiting.attach(condition)
        reader.opened = topic, condition, opened

    def _publishers(self, reader: Reader) -> tuple[bool, bool]:
        opened = reader.opened[-1]
        return bool(opened.matched_pub), bool(
            opened.get_requested_incompatible_qos_status().total_count
        )

    def _writer(self, topic: str, kind: Any) -> Callable[[Any], object]:  # noqa: ANN401  # made by `find`
        writer = self._data_writer(topic, kind)
        return lambda thing: self._outbox.put((writer, thing, None))

    def _data_writer(self, topic: str, kind: Any, *policies: Any) -> Any:  # noqa: ANN401  # of cyclonedds
        from cyclonedds.core import Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        quality = Qos(*policies, base=_quality())
        return DataWriter(self._participant, Topic(self._participant, topic, kind), qos=quality)

    def _client(self, service: str, kind: str) -> Client:
        def take(answer: Any) -> None:  # noqa: ANN401  # made by `find`
            if answer.rmw_guid == self._whose:
                self._finish(answer.rmw_seq, answer)

        def is_served() -> bool:
            servers = reader.opened[-1].matched_pub
            if writer.matched_sub and any(self._is_fast_dds(reader, one) for one in servers):
                raise RosError(
                    f"{service} is served by Fast DDS, whose services are not reached by DDS; use rosbridge"
                )
            return bool(writer.matched_sub and servers)

        def send(number: int, request: Any) -> None:  # noqa: ANN401  # made by `find`
            self._outbox.put(
                (writer, self._structs.with_header(asked, self._whose, number, request), None)
            )

        asked = f"{kind}_Request"
        writer = self._data_writer(
            f"rq{service}Request", self._structs.find(asked, has_header=True)
        )
        reader = self._hear(
            f"rr{service}Reply", self._structs.find(f"{kind}_Response", has_header=True), take
        )
        return Client(is_served, send)

    def _serve(self, service: str, kind: str, respond: Callable[[Any], Any]) -> None:
        writer = self._data_writer(
            f"rr{service}Reply", self._structs.find(f"{kind}_Response", has_header=True)
        )

        def take(request: Any) -> None:  # noqa: ANN401  # a class made here
            if self._is_fast_dds(reader, request.sample_info.publication_handle):
                raise ValueError(
                    f"{service} is called by Fast DDS, whose calls are not read by DDS; use rosbridge"
                )
            answer = respond(request)
            thing = self._structs.with_header(
                f"{kind}_Response", request.rmw_guid, request.rmw_seq, answer
            )
            self._outbox.put((writer, thing, reader))

        reader = self._hear(
            f"rq{service}Request", self._structs.find(f"{kind}_Request", has_header=True), take
        )

    def _send(self, what: tuple[Any, Any, Reader | None]) -> None:
        """Write a message; a response waits until its client's reader is discovered, which can take a moment."""
        writer, thing, asking = what
        end = monotonic() + _WRITE_S
        while (
            asking is not None
            and len(writer.matched_sub) < len(asking.opened[-1].matched_pub)
            and monotonic() < end
        ):
            self._closing.wait(0.005)
        while not self._closing.is_set():
            try:
                writer.write(thing)
                return
            except (
                Exception
            ) as error:  # a reader does not keep up, or the message cannot be written
                if monotonic() > end:
                    self.refused.add(error)
                    return
                self._closing.wait(0.005)

    def _run(self) -> None:
        from cyclonedds.util import duration

        looked_s = 0.0
        while not self._closing.is_set():
            self._waiting.wait(duration(milliseconds=1000 * _LOOK_S))
            for reader in list(self._readers):
                self._drain(reader)
            if monotonic() > looked_s + _LOOK_S:
                self._look()
                looked_s = monotonic()

    def _drain(self, reader: Reader) -> None:
        for _ in range(_AT_ONCE):
            try:
                found = reader.opened[-1].take(1)
            except Exception as error:  # a malformed message
                self.refused.add(error)
                continue
            if not found:
                return
            if found[0].sample_info.valid_data:
                self._take(reader, found[0])

    def _is_fast_dds(self, reader: Reader, handle: int) -> bool:
        found = reader.opened[-1].get_matched_publication_data(handle)
        return found is not None and found.participant_key.bytes.startswith(_FAST_DDS)

    def _announce(self) -> None:
        from cyclonedds.core import Policy

        kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
        writer = self._data_writer(
            "ros_discovery_info", self._structs.find(kind), Policy.Durability.TransientLocal
        )
        node = {"node_namespace": "/", "node_name": "rosa_kb"}
        identity = {"data": [*self._participant.guid.bytes, *bytes(8)]}
        self._outbox.put(
            (
                writer,
                made(self._structs, kind, {"gid": identity, "node_entities_info_seq": [node]}),
                None,
            )
        )


def _participant(domain: int, host: str) -> Any:  # noqa: ANN401  # of cyclonedds
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain, DomainParticipant

    address = LOOPBACK[0] if host in LOOPBACK else host
    try:
        if domain not in _domains:
            _domains[domain] = address, Domain(domain, _CONFIGURATION.format(address))
        if _domains[domain][0] != address:
            raise MissionError(
                f"this process is in the DDS domain {domain} on {_domains[domain][0]}, not on {host}"
            )
        return DomainParticipant(domain)
    except DDSException as error:
        raise MissionError(
            f"the DDS domain {domain} cannot be opened on {host}: {error.msg}"
        ) from None


def _quality(*, is_reliable: bool = True) -> Any:  # noqa: ANN401  # of cyclonedds
    from cyclonedds.core import Policy, Qos

    sure = Policy.Reliability.Reliable(0) if is_reliable else Policy.Reliability.BestEffort
    own = Policy.IgnoreLocal.Participant
    return Qos(sure, own, Policy.Durability.Volatile, Policy.History.KeepLast(QUEUED))
