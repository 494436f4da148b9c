"""The live page as one HTML file, and its server for the browser on this machine alone.

The page is either live and asks its server, or contains a solved sweep and works from disk.

The server listens on the loopback address. Every path begins with a random token, and the Host header must name this
server, so that neither other users nor pages of other sites (by a name that resolves to 127.0.0.1) get an answer.
Requests are solved one after another; a request that a newer one of the same page has overtaken is not solved.
"""

from __future__ import annotations

import json
import re
import secrets
import sys
import threading
from contextlib import suppress
from dataclasses import asdict
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from socket import socket
from typing import NoReturn

from lin_freq_ocp.base.activity import activity, tell
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError, first_line
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.pages.explorer.session import FOLDED, GROUPS, Data, Session
from lin_freq_ocp.pages.explorer.sliders import Slider
from lin_freq_ocp.pages.templates import render_template
from lin_freq_ocp.problem.description import problem_facts

# Points of a solved sweep along a slider, the problem's value among them: two sliders vary together, the others alone.
PAIRED, ALONE = 7, 5
PAIR = "frequency", "bounds"  # the groups whose first sliders vary together

Connection = socket | tuple[bytes, socket]  # the second for datagrams, which never reach this server
LOOPBACK = "127.0.0.1"
MOST_BYTES = 1 << 16  # of a request: the values of a few sliders
TOKEN_BYTES = 16
IDLE_SECONDS = 30.0  # a connection without a byte for so long is closed; browsers open a new one on demand
MOST_CONNECTIONS = 32  # each has a thread; a browser opens six for a page
BUSY_ANSWER = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
LENGTH = re.compile("[0-9]{1,9}")  # of a request, in ASCII
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
}


def page(session: Session, solved: list[Data] | None = None) -> str:
    """Return the live page, or the page that contains these solved points."""
    data: Data = {"sliders": [asdict(slider) for slider in session.sliders], "points": solved}
    return render_template(
        "explore.html.jinja",
        title=session.problem.name or "Optimal control problem",
        facts=problem_facts(session.problem),
        cutoff=any(slider.key == "cutoff" for slider in session.sliders),
        live=solved is None,
        groups=[(key, heading) for key, heading in GROUPS.items() if key not in FOLDED],
        folded=[(key, GROUPS[key]) for key in FOLDED],
        data=data,
    )


@activity("solving the points")
def static_page(session: Session) -> str:
    """Return the page with a solved sweep."""
    grid = points(session.sliders)
    solved = list[Data]()
    for values in grid:
        solved.append({"values": values, "answer": session.answer(values), "compared": session.compare(values)})
        tell(f"{len(solved)} of {len(grid)} points")
    return page(session, solved)


def points(sliders: tuple[Slider, ...]) -> list[dict[str, float]]:
    """Return the values of all sliders at the points of a sweep."""
    paired = [slider for group in PAIR for slider in [slider for slider in sliders if slider.group == group][:1]]
    moves = [dict(pair) for pair in product(*(slider.samples(PAIRED) for slider in paired))]
    moves += [dict([sample]) for slider in sliders if slider not in paired for sample in slider.samples(ALONE)]
    start = {slider.key: slider.value for slider in sliders}
    unique = {tuple({**start, **values}.items()): None for values in moves}
    return [dict(values) for values in unique] or [start]


class OvertakenError(Exception):
    """A newer request of the same page has arrived, so that nobody waits for this answer."""


