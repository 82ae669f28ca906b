"""How a node speaks: publish, subscribe, serve; by rclpy where ROS 2 is installed, else by zenoh,
which needs no ROS.

Over zenoh two processes of this project, or any program that reads CDR from zenoh, speak with each
other; keys are `DOMAIN/TOPIC/TYPE/HASH`, as rmw_zenoh has them, without its liveliness tokens.
Nodes of ROS are reached by rclpy.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import logging
import os
import re
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Literal, NamedTuple, Self

from vstestbed.apps.ros.messages import TRIGGER, Message, from_cdr, made, to_cdr, types
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.foreign import foreign

Heard = Callable[[Message], None]
Answer = Callable[[], tuple[bool, str]]
Backend = Literal["auto", "rclpy", "zenoh"]
LATCHED = "/tf_static", "status"
"""Topics whose last message late subscribers get, too (transient local), by their ends."""


NODES = "vstestbed_law", "vstestbed_robot", "vstestbed_excite"
"""The nodes that have names of their own."""
NAME = re.compile(r"(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


class Rule(NamedTuple):
    """One name of topics or services for another, as ROS 2 has it (design.ros2.org, static
    remapping).

    node: whose names alone it maps; "" for those of any. name, other: relative, absolute
    (`/cam/image`) or private (`~/stop`).
    """

    node: str
    name: str
    other: str

    def maps(self, full: str, node: str) -> bool:
        """Whether it is for a full name of a node. A relative name is also that of one in our
        nodes: in the law's node `image_raw` is `/vstestbed_robot/image_raw`.
        """
        if self.node not in ("", node):
            return False
        ours = [f"/{one}/{self.name}" for one in NODES] if self.name[0] not in "~/" else []
        return full in (expanded(self.name, node), *ours)


def expanded(name: str, node: str) -> str:
    """The full name of a relative or a private one of a node."""
    if name.startswith("~/"):
        return f"/{node}/{name[2:]}"
    return name if name.startswith("/") else f"/{name}"


def rules_of(words: Iterable[str]) -> list[Rule]:
    """The rules of `[NODE:]NAME:=OTHER` or `NAME=OTHER`. ParameterError: not of that form, or the
    node itself is to have another name.
    """
    found = []
    for word in words:
        left, _, other = word.partition(":=" if ":=" in word else "=")
        node, _, name = left.rpartition(":")
        if name.startswith("__"):
            raise ParameterError(
                "--remap",
                f"does not know {name}; works: [NODE:]NAME:=OTHER for each topic and service",
                word,
            )
        if not (NAME.fullmatch(name) and NAME.fullmatch(other) and node in ("", *NODES)):
            form = (
                "[NODE:]NAME:=OTHER, such as image_raw:=/camera/color/image_raw,"
                f" NODE one of {', '.join(NODES)}"
            )
            raise ParameterError.form("--remap", form, word)
        found.append(Rule(node, name, other))
    return found


class Link(ABC):
    """A node's way to the others. What is heard comes in threads of the backend's own.

    node: its name, which stands for `~` in those of topics. domain: as ROS_DOMAIN_ID. rules: other
    names; the first one that fits counts.
    """

    def __init__(self, node: str, domain: int, rules: Iterable[Rule] = ()):
        self.node = node
        self.domain = domain
        self._rules = list(rules)
        self._names: dict[str, Rule | None] = {}  # by full names: what maps each
        self.passed_over: Counter[str] = Counter()  # by topics: how many messages could not be read

    def name(self, topic: str) -> str:
        """The full name of a topic or a service: `~/stop` is `/NODE/stop`, `imu` is `/imu`; or the
        one that it is mapped to.
        """
        full = expanded(topic, self.node)
        if full not in self._names:
            mapping = (rule for rule in self._rules if rule.maps(full, self.node))
            self._names[full] = next(mapping, None)
        rule = self._names[full]
        return full if rule is None else expanded(rule.other, self.node)

    def publishes(self, *topics: str) -> None:
        """Say what will be published, after everything is subscribed and served: now all names are
        known. ParameterError: a rule maps none of them.
        """
        for topic in topics:
            self.name(topic)
        for rule in self._rules:
            if rule.node in ("", self.node) and rule not in self._names.values():
                words = (
                    f"maps {rule.name}, which {self.node} does not have, or an earlier rule maps;"
                    f" it has {', '.join(self._names)}"
                )
                raise ParameterError("--remap", words)

    def reader(self, topic: str, kind: str, heard: Heard) -> Callable[[bytes], None]:
        """What calls `heard` with the message of the bytes that came. Those that are none are
        passed over, counted, and told.
        """

        def read(data: bytes) -> None:
            try:
                heard(from_cdr(data, kind))
            except ParameterError as error:
                self.pass_over(topic, str(error))

        return read

    def pass_over(self, topic: str, why: str) -> None:
        """Count a message that cannot be read; of ten, a hundred, ... one is told."""
        name = self.name(topic)
        self.passed_over[name] += 1
        count = self.passed_over[name]
        if str(count).strip("0") == "1":
            logging.getLogger("vstestbed").warning(
                "%s: messages passed over: %d; the last one: %s", name, count, why
            )

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
    """A session of zenoh, a peer of those that it finds on the local network; with addresses it
    finds nobody, and speaks there alone.

    connect: endpoints, such as `tcp/192.168.1.5:7447`. listen: those at which it can be found;
    without, it can be found nowhere.
    """

    def __init__(
        self,
        node: str,
        domain: int,
        rules: Iterable[Rule],
        connect: Sequence[str] = (),
        listen: Sequence[str] = (),
    ):
        super().__init__(node, domain, rules)
        import zenoh

        settings = zenoh.Config()
        if connect or listen:
            with foreign("--connect and --listen", "addresses such as tcp/192.168.1.5:7447"):
                settings.insert_json5("connect/endpoints", json.dumps(list(connect)))
                # empty: the default is a port of every interface
                settings.insert_json5("listen/endpoints", json.dumps(list(listen)))
            settings.insert_json5("scouting/multicast/enabled", "false")
            settings.insert_json5("scouting/gossip/enabled", "false")
            # peers pass nothing on: a law and who stops it, both connected to the robot, would not
            # hear each other
            settings.insert_json5("mode", '"router"')
        try:
            self._session: Any = zenoh.open(settings)
        except zenoh.ZError as error:
            raise EnvironmentLackError(
                f"zenoh cannot be opened ({error})", "is the address free, or somebody there?"
            ) from None
        self._publishers: dict[str, Any] = {}
        self._held: list[Any] = []  # subscribers and services end when they are forgotten

    def key(self, topic: str, kind: str) -> str:
        """The key of a topic's messages."""
        package, _, name = kind.split("/")
        place = self.name(topic).strip("/")
        hashed = types().hash_rihs01(kind)
        return f"{self.domain}/{place}/{package}::msg::dds_::{name}_/{hashed}"

    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        key = self.key(topic, message.__msgtype__)
        if key not in self._publishers:
            import zenoh

            # a picture that waits for a slow reader is worth nothing: the next one is on its way
            self._publishers[key] = self._session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP
            )
        self._publishers[key].put(to_cdr(message))

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        key = self.key(topic, kind)
        read = self.reader(topic, kind, heard)

        def hear(sample: Any) -> None:
            if str(sample.key_expr) == key:
                read(sample.payload.to_bytes())
            else:
                none = f"it is none of {kind}, as this program knows it"
                self.pass_over(topic, f"{none}, but {sample.key_expr}")

        others = key.rsplit("/", 2)[0] + "/*/*"  # of any type: one that nobody reads is told
        self._held.append(self._session.declare_subscriber(others, hear))

    def _service(self, service: str) -> str:
        return f"{self.domain}/{self.name(service).strip('/')}/std_srvs::srv::dds_::Trigger_"

    def serve(self, service: str, answer: Answer) -> None:
        key = self._service(service)

        def reply(query: Any) -> None:
            done, words = answer()
            query.reply(
                key, to_cdr(made("std_srvs/msg/Trigger_Response", success=done, message=words))
            )

        self._held.append(self._session.declare_queryable(key, reply))

    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        request = to_cdr(
            made("std_srvs/msg/Trigger_Request", structure_needs_at_least_one_member=0)
        )
        for reply in self._session.get(self._service(service), payload=request, timeout=timeout_s):
            answers: list[Message] = []
            if reply.ok is not None:
                self.reader(service, "std_srvs/msg/Trigger_Response", answers.append)(
                    reply.ok.payload.to_bytes()
                )
            if answers:
                return answers[0].success, answers[0].message
        return None

    def close(self) -> None:
        self._session.close()


