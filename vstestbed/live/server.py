"""The web server of a live view: on this machine alone, for pages that it served itself."""

from __future__ import annotations

import contextlib
import errno
import io
import logging
import socket
from urllib.parse import urlsplit

import viser
import viser.infra

from vstestbed.core.errors import ParameterError

HOST = "127.0.0.1"
OWN_NAMES = {"127.0.0.1", "localhost"}


class ForeignPageError(Exception):
    """A page of another site has asked to be connected."""


class LocalServer(viser.ViserServer):
    """A server on 127.0.0.1; never shared with other machines.

    Args:
        port: to listen at; None for a free one. label: title of the panel.

    Attributes:
        address: of the page.

    Raises:
        ParameterError: the port is taken, or may not be used.
    """

    def __init__(self, port: int | None, label: str):
        if port is not None:
            _must_be_free(port)
        with contextlib.redirect_stdout(io.StringIO()):  # its own table of addresses
            super().__init__(host=HOST, port=port or 0, label=label, verbose=False)
        logging.getLogger("websockets.server").addFilter(_without_foreign)
        self.address = f"http://{HOST}:{self.get_port()}"
        self._websock_server.on_client_connect(self._refuse_foreign)
        self.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)

    def request_share_url(self, verbose: bool = True) -> None:
        """Never: a page could ask for it."""

    async def _refuse_foreign(self, connection: viser.infra.WebsockClientConnection) -> None:
        """Raise, which closes the connection, where another site's page asks for it: browsers let any page connect to any address."""
        request = self._websock_server._live_connections[connection.client_id].request
        origin = request.headers.get("Origin") if request is not None else None
        if origin is not None and urlsplit(origin).hostname not in OWN_NAMES:
            raise ForeignPageError(origin)

    def stop(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def _without_foreign(record: logging.LogRecord) -> bool:
    """A filter: refusals need no traceback."""
    return not (record.exc_info and isinstance(record.exc_info[1], ForeignPageError))


def _must_be_free(port: int) -> None:
    """Refuse a port at which something listens; viser would take the next one without a word."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that was closed a moment ago is free
        try:
            probe.bind((HOST, port))
        except OSError as error:
            taken = "is taken" if error.errno == errno.EADDRINUSE else f"cannot be used ({error.strerror})"
            raise ParameterError("--port", f"{taken}; give another one, or none for a free one", port) from None