class ExploreServer(ThreadingHTTPServer):
    """A live page; ``url`` is its address, token included."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = False
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, session: Session, port: int = 0):
        try:
            super().__init__((LOOPBACK, port), Handler)
        except OSError as error:
            advice = "Without --port, a free one is taken."
            got = f"{port}, which cannot be used ({error.strerror})"
            raise ProblemError("--port", got, "a free port", advice) from None
        self.session, self.token = session, secrets.token_urlsafe(TOKEN_BYTES)
        self.page = page(session).encode()
        self._solving = threading.Lock()
        self._newest = dict[str, int]()
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._interrupted = threading.Event()

    def serve_until_interrupted(self) -> NoReturn:
        """Serve until Ctrl-C, which may arrive in any thread and is raised between connections."""
        with interrupts_noted() as self._interrupted:
            self.serve_forever()
        raise KeyboardInterrupt

    def service_actions(self) -> None:
        """End the server after Ctrl-C."""
        if self._interrupted.is_set():
            raise KeyboardInterrupt

    def process_request(self, request: Connection, client_address: object) -> None:
        """Serve a connection in its own thread; refuse it if there are too many."""
        if not self._free.acquire(blocking=False):
            with suppress(OSError):
                if isinstance(request, socket):
                    request.sendall(BUSY_ANSWER)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread was started
            self._free.release()
            raise

    def process_request_thread(self, request: Connection, client_address: object) -> None:
        """Serve a connection until it is closed."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Connection, client_address: object) -> None:
        """Print one line on an error, and nothing on a connection that was reset or timed out."""
        error = sys.exception()
        if isinstance(error, Exception) and not isinstance(error, (ConnectionError, TimeoutError)):
            print(f"error: a fault of lin-freq-ocp explore: {first_line(error)}", file=sys.stderr)

    @property
    def hosts(self) -> tuple[str, str]:
        """Return the Host headers of the server's page."""
        return f"{LOOPBACK}:{self.server_port}", f"localhost:{self.server_port}"

    @property
    def url(self) -> str:
        """Return the address of the page."""
        return f"http://{self.hosts[0]}/{self.token}/"

    def answer(self, question: str, request: dict[str, object]) -> Data:
        """Return the answer to a request; raise OvertakenError if a newer one of its page has arrived."""
        client, order = str(request.get("page")), request.get("order")
        if not isinstance(order, int):
            raise ProblemError("order", repr(order), "a whole number, larger with every move of a slider")
        self._newest[client] = max(order, self._newest.get(client, order))

        def is_newest() -> bool:
            return self._newest[client] == order

        with self._solving:
            if not is_newest():
                raise OvertakenError
            if question == "cure":
                return self.session.cure(request.get("values"), request.get("slider"), is_newest)
            return {"answer": self.session.answer, "compare": self.session.compare}[question](request.get("values"))


class Handler(BaseHTTPRequestHandler):
    """The handler of one connection."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = IDLE_SECONDS
    server_version, sys_version = "lin-freq-ocp", ""

    @property
    def _live(self) -> ExploreServer:
        assert isinstance(self.server, ExploreServer)
        return self.server

    def do_GET(self) -> None:
        """Answer with the page, the only thing to get."""
        path = self._path_after_token()
        if path == "":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", self._live.page)
        elif path is not None:
            self._refuse(HTTPStatus.NOT_FOUND, "There is only the page.")

    def do_POST(self) -> None:
        """Answer a question of the page."""
        path = self._path_after_token()
        if path is None:
            return
        if path not in ("answer", "compare", "cure"):
            self._refuse(HTTPStatus.NOT_FOUND, "expected answer, compare or cure")
            return
        try:
            self._send_json(HTTPStatus.OK, self._live.answer(path, self._read_request()))
        except OvertakenError:
            self._send_json(HTTPStatus.OK, {"overtaken": True})
        except LinFreqOCPError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except (ConnectionError, TimeoutError):  # the page has been closed, or stopped sending
            self.close_connection = True
        except Exception as error:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, f"a fault of lin-freq-ocp: {type(error).__name__}: {error}")

    def _path_after_token(self) -> str | None:
        """Return the path after the token; refuse the request, and return None, if host or token are wrong."""
        token, slash, rest = self.path.removeprefix("/").partition("/")
        origin, hosts = self.headers.get("Origin"), self._live.hosts
        if self.headers.get("Host") not in hosts or origin not in (None, *(f"http://{host}" for host in hosts)):
            self._refuse(HTTPStatus.FORBIDDEN, "not the page's own host")
        elif not secrets.compare_digest(token.encode(), self._live.token.encode()) or not slash:
            self._refuse(HTTPStatus.FORBIDDEN, "the address needs its token: open the one that lin-freq-ocp prints")
        else:
            return rest
        return None

    def _read_request(self) -> dict[str, object]:
        """Return the JSON object of the request."""
        length = self.headers.get("Content-Length", "")
        if not LENGTH.fullmatch(length) or int(length) > MOST_BYTES:
            self.close_connection = True  # the body is not read
            raise ProblemError("Content-Length", repr(length), f"at most {MOST_BYTES} bytes")
        content = self.rfile.read(int(length))
        try:
            request = json.loads(content)
        except (ValueError, RecursionError) as error:
            raise ProblemError("request", "no JSON", f"one JSON object ({error})") from None
        if not isinstance(request, dict):
            raise ProblemError("request", type(request).__name__, "one JSON object")
        return request

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self.close_connection = True  # the body may not have been read
        self._send_json(status, {"error": why})

    def _send_json(self, status: HTTPStatus, answer: Data) -> None:
        self._send(status, "application/json", json.dumps(answer, allow_nan=False, separators=(",", ":")).encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Log no requests."""