class Rclpy(Link):
    """A node of ROS 2's own client library, which runs in a thread. Messages cross as CDR: rosbags
    writes and reads them.
    """

    def __init__(self, node: str, domain: int, rules: Iterable[Rule]):
        super().__init__(node, domain, rules)
        self._rclpy: Any = importlib.import_module("rclpy")
        context = self._context = self._rclpy.context.Context()
        self._rclpy.init(
            context=context,
            domain_id=domain,
            signal_handler_options=self._rclpy.signals.SignalHandlerOptions.NO,
        )
        self._node: Any = self._rclpy.create_node(node, context=context)
        executors: Any = importlib.import_module("rclpy.executors")
        self._executor: Any = executors.SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._publishers: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        # the executor raises one of several errors when its context ends
        with suppress(Exception):
            while self._context.ok():
                self._executor.spin_once(timeout_sec=0.01)

    def _class(self, kind: str) -> Any | None:
        """The class of a kind of message; None where its package is not installed."""
        package, part, name = kind.split("/")
        try:
            return getattr(importlib.import_module(f"{package}.{part}"), name)
        except ImportError:
            return None

    def _quality(self, topic: str, sensed: bool = False) -> Any:
        """The quality of service. sensed: of what a sensor tells, whose driver may speak by best
        effort.
        """
        qos: Any = importlib.import_module("rclpy.qos")
        if sensed:
            return qos.QoSProfile(depth=5, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        if topic.endswith(LATCHED):
            return qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        return qos.QoSProfile(depth=10)

    def publish(self, topic: str, message: Message, now: float = 0.0) -> None:
        """As `Link.publish`; without a word where the message's package is not installed."""
        if topic not in self._publishers:
            kind = self._class(message.__msgtype__)
            self._publishers[topic] = kind and self._node.create_publisher(
                kind, self.name(topic), self._quality(topic)
            )
        if self._publishers[topic] is not None:
            self._publishers[topic].publish(to_cdr(message))

    def subscribe(self, topic: str, kind: str, heard: Heard) -> None:
        """As `Link.subscribe`. EnvironmentLackError: the message's package is not installed."""
        known = self._class(kind)
        if known is None:
            package = kind.split("/")[0]
            raise EnvironmentLackError(
                f"messages of {package} are not installed",
                f"install ros-DISTRO-{package.replace('_', '-')}",
            )
        quality = self._quality(topic, kind.startswith("sensor_msgs/"))
        self._node.create_subscription(
            known, self.name(topic), self.reader(topic, kind, heard), quality, raw=True
        )

    def serve(self, service: str, answer: Answer) -> None:

        def reply(_: Any, response: Any) -> Any:
            response.success, response.message = answer()
            return response

        self._node.create_service(self._class(TRIGGER), self.name(service), reply)

    def call(self, service: str, timeout_s: float = 2.0) -> tuple[bool, str] | None:
        kind: Any = self._class(TRIGGER)
        end = time.monotonic() + timeout_s
        client = self._node.create_client(kind, self.name(service))
        if not client.wait_for_service(timeout_sec=timeout_s):
            return None
        asked = client.call_async(kind.Request())
        while not asked.done() and time.monotonic() < end:
            time.sleep(0.005)  # the answer comes in the executor's thread
        if not asked.done():
            return None
        answer = asked.result()
        return answer.success, answer.message

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


REMEDIES = {
    "rclpy": "source the setup.bash of a ROS 2 installation",
    "zenoh": "pip install 'vstestbed[ros]'",
}


def _installed(name: str) -> bool:
    return importlib.util.find_spec(name) is not None


def connected(
    node: str,
    backend: Backend = "auto",
    rules: Iterable[Rule] = (),
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
) -> Link:
    """The link of a node; `auto`: by rclpy where it is, unless an address of zenoh is given.
    Raises EnvironmentLackError: neither rclpy nor zenoh, or not the one that is wanted.
    ParameterError: an address for rclpy.
    """
    addressed = connect or listen
    if addressed and backend == "rclpy":
        raise ParameterError.only_for(
            "--connect and --listen", "--backend zenoh; rclpy finds the others by ROS_DOMAIN_ID"
        )
    if backend == "auto":
        backend = "rclpy" if _installed("rclpy") and not addressed else "zenoh"
    if not _installed(backend):
        raise EnvironmentLackError(f"{backend} is not installed", REMEDIES[backend])
    if backend == "rclpy":
        return Rclpy(node, domain_of(), rules)
    return Zenoh(node, domain_of(), rules, connect, listen)


def remapped(words: Sequence[str]) -> dict[str, str]:
    """Topics of a bag by the names that they have here, the first one of each; errors: as of
    `rules_of`.
    """
    found: dict[str, str] = {}
    for rule in rules_of(words):
        name = re.sub(r"^~?/(vstestbed_robot/)?", "", rule.name)
        found.setdefault(name, expanded(rule.other, NODES[1]))
    return found
