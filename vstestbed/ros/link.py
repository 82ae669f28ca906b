"""How a node speaks: publish, subscribe, serve; by rclpy where ROS 2 is installed, else by zenoh, which needs no ROS.

Over zenoh two processes of this project, or any program that reads CDR from zenoh, speak with each other; keys are
`DOMAIN/TOPIC/TYPE/HASH`, as rmw_zenoh has them, without its liveliness tokens. Nodes of ROS are reached by rclpy.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Literal, Self

from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.ros.messages import TRIGGER, Message, from_cdr, made, to_cdr, types

Heard = Callable[[Message], None]
Answer = Callable[[], tuple[bool, str]]
Backend = Literal["auto", "rclpy", "zenoh"]
LATCHED = "/tf_static", "status"
"""Topics whose last message late subscribers get, too (transient local), by their ends."""


class Link(ABC):
    """A node's way to the others. What is heard comes in threads of the backend's own.

    node: its name, which stands for `~` in those of topics. domain: as ROS_DOMAIN_ID. remap: other names of topics.
    """

    def __init__(self, node: str, domain: int, remap: dict[str, str]):
        self.node, self.domain, self._remap = node, domain, remap

    def name(self, topic: str) -> str:
        """The full name of a topic or a service: `~/stop` is `/NODE/stop`, `imu` is `/imu`; or the one that it is mapped to."""
        topic = self._remap.get(topic.removeprefix("~/").removeprefix("/"), topic)
        return f"/{self.node}/{topic[2:]}" if topic.startswith("~/") else topic if topic.startswith("/") else f"/{topic}"

    @abstractmethod
    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        """Send a message. now: the time by its clock [s], which a bag keeps."""

    @abstractmethod
    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """Call `heard` with each message of a kind, in another thread."""

    @abstractmethod
    def serve(self, service: str, answer: Answer) -> None:
        """Answer a service (std_srvs/Trigger) with success and a message, in another thread."""

    @abstractmethod
    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        """Call a service; its answer, None where nobody gives one."""

    @abstractmethod
    def close(self) -> None:
        """End all of it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Zenoh(Link):
    """A session of zenoh, a peer of those that it finds on the local network, or that it is told.

    connect, listen: endpoints, such as `tcp/192.168.1.5:7447`.
    """

    def __init__(self, node: str, domain: int, remap: dict[str, str], connect: Sequence[str] = (), listen: Sequence[str] = ()):
        super().__init__(node, domain, remap)
        import zenoh

        settings = zenoh.Config()
        for key, ends in (("connect/endpoints", connect), ("listen/endpoints", listen)):
            if ends:
                settings.insert_json5(key, f"[{', '.join(repr(end) for end in ends)}]")
        if connect or listen:  # who names an address means that one alone
            settings.insert_json5("scouting/multicast/enabled", "false")
        try:
            self._session: Any = zenoh.open(settings)
        except zenoh.ZError as error:
            raise EnvironmentLackError(f"zenoh cannot be opened ({error})", "is the address free, or somebody there?") from None
        self._publishers: dict[str, Any] = {}
        self._held: list[Any] = []  # subscribers and services end when they are forgotten

    def key(self, topic: str, kind: str) -> str:
        """The key of a topic's messages."""
        package, _, name = kind.split("/")
        return f"{self.domain}/{self.name(topic).strip('/')}/{package}::msg::dds_::{name}_/{types().hash_rihs01(kind)}"

    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        key = self.key(topic, message.__msgtype__)
        if key not in self._publishers:
            import zenoh

            # a picture that waits for a slow reader is worth nothing: the next one is on its way
            self._publishers[key] = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        self._publishers[key].put(to_cdr(message))

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        found = self._session.declare_subscriber(self.key(topic, kind), lambda sample: heard(from_cdr(sample.payload.to_bytes(), kind)))
        self._held.append(found)

    def _service(self, service: str) -> str:
        return f"{self.domain}/{self.name(service).strip('/')}/std_srvs::srv::dds_::Trigger_"

    def serve(self, service: str, answer: Answer) -> None:
        key = self._service(service)

        def reply(query: Any) -> None:
            done, words = answer()
            query.reply(key, to_cdr(made("std_srvs/msg/Trigger_Response", success=done, message=words)))

        self._held.append(self._session.declare_queryable(key, reply))

    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        request = to_cdr(made("std_srvs/msg/Trigger_Request", structure_needs_at_least_one_member=0))
        for reply in self._session.get(self._service(service), payload=request, timeout=timeout_s):
            if reply.ok is not None:
                response = from_cdr(reply.ok.payload.to_bytes(), "std_srvs/msg/Trigger_Response")
                return response.success, response.message
        return None

    def close(self) -> None:
        self._session.close()


