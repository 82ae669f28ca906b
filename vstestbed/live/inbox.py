"""What pages ask for, handed to the thread that runs the simulation; nothing else passes between the two."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

Order = Callable[[], object]


class Inbox:
    """Orders in the sequence in which they came. Of several with one key, such as those of a slider that is drawn, only the last stays."""

    def __init__(self) -> None:
        self._orders: dict[object, Order] = {}
        self._come, self._numbers = threading.Condition(), itertools.count()

    def put(self, order: Order, key: str | None = None) -> None:
        """Add an order, from any thread. key: what it sets; None for one that counts, such as a click."""
        with self._come:
            name: object = next(self._numbers) if key is None else key
            self._orders.pop(name, None)
            self._orders[name] = order
            self._come.notify()

    def waits(self, key: str) -> bool:
        """Whether an order of this key has not been taken yet."""
        with self._come:
            return key in self._orders

    def take(self, wait_s: float) -> list[Order]:
        """All orders, which are then gone; where there is none, wait for one, but not for long."""
        with self._come:
            if not self._orders and wait_s > 0:
                self._come.wait(wait_s)
            orders, self._orders = list(self._orders.values()), {}
            return orders


class Served:
    """An app whose pages, and other threads, ask for things that the thread that serves does."""

    def __init__(self) -> None:
        self._inbox, self._stop = Inbox(), threading.Event()

    def ask(self, order: Order) -> None:
        """Let the thread that serves do something, as a page does; from any thread."""
        self._inbox.put(order)

    def stop(self) -> None:
        """Let `serve` return; from any thread."""
        self._stop.set()
        self._inbox.put(lambda: None)
