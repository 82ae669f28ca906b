"""The web server of a live view: on this machine alone, for those who have its address, which holds
a secret, and for its own pages.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import io
import logging
import re
import secrets
import socket
import threading
import warnings
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from vstestbed.core.errors import EnvironmentLackError, ParameterError, short

HOST = "127.0.0.1"
OWN_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d+)?", re.IGNORECASE)
"""Header `Host` of a request by a name of this machine, at any port: a tunnel (`ssh -L`) may have
another one.
"""
_log = logging.getLogger(__name__)
_web_log = logging.getLogger(f"{__name__}.web")
# below, websockets logs whole requests, and with them the secret
_web_log.setLevel(logging.WARNING)
# of what is no request: it has had its answer
_web_log.addFilter(lambda record: record.getMessage() != "opening handshake failed")
_opening = threading.Lock()


class Gate:
    """Who is served: requests that have the secret as the first part of their path, and come from
    nowhere or from a page of this server.

    A page anywhere may ask for any address, and a name that its site owns may lead to this machine
    (DNS rebinding). So a request names this machine (`Host`), and the scheme, host and port of its
    page (`Origin`), which browsers always state, are the very same; one to open a socket has to
    state them.

    secret: of this start of the server. stands: whether a server asks it.
    """

    def __init__(self) -> None:
        self.secret = secrets.token_urlsafe(16)
        self.stands = False

    def message(self, request: Request) -> str | None:
        """Why a request is not served; None for one that is."""
        hosts = request.headers.get_all("Host")
        origins = request.headers.get_all("Origin")
        opens_socket = "Upgrade" in request.headers
        if len(hosts) != 1 or not OWN_HOST.fullmatch(hosts[0]):
            return f"This server answers only to the names {HOST} and localhost."
        first, _ = _parts(request.path)
        if not secrets.compare_digest(first.encode(errors="surrogateescape"), self.secret.encode()):
            return (
                "Open the whole address that `vstestbed live` has printed:"
                " it holds a secret, which is another one after each start."
            )
        if origins != [f"http://{hosts[0]}"] and (origins or opens_socket):
            return "This server serves its own pages only."
        spoken = request.headers.get_all("Sec-WebSocket-Protocol")
        if opens_socket and f"viser-v{viser.__version__}" not in spoken:
            # of others viser writes to standard output
            return f"This server speaks to pages of viser {viser.__version__} only."
        return None

    @contextlib.contextmanager
    def before_next_server(self) -> Iterator[None]:
        """Let the server that viser opens meanwhile ask this gate: viser has no way to say who is
        let in.
        """
        module: Any = websockets.asyncio.server
        with _opening:
            serve = module.serve

            def guarded(
                handler: Callable[[ServerConnection], Awaitable[None]], *place: Any, **options: Any
            ) -> Any:
                self.stands = True
                own = {
                    "process_request": self._before(options["process_request"]),
                    "logger": _web_log,
                }
                return serve(_told(handler), *place, **options | own)

            module.serve = guarded
            try:
                yield
            finally:
                module.serve = serve

    def _before(
        self, answer: Callable[[ServerConnection, Request], Response | None]
    ) -> Callable[..., Response | None]:
        def answered(connection: ServerConnection, request: Request) -> Response | None:
            if (words := self.message(request)) is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{words}\n")
            request.path = f"/{_parts(request.path)[1]}"
            response = answer(connection, request)
            if response is not None:
                # the address of the page is the secret
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["Cache-Control"] = "no-store"
            return response

        return answered


class LocalServer(viser.ViserServer):
    """A server on 127.0.0.1, never shared with other machines; `address` holds the secret without
    which nothing is served.
    Raises ParameterError: the port is taken, or may not be used. EnvironmentLackError: this version
    of viser cannot be guarded.
    """

    def __init__(self, port: int | None, label: str):
        if port is not None:
            _must_be_free(port)
        # a malformed message would make a warning alone
        warnings.filterwarnings("error", r"(?s)\[viser\].* does not match annotation", UserWarning)
        gate = Gate()
        # its own table of addresses
        with contextlib.redirect_stdout(io.StringIO()), gate.before_next_server():
            super().__init__(host=HOST, port=port or 0, label=label, verbose=False)
        if not gate.stands:
            self.stop()
            raise EnvironmentLackError(
                f"viser {viser.__version__} opens its server in a new way",
                "pip install 'viser==1.1.1'",
            )
        self._event_loop.set_exception_handler(_tell_failed)
        self.address = f"http://{HOST}:{self.get_port()}/{gate.secret}/"
        self.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)

    def request_share_url(self, verbose: bool = True) -> None:
        """Never: a page could ask for it."""

    def stop(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def _parts(path: str) -> tuple[str, str]:
    first, _, others = path.partition("?")[0].removeprefix("/").partition("/")
    return first, others


def _told(
    handler: Callable[[ServerConnection], Awaitable[None]],
) -> Callable[[ServerConnection], Awaitable[None]]:
    """Viser's handler of a connection, which lets pass whatever a malformed message raises."""

    async def handled(connection: ServerConnection) -> None:
        try:
            await handler(connection)
        except Exception as error:  # of a message that is none of viser's
            _log.warning(
                "a page was disconnected, since it sent a malformed message: %s", short(error)
            )

    return handled


def _tell_failed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    if (error := context.get("exception")) is None:
        loop.default_exception_handler(context)
    else:
        _log.warning("a message of a page is without effect: %s", short(error))


def _must_be_free(port: int) -> None:
    """Refuse a port at which something listens; viser would take the next one without a word."""
    with socket.socket() as probe:
        # one that was closed a moment ago is free
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            taken = f"cannot be used ({error.strerror})"
            if error.errno == errno.EADDRINUSE:
                taken = "is taken"
            words = f"{taken}; give another one, or none for a free one"
            raise ParameterError("--port", words, port) from None