class Rclpy(Link):
    """A node of ROS 2's own client library, which runs in a thread. Messages cross as CDR: rosbags writes and reads them."""

    def __init__(self, node: str, domain: int, remap: dict[str, str]):
        super().__init__(node, domain, remap)
        self._rclpy: Any = importlib.import_module("rclpy")
        context = self._context = self._rclpy.context.Context()
        self._rclpy.init(context=context, domain_id=domain, signal_handler_options=self._rclpy.signals.SignalHandlerOptions.NO)
        self._node: Any = self._rclpy.create_node(node, context=context)
        executors: Any = importlib.import_module("rclpy.executors")
        self._executor: Any = executors.SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._publishers: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        import contextlib

        with contextlib.suppress(Exception):  # the executor raises one of several errors when its context ends
            while self._context.ok():
                self._executor.spin_once(timeout_sec=0.01)

    def _class(self, kind: str) -> Any | None:
        """The class of a kind of message; None where its package is not installed."""
        package, part, name = kind.split("/")
        try:
            return getattr(importlib.import_module(f"{package}.{part}"), name)
        except ImportError:
            return None

    def _quality(self, topic: str) -> Any:
        qos: Any = importlib.import_module("rclpy.qos")
        if topic.endswith(LATCHED):
            return qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        return qos.QoSProfile(depth=10)

    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        """As `Link.publish`; without a word where the message's package is not installed."""
        if topic not in self._publishers:
            kind = self._class(message.__msgtype__)
            self._publishers[topic] = kind and self._node.create_publisher(kind, self.name(topic), self._quality(topic))
        if self._publishers[topic] is not None:
            self._publishers[topic].publish(to_cdr(message))

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """As `Link.subscribe`. EnvironmentLackError: the message's package is not installed."""
        known = self._class(kind)
        if known is None:
            package = kind.split("/")[0]
            raise EnvironmentLackError(f"messages of {package} are not installed", f"install ros-DISTRO-{package.replace('_', '-')}")
        self._node.create_subscription(known, self.name(topic), lambda data: heard(from_cdr(data, kind)), self._quality(topic), raw=True)

    def serve(self, service: str, answer: Answer) -> None:

        def reply(_: Any, response: Any) -> Any:
            response.success, response.message = answer()
            return response

        self._node.create_service(self._class(TRIGGER), self.name(service), reply)

    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        kind: Any = self._class(TRIGGER)
        client, end = self._node.create_client(kind, self.name(service)), time.monotonic() + timeout_s
        if not client.wait_for_service(timeout_sec=timeout_s):
            return None
        asked = client.call_async(kind.Request())
        while not asked.done() and time.monotonic() < end:
            time.sleep(0.005)  # the answer comes in the executor's thread
        return (asked.result().success, asked.result().message) if asked.done() else None

    def close(self) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)
        self._thread.join(timeout=1.0)


def domain_of() -> int:
    """The domain that ROS_DOMAIN_ID names; 0 without. ParameterError: it is no number of one."""
    word = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    if not word.isdigit() or int(word) > 232:
        raise ParameterError.form("ROS_DOMAIN_ID", "of a whole number from 0 to 232", word)
    return int(word)


def connected(
    node: str, backend: Backend = "auto", remap: dict[str, str] | None = None, connect: Sequence[str] = (), listen: Sequence[str] = ()
) -> Link:
    """The link of a node; `auto`: by rclpy where it is, unless an address of zenoh is given.
    Raises EnvironmentLackError: neither rclpy nor zenoh, or not the one that is wanted. ParameterError: an address for rclpy.
    """
    there = {name: importlib.util.find_spec(name) is not None for name in ("rclpy", "zenoh")}
    if (connect or listen) and backend == "rclpy":
        raise ParameterError.only_for("--connect and --listen", "--backend zenoh; rclpy finds the others by ROS_DOMAIN_ID")
    if backend == "auto":
        backend = "rclpy" if there["rclpy"] and not (connect or listen) else "zenoh"
    if not there[backend]:
        remedy = "source the setup.bash of a ROS 2 installation" if backend == "rclpy" else "pip install 'vstestbed[ros]'"
        raise EnvironmentLackError(f"{backend} is not installed", remedy)
    if backend == "rclpy":
        return Rclpy(node, domain_of(), remap or {})
    return Zenoh(node, domain_of(), remap or {}, connect, listen)
