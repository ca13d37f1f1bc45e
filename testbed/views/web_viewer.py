"""Serve Rerun's web viewer, for a browser on this machine or, through ssh, on another one."""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import quote

from testbed.core.errors import InputError, install_command
from testbed.views import viewer
from testbed.views.sinks import PORT as DATA_PORT

ANY_HOST = "0.0.0.0"
HOSTS = (viewer.HOST, ANY_HOST)
PAGE_PORT = 9090  # Rerun's default


@dataclass(frozen=True, slots=True)
class WebViewer:
    """A web viewer that is being served.

    Attributes:
        host: one of `HOSTS`, on which it listens.
        page_port: of the page.
        port: on which the run sends the flight and the page receives it.
    """

    host: str
    page_port: int
    port: int

    @property
    def url(self) -> str:
        """Address of the page, for a browser; the colours are for a dark background."""
        name = socket.gethostname() if self.host == ANY_HOST else self.host
        data = quote(f"rerun+http://{name}:{self.port}/proxy", safe="")
        return f"http://{name}:{self.page_port}/?url={data}&theme=dark"

    @property
    def directions(self) -> tuple[str, str]:
        """Lines with the address, and how to open it."""
        if self.host == ANY_HOST:
            access = "whoever reaches this machine can see the flight, and send to the viewer"
        else:
            ports = (self.page_port, self.port)
            forwards = " ".join(f"-L {each}:{self.host}:{each}" for each in ports)
            access = (
                "only this machine reaches it; on another one, first write "
                f"ssh {forwards} {socket.gethostname()}"
            )
        return f"view: {self.url}", f"      {access}"


@contextlib.contextmanager
def serve_web_viewer(host: str = viewer.HOST) -> Iterator[WebViewer]:
    """Serve a web viewer until the context or this process ends, also by SIGKILL.

    Args:
        host: one of `HOSTS`.

    Raises:
        InputError: it is another one, or the viewer does not start.
    """
    if host not in HOSTS:
        raise InputError(
            f"--host {host}: write {viewer.HOST}, or {ANY_HOST} to let other machines reach it"
        )
    executable = viewer.rerun_program()
    if executable is None:
        raise InputError(
            f"there is no `rerun` program beside {sys.executable}: write {install_command('view')}"
        )
    served = WebViewer(host, _port(host, PAGE_PORT), _port(host, DATA_PORT))
    process = viewer.launch(
        executable,
        served.port,
        "--serve-web",
        "--web-viewer-port",
        str(served.page_port),
        guarded=True,
        host=host,
    )
    try:
        started = all(
            viewer.wait_until_listening(process, port) for port in (served.port, served.page_port)
        )
        if not started:
            raise InputError(
                f"the web viewer does not start; has another program taken port {served.port} or "
                f"{served.page_port}?"
            )
        yield served
    finally:
        viewer.kill(process)


def _port(host: str, usual: int) -> int:
    """Choose the usual port, or a free one where it is taken."""
    for port in (usual, 0):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    raise InputError(f"--host {host}: there is no free port")
