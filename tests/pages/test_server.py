"""The server of the live page: who gets an answer, and which."""

import http.client
import json
import socket
import struct
import threading
from contextlib import ExitStack

import pytest

import lin_freq_ocp as lfo
from helpers.patience import PATIENCE, wait_until
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.pages import MOST_BYTES, MOST_CONNECTIONS, ExploreServer, Handler, Session


@pytest.fixture(scope="module")
def server():
    with ExploreServer(Session(lfo.library.double_integrator())) as server:
        server.earlier = set(threading.enumerate())  # connections of a browser to another server may live on
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def asked(server, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=PATIENCE)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    reply = connection.getresponse()
    content = reply.read()
    connection.close()
    return reply, content


def posted(server, what, body, **headers):
    reply, content = asked(server, "POST", f"/{server.token}/{what}", body, **headers)
    return reply.status, json.loads(content)


def request(order=1, **more):
    return json.dumps({"page": "test", "order": order, "values": {}, **more})


def test_it_listens_on_this_machine_alone(server):
    assert server.server_address[0] == "127.0.0.1"
    assert server.url == f"http://127.0.0.1:{server.server_port}/{server.token}/"
    assert len(server.token) >= 20


def test_the_page_is_served_with_its_policy(server):
    reply, content = asked(server, "GET", f"/{server.token}/")
    assert reply.status == 200
    assert b"double_integrator" in content
    assert "default-src 'none'" in reply.headers["Content-Security-Policy"]
    assert reply.headers["Cache-Control"] == "no-store"
    assert reply.headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("path", ["/", "/wrong/", "/wrong/answer", "/{token}", "/{token}x/", "/%C3%A4/"])
def test_nothing_is_served_without_the_token(server, path):
    for method in ("GET", "POST"):
        reply, content = asked(server, method, path.format(token=server.token), request() if method == "POST" else None)
        assert reply.status == 403
        assert server.token not in content.decode()


@pytest.mark.parametrize("host", ["example.com", "127.0.0.1", "localhost:1", "127.0.0.1:{port}.example.com"])
def test_other_hosts_are_refused(server, host):
    reply, _ = asked(server, "GET", f"/{server.token}/", Host=host.format(port=server.server_port))
    assert reply.status == 403


def test_pages_of_other_sites_are_refused(server):
    assert posted(server, "answer", request(), Origin="http://example.com")[0] == 403
    assert posted(server, "answer", request(), Origin=f"http://127.0.0.1:{server.server_port}")[0] == 200


def test_nothing_else_is_served(server):
    assert asked(server, "GET", f"/{server.token}/../etc/passwd")[0].status == 404
    assert asked(server, "GET", f"/{server.token}/answer")[0].status == 404
    assert posted(server, "solve", request())[0] == 404
    assert asked(server, "PUT", f"/{server.token}/")[0].status == 501


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("{", "no JSON"),
        ("[1]", "list"),
        ("[" * 30000, "no JSON"),
        ('{"values": {}}', "order"),
        (request(values={"cutoff": 1e9}), "values.cutoff"),
        (request(values=3), "values"),
    ],
)
def test_a_bad_request_is_told_what_is_wrong(server, body, words):
    status, answer = posted(server, "answer", body)
    assert status == 400
    assert words in answer["error"]


def test_an_unknown_slider_has_no_cure(server):
    status, answer = posted(server, "cure", request(slider="colour"))
    assert status == 400
    assert "colour" in answer["error"]


def test_a_request_of_too_many_bytes_is_not_read(server):
    status, answer = posted(server, "answer", "", Content_Length=str(MOST_BYTES + 1))
    assert status == 400
    assert str(MOST_BYTES) in answer["error"]


def test_answers_are_those_of_solve(server):
    status, answer = posted(server, "answer", request())
    assert status == 200
    assert answer["status"] == "optimal"
    assert answer["cost"] == pytest.approx(lfo.solve(lfo.library.double_integrator()).cost, rel=1e-6)
    assert [one["name"] for one in posted(server, "compare", request())[1]["trajectories"]] == ["classical", "filtered"]
    assert posted(server, "cure", request(slider="cutoff"))[1]["key"] == "cutoff"


def test_an_overtaken_request_is_not_solved(server):
    assert "cost" in posted(server, "answer", request(7, page="other"))[1]
    assert posted(server, "answer", request(6, page="other")) == (200, {"overtaken": True})
    assert "cost" in posted(server, "answer", request(1, page="third"))[1]


def test_a_port_in_use_is_named(server):
    with pytest.raises(ProblemError, match=str(server.server_port)) as raised:
        ExploreServer(server.session, server.server_port)
    assert raised.value.field == "--port"


@pytest.mark.parametrize("length", ["²", "³1", "-1", "+5", "1_0", "0x10", "1.0", "", " ", "9" * 5000])
def test_what_is_no_length_is_a_bad_request(server, length):
    status, answer = posted(server, "answer", "", Content_Length=length)
    assert status == 400
    assert "Content-Length" in answer["error"]


def opened(server, sent=b""):
    connection = socket.create_connection(("127.0.0.1", server.server_port), timeout=PATIENCE)
    connection.sendall(sent)
    return connection


def served(server):
    """Return how many connections of the server have a thread."""
    new = set(threading.enumerate()) - server.earlier
    return sum("process_request_thread" in thread.name for thread in new)


HALF = b"POST /{token}/answer HTTP/1.1\r\nHost: {host}\r\nContent-Length: 100\r\n\r\n{{"


@pytest.mark.parametrize("sent", [b"", b"GET / HTT", b"GET / HTTP/1.1\r\nHost: ", HALF], ids=len)
def test_a_connection_that_falls_silent_is_closed(server, sent, monkeypatch, capsys):
    assert Handler.timeout
    monkeypatch.setattr(Handler, "timeout", 0.05)
    sent = sent.decode().format(token=server.token, host=server.hosts[0]).encode()
    with opened(server, sent) as connection:
        assert connection.recv(1) == b""
    assert capsys.readouterr().err == ""


def test_a_connection_that_is_reset_is_no_error(server, capsys):
    for sent in (b"", b"GET / HTTP/1.1\r\nHost: "):
        wait_until(lambda: not served(server))
        with opened(server, sent) as connection:
            wait_until(lambda: served(server))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    wait_until(lambda: not served(server))
    assert capsys.readouterr().err == ""


def test_there_are_at_most_so_many_connections(server):
    wait_until(lambda: not served(server))
    with ExitStack() as stack:
        for _ in range(MOST_CONNECTIONS):
            stack.enter_context(opened(server))
        wait_until(lambda: served(server) == MOST_CONNECTIONS)
        for _ in range(3):
            with opened(server) as connection:
                assert connection.recv(100).startswith(b"HTTP/1.1 503 ")
        assert served(server) == MOST_CONNECTIONS
    wait_until(lambda: not served(server))
    assert asked(server, "GET", f"/{server.token}/")[0].status == 200
